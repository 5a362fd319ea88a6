"""Checks of raw data: a topic with two publishers, a wheel that stands still, wheel angles in degrees."""

from __future__ import annotations

import math
from collections import Counter

import numpy as np
from msgspec.structs import replace

from locfuse.fusion.data import Drive, Stream, stretches, totals
from locfuse.fusion.robot import Robot
from locfuse.fusion.streams import parts_of
from locfuse.fusion.wheels.read import counts_ticks

from .finding import Finding
from .lag import headings
from .truth import UNIT, wheels_metre
from .turning import turnings

PUBLISHERS = "publishers"  # code of the finding on a topic to which two publishers write
MIN_CHANGES = 10  # from one publisher to the other


def of_publishers(name: str, stream: Stream, two_sources: bool = False) -> list[Finding]:
    """Return a finding for each topic of a role whose messages come from two publishers in turn.

    `two_sources`: the values of the readings show it (Measurements.two_sources).
    """
    found = []
    for part in parts_of(stream):
        frames = np.array(getattr(part, "frames", ()))
        two = Counter(frames.tolist()).most_common(2)
        changes = int((frames[1:] != frames[:-1]).sum())
        if len(two) == 2 and changes >= max(two[1][1], MIN_CHANGES):
            how = f"mixes messages of two frames in turn, {two[0][0]} and {two[1][0]}"
        elif two_sources:
            how = "has scans that are like the one before the last, not like the last"
        else:
            continue
        words = f"{part.topic} {how}: two publishers. Record each on a topic of its own"
        found.append(Finding(name, PUBLISHERS, words, severe=True))
    return found


STUCK = "stuck"  # code of the finding on a wheel that stands still
MIN_TURN_RAD = 2.0 * math.pi  # about the standing wheel: robots rarely turn about one wheel for a whole turn
MIN_TURNED_SHARE = 0.5  # of that turn: a robot that did turn about one wheel turned by as much as wheels say
DEGREES = math.degrees(1.0)  # in a radian
MAX_UNIT_RATIO = 1.3  # of that ratio, either way: errors of radius and track are smaller
MIN_SPEED_MPS = 1.0  # mean of the drive, by angles in degrees: that of a robot with 2 cm/s


def of_stuck_wheel(drive: Drive) -> list[Finding]:
    """Return a finding if one wheel stands still while the other rolls, and no other sensor turns with them.

    Wheels say then that the robot turns about the standing one: a circle that few robots drive.
    """
    wheels, found = drive.wheels, []
    for i, side in enumerate(("left", "right")):
        other = totals(np.abs(wheels.rolled[:, 1 - i]))
        for first, last in stretches(wheels.rolled[:, i] == 0.0):
            distance = float(other[last + 1] - other[first])
            begin, end = float(wheels.t[first]), float(wheels.t[last + 1])
            if distance > MIN_TURN_RAD * wheels.track and not _turned(drive, begin, end):
                found.append((distance, side, begin, end))
    if not found:
        return []
    distance, side, begin, end = max(found)
    words = (
        f"the {side} wheel stands still from {begin:.1f} s to {end:.1f} s, while the other one rolls "
        f"{distance:.1f} m; check its encoder"
    )
    return [Finding("wheels", STUCK, words, severe=True)]


def _turned(drive: Drive, begin: float, end: float) -> bool:
    """Return whether the truth or a sensor turns at least half as far as the wheels between two times [s]."""
    by_wheels = float(np.diff(drive.wheels.heading(np.array((begin, end))))[0])
    sources, truth = [*headings(drive.measurements).values()], drive.truth
    if truth is not None and truth.theta is not None:
        sources.append((truth.t, np.unwrap(truth.theta)))
    turns = (float(np.diff(np.interp((begin, end), *source))[0]) for source in sources)
    return any(turn * by_wheels > MIN_TURNED_SHARE * by_wheels**2 for turn in turns)  # by_wheels may be 0


def of_degrees(drive: Drive, robot: Robot, msgtype: str) -> list[Finding]:
    """Return a finding if the wheels' angles are in degrees: the truth or a sensor turns 57 times less far."""
    wheels = drive.wheels
    speed = float(wheels.driven(wheels.t[-1])) / float(wheels.t[-1] - wheels.t[0])
    if robot.wheels.ticks_per_revolution is not None or counts_ticks(msgtype) or speed < MIN_SPEED_MPS:
        return []
    smaller = replace(drive, wheels=wheels.rerolled(wheels.rolled / DEGREES, wheels.track))
    ratios = {name: (t.a - t.b) * wheels.track / 2.0 for name, t in turnings(smaller).items()}
    if (by_truth := wheels_metre(smaller)) is not None:
        ratios["truth"] = by_truth[0]
    by = [name for name, ratio in ratios.items() if 1.0 / MAX_UNIT_RATIO < ratio < MAX_UNIT_RATIO]
    if not by:
        return []
    words = f"by {', '.join(by)} they roll about {DEGREES:.0f} times too far: their angles look like degrees"
    return [Finding("wheels", UNIT, words, ("wheels.ticks_per_revolution=360",), True)]
