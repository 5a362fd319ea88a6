"""Which sets of sensors a command runs: the words of --sensors, or the paper's five."""

from __future__ import annotations

from collections.abc import Sequence

from ..fusion.data import Drive, LocfuseError, UsageError
from ..fusion.sensors.registry import REGISTRY

Sensors = tuple[str, ...]


def parse(words: str, drive: Drive) -> Sensors:
    """Return the sensors that one --sensors names, in registry order.

    Raises UsageError for an unknown word, LocfuseError for a sensor that this log lacks.
    """
    present = tuple(s for s in REGISTRY if s in drive.measurements)
    names = [w.strip() for w in words.replace("+", ",").split(",") if w.strip()]
    if names == ["all"]:
        return present
    if names == ["odometry"]:
        return ()
    for name in names:
        if name not in REGISTRY:
            raise UsageError(
                f"--sensors: unknown sensor {name!r}; choose from odometry, {', '.join(REGISTRY)}, all"
            )
        if name not in present:
            raise LocfuseError(f"--sensors {name}: {drive.absent.get(name, 'not in this log')}")
    return tuple(s for s in REGISTRY if s in names)


def for_comparison(words: Sequence[str], drive: Drive) -> list[Sensors]:
    """Return the configurations to compare: those named, else odometry, each sensor alone, and all."""
    if words:
        return list(dict.fromkeys(parse(w, drive) for w in words))
    present = tuple(s for s in REGISTRY if s in drive.measurements)
    alone: list[Sensors] = [(s,) for s in present]
    together = [present] if len(present) > 1 else []
    return [(), *alone, *together]
