"""Checks of the truth: its jumps and gaps, the tracked point, and its distance scale against the wheels'."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from locfuse.fusion import se2
from locfuse.fusion.data import Array, Drive, Estimates, Truth, stretches
from locfuse.fusion.robot import Robot
from locfuse.fusion.streams import gap_limit
from locfuse.fusion.wheels.calibrate import Sigma, truth_sigma
from locfuse.fusion.wheels.motion import Wheels
from locfuse.fusion.wheels.repairs import Mask, gaps_of, spikes, times

from .finding import Finding, Least
from .laser import OPEN_SCALE, Motion, range_fix, who_is_right

UNIT, JUMP = "unit", "jump"  # codes of the findings on a truth by which no error means anything
UNITS = {1000.0: "mm", 100.0: "cm", 0.01: "hundreds of metres", 0.001: "km"}  # by the ways in it over those in m
MAX_SIZE_SIGMAS, MAX_APART_SHARE = 3.0, 0.5  # standard errors; of the truth's error: wheels and laser agree better
MAX_UNIT_RATIO = 1.5  # of the ways over what the unit explains, either way
ROBOT_SPEEDS_MPS = 0.02, 20.0  # m/s: 99th percentile of the speeds of a robot
STEP = "step"  # code of the finding on a truth that steps aside
POINT, CREEP = "body point", "sideways"  # codes of the findings on the tracked point, on wheels that creep
MIN_CREEP, CREEP_SIGMAS = 0.008, 5.0  # m per m; standard errors
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
MIN_POINT_ERROR_M, SEVERE_POINT_ERROR_M, POINT_SIGMAS = 0.01, 0.05, 4.0  # m; standard errors, of the tracked point
MIN_STEP_M, STEP_SIGMAS, MAX_STEPS = 0.03, 12.0, 5  # m; times the usual difference from the wheels; steps in all
MIN_STEPS, AROUND = 100, 5  # steps of a truth by which its noise is judged; readings before and after one
CLIPPED_SIGMAS, NOISE_SIGMAS = 6.0, 5.0  # larger steps count as that; standard errors of a noise that is sure
MIN_NOISE_FACTOR = 2.0  # times what is configured: more is named
MIN_NOISE_M, MIN_NOISE_RAD = 0.001, math.radians(0.1)  # of a truth's poses; what is smaller changes no figure
MIN_TURN_RAD = math.radians(60.0)
MIN_WAY_ERROR, WAY_SIGMAS = 0.01, 3.0  # relative, standard errors: of the laser's ways beside the wheels'


def of_truth(drive: Drive, robot: Robot) -> list[Finding]:
    """Check the ground truth: where it cannot be used, its noise, the tracked point, and the start."""
    truth = drive.truth
    if truth is None or len(truth.t) < MIN_READINGS:
        return []
    jumps = _jumps(drive) or _steps(truth, drive)
    swings = swing(truth, drive, axle_path(truth, drive.wheels))
    point = of_point(truth, swings)
    # a truth that jumps, or is of another point, does not show the start
    creep = of_creep(swings)
    aside = abs(float(swings.x[3])) if swings is not None and creep else 0.0
    start = [] if jumps or point else of_start(truth, drive, robot, aside)
    return [*jumps, *_gaps(truth), *_noise(truth, drive), *point, *start, *creep]


def axle_path(truth: Truth, wheels: Wheels) -> Array | None:
    """Return the axle's path at the truth's stamps (n, 2) [m, map frame]: wheel distance along truth headings.

    The wheels' own turns, which slips spoil, have no part in it. None where the truth has no headings.
    """
    if truth.theta is None:
        return None
    theta = np.interp(wheels.t, truth.t, np.unwrap(truth.theta))
    turn = np.diff(theta)
    chord = wheels.twist[:, :2] * np.sinc(turn / (2.0 * np.pi))[:, None]
    path = np.concatenate((np.zeros((1, 2)), np.cumsum(se2.rotated(theta[:-1] + 0.5 * turn, chord), axis=0)))
    return np.stack([np.interp(truth.t, wheels.t, column) for column in path.T], axis=-1)


def _inside(truth: Truth, wheels: Wheels) -> Mask:
    """Return which of the truth's steps (n - 1,) lie within the drive and across no gap."""
    usual = np.diff(truth.t) < gap_limit(truth.t)
    within: Mask = usual & (truth.t[:-1] >= wheels.t[0]) & (truth.t[1:] <= wheels.t[-1])
    return within


