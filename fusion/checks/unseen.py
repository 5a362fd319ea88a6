"""Quantities that a drive does not determine with any sensor, and the manoeuvre that would.

If all turns have one direction, errors of a clock, a mount and the track cannot be separated. Straight paths show
the distance scale, standstill shows a gyro's bias.
"""

from __future__ import annotations

import math

import numpy as np

from locfuse.fusion.data import Array, Drive, stretches

from .finding import Finding

UNSEEN = "unseen"  # code of the findings
MIN_TURN_RAD = math.radians(90.0)  # sum of turns, to the left and to the right
MAX_BEND_RAD, MIN_STRAIGHT_M = math.radians(5.0), 1.0  # of a straight path
MAX_SPEED_MPS, MAX_RATE_RADPS, MIN_STAND_S = 0.005, 0.005, 5.0  # of standstill


def unseen(drive: Drive) -> list[Finding]:
    """Return findings on quantities that this drive's motion does not determine."""
    t, heading = drive.wheels.t, drive.wheels.heading(drive.wheels.t)
    found = [_turning(heading), _straight(heading, drive.wheels.driven(t))]
    if "gyro" in drive.measurements:
        found.append(_standing(t, heading, drive.wheels.driven(t)))
    return [Finding("wheels", UNSEEN, words) for words in found if words]


def _turning(heading: Array) -> str:
    """Return a note if headings (n,) [rad, unwrapped] hardly turn to one of the two sides, else ""."""
    turns = np.diff(heading)
    left, right = float(turns[turns > 0.0].sum()), float(-turns[turns < 0.0].sum())
    if min(left, right) >= MIN_TURN_RAD:
        return ""
    turned = f"the robot turns {math.degrees(left):.0f}° to the left and {math.degrees(right):.0f}° to the right"
    return f"{turned}: a late clock, a mount and the track cannot be told apart. Turn on the spot, once each way"


def _straight(heading: Array, way: Array) -> str:
    """Return a note if no metre of the path length `way` (n,) [m] is straight, else ""."""
    begin = way[way + MIN_STRAIGHT_M <= way[-1]]
    ahead = [np.interp(begin + part * MIN_STRAIGHT_M, way, heading) for part in (0.0, 0.25, 0.5, 0.75, 1.0)]
    if (np.ptp(ahead, axis=0) <= MAX_BEND_RAD).any():
        return ""
    return "no metre of its way is straight, which tells no distance scale. Drive 3 m straight along a tape"


def _standing(t: Array, heading: Array, way: Array) -> str:
    """Return a note if the robot never stands still long enough to measure the gyro's bias, else ""."""
    period = np.diff(t)
    still = (np.diff(way) <= MAX_SPEED_MPS * period) & (np.abs(np.diff(heading)) <= MAX_RATE_RADPS * period)
    longest = max((float(t[last + 1] - t[first]) for first, last in stretches(still)), default=0.0)
    if longest >= MIN_STAND_S:
        return ""
    return f"it stands for {longest:.1f} s at most, which tells no offset of the gyro. Stand for 5 s first"
