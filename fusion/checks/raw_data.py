"""Checks of raw data: two publishers of a topic, counters that stand still, wheels in other units."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from msgspec.structs import replace

from locfuse.fusion import se2
from locfuse.fusion.data import Array, Drive, Stream, Truth, changes, stretches, totals
from locfuse.fusion.robot import Robot
from locfuse.fusion.streams import parts_of
from locfuse.fusion.wheels.motion import Wheels
from locfuse.fusion.wheels.odometry import BODY_READS
from locfuse.fusion.wheels.read import SPEEDS_ALONE, counts_ticks
from locfuse.fusion.wheels.repairs import MAX_HELD_FACTOR

from .finding import Finding
from .truth import UNIT, wheels_metre
from .turning import (
    MIN_RMS_TURN_RAD,
    MIN_WINDOWS,
    Headings,
    and_truth,
    headings_of,
    source_words,
    true_headings,
    turnings,
)

PUBLISHERS = "publishers"  # code of the finding on a topic to which two publishers write
MIN_CHANGES = 10  # from one publisher to the other
STUCK = "stuck"  # code of the finding on a wheel that stands still
MIN_TURN_RAD = 2.0 * math.pi  # about the standing wheel: robots rarely turn about one wheel for a whole turn
MIN_SHORT_TURN_RAD = math.radians(15.0)  # about the standing wheel, if other sensors show that it rolls
MIN_BOTH_M = 0.3  # of the truth, while both counters stand still
MIN_STRAIGHT_M, MIN_TRUTH_SIGMAS = 0.08, 6.0  # of a straight line over a turn about one wheel, by the truth
MIN_TURNED_SHARE = 0.5  # of that turn: a robot that did turn about one wheel turned by as much as wheels say
UNSIGNED = "unsigned"  # code of the finding on encoders without a sign
WINDOW_S, MAX_PERIOD_S = 1.0, 0.5  # s over which turns are compared; between two readings of the wheels
MIN_SPOT_TURN_RAD, MIN_SPOT_RAD = math.radians(5.0), math.radians(45.0)  # turn on the spot: in a window, in all
MIN_SPOT_SHARE, MAX_SPOT_SHARE = 0.5, 2.0  # ratio of a turn to that of both wheels in opposite directions
MIN_SPEED_MPS = 0.02  # mean of the drive
MAX_LN_TURNS = 0.25  # of (sensor's turns / wheels' turns), in the right unit


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


def of_signs(drive: Drive) -> list[Finding]:
    """Return a finding if wheels never roll back, but a sensor turns as with one wheel that does.

    Encoders with one channel count without a sign: on the spot, both wheels seem to roll ahead.
    """
    wheels, found = drive.wheels, dict[str, float]()
    if wheels.rolled.min(initial=0.0) < 0.0 or np.median(np.diff(wheels.t)) > MAX_PERIOD_S:
        return []
    for name, (t, angle, without_lines) in (headings_of(drive) | true_headings(drive)).items():
        start = t[(t >= wheels.t[0]) & (t + WINDOW_S <= min(t[-1], wheels.t[-1]))]
        if len(start) < MIN_WINDOWS:
            continue
        turned = np.abs(changes(start, WINDOW_S, t, angle))
        if without_lines is not None:
            turned[changes(start, WINDOW_S, t, without_lines) > 0.0] = 0.0
        left, right = changes(start, WINDOW_S, wheels.t, totals(wheels.rolled)).T / wheels.track
        share = turned / np.maximum(left + right, 1e-9)  # 1 on the spot; far more if the wheels roll too little
        spot = (turned > MIN_SPOT_TURN_RAD) & (share > MIN_SPOT_SHARE) & (share < MAX_SPOT_SHARE)
        spot &= np.abs(right - left) < MIN_TURNED_SHARE * turned
        if spot.any():
            found[name] = float(turned[spot].sum() * np.median(np.diff(start))) / WINDOW_S
    name = max(found, key=lambda one: found[one], default="")
    if found.get(name, 0.0) < MIN_SPOT_RAD:
        return []
    far = f"{math.degrees(found[name]):.0f}° on the spot"
    words = f"they never roll back, but by {source_words(name)} the robot turns {far}: they count without a sign"
    return [Finding("wheels", UNSIGNED, words, severe=True)]


class Unit(NamedTuple):
    """A unit in which wheels may be given, instead of radians and seconds."""

    words: str
    factor: float  # of the unit in a radian, or in a radian per second
    per_revolution: float
    margin: float  # largest error of radius and track, as factor
    of_speeds: bool = False


UNITS: tuple[Unit, ...] = (
    Unit("their angles look like degrees", math.degrees(1.0), 360, 1.3),
    # a radius of cm instead of mm is near
    Unit("their speeds look like revolutions per minute (60 / (2 pi))", 30.0 / math.pi, 60, 1.04, True),
)


class Standstill(NamedTuple):
    """A time in which a counter stands still although the robot drives."""

    distance: float  # m that the other wheel rolls, or that the truth moves if both wheels stand
    begin: float  # s
    end: float  # s


def of_stuck_wheel(drive: Drive) -> list[Finding]:
    """Return a finding if counters stand still at times in which the robot drives.

    If one stands, wheels say that the robot turns about it: a circle that few robots drive. Other sensors show
    shorter times: they do not turn so, and the counter starts and stops at full speed. If both stand, the truth
    moves.
    """
    still = drive.wheels.rolled == 0.0
    sources = [*(headings_of(drive) | true_headings(drive)).values()]
    found = {
        side: [s for first, last in stretches(still[:, i]) if (s := _alone(drive, sources, i, first, last))]
        for i, side in enumerate(("left", "right"))
    }
    found["both"] = [s for first, last in stretches(still.all(axis=1)) if (s := _both(drive, first, last))]
    side, times = max(found.items(), key=lambda one: sum(s.distance for s in one[1]))
    if not times:
        return []
    who = "both wheels stand still from" if side == "both" else f"the {side} wheel stands still from"
    whom = "the truth moves" if side == "both" else "the other one rolls"
    when = f"{times[0].begin:.1f} s to {times[0].end:.1f} s"
    when += f" (the first of {len(times)} times)" if len(times) > 1 else ""
    words = f"{who} {when}, while {whom} {sum(s.distance for s in times):.1f} m; check the encoder"
    return [Finding("wheels", STUCK, words, severe=True)]


def _alone(drive: Drive, sources: Sequence[Headings], side: int, first: int, last: int) -> Standstill | None:
    """Return the standstill of one counter in the intervals from `first` to `last`; None if it is right."""
    wheels = drive.wheels
    ways = wheels.rolled[first : last + 1, 1 - side]
    distance, begin, end = float(np.abs(ways).sum()), float(wheels.t[first]), float(wheels.t[last + 1])
    by_wheels = float(np.diff(wheels.heading(np.array((begin, end))))[0])
    shown = [t * by_wheels > MIN_TURNED_SHARE * by_wheels**2 for t in _turns(sources, begin, end)]  # it may be 0
    if not shown and (straight := _drives_straight(drive, begin, end, float(ways.sum()))) is not None:
        shown = [not straight]
    stuck = distance > MIN_TURN_RAD * wheels.track
    if shown and abs(by_wheels) > MIN_SHORT_TURN_RAD:
        stuck |= _is_abrupt(wheels, np.abs(wheels.rolled[:, side]), first, last, distance)
    return Standstill(distance, begin, end) if stuck and not any(shown) else None


def _both(drive: Drive, first: int, last: int) -> Standstill | None:
    """Return the standstill of both counters in the intervals from `first` to `last`; None if it is right."""
    wheels, truth = drive.wheels, drive.truth
    begin, end = float(wheels.t[first]), float(wheels.t[last + 1])
    if truth is None or not _covers(truth.t, begin, end):
        return None
    moved = float(np.hypot(*_moved(truth, begin, end)))
    if moved < max(MIN_BOTH_M, MIN_TRUTH_SIGMAS * truth.sigma):
        return None
    abrupt = _is_abrupt(wheels, np.abs(wheels.rolled).mean(axis=1), first, last, moved)
    return Standstill(moved, begin, end) if abrupt else None


def _is_abrupt(wheels: Wheels, ways: Array, first: int, last: int, distance: float) -> bool:
    """Return whether speeds by `ways` (n-1,) [m] before and after the intervals are like that of `distance`."""
    speed = distance / (wheels.t[last + 1] - wheels.t[first])
    beside = [i for i in (first - 1, last + 1) if 0 <= i < len(ways)]
    rates = ways[beside] / np.diff(wheels.t)[beside] / speed
    return len(beside) > 0 and bool((rates > 1.0 / MAX_HELD_FACTOR).all() and (rates < MAX_HELD_FACTOR).all())


def _turns(sources: Sequence[Headings], begin: float, end: float) -> list[float]:
    """Return the turns [rad] of all sources with readings between two times [s]."""
    found = []
    for t, angle, without_lines in sources:
        some = slice(*np.searchsorted(t, (begin, end)))
        if _covers(t, begin, end) and (without_lines is None or not np.ptp(without_lines[some])):
            found.append(float(np.diff(np.interp((begin, end), t, angle))[0]))
    return found


def _covers(t: Array, begin: float, end: float) -> bool:
    """Return whether times (n,) [s] begin before a time, end after it, and have two readings in it."""
    return bool(len(t) and t[0] <= begin and end <= t[-1] and np.diff(np.searchsorted(t, (begin, end)))[0] > 1)


def _moved(truth: Truth, begin: float, end: float) -> Array:
    return np.array([np.diff(np.interp((begin, end), truth.t, axis))[0] for axis in truth.xy.T])


def _drives_straight(drive: Drive, begin: float, end: float, ahead: float) -> bool | None:
    """Return whether the truth moves as with `ahead` [m] of both wheels, instead of as by the wheels; or None."""
    truth = drive.truth
    if truth is None or not _covers(truth.t, begin, end):
        return None
    by_wheels, point = drive.wheels.relative(np.array(begin), np.array(end)), np.array(truth.point)
    turning = float(np.hypot(*(by_wheels[:2] + se2.rotated(by_wheels[2], point) - point)))
    if abs(ahead) - turning < max(MIN_STRAIGHT_M, MIN_TRUTH_SIGMAS * truth.sigma):
        return None
    return float(np.hypot(*_moved(truth, begin, end))) > 0.5 * (abs(ahead) + turning)


def of_wheel_unit(drive: Drive, robot: Robot, msgtype: str) -> list[Finding]:
    """Return a finding if the wheels' angles or speeds seem to have another unit.

    Then the wheels drive farther than the truth or another sensor, by the factor of this unit.
    """
    wheels = drive.wheels
    if msgtype in BODY_READS:
        return _of_rate_unit(drive, robot)
    if counts_ticks(msgtype):
        return []
    units, ticks = UNITS, robot.wheels.ticks_per_revolution
    if ticks is not None:
        units = (Unit("their readings look like radians, not ticks", 2.0 * math.pi / ticks, 2.0 * math.pi, 1.3),)
    speed = float(wheels.driven(wheels.t[-1])) / float(wheels.t[-1] - wheels.t[0])
    for unit in units:
        if 1.0 / unit.margin < unit.factor < unit.margin:
            continue  # configured so
        if speed < MIN_SPEED_MPS * unit.factor or (unit.of_speeds and SPEEDS_ALONE not in drive.repairs):
            continue
        smaller = replace(drive, wheels=wheels.rerolled(wheels.rolled / unit.factor, wheels.track))
        ratios = {name: (t.a - t.b) * wheels.track / 2.0 for name, t in turnings(smaller).items()}
        if (by_truth := wheels_metre(smaller)) is not None:
            ratios["truth"] = by_truth[0]
        by = [name for name, ratio in ratios.items() if 1.0 / unit.margin < ratio < unit.margin]
        if by:
            words = f"by {', '.join(by)} they roll about {unit.factor:.3g} times as far as the robot: {unit.words}"
            fix = f"wheels.ticks_per_revolution={unit.per_revolution:.6g}"
            return [Finding("wheels", UNIT, words, (fix,), True)]
    return []


def _of_rate_unit(drive: Drive, robot: Robot) -> list[Finding]:
    """Return a finding if the turns of an odometry look like degrees: other sensors turn less far."""
    wheels, degrees = drive.wheels, math.degrees(1.0)
    rate = float(np.sqrt(np.square(wheels.twist[:, 2] / np.diff(wheels.t)).mean()))
    if rate * WINDOW_S < 0.5 * degrees * MIN_RMS_TURN_RAD:
        return []  # a sensor that turned so little would not be compared
    smaller = Wheels.from_twists(wheels.t, wheels.twist / [1.0, 1.0, degrees], wheels.track, wheels.noise)
    fits = and_truth(replace(drive, wheels=smaller), turnings(replace(drive, wheels=smaller)))
    by = [n for n, t in fits.items() if abs(math.log(max((t.a - t.b) * wheels.track / 2.0, 1e-9))) < MAX_LN_TURNS]
    if not by:
        return []
    words = f"by {', '.join(by)} they turn about 57.3 times as far as the robot: their rates look like degrees/s"
    return [Finding("wheels", UNIT, words, (f"wheels.turn_scale={robot.wheels.turn_scale / degrees:.4g}",), True)]