def _steps(truth: Truth, drive: Drive) -> list[Finding]:
    """Return where the truth jumps sideways within one period and stays there, which a robot cannot do."""
    path = axle_path(truth, drive.wheels)
    if path is None or truth.theta is None:
        return []
    body = truth.xy - se2.rotated(truth.theta, np.tile(truth.point, (len(truth.t), 1))) - path
    step, inside = np.diff(body, axis=0), _inside(truth, drive.wheels)
    size = np.hypot(*step.T)
    if inside.sum() < MIN_STEPS:
        return []
    limit = max(MIN_STEP_M, STEP_SIGMAS * float(np.median(size[inside])))
    found = []
    for k in np.flatnonzero(inside & (size > limit)).tolist():
        before, after = body[max(0, k - AROUND) : k + 1], body[k + 1 : k + 2 + AROUND]
        stays = float(np.hypot(*(np.median(after, axis=0) - np.median(before, axis=0))))
        if stays > 0.7 * float(size[k]):
            found.append((float(truth.t[k + 1]), stays))
    if not found or len(found) > MAX_STEPS:
        return []  # so many are no steps of a truth: a robot that was carried, wheels that slipped
    where = ", ".join(f"{away:.2f} m at {t:.1f} s" for t, away in found)
    words = f"it steps aside by {where}, while the robot rolls on: errors after that are the truth's"
    return [Finding("truth", STEP, words, (), True)]


def _gaps(truth: Truth) -> list[Finding]:
    dt = np.diff(truth.t)
    long = dt > gap_limit(truth.t)
    if not long.any():
        return []
    words = f"{gaps_of(int(long.sum()), float(dt.max()))}: no errors are computed there"
    return [Finding("truth", "gap", words)]


def _noise(truth: Truth, drive: Drive) -> list[Finding]:
    """Return a finding if the truth is noisier than truth.sigma; ANEES counts that as an error of the estimate."""
    rest, moving = truth_sigma(truth, drive.wheels), _scatter(truth, drive.wheels)
    place, turn = max(rest.xy, moving.xy), max(rest.theta, moving.theta)
    parts: list[tuple[str, str]] = []
    if place >= max(MIN_NOISE_M, MIN_NOISE_FACTOR * truth.sigma):
        parts.append((f"{1e3 * place:.1f} mm", f"truth.sigma={place:.2g}"))
    if truth.theta is not None and turn >= max(MIN_NOISE_RAD, MIN_NOISE_FACTOR * truth.sigma_theta):
        parts.append((f"{math.degrees(turn):.2f}°", f"truth.sigma_theta_deg={math.degrees(turn):.2g}"))
    if not parts:
        return []
    words = " and ".join(part for part, _ in parts)
    return [Finding("truth", "noise", f"its own noise is {words} (1 sigma)", tuple(fix for _, fix in parts))]


def _scatter(truth: Truth, wheels: Wheels) -> Sigma:
    """Return the noise of poses by neighbouring steps: an error in one step is reversed in the next.

    Only across the way: along it stamps that jitter do the same. Zero where nothing is sure.
    """
    path, inside = axle_path(truth, wheels), _inside(truth, wheels)
    if path is None or truth.theta is None or inside.sum() < MIN_STEPS:
        return Sigma(0.0, 0.0)
    step = se2.rotated(-truth.theta[:-1], np.diff(truth.xy - path, axis=0))[:, 1]
    turn = np.diff(np.unwrap(truth.theta) - np.interp(truth.t, wheels.t, wheels.pose[:, 2]))
    return Sigma(_taken_back(step[inside]), _taken_back(turn[inside]))


def _taken_back(steps: Array) -> float:
    """Return the sigma of white noise on positions, from their steps (n,); 0 if it is not significant.

    Noise of one position adds to one step and is subtracted in the next one.
    """
    steps = np.clip(steps, *(np.array([-1.0, 1.0]) * CLIPPED_SIGMAS * float(np.median(np.abs(steps)))))
    products = -steps[1:] * steps[:-1]
    variance, sure = float(products.mean()), float(products.std()) / math.sqrt(len(products))
    return math.sqrt(variance) if variance > NOISE_SIGMAS * sure else 0.0


