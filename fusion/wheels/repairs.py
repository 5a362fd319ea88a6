"""A wheel's counter made whole: without rollovers, spikes and restarts, and what was done in words."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from locfuse.fusion.data import Array, Ints

from .jumps import Mask, limits, restarted, spikes
from .rollover import Unrolled, unrolled


class Side(NamedTuple):
    """Readings of one wheel, finite and in strictly increasing time."""

    name: str  # left or right
    t: Array  # (n,) s
    value: Array  # (n,) in the message's unit
    likely: tuple[float, ...] = ()  # moduli that the message's type suggests


class Repaired(NamedTuple):
    """One wheel's way, and what had to be repaired."""

    keep: Ints  # (k,) readings that are not spikes
    rolled: Array  # (k,) m since the first reading
    spikes: int
    notes: tuple[str, ...]


def repaired(side: Side, metres: float, modulus: float | None, max_speed: float | None) -> Repaired:
    """Return how far a wheel has rolled; `metres` is what one unit of its readings is worth.

    `modulus` and `max_speed` are wheels.rollover and wheels.max_speed.
    """
    count = unrolled(side.value, modulus, side.likely)
    bad = _spikes(side.t, count.values * metres, max_speed)
    if bad.any():  # a spike may have hidden the modulus, or looked like a rollover
        count = unrolled(side.value[~bad], modulus, side.likely)
    keep = np.flatnonzero(~bad)
    t, rolled = side.t[keep], count.values * metres
    steps = np.diff(rolled)
    start_anew = np.abs(steps) > limits(t, steps, max_speed)
    restart = restarted(t, steps[:, None], start_anew)
    way = np.concatenate(([0.0], np.cumsum(restart.steps[:, 0])))
    jumps = steps[start_anew] / metres
    return Repaired(keep, way, int(bad.sum()), tuple(_words(side.name, count, int(bad.sum()), jumps.tolist())))


def _spikes(t: Array, rolled: Array, max_speed: float | None) -> Mask:
    return spikes(t, rolled[:, None], limits(t, np.diff(rolled), max_speed))


def _words(name: str, count: Unrolled, spiked: int, jumps: Sequence[float]) -> list[str]:
    words = []
    if count.modulus is not None:
        words.append(
            f"{name} counter rolled over {times(count.turns)}, taken as modulo {count.modulus:.10g}; "
            f"if that is wrong, set wheels.rollover (0: it never does)"
        )
    if spiked:
        words.append(
            f"{name} counter jumped away and back {spiked} readings long, not used; "
            "wheels.max_speed [m/s] says how far it may step"
        )
    if jumps:
        sizes = ", ".join(f"{j:+.6g}" for j in jumps[:3])
        words.append(
            f"{name} counter started anew {times(len(jumps))} (by {sizes}{' ...' if len(jumps) > 3 else ''}); "
            "the motion there is taken from around it; wheels.max_speed [m/s] says how far it may step"
        )
    return words


def times(n: int) -> str:
    """Return "once", "twice", "3 times"."""
    return {1: "once", 2: "twice"}.get(n, f"{n} times")


def gaps_of(n: int, longest_s: float) -> str:
    """Return "a gap of 1.2 s", "3 gaps, the longest 1.2 s"."""
    return f"a gap of {longest_s:.1f} s" if n == 1 else f"{n} gaps, the longest {longest_s:.1f} s"
