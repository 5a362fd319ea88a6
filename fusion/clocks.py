"""Whose clock is off? Every sensor's own turning is held against the wheels', then the others'.

Wheels slip: over a lap of the paper's robot they tell a lag to 7 ms at best (docs/trust.md). Two sensors see the
same turning, slips and all: so a clock that the wheels contradict is held against those that they do not.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

import numpy as np

from locfuse.fusion.sensors.registry import REGISTRY
from locfuse.fusion.wheels.motion import Wheels

from .data import Array, Measurements
from .lag import WORTH_SAYING, Lag, Reference, by_wheels, find_lag, worth_saying

FEWEST = 20  # readings
READINGS = 3000  # enough to find a lag: five minutes of a 10 Hz laser


def clock_lags(measurements: Mapping[str, Measurements], wheels: Wheels) -> dict[str, Lag]:
    """Return how far each sensor's clock is from the wheels', from the first minutes of the drive."""
    turned = {name: heading for name, m in measurements.items() if (heading := _heading(name, m)) is not None}
    found = {name: find_lag(*heading, by_wheels(wheels)) for name, heading in turned.items()}
    lags = {name: lag for name, lag in found.items() if lag is not None}
    right = {name: turned[name] for name, lag in lags.items() if abs(lag.offset) < WORTH_SAYING}
    return {
        name: _sharper(lag, turned[name], right, wheels) if worth_saying(lag) else lag
        for name, lag in lags.items()
    }


def _heading(name: str, m: Measurements) -> tuple[Array, Array] | None:
    """Return times (n,) [s] and headings (n,) [rad] of a sensor that knows its own turning."""
    heading = getattr(REGISTRY[name], "heading", None)
    if heading is None or len(m.t) < FEWEST:
        return None
    t, angle = heading(m.take(np.arange(min(len(m.t), READINGS))))
    known = np.isfinite(angle)
    return (t[known], angle[known]) if known.sum() >= FEWEST else None


def _sharper(lag: Lag, own: tuple[Array, Array], right: Mapping[str, tuple[Array, Array]], wheels: Wheels) -> Lag:
    """Return the lag against whose turning agrees best: the wheels', or that of a sensor."""
    lags = [lag]
    for name, (t, heading) in right.items():
        span = (float(t[0]), float(t[-1]))
        found = find_lag(*own, Reference(partial(_between, t, heading), span, wheels.heading))
        if found is not None:
            lags.append(found._replace(against=name))
    return max(lags, key=lambda lag: lag.correlation)


def _between(t: Array, heading: Array, at: Array) -> Array:
    return np.interp(at, t, heading)


def lag_notes(wheels: Wheels, measurements: Mapping[str, Measurements]) -> list[str]:
    """Say in words where a sensor's own turning runs behind or ahead of the wheels' by a constant time."""
    return [
        f"{name}: its turning {in_words(lag)}. If its clock is off, "
        f"--set {name}.time_offset={lag.offset:.2f} cures it"
        for name, lag in clock_lags(measurements, wheels).items()
        if worth_saying(lag)
    ]


def in_words(lag: Lag) -> str:
    """Return "runs 0.12 s behind the wheels' (correlation ...)"."""
    whose = "the wheels'" if lag.against == "wheels" else f"the {lag.against}'s, which agrees with the wheels'"
    return (
        f"runs {abs(lag.offset):.2f} s {side(lag.offset)} {whose} "
        f"(correlation {lag.without:.3f} as stamped, {lag.correlation:.3f} shifted)"
    )


def side(offset: float) -> str:
    """Return on which side of the wheels something is that needs this time_offset [s]."""
    return "behind" if offset < 0 else "ahead of"