class Jumps(NamedTuple):
    """Steps of a truth that are metres longer than the wheels rolled meanwhile: a tracker that lost its body."""

    number: int
    spikes: int  # readings that jump away and return
    staying: int  # jumps that do not return
    steps: int  # of the whole truth

    @property
    def unusable(self) -> bool:
        """Whether the truth jumps so often that it cannot be used."""
        return self.number > MAX_JUMP_SHARE * self.steps

    @property
    def words(self) -> str:
        """The problem with the truth, in words."""
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
    return Jumps(number, int(away.sum()), number - 2 * len(stretches(away)), len(limit))


def _jumps(drive: Drive) -> list[Finding]:
    found = jumps_of(drive)
    if found is None:
        return []
    speed = max(1.0, math.ceil(3.0 * _fastest(drive)))
    return [Finding("truth", JUMP, found.words, (f"truth.max_speed={speed:g}",), True)]


def _fastest(drive: Drive) -> float:
    """Return the 99th percentile of the speeds [m/s] by the wheels."""
    return float(np.percentile(np.hypot(*drive.wheels.twist[:, :2].T) / np.diff(drive.wheels.t), 99.0))


def of_unit(drive: Drive) -> list[Finding]:
    """Return a finding if the truth's unit is not the metre: its ways are another power of ten of the wheels'.

    Wheels of a wrong radius show the same: it is the truth's if a robot drives as fast as the wheels say.
    """
    factor, (slowest, fastest), speed = (wheels_metre(drive) or (1.0,))[0], ROBOT_SPEEDS_MPS, _fastest(drive)
    unit = next((u for f, u in UNITS.items() if 1.0 / MAX_UNIT_RATIO < factor / f < MAX_UNIT_RATIO), None)
    if unit is None or not slowest < speed < fastest or slowest < factor * speed < fastest:
        return []
    words = (
        f"its distances are {float(f'{factor:.2g}'):g} times the wheels': its unit looks like {unit}. "
        "Errors by it mean nothing until it is recorded in m"
    )
    return [Finding("truth", UNIT, words, (), True)]


def of_size(drive: Drive, motion: Motion | None) -> list[Finding]:
    """Return a finding if wheels and laser agree on distances, and the truth differs from both.

    `motion`: the laser beside the wheels, by walls. Two that agree are hardly wrong by the same factor.
    """
    truth = drive.truth
    if truth is None or motion is None or drive.wheels.matched is not None:
        return []
    swung = swing(truth, drive, axle_path(truth, drive.wheels))  # a tracked point off the axle drives other ways
    found = wheels_metre(drive) if swung is None else (float(swung.x[2]), float(swung.sigma[2]))
    if found is None:
        return []
    factor, off = found[0], abs(found[0] - 1.0)
    apart = abs(motion.scale - 1.0) + MAX_SIZE_SIGMAS * motion.scale_sigma
    if off < max(SEVERE_SCALE_ERROR, MAX_SIZE_SIGMAS * found[1]) or apart > MAX_APART_SHARE * off:
        return []
    words = (
        f"its distances are {factor:.3f} times those of the wheels and of the laser, which agree to "
        f"{abs(motion.scale - 1.0):.1%}: its scale is wrong. Errors by it mean nothing until it is corrected"
    )
    return [Finding("truth", UNIT, words, (), True)]


def unusable(drive: Drive) -> Finding | None:
    """Return why no error by this truth means anything: its unit, or its many jumps; None if it can be used."""
    for found in of_unit(drive):
        return found
    jumps = jumps_of(drive)
    if jumps is None or not jumps.unusable:
        return None
    words = f"{jumps.words}. Set truth.max_speed, or truth.sigma if this is its noise"
    return Finding("truth", JUMP, words, (), True)


def step_limits(truth: Truth, drive: Drive) -> Array:
    """How far the truth may step (n-1,) [m], given what the wheels rolled meanwhile."""
    limit: Array = JUMP_FACTOR * np.diff(drive.wheels.driven(truth.t)) + MIN_JUMP_M + 6.0 * truth.sigma
    return limit


