"""Wheel radius and track, by comparing wheel angles with an odometry that the robot computed from them."""

from __future__ import annotations

from typing import NamedTuple

import msgspec
import numpy as np

from locfuse.fusion import se2
from locfuse.fusion.data import Array, LocfuseError, Stream, changes
from locfuse.fusion.robot import Mirrored, WheelSettings

from .read import SIGNS, WheelReading, read_wheels
from .repairs import repaired
from .sources import Counters, read_counters

WINDOW_S = 0.5  # s, window in which both are compared
ASSUMED_RADIUS_M = 0.05  # m: radius assumed until it is known
MIN_WINDOWS, MIN_CORRELATION = 40, 0.95  # windows; correlation
EQUAL_CORRELATION = 1e-3  # correlations that differ by less are equal: on a circle all combinations of signs fit
MIN_TURN_RAD = 0.5  # rad, root of the sum of squared turns, from which the track is estimated


class Geometry(NamedTuple):
    """Wheel radius and track with which the robot's odometry was computed."""

    radius: float  # m; if ticks_per_revolution is not configured, a tick counts as 1 rad: metres per tick
    track: float | None  # m; None if the robot hardly turned
    mirrored: Mirrored = "none"  # wheels that count backwards while the robot drives forward
    sigmas: tuple[float, float] = (0.0, 0.0)  # standard deviations of radius and track, by the residuals


def by_odometry(counters: Stream, odometry: Stream, settings: WheelSettings) -> Geometry | None:
    """Fit radius and track to wheel angles and the motion of an odometry; None if they do not agree."""
    try:
        return by_motion(counters, read_wheels(odometry, WheelSettings()), settings)
    except LocfuseError:
        return None


def by_motion(counters: Stream, theirs: WheelReading, settings: WheelSettings) -> Geometry | None:
    """Fit wheel radius and track to wheel angles and a body motion `theirs`.

    None if wheels and body motion disagree or overlap too little in time. Raises LocfuseError if the counters
    cannot be read.
    """
    known = msgspec.structs.replace(settings, ticks_per_revolution=settings.ticks_per_revolution or None)
    both = read_counters(counters, known)
    t, left, right = _angles(both, known)
    offset = (theirs.epoch_ns - both.zero_ns) * 1e-9
    begin, end = max(t[0], offset), min(t[-1], offset + theirs.wheels.t[-1])
    windows = np.unique(np.floor((t - begin) / WINDOW_S))  # only windows with readings: clocks may differ by years
    start = begin + WINDOW_S * windows
    start = start[(windows >= 0.0) & (start < end - WINDOW_S)]
    if len(start) < MIN_WINDOWS:
        return None
    # as twists, since the wheels roll along the arc, not along its chord
    moved = se2.log(theirs.wheels.relative(start - offset, start - offset + WINDOW_S))
    rolled = [changes(start, WINDOW_S, t, side) for side in (left, right)]
    return _best(rolled[0], rolled[1], moved)


def _angles(both: Counters, settings: WheelSettings) -> tuple[Array, Array, Array]:
    """Return times (n,) [s] and the repaired angles of both wheels (n,) [rad]."""
    turn = 2.0 * np.pi / settings.ticks_per_revolution if settings.ticks_per_revolution else 1.0
    how = ASSUMED_RADIUS_M * turn, settings.rollover, None
    left, right = (repaired(side, *how) for side in (both.left, both.right))
    t = both.left.t[left.keep]
    at_left = np.interp(t, both.right.t[right.keep], right.rolled / ASSUMED_RADIUS_M)
    return t, left.rolled / ASSUMED_RADIUS_M, at_left


def _best(left: Array, right: Array, moved: Array) -> Geometry | None:
    """Fit the geometry with the wheel directions that agree best with the motion; None if even these disagree.

    The configured directions are kept if they agree equally well. Wheel angles left, right (n,) [rad]; body twists
    `moved` (n, 3).
    """
    means = {mirrored: 0.5 * (a * left + b * right) for mirrored, (a, b) in SIGNS.items()}
    agrees = {mirrored: _correlation(mean, moved[:, 0]) for mirrored, mean in means.items()}
    best = max(agrees, key=lambda mirrored: agrees[mirrored] + (EQUAL_CORRELATION if mirrored == "none" else 0.0))
    s_left, s_right = SIGNS[best]
    found = _fitted(means[best], s_right * right - s_left * left, moved)
    return None if found is None else found._replace(mirrored=best)


def _correlation(a: Array, b: Array) -> float:
    return float(np.corrcoef(a, b)[0, 1]) if np.std(a) > 0.0 and np.std(b) > 0.0 else -1.0


def _fitted(mean: Array, difference: Array, moved: Array) -> Geometry | None:
    ahead, turn = moved[:, 0], moved[:, 2]
    if _correlation(mean, ahead) < MIN_CORRELATION:
        return None
    radius = float((mean * ahead).sum() / (mean**2).sum())
    off = float(np.std(ahead - radius * mean) / np.sqrt((mean**2).sum()))
    turns = float(np.sqrt((turn**2).sum()))
    if turns < MIN_TURN_RAD or float(np.corrcoef(difference, turn)[0, 1]) < MIN_CORRELATION:
        return Geometry(radius, None, sigmas=(off, 0.0))
    per_turn = float((difference**2).sum() / (difference * turn).sum())
    off_turn = float(np.std(difference - per_turn * turn) / turns)
    return Geometry(radius, radius * per_turn, sigmas=(off, float(np.hypot(radius * off_turn, per_turn * off))))
