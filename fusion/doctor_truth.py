"""Can the truth judge this drive? Its clock, jumps and gaps, the point it tracked, and where the drive starts."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from . import se2
from .data import Array, Drive, Truth
from .jumps import Mask, spikes
from .oddity import Oddity
from .robot import Robot

WINDOW = 1.0  # s over which ways are compared
LONGEST, STEP = 1.5, 0.02  # s
WORTH, BETTER, AGREES = 0.06, 0.75, 0.9
BLOCKS = 8  # stretches of the drive whose estimates must agree
LEAST_WAY, OFF_METRE, SPOILS_METRE = 0.1, 0.03, 0.05  # m per window; relative errors of the wheels' metre
GAP, GAP_PERIODS = 0.5, 5.0
FASTER, JUMP = 3.0, 0.3  # a step is a jump if it is this many times the wheels', and this much [m] more
OFF_POINT = 0.05  # m, of the tracked point
OFF_START, OFF_HEADING = 0.05, math.radians(5.0)
BEGINNING = 3.0  # m of the drive from which the start pose is told
LEAST_TURN = math.radians(60.0)


def of_truth(drive: Drive, robot: Robot) -> list[Oddity]:
    """Return what is odd about the truth."""
    truth = drive.truth
    if truth is None or len(truth.t) < 5:
        return []
    jumps = _jumps(truth, drive)
    found = [*jumps, *_gaps(truth), *_clock(truth, drive, robot), *_point(truth, drive)]
    return [*found, *([] if jumps else _start(truth, drive, robot))]


def _gaps(truth: Truth) -> list[Oddity]:
    dt = np.diff(truth.t)
    long = dt > max(GAP, GAP_PERIODS * float(np.median(dt)))
    if not long.any():
        return []
    words = f"silent {int(long.sum())} times, at most {float(dt.max()):.1f} s; errors there do not exist"
    return [Oddity("gap", "truth", words)]


def _jumps(truth: Truth, drive: Drive) -> list[Oddity]:
    """Steps that are metres longer than the wheels rolled meanwhile: a tracker that lost its body."""
    limit = step_limits(truth, drive)
    away = spikes(truth.t, truth.xy, limit)
    long = np.hypot(*np.diff(truth.xy, axis=0).T) > limit
    stays = int(long.sum()) - 2 * _runs(away)
    if not long.any():
        return []
    fastest = float(np.percentile(np.abs(drive.wheels.twist[:, 0]) / np.diff(drive.wheels.t), 99.0))
    speed = max(1.0, math.ceil(3.0 * fastest))
    words = f"it jumps {int(long.sum())} times by more than the wheels rolled"
    words += f"; {int(away.sum())} readings can be left out" if away.any() else ""
    words += f"; {stays} jumps do not return, and errors across them mean nothing" if stays > 0 else ""
    return [Oddity("jump", "truth", words, (f"truth.max_speed={speed:g}",), True)]


def step_limits(truth: Truth, drive: Drive) -> Array:
    """How far the truth may step (n-1,) [m], given what the wheels rolled meanwhile."""
    wheels = drive.wheels
    way = np.interp(truth.t, wheels.t, np.concatenate(([0.0], np.cumsum(np.abs(wheels.rolled).max(axis=1)))))
    limit: Array = FASTER * np.diff(way) + JUMP + 6.0 * truth.sigma
    return limit


def _runs(mask: Mask) -> int:
    return int((np.diff(mask.astype(int), prepend=0) > 0).sum())


class Match(NamedTuple):
    """A lag, and how well speeds correlate there and as stamped."""

    offset: float
    correlation: float
    without: float


def _clock(truth: Truth, drive: Drive, robot: Robot) -> list[Oddity]:
    """Compare how far truth and wheels moved in each second, at every lag."""
    match = way_lag(truth, drive)
    if match is None or abs(match.offset) < WORTH or match.correlation < AGREES:
        return []
    if 1.0 - match.correlation > BETTER * (1.0 - match.without):
        return []
    words = (
        f"it moves {abs(match.offset):.2f} s {'after' if match.offset < 0 else 'before'} the wheels "
        f"(correlation of speeds {match.without:.3f} as stamped, {match.correlation:.3f} shifted)"
    )
    offset = robot.truth.time_offset + match.offset
    return [Oddity("lag", "truth", words, (f"truth.time_offset={offset:.2f}",), abs(match.offset) > 0.1)]


def way_lag(truth: Truth, drive: Drive) -> Match | None:
    """Return the lag at which the truth's speed follows the wheels' best; None where speed hardly changes."""
    wheels = drive.wheels
    inside = (truth.t > wheels.t[0] + LONGEST) & (truth.t < wheels.t[-1] - LONGEST - WINDOW)
    start = truth.t[inside & (truth.t + WINDOW <= truth.t[-1])]
    if len(start) < 20:
        return None
    ends = [np.stack([np.interp(start + s, truth.t, c) for c in truth.xy.T], axis=-1) for s in (0.0, WINDOW)]
    own = np.hypot(*(ends[1] - ends[0]).T)
    if own.std() < 0.02 or own.std() < 0.1 * own.mean():
        return None
    lags = np.arange(-LONGEST, LONGEST + STEP / 2, STEP)
    scores = []
    for lag in lags.tolist():
        theirs = np.hypot(*wheels.relative(start + lag, start + lag + WINDOW)[:, :2].T)
        scores.append(float(np.corrcoef(own, theirs)[0, 1]) if theirs.std() > 0 else 0.0)
    best = int(np.argmax(scores))
    if scores[best] < AGREES or best in {0, len(lags) - 1}:
        return None
    return Match(float(lags[best]), scores[best], scores[int(np.argmin(np.abs(lags)))])


def wheels_metre(drive: Drive) -> tuple[float, float] | None:
    """Return the factor that makes the wheels' metre the truth's, and its sigma; None without enough way.

    Chords of a few windows' length are compared: the truth's noise adds to short ones, wrong turns to long ones.
    """
    truth, wheels = drive.truth, drive.wheels
    if truth is None:
        return None
    start = truth.t[(truth.t >= wheels.t[0]) & (truth.t + WINDOW <= min(wheels.t[-1], truth.t[-1]))]
    if len(start) < 20:
        return None
    step = np.stack([np.interp(start + WINDOW, truth.t, c) - np.interp(start, truth.t, c) for c in truth.xy.T])
    own = np.hypot(*wheels.relative(start, start + WINDOW)[:, :2].T)
    moving = own > LEAST_WAY
    ratio = np.hypot(*step)[moving] / own[moving]
    if moving.sum() < 20:
        return None
    parts = [float(np.median(part)) for part in np.array_split(ratio, BLOCKS)]
    return float(np.median(ratio)), 1.25 * float(np.std(parts, ddof=1)) / math.sqrt(BLOCKS)


def metre(drive: Drive, robot: Robot) -> tuple[float, list[Oddity]]:
    """Return the factor by which a cure scales the wheels' metre, and that cure."""
    found = wheels_metre(drive)
    if found is None or robot.wheels.radius is None:
        return 1.0, []
    factor, sigma = found
    if abs(factor - 1.0) < OFF_METRE + 3.0 * sigma:
        return 1.0, []
    words = f"their metre is {1.0 / factor:.3f} of the truth's (1 sigma {sigma:.3f})"
    radius = robot.wheels.radius * factor
    cures = [f"wheels.radius={radius:.4g}"]
    if robot.wheels.track is not None:  # what turns right must go on turning right
        cures.append(f"wheels.track={robot.wheels.track * factor:.4g}")
    return factor, [Oddity("wheel scale", "wheels", words, tuple(cures), abs(factor - 1.0) > SPOILS_METRE)]