def wheels_metre(drive: Drive) -> tuple[float, float] | None:
    """Return the factor from the wheels' distance scale to the truth's, and its sigma; None for a short path.

    Chords of a few windows' length are compared: the truth's noise adds to short ones, wrong turns to long ones.
    """
    truth, wheels = drive.truth, drive.wheels
    if truth is None:
        return None
    start = truth.t[(truth.t >= wheels.t[0]) & (truth.t + WINDOW_S <= min(wheels.t[-1], truth.t[-1]))]
    if len(start) < 20:
        return None
    step = np.stack([np.interp(start + WINDOW_S, truth.t, c) - np.interp(start, truth.t, c) for c in truth.xy.T])
    moved = wheels.relative(start, start + WINDOW_S)
    point = np.tile(truth.point, (len(start), 1))
    seen, own = np.hypot(*step), np.hypot(*(moved[:, :2] + se2.rotated(moved[:, 2], point) - point).T)
    moving = (own > MIN_WAY_M) & (seen > MIN_SEEN_M)
    ratio = seen[moving] / own[moving]
    if moving.sum() < 20:
        return None
    parts = [float(np.median(part)) for part in np.array_split(ratio, STRETCHES)]
    return float(np.median(ratio)), 1.25 * float(np.std(parts, ddof=1)) / math.sqrt(STRETCHES)


def metre(drive: Drive, robot: Robot, least: Least = WORTH_SAYING) -> tuple[float, list[Finding]]:
    """Return the scale factor of the wheels' distances and its fix, if it is off by `least` or more."""
    found = wheels_metre(drive)
    by_driver = robot.wheels.is_of_driver
    if found is None or drive.wheels.matched is not None or (robot.wheels.radius is None and not by_driver):
        return 1.0, []
    factor, sigma = found
    if abs(factor - 1.0) < least.error + least.sigmas * sigma:
        return 1.0, []
    words = (
        f"they measure {abs(1.0 / factor - 1.0):.1%} too {'short' if factor > 1.0 else 'long'} by the truth "
        f"(± {sigma:.1%})"
    )
    fixes = wheels_fix(robot, factor)
    if not fixes and robot.wheels.estimate:
        return factor, []
    return factor, [Finding("wheels", WHEEL_SCALE, words, fixes, abs(factor - 1.0) > SEVERE_SCALE_ERROR)]


def wheels_fix(robot: Robot, factor: float) -> tuple[str, ...]:
    """Return settings by which the wheels measure `factor` times as far; () if the filter finds the scale."""
    wheels = robot.wheels
    if wheels.radius is None:  # the driver's radius, which no setting here changes: the filter may find the scale
        return () if wheels.estimate else ("wheels.estimate=true",)
    # what turns right must go on turning right
    track = () if wheels.track is None else (f"wheels.track={wheels.track * factor:.4g}",)
    return (f"wheels.radius={wheels.radius * factor:.4g}", *track)


class Swing(NamedTuple):
    """How the truth moves relative to the path of the base."""

    x: Array  # (4,) the tracked point (x, y) [m], the path's scale, by how much it drives aside [m per m]
    sigma: Array  # (4,)


def swing(truth: Truth, drive: Drive, path: Array | None) -> Swing | None:
    """Fit how a tracked point swings while the robot turns; None where it hardly turns.

    With p(t) = base + R(theta) l, a step of the point is that of the base's `path` (n, 2) [m] at the truth's
    stamps, up to a factor and a small turn, and (R(theta') - R(theta)) l. NaN where nothing is known of the path.
    """
    if path is None or truth.theta is None or np.ptp(np.unwrap(truth.theta)) < MIN_TURN_RAD:
        return None
    wheels = drive.wheels
    last = np.searchsorted(truth.t, truth.t + WINDOW_S)
    first = np.flatnonzero((last < len(truth.t)) & (truth.t >= wheels.t[0]))
    known = (truth.t[last[first]] <= wheels.t[-1]) & np.isfinite(path[first] + path[last[first]]).all(axis=1)
    first = first[known]
    if len(first) < 20:
        return None
    last = last[first]
    c, s = (turned(truth.theta[last]) - turned(truth.theta[first]) for turned in (np.cos, np.sin))
    rolled, y = path[last] - path[first], truth.xy[last] - truth.xy[first]
    along, across = (c, -s, rolled[:, 0], -rolled[:, 1]), (s, c, rolled[:, 1], rolled[:, 0])
    A = np.stack((np.stack(along, axis=-1), np.stack(across, axis=-1)), axis=1)
    if (A[:, :, :2] ** 2).sum() < 1.0:
        return None
    parts = np.array_split(np.arange(len(y)), STRETCHES)
    others = np.array([_robust(np.delete(A, part, axis=0), np.delete(y, part, axis=0)) for part in parts])
    return Swing(_robust(A, y), others.std(axis=0) * math.sqrt(STRETCHES - 1))


