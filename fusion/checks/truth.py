"""Can the truth judge this drive? Its jumps and gaps, the point that it tracked, its metre against the wheels'."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from locfuse.fusion import se2
from locfuse.fusion.data import Array, Drive, Truth
from locfuse.fusion.robot import Robot
from locfuse.fusion.streams import gap_limit
from locfuse.fusion.wheels.calibrate import truth_sigma
from locfuse.fusion.wheels.jumps import Mask, spikes
from locfuse.fusion.wheels.motion import Wheels
from locfuse.fusion.wheels.repairs import gaps_of, times

from .finding import Finding, Least
from .start import of_start

WHEEL_SCALE = "wheel scale"  # code of the finding on the wheels' metre
MIN_READINGS = 5  # of a truth that is checked
WINDOW_S = 1.0  # s over which ways are compared
STRETCHES = 8  # stretches of the drive whose estimates must agree
MIN_WAY_M = 0.1  # m per window, by the wheels
MIN_SEEN_M = 1e-6  # m per window, by the truth: one that stands still measures no wheels
MIN_SCALE_ERROR, SEVERE_SCALE_ERROR = 0.03, 0.05  # relative errors of the wheels' metre
WORTH_SAYING = Least(MIN_SCALE_ERROR, 3.0)
MAX_JUMP_SHARE = 0.01  # of a truth's steps: with more jumps no error by it means anything
JUMP_FACTOR, MIN_JUMP_M = 3.0, 0.3  # a step is a jump if it is this many times the wheels', and this much [m] more
MIN_POINT_ERROR_M = 0.05  # m, of the tracked point
MIN_NOISE_M, MIN_NOISE_RAD = 0.001, math.radians(0.1)  # of a truth's poses; what is smaller changes no figure
MIN_TURN_RAD = math.radians(60.0)


def of_truth(drive: Drive, robot: Robot, same_metre: bool = True) -> list[Finding]:
    """Check the ground truth. The tracked body point is estimated only if the wheel scale is plausible."""
    truth = drive.truth
    if truth is None or len(truth.t) < MIN_READINGS:
        return []
    jumps = _jumps(drive)
    point = _point(truth, drive) if same_metre else []
    # where a jump or another point is told, what it tells of the start is not the start
    start = [] if jumps or point else of_start(truth, drive, robot)
    return [*jumps, *_gaps(truth), *_noise(truth, drive), *point, *start]


def _gaps(truth: Truth) -> list[Finding]:
    dt = np.diff(truth.t)
    long = dt > gap_limit(truth.t)
    if not long.any():
        return []
    words = f"{gaps_of(int(long.sum()), float(dt.max()))}: no errors are computed there"
    return [Finding("truth", "gap", words)]


def _noise(truth: Truth, drive: Drive) -> list[Finding]:
    """The truth's scatter while the robot stands: unless it is set, ANEES takes it for an error of the filter.

    No estimate depends on it.
    """
    seen = truth_sigma(truth, drive.wheels)
    if truth.sigma or truth.sigma_theta or (seen.xy < MIN_NOISE_M and seen.theta < MIN_NOISE_RAD):
        return []
    words, fixes = f"{1e3 * seen.xy:.1f} mm", [f"truth.sigma={seen.xy:.2g}"]
    if truth.theta is not None:
        words += f" and {math.degrees(seen.theta):.2f}°"
        fixes.append(f"truth.sigma_theta_deg={math.degrees(seen.theta):.2g}")
    return [Finding("truth", "noise", f"its own noise is {words} (1 sigma, at rest)", tuple(fixes))]


class Jumps(NamedTuple):
    """Steps of a truth that are metres longer than the wheels rolled meanwhile: a tracker that lost its body."""

    number: int
    spikes: int  # readings that jump away and return
    staying: int  # jumps that do not return
    steps: int  # of the whole truth

    @property
    def spoil(self) -> bool:
        """Whether they are so many that the truth judges nothing."""
        return self.number > MAX_JUMP_SHARE * self.steps

    @property
    def words(self) -> str:
        """What is wrong with the truth."""
        words = f"it jumps {times(self.number)} by more than the wheels rolled"
        words += f"; {self.spikes} readings can be left out" if self.spikes else ""
        if self.staying > 0:
            words += f"; {self.staying} jumps do not return, and errors across them mean nothing"
        return words


def jumps_of(drive: Drive) -> Jumps | None:
    """Return the jumps of the truth; None without truth or without jumps."""
    truth = drive.truth
    if truth is None or len(truth.t) < MIN_READINGS:
        return None
    limit = step_limits(truth, drive)
    number = int((np.hypot(*np.diff(truth.xy, axis=0).T) > limit).sum())
    if not number:
        return None
    away = spikes(truth.t, truth.xy, limit)
    return Jumps(number, int(away.sum()), number - 2 * _runs(away), len(limit))


def _jumps(drive: Drive) -> list[Finding]:
    found = jumps_of(drive)
    if found is None:
        return []
    fastest = float(np.percentile(np.hypot(*drive.wheels.twist[:, :2].T) / np.diff(drive.wheels.t), 99.0))
    speed = max(1.0, math.ceil(3.0 * fastest))
    return [Finding("truth", "jump", found.words, (f"truth.max_speed={speed:g}",), True)]


def step_limits(truth: Truth, drive: Drive) -> Array:
    """How far the truth may step (n-1,) [m], given what the wheels rolled meanwhile."""
    limit: Array = JUMP_FACTOR * np.diff(drive.wheels.driven(truth.t)) + MIN_JUMP_M + 6.0 * truth.sigma
    return limit


def _runs(mask: Mask) -> int:
    return int((np.diff(mask.astype(int), prepend=0) > 0).sum())


def wheels_metre(drive: Drive) -> tuple[float, float] | None:
    """Return the factor that makes the wheels' metre the truth's, and its sigma; None without enough way.

    Chords of a few windows' length are compared: the truth's noise adds to short ones, wrong turns to long ones.
    """
    truth, wheels = drive.truth, drive.wheels
    if truth is None:
        return None
    start = truth.t[(truth.t >= wheels.t[0]) & (truth.t + WINDOW_S <= min(wheels.t[-1], truth.t[-1]))]
    if len(start) < 20:
        return None
    step = np.stack([np.interp(start + WINDOW_S, truth.t, c) - np.interp(start, truth.t, c) for c in truth.xy.T])
    seen, own = np.hypot(*step), np.hypot(*wheels.relative(start, start + WINDOW_S)[:, :2].T)
    moving = (own > MIN_WAY_M) & (seen > MIN_SEEN_M)
    ratio = seen[moving] / own[moving]
    if moving.sum() < 20:
        return None
    parts = [float(np.median(part)) for part in np.array_split(ratio, STRETCHES)]
    return float(np.median(ratio)), 1.25 * float(np.std(parts, ddof=1)) / math.sqrt(STRETCHES)


def metre(drive: Drive, robot: Robot, least: Least = WORTH_SAYING) -> tuple[float, list[Finding]]:
    """Return the factor by which a fix scales the wheels' metre, and that fix, if it is off by `least` or more."""
    found = wheels_metre(drive)
    if found is None or robot.wheels.radius is None:
        return 1.0, []
    factor, sigma = found
    if abs(factor - 1.0) < least.error + least.sigmas * sigma:
        return 1.0, []
    words = f"they measure {1.0 / factor:.3f} times the distances of the truth (1 sigma {sigma:.3f})"
    radius = robot.wheels.radius * factor
    fixes = [f"wheels.radius={radius:.4g}"]
    if robot.wheels.track is not None:  # what turns right must go on turning right
        fixes.append(f"wheels.track={robot.wheels.track * factor:.4g}")
    return factor, [Finding("wheels", WHEEL_SCALE, words, tuple(fixes), abs(factor - 1.0) > SEVERE_SCALE_ERROR)]


