"""Encoder check: a wheel whose value stays the same while the other wheel rolls."""

from __future__ import annotations

import math

import numpy as np

from locfuse.fusion.data import Drive, stretches

from .finding import Finding
from .lag import headings

STUCK = "stuck"  # code of the finding on a wheel that stands still
MIN_TURN_RAD = 2.0 * math.pi  # about the standing wheel: robots rarely turn about one wheel for a whole turn
MIN_TURNED_SHARE = 0.5  # of that turn: a robot that did turn about one wheel turned by as much as wheels say


def of_stuck_wheel(drive: Drive) -> list[Finding]:
    """Return a finding if one wheel stands still while the other rolls, and no other sensor turns with them.

    Wheels say then that the robot turns about the standing one: a circle that few robots drive.
    """
    wheels, found = drive.wheels, []
    for i, side in enumerate(("left", "right")):
        other = np.concatenate(([0.0], np.cumsum(np.abs(wheels.rolled[:, 1 - i]))))
        for first, last in stretches(wheels.rolled[:, i] == 0.0):
            way, begin, end = float(other[last + 1] - other[first]), wheels.t[first], wheels.t[last + 1]
            if way > MIN_TURN_RAD * wheels.track and not _turned(drive, float(begin), float(end)):
                found.append((way, side, float(begin), float(end)))
    if not found:
        return []
    way, side, begin, end = max(found)
    words = (
        f"the {side} wheel stands still from {begin:.1f} s to {end:.1f} s, while the other one rolls {way:.1f} m; "
        "check its encoder"
    )
    return [Finding("wheels", STUCK, words, severe=True)]


def _turned(drive: Drive, begin: float, end: float) -> bool:
    """Return whether the truth or a sensor turns at least half as far as the wheels between two times [s]."""
    by_wheels = float(np.diff(drive.wheels.heading(np.array((begin, end))))[0])
    sources, truth = [*headings(drive.measurements).values()], drive.truth
    if truth is not None and truth.theta is not None:
        sources.append((truth.t, np.unwrap(truth.theta)))
    turns = (float(np.diff(np.interp((begin, end), *source))[0]) for source in sources)
    return any(turn / by_wheels > MIN_TURNED_SHARE for turn in turns)