def of_point(truth: Truth, found: Swing | None) -> list[Finding]:
    """Return the body point that was tracked, if it is not the configured one."""
    if found is None:
        return []
    (x, y), sigma, configured = found.x[:2].tolist(), float(np.hypot(*found.sigma[:2])), truth.point
    away = math.hypot(x - configured[0], y - configured[1])
    if away < max(MIN_POINT_ERROR_M, POINT_SIGMAS * sigma):
        return []
    words = (
        f"it swings as the body point ({x:.3f}, {y:.3f}) m does (1 sigma {sigma:.3f}), not "
        f"({configured[0]:g}, {configured[1]:g}): a tracked marker off the axle"
    )
    return [Finding("truth", POINT, words, (f"truth.x={x:.3f}", f"truth.y={y:.3f}"), away > SEVERE_POINT_ERROR_M)]


def of_creep(found: Swing | None) -> list[Finding]:
    """Report that, by the truth, the robot drives sideways to its heading."""
    if found is None or abs(found.x[3]) < max(MIN_CREEP, CREEP_SIGMAS * found.sigma[3]):
        return []
    aside, sigma = (math.degrees(float(v)) for v in (found.x[3], found.sigma[3]))
    words = (
        f"by the truth the robot drives {abs(aside):.1f}° to the {'left' if aside > 0.0 else 'right'} of where it "
        f"points (1 sigma {sigma:.1g}°): wheels that creep sideways, or a truth whose headings are off by that"
    )
    return [Finding("wheels", CREEP, words)]


def of_ways(drive: Drive, robot: Robot, run: Estimates) -> list[Finding]:
    """Return a finding if the laser's own `run` and the wheels differ in distance; either may be right."""
    rows = np.unique(drive.instant[run.sensors[0]])
    by_laser = Truth("", run.t[rows], run.pose[rows, :2], np.unwrap(run.pose[rows, 2]))
    found = swing(by_laser, drive, axle_path(by_laser, drive.wheels))
    way = float(drive.wheels.driven(drive.wheels.t[-1]))
    if found is None or way <= 0.0:
        return []
    ratio, sigma = float(found.x[2]), max(float(found.sigma[2]), math.sqrt(0.5 * drive.wheels.noise / way))
    if abs(ratio - 1.0) < max(MIN_WAY_ERROR, WAY_SIGMAS * sigma):
        return []
    fixes = range_fix(robot, 1.0 / ratio)
    words = (
        f"laser and wheels differ by {abs(ratio - 1.0):.1%} in distance (the laser's is {ratio:.3f} times the "
        f"wheels', 1 sigma {sigma:.3f})"
    )
    hint = who_is_right(robot, 1.0 / ratio, fixes[0]) if fixes else ""
    found_too = [Finding("wheels", WHEEL_SCALE, words, wheels_fix(robot, ratio))]
    return [Finding(run.sensors[0], OPEN_SCALE, words + hint, fixes), *found_too]


def _robust(A: Array, y: Array) -> Array:
    """Return the least squares (4,) of steps y (n, 2) by A (n, 2, 4), without those that do not fit."""
    keep = np.ones(len(y), dtype=bool)
    x: Array = np.zeros(4)
    for _ in range(3):
        x = np.asarray(np.linalg.lstsq(A[keep].reshape(-1, 4), y[keep].ravel(), rcond=None)[0])
        rest = np.hypot(*(y - A @ x).T)
        keep = rest <= 4.0 * max(float(np.median(rest)), 1e-4)
    return x


START = "start"  # code of the finding
SEVERE_START_ERROR_M, SEVERE_START_ERROR_RAD = 0.1, math.radians(5.0)
MIN_START_ERROR_M, MIN_START_ERROR_RAD = 0.02, math.radians(1.0)  # by poses; the shape of points is less exact
SIGMAS = 3.0  # standard deviations of the start, as it is configured and as the truth shows it
SHAPE_WAY_M, POSE_WAY_M = 3.0, 0.1  # m of the drive from which the start pose is found: by points, by poses
MIN_SHAPE_EXTENT_M = 0.3  # m, extent of the points