def _arc(wheels: Wheels, start: Array, end: Array, turn: Array) -> Array:
    """Return the chords (k, 2) [m, base frame at the start] of arcs as long as rolled, which turn by `turn`."""
    rolled = np.concatenate((np.zeros((1, 2)), np.cumsum(wheels.twist[:, :2], axis=0)))
    way = np.stack([np.interp(end, wheels.t, r) - np.interp(start, wheels.t, r) for r in rolled.T], axis=-1)
    return se2.rotated(0.5 * turn, way * np.sinc(turn / (2.0 * np.pi))[:, None])


def _point(truth: Truth, drive: Drive) -> list[Finding]:
    """Fit which body point was tracked: while the robot turns, a point off its axle swings.

    With p(t) = base + R(theta) l, a step of the point seen in the base frame is d + (R(turn) - 1) l. The turn is
    the truth's, and of the wheels only how far they rolled counts: were the turn theirs, its noise would stand on
    both sides of the equation and look like a point behind the axle.
    """
    if truth.theta is None or np.ptp(np.unwrap(truth.theta)) < MIN_TURN_RAD:
        return []
    wheels = drive.wheels
    rows = np.flatnonzero((truth.t >= wheels.t[0]) & (truth.t + WINDOW_S <= min(wheels.t[-1], truth.t[-1])))
    if len(rows) < 20:
        return []
    start, end = truth.t[rows], truth.t[rows] + WINDOW_S
    heading = np.unwrap(truth.theta)
    theta, turn = heading[rows], np.interp(end, truth.t, heading) - heading[rows]
    later = np.stack([np.interp(end, truth.t, c) for c in truth.xy.T], axis=-1)
    step = se2.rotated(-theta, later - truth.xy[rows])
    c, s = np.cos(turn) - 1.0, np.sin(turn)
    A = np.concatenate((np.stack((c, -s), axis=-1), np.stack((s, c), axis=-1)))
    y = np.concatenate((step - _arc(wheels, start, end, turn)).T)
    keep = np.ones(len(y), dtype=bool)
    for _ in range(3):
        x, *_ = np.linalg.lstsq(A[keep], y[keep], rcond=None)
        rest = np.abs(y - A @ x)
        keep = rest <= 4.0 * max(float(np.median(rest)), 1e-4)
    configured = np.array(truth.point)
    if float(np.hypot(*(x - configured))) < MIN_POINT_ERROR_M or (A[keep] ** 2).sum() < 1.0:
        return []
    words = (
        f"it swings as the body point ({x[0]:.2f}, {x[1]:.2f}) m does, not "
        f"({configured[0]:g}, {configured[1]:g}): a tracked marker off the axle"
    )
    return [Finding("truth", "body point", words, (f"truth.x={x[0]:.3f}", f"truth.y={x[1]:.3f}"), True)]