def _point(truth: Truth, drive: Drive) -> list[Oddity]:
    """Fit which body point was tracked: while the robot turns, a point off its axle swings.

    With p(t) = base + R(theta) l, a step of the point seen in the base frame is d + (R(turn) - 1) l.
    """
    if truth.theta is None or np.ptp(np.unwrap(truth.theta)) < LEAST_TURN:
        return []
    wheels = drive.wheels
    rows = np.flatnonzero((truth.t >= wheels.t[0]) & (truth.t + WINDOW <= min(wheels.t[-1], truth.t[-1])))
    if len(rows) < 20:
        return []
    start, end = truth.t[rows], truth.t[rows] + WINDOW
    theta = np.unwrap(truth.theta)[rows]
    later = np.stack([np.interp(end, truth.t, c) for c in truth.xy.T], axis=-1)
    step = _turned(-theta, later - truth.xy[rows])
    moved = wheels.relative(start, end)
    c, s = np.cos(moved[:, 2]) - 1.0, np.sin(moved[:, 2])
    A = np.concatenate((np.stack((c, -s), axis=-1), np.stack((s, c), axis=-1)))
    y = np.concatenate((step - moved[:, :2]).T.reshape(2, -1))
    keep = np.ones(len(y), dtype=bool)
    for _ in range(3):
        x, *_ = np.linalg.lstsq(A[keep], y[keep], rcond=None)
        rest = np.abs(y - A @ x)
        keep = rest <= 4.0 * max(float(np.median(rest)), 1e-4)
    told = np.array(truth.point)
    if float(np.hypot(*(x - told))) < OFF_POINT or (A[keep] ** 2).sum() < 1.0:
        return []
    words = (
        f"it swings as the body point ({x[0]:.2f}, {x[1]:.2f}) m does, not ({told[0]:g}, {told[1]:g}): a tracked "
        "marker off the axle"
    )
    return [Oddity("body point", "truth", words, (f"truth.x={x[0]:.3f}", f"truth.y={x[1]:.3f}"), True)]