def of_start(truth: Truth, drive: Drive, robot: Robot, aside: float = 0.0) -> list[Finding]:
    """Return a finding if the configured start is not the pose with which the wheels' path fits the truth.

    Where the robot drives `aside` [rad] of the truth's headings, the shape of the way tells the start's heading.
    """
    fitted = start_pose(truth, drive, by_shape=aside > 0.0)
    if fitted is None:
        return []
    moment = fitted.t or robot.start.at
    at = np.float64(moment if isinstance(moment, float) else 0.0)
    both = np.stack((np.array(robot.start.pose), fitted.pose))
    wheels = drive.wheels
    configured, (x, y, theta) = se2.compose(both, wheels.relative(wheels.t[0], at)).tolist()
    blur = fitted.sigma
    away, turn = math.hypot(x - configured[0], y - configured[1]), abs(se2.wrap(theta - configured[2]))
    severe = away > SEVERE_START_ERROR_M or turn > SEVERE_START_ERROR_RAD
    least = (MIN_START_ERROR_M, MIN_START_ERROR_RAD)
    if truth.theta is None or aside:
        least = (SEVERE_START_ERROR_M, SEVERE_START_ERROR_RAD)
    # the way is laid on the truth about its middle: half of it swings with the turn
    spread = robot.start.sigma_xy, 0.5 * fitted.way * blur, fitted.spread, truth.sigma
    place = least[0] + SIGMAS * math.hypot(*spread)
    if away < place and turn < least[1] + SIGMAS * math.hypot(math.radians(robot.start.sigma_theta_deg), blur):
        return []
    where = f"the drive is at {at:.1f} s" if fitted.t else "the drive starts"
    words = (
        f"it starts {away:.2f} m and {math.degrees(turn):.1f} deg from where {where}; set the start, or "
        "judge the shape only (--align origin)"
    )
    degrees = math.degrees(se2.wrap(theta))
    moments = (f"start.at={at:.2f}",) if fitted.t else ()
    unsure = (f"start.sigma_theta_deg={math.degrees(aside):.1f}",) if aside else ()
    fixes = (f"start.x={x:.3f}", f"start.y={y:.3f}", f"start.theta_deg={degrees:.1f}", *unsure, *moments)
    return [Finding("truth", START, words, fixes, severe)]


class Start(NamedTuple):
    """Where the truth says that the drive started."""

    pose: Array  # (3,) of the base at the first wheel reading, as the wheels lead back to it
    way: float  # m of the drive from which it is found
    sigma: float  # rad by which the wheels may have turned wrongly meanwhile, or the truth's headings scatter
    spread: float  # m by which the truth's places scatter
    t: float  # s at which the truth begins, where the robot has moved by then; else at the first reading


def start_pose(truth: Truth, drive: Drive, by_shape: bool = False) -> Start | None:
    """Return where the drive started; None if its first metres do not show it.

    A truth with headings tells at once, points only by the shape of the first metres of the truth.
    """
    wheels, headings = drive.wheels, None if by_shape else truth.theta
    inside = (truth.t >= wheels.t[0]) & (truth.t <= wheels.t[-1])
    way, fewest = (SHAPE_WAY_M, 5) if headings is None else (POSE_WAY_M, 1)
    if not inside.any():
        return None
    first = float(truth.t[inside].min())
    driven = wheels.driven(truth.t) - wheels.driven(first)
    inside &= driven <= min(way, 0.5 * float(wheels.driven(wheels.t[-1]) - wheels.driven(first)))
    if inside.sum() < fewest:
        return None
    own = wheels.relative(np.full(int(inside.sum()), wheels.t[0]), truth.t[inside])
    points = own[:, :2] + se2.rotated(own[:, 2], np.tile(truth.point, (len(own), 1)))
    tracked = truth.xy[inside]
    if headings is not None:
        turns = se2.wrap_all(headings[inside] - own[:, 2])
        turn, metre = float(turns[0] + np.median(se2.wrap_all(turns - turns[0]))), 1.0
    elif float(np.ptp(points, axis=0).max()) < MIN_SHAPE_EXTENT_M:
        return None
    else:
        turn, metre = se2.laid_on(points, tracked)
    places = tracked - metre * se2.rotated(np.full(len(points), turn), points)
    place = np.median(places, axis=0)
    if headings is None:
        blur = math.sqrt(2.0 * wheels.noise * way) / wheels.track
    else:
        blur = float(np.std(se2.wrap_all(turns - turn))) / math.sqrt(len(points))
    spread = float(np.hypot(*(places - place).std(axis=0))) / math.sqrt(len(points))
    moved = float(wheels.driven(first) - wheels.driven(wheels.t[0])) > POSE_WAY_M
    return Start(np.array([*place, se2.wrap(turn)]), way, blur, spread, first if moved else float(wheels.t[0]))
