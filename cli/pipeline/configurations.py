"""Which sets of sensors a command runs: the words of --sensors, or the paper's five, or every subset."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from locfuse.fusion.data import Drive, Estimates, LocfuseError, UsageError
from locfuse.fusion.fuse import configuration_name
from locfuse.fusion.judge.credit import subsets
from locfuse.fusion.measure import thinned
from locfuse.fusion.paper.preset import fuser
from locfuse.fusion.robot import Robot
from locfuse.fusion.sensors.registry import REGISTRY

RATE = re.compile(r"(\d+(?:\.\d+)?)\s*hz", re.IGNORECASE)
MOST_SUBSETS = 6  # sensors: 64 subsets


@dataclass(frozen=True)
class Configuration:
    """A set of sensors in registry order, some perhaps at a lower rate than the log has them."""

    name: str
    sensors: tuple[str, ...]
    rates: Mapping[str, float] = field(default_factory=dict)  # Hz

    def drive(self, drive: Drive) -> Drive:
        """Return the drive as this configuration sees it."""
        return thinned(drive, self.rates) if self.rates else drive

    def fuse(self, drive: Drive, robot: Robot, smooth: bool = False) -> tuple[Estimates, ...]:
        """Run the filter, and perhaps the smoother: (filtered,) or (filtered, smoothed).

        Raises UsageError where a filter does not weigh optimally that is to be smoothed.
        """
        if not smooth:
            return (fuser(robot.preset)(self.drive(drive), robot, self.sensors, self.name),)
        from locfuse.fusion.smooth import fuse_and_smooth

        return fuse_and_smooth(self.drive(drive), robot, self.sensors, self.name)


def parse(words: str, drive: Drive) -> Configuration:
    """Return the configuration that one --sensors names.

    Raises UsageError for an unknown word, LocfuseError for a sensor that this log lacks.
    """
    present = tuple(s for s in REGISTRY if s in drive.measurements)
    names = [w.strip() for w in words.replace("+", ",").split(",") if w.strip()]
    names = list(dict.fromkeys(names))
    if names == ["all"]:
        return plain(present, drive)
    if names == ["odometry"]:
        return plain((), drive)
    refuse_beside_others(words, names)
    rates: dict[str, float] = {}
    written: dict[str, str] = {}
    for name in names:
        sensor, at, rate = name.partition("@")
        if sensor not in REGISTRY:
            raise UsageError(
                f"--sensors: unknown sensor {sensor!r}; choose from odometry, {', '.join(REGISTRY)}, all"
            )
        if sensor not in present:
            raise LocfuseError(f"--sensors {name}: {drive.absent.get(sensor, 'no topic of its type in this log')}")
        written[sensor] = name
        if at:
            rates[sensor] = _rate(name, rate)
    sensors = tuple(s for s in REGISTRY if s in written)
    for sensor in sensors:
        lacking = [other for other in needs(sensor) if other not in sensors]
        if lacking:
            raise UsageError(
                f"--sensors {words}: {sensor} is held against the map of {lacking[0]}; "
                f"write --sensors {','.join((*lacking, *written.values()))}"
            )
    if not rates:
        return plain(sensors, drive)
    return Configuration("+".join(written[s] for s in sensors), sensors, rates)


def refuse_beside_others(words: str, names: Sequence[str]) -> None:
    """Raise UsageError where `all` or `odometry` is named together with other words."""
    meaning = {"all": "every sensor of the log", "odometry": "the wheels and no sensor"}
    for word, what in meaning.items():
        others = [name for name in names if name != word]
        if word in names and others:
            raise UsageError(
                f"--sensors {words}: {word} stands alone, it means {what}; write --sensors {word} or --sensors "
                f"{','.join(name for name in others if name not in meaning) or others[0]}"
            )


def _rate(name: str, text: str) -> float:
    """Return Hz. Raises UsageError for anything but a positive number followed by Hz."""
    found = RATE.fullmatch(text.strip())
    if found is None or float(found[1]) <= 0.0:
        raise UsageError(f"--sensors {name}: a lower rate reads like lrf@2Hz")
    return float(found[1])


def plain(sensors: tuple[str, ...], drive: Drive) -> Configuration:
    """Return a configuration of sensors at the rates of the log."""
    return Configuration(configuration_name(sensors, drive), sensors)


def needs(sensor: str) -> tuple[str, ...]:
    """Return the sensors without whose map this one says nothing."""
    return tuple(getattr(REGISTRY[sensor], "needs", ()))


def for_comparison(words: Sequence[str], drive: Drive, every: bool = False) -> list[Configuration]:
    """Return the configurations to compare.

    Those named; else odometry, each sensor alone (or with the one whose map it reads), and all; `every`: all
    subsets, and those named beside them.
    """
    present = tuple(s for s in REGISTRY if s in drive.measurements)
    named = [parse(w, drive) for w in words]
    if every:
        if len(present) > MOST_SUBSETS:
            raise UsageError(
                f"--all-subsets: {len(present)} sensors have {2 ** len(present)} subsets; leave it out"
            )
        named = [plain(s, drive) for s in subsets(present)] + named
    if not named:
        alone = [tuple(s for s in present if s in (name, *needs(name))) for name in present]
        together = [present] if len(present) > 1 else []
        named = [plain(s, drive) for s in [(), *alone, *together]]
    return list({c.name: c for c in named}.values())