def _start(truth: Truth, drive: Drive, robot: Robot) -> list[Oddity]:
    """Compare the start pose with the one that lays the wheels' first metres over the truth's."""
    fitted = start_pose(truth, drive)
    if fitted is None:
        return []
    told = np.array([robot.start.x, robot.start.y, math.radians(robot.start.theta_deg)])
    x, y, theta = fitted.tolist()
    away, turn = math.hypot(x - told[0], y - told[1]), abs(se2.wrap(theta - told[2]))
    allowed = max(OFF_START, 3.0 * robot.start.sigma_xy) + 4.0 * truth.sigma
    if away < allowed + 0.05 and turn < OFF_HEADING + 3.0 * math.radians(robot.start.sigma_theta_deg):
        return []
    words = (
        f"it starts {away:.2f} m and {math.degrees(turn):.0f} deg from where the drive starts, by the first "
        "metres of both; set the start, or judge the shape only (--align origin)"
    )
    cures = (f"start.x={x:.3f}", f"start.y={y:.3f}", f"start.theta_deg={math.degrees(theta):.1f}")
    return [Oddity("start", "truth", words, cures, True)]


def start_pose(truth: Truth, drive: Drive) -> Array | None:
    """Return the pose (3,) of the base at the first wheel reading; None where the beginning does not tell."""
    wheels = drive.wheels
    way = np.concatenate(([0.0], np.cumsum(np.abs(wheels.twist[:, 0]))))
    inside = (truth.t >= wheels.t[0]) & (truth.t <= wheels.t[-1])
    inside &= np.interp(truth.t, wheels.t, way) <= min(BEGINNING, 0.5 * float(way[-1]))
    if inside.sum() < 5:
        return None
    own = wheels.at(truth.t[inside])[2]
    points = own[:, :2] + _turned(own[:, 2], np.tile(truth.point, (len(own), 1)))
    seen = truth.xy[inside]
    if truth.theta is not None:
        turn = float(np.median(se2.wrap_all(truth.theta[inside] - own[:, 2] - truth.theta[inside][0]))) + float(
            truth.theta[inside][0]
        )
    elif float(np.ptp(points, axis=0).max()) < 0.3:
        return None
    else:
        a, b = points - points.mean(axis=0), seen - seen.mean(axis=0)
        turn = math.atan2(float((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum()), float((a * b).sum()))
    place = np.median(seen - _turned(np.full(len(points), turn), points), axis=0)
    return np.array([*place, se2.wrap(turn)])


def _turned(angle: Array, v: Array) -> Array:
    """Turn vectors v (n, 2) by angles (n,)."""
    c, s = np.cos(angle), np.sin(angle)
    return np.stack((c * v[:, 0] - s * v[:, 1], s * v[:, 0] + c * v[:, 1]), axis=-1)
