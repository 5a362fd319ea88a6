"""Checks of sensors of positions (GPS, poses of another program) and of speeds by the truth.

Points are complex numbers. With the truth's pose (p, theta), a point l on the base is seen in another frame at

    z = c (p + e^(i theta) l) + d

so c, c l and d are found by linear least squares: the direction of c is that of the frame, its length the scale.
The antenna of a GPS is also found without truth, by the headings of a run and fixes that lie a few seconds apart.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from msgspec.structs import replace

from locfuse.fusion import se2
from locfuse.fusion.data import Drive, Estimates, Ints, Measurements, Truth
from locfuse.fusion.robot import Robot
from locfuse.fusion.sensors.registry import REGISTRY
from locfuse.fusion.statistics import Plane, jackknife, off_turned, robust, robust_sigma, robust_with_sigmas
from locfuse.fusion.truth import poses_at
from locfuse.fusion.wheels.motion import PART_S

from .finding import Finding, Least
from .tracked_point import axle_path
from .truth import FIXES, STEP, steps_aside, white_sigma

GPS, POSE, ANTENNA = "gps", "pose", "antenna"  # sensors; code of the finding on the antenna
EAST, PATH = "east", "path"  # codes of the findings on the direction of east, on a mirrored or scaled path
BODY, FRAME, SPEEDS = "body", "frame", "speeds"  # codes of findings on another program's body, frame, speeds
SPEED_WINDOW_S = 1.0  # s over which speeds are summed
WINDOW_S, SPEED_S = 5.0, 0.2  # s between two compared fixes; s before and after a time, for the speed at this time
MIN_WINDOWS, STRETCH_COUNT = 40, 8  # windows; stretches of the drive, for the jackknife
MIN_TURNED = 1.0  # sum of squared changes of the direction of driving, unit vectors
# m, standard errors: smallest error reported; m
MIN_ANTENNA_M, ANTENNA_SIGMAS, SEVERE_ANTENNA_M = 0.05, 4.0, 0.1
MAX_EAST_SIGMA_DEG = 1.0  # of a direction of east that is offered
CLAIM, MAX_CLAIM_RATIO = "claim", 2.0  # code of the finding on claimed errors; largest ratio of real ones to them
RADIANS = math.radians(1.0)  # size of a path whose degrees are recorded in radians
MAX_SIZE_RATIO = 1.3  # largest factor between the observed size and that of a unit
MIN_EXPLAINED_SHARE = 0.9  # least share of the positions' squares that a linear map of the truth explains
PATH_SCALE = Least(0.03, 4.0)  # smallest error of a path's size
BODY_YAW = Least(math.radians(2.0), 4.0)  # smallest error of the yaw of a body, rad
FRAME_ERROR = Least(math.radians(3.0), 4.0)  # smallest direction of a frame that is said to be the map's, rad
MIN_SHIFT_M = 0.3  # m, smallest shift of such a frame
SPEED_ERROR, MAX_SPEED_REST = Least(0.1, 4.0), 0.5  # smallest error of speeds; rest / rms that shows other speeds
MIN_MOVING_SHARE = 0.5  # of the rms: windows in which the robot moves or turns
UNITS = {1000.0: "mm/s", 100.0: "cm/s", 3.6: "km/h"}  # speeds, as multiples of m/s
DEGREES = math.degrees(1.0)  # turning rates in degrees/s, as multiple of rad/s


class FrameFit(NamedTuple):
    """Fit of positions in another frame by the truth, and standard errors of the values."""

    size: float  # of the path, as multiple of the truth's
    size_sigma: float
    turn: float  # rad by which the frame is turned: direction of the map's x axis in it
    turn_sigma: float
    shift: float  # m from the map's origin to that of the frame
    x: float  # m, the point on the base; NaN without headings
    y: float
    sigma: float  # m
    yaw: float  # rad of the body on the base; NaN for positions
    yaw_sigma: float


def by_truth(drive: Drive, sensor: str) -> FrameFit | None:
    """Return the fit of a sensor's positions by the truth; None without truth, or for few readings or a drift."""
    m, poses = _beside_truth(drive, sensor)
    if m is None or poses is None or m.extra.get("drifts", np.zeros(1)).any():
        return None
    A, y = se2.in_other_frame(m.z, poses)
    headings = m.z[:, 2] if m.z.shape[1] == 3 else np.full(len(y), math.nan)

    def fit(some: Ints) -> list[float]:
        x, _ = robust(A[some], y[some])
        lever = x[1] / x[0] if A.shape[1] == 3 else complex(math.nan, math.nan)
        off = np.exp(1.0j * (headings[some] - poses[some, 2] - np.angle(x[0])))
        yaw = float(np.angle(complex(np.median(off.real), np.median(off.imag))))
        return [abs(x[0]), float(np.angle(x[0])), abs(x[-1]), lever.real, lever.imag, yaw]

    size, turn, shift, ahead, left, yaw = fit(np.arange(len(y)))
    errors = np.broadcast_to(jackknife(fit, len(y), STRETCH_COUNT), 6).tolist()
    point = ahead, left, math.hypot(errors[3], errors[4])
    return FrameFit(size, errors[0], turn, errors[1], shift, *point, yaw, errors[5])


def _beside_truth(drive: Drive, sensor: str) -> tuple[Measurements | None, Any]:
    """Return a sensor's readings inside the truth, and the robot's poses (n, 3) then; None for too few."""
    m, truth = drive.measurements.get(sensor), drive.truth
    if m is None or truth is None:
        return None, None
    inside = np.flatnonzero(truth.spans(m.t))
    if len(inside) < MIN_WINDOWS:
        return None, None
    return m.take(inside), poses_at(truth, m.t[inside])


def of_positions(drive: Drive, robot: Robot) -> list[Finding]:
    """Return findings on sensors of positions and of speeds that the truth contradicts."""
    fits = {sensor: fit for sensor in (GPS, POSE) if (fit := by_truth(drive, sensor)) is not None}
    found = [f for sensor, fit in fits.items() for f in _of_path(drive, sensor, fit)]
    if not found and POSE in fits:
        found = _of_body(fits[POSE], robot)
    return [*found, *_of_steps(drive), *_of_speeds(drive)]


def _of_steps(drive: Drive) -> list[Finding]:
    """Return a finding if fixes step aside a few times, as after a loss of the carrier phase (RTK float)."""
    m = drive.measurements.get(GPS)
    where = [] if m is None else steps_aside(Truth(FIXES, m.t, m.z, None), drive)
    words = f"its fixes step aside by {', '.join(where)}, while the robot rolls on: reflections, or RTK float"
    return [Finding(GPS, STEP, words)] if where else []


def _of_path(drive: Drive, sensor: str, fit: FrameFit) -> list[Finding]:
    """Return a finding on positions whose path is a mirror image of the truth's, or of another size."""
    m, poses = _beside_truth(drive, sensor)
    if m is None:
        return []
    z, A = m.z[:, :2], np.column_stack((poses[:, :2] - poses[:, :2].mean(axis=0), np.ones(len(poses))))
    x, *_ = np.linalg.lstsq(A, z, rcond=None)
    rest, det = z - A @ x, float(np.linalg.det(x[:2]))
    if float(rest.var(axis=0).sum()) > (1.0 - MIN_EXPLAINED_SHARE) * float(z.var(axis=0).sum()):
        return []
    if det < 0.0:
        what = "latitude and longitude" if sensor == GPS else "x and y"
        words = f"its path is a mirror image of the truth's: {what} are exchanged, or one has the other sign"
        return [Finding(sensor, PATH, words, (), True)]
    if abs(fit.size - 1.0) < PATH_SCALE.error + PATH_SCALE.sigmas * fit.size_sigma:
        return []
    words = f"its path is {fit.size:.3g} times as large as the truth's"
    if sensor == GPS and 1.0 / MAX_SIZE_RATIO < fit.size / RADIANS < MAX_SIZE_RATIO:
        words += ": it looks like radians; write degrees"
    return [Finding(sensor, PATH, words, (), True)]


def _of_body(fit: FrameFit, robot: Robot) -> list[Finding]:
    """Return a finding if poses are in another frame than the map, or of another body than configured."""
    settings = robot.settings(POSE)
    turned = abs(fit.turn) > FRAME_ERROR.error + FRAME_ERROR.sigmas * fit.turn_sigma
    if settings.frame == "map" and (turned or fit.shift > MIN_SHIFT_M):
        away = f"turned by {math.degrees(fit.turn):z.1f}° and shifted by {fit.shift:.2f} m"
        words = f"by the truth its frame is not the map: it is {away}"
        return [Finding(POSE, FRAME, words, ("pose.frame=own",), True)]
    other = math.hypot(fit.x, fit.y) > max(MIN_ANTENNA_M, ANTENNA_SIGMAS * fit.sigma)
    turned = settings.heading and abs(fit.yaw) > BODY_YAW.error + BODY_YAW.sigmas * fit.yaw_sigma
    if not other and not turned:
        return []
    now = np.array([settings.x, settings.y, math.radians(settings.yaw_deg)])
    x, y, yaw = se2.compose(np.array([fit.x, fit.y, fit.yaw if turned else 0.0]), now).tolist()
    degrees = math.degrees(se2.wrap(yaw))
    sigmas = f"1 sigma {fit.sigma:.1g} m, {math.degrees(fit.yaw_sigma):.1g}°"
    words = (
        f"by the truth the tracked body sits at ({x:z.2f}, {y:z.2f}) m on the base, turned by {degrees:z.1f}° "
        f"({sigmas}), configured ({settings.x:g}, {settings.y:g}) m, {settings.yaw_deg:g}°"
    )
    fixes = [f"pose.x={x:z.3f}", f"pose.y={y:z.3f}"] if other else []
    fixes += [f"pose.yaw_deg={degrees:z.1f}"] if turned else []
    return [Finding(POSE, BODY, words, tuple(fixes), True)]


def _of_speeds(drive: Drive) -> list[Finding]:
    """Return a finding if forward speeds or turning rates of a twist are wrong by a factor.

    They are compared with the truth if it has headings, else with the wheels.
    """
    m, truth = drive.measurements.get("twist"), drive.truth
    if m is None or len(m.t) < MIN_WINDOWS:
        return []
    by_truth, last = truth is not None and truth.theta is not None, np.searchsorted(m.t, m.t + SPEED_WINDOW_S)
    first = np.flatnonzero(last < len(m.t))
    first = first[m.extra["piece"][first] == m.extra["piece"][last[first]]]
    if truth is not None and by_truth:
        first = first[(m.t[first] >= truth.t[0]) & (m.t[last[first]] <= truth.t[-1])]
        moved = se2.between(poses_at(truth, m.t[first]), poses_at(truth, m.t[last[first]]))
    else:
        moved = drive.wheels.relative(m.t[first], m.t[last[first]])
    if len(first) < MIN_WINDOWS:
        return []
    found = []
    for column, name, unit_of in ((0, "forward speeds", UNITS), (1, "turning rates", {DEGREES: "degrees/s"})):
        both = np.stack((moved[:, 2 * column], m.z[last[first], column] - m.z[first, column]))
        moving = (np.abs(both) > MIN_MOVING_SHARE * np.sqrt((both**2).mean(axis=1, keepdims=True))).any(axis=0)
        theirs, own = both[:, moving]
        (slope,), (sigma,) = (one.tolist() for one in robust_with_sigmas(theirs[:, None], own, STRETCH_COUNT))
        rest = robust_sigma(own - slope * theirs)
        if rest > MAX_SPEED_REST * math.sqrt(float((own**2).mean())) or sigma > MAX_SPEED_REST * abs(slope):
            continue
        unit = next((u for f, u in unit_of.items() if 1 / MAX_SIZE_RATIO < abs(slope) / f < MAX_SIZE_RATIO), None)
        if abs(slope - 1.0) > SPEED_ERROR.error + SPEED_ERROR.sigmas * sigma and (by_truth or unit or slope < 0.0):
            look = f": they look like {unit}" if unit else ": they have the other sign" if slope < 0.0 else ""
            words = f"its {name} are {slope:.3g} times those of the {'truth' if by_truth else 'wheels'}{look}"
            found.append(Finding("twist", SPEEDS, words, (), True))
    return found[:1]


def white_error(drive: Drive) -> float:
    """Return the sigma [m] of independent errors of fixes, by their steps beside those of the wheels; else 0.

    Both paths have one direction in PART_S. Errors that last longer, such as those of multipath, do not count.
    """
    m, wheels = drive.measurements.get(GPS), drive.wheels
    if m is None or len(m.t) < MIN_WINDOWS:
        return 0.0
    _, _, pose = wheels.at(np.clip(m.t, wheels.t[0], wheels.t[-1]))
    steps, rolled = (np.diff(xy @ (1.0, 1.0j)) for xy in (m.z, pose[:, :2]))
    part = np.unique(((m.t[1:] - m.t[0]) / PART_S).astype(np.int64), return_inverse=True)[1]
    rest = off_turned(steps, rolled, part)
    return max(white_sigma(rest.real), white_sigma(rest.imag))


def with_fixes_as_truth(drive: Drive, robot: Robot) -> Drive:
    """Return the drive with the fixes of a GPS as its truth if it has none: they show the scale of the wheels."""
    m = drive.measurements.get(GPS)
    if m is None or drive.truth is not None or len(m.t) < MIN_WINDOWS:
        return drive
    settings, claimed = robot.settings(GPS), REGISTRY[GPS].claimed(m)
    sigma = max(white_error(drive), claimed.get(REGISTRY[GPS].noise_keys[0], settings.sigma))
    return replace(drive, truth=Truth(FIXES, m.t, m.z, None, (settings.x, settings.y), sigma))


def of_claims(drive: Drive, robot: Robot) -> list[Finding]:
    """Return findings on positions that are much less exact than is claimed, by the truth, fixes also without."""
    found = []
    for sensor in (GPS, POSE):
        if sensor == GPS and drive.truth is None:
            found += _of_claim(drive, robot, GPS, "from one to the next", [white_error(drive)])
            continue
        m, poses = _beside_truth(drive, sensor)
        if m is None or m.extra.get("drifts", np.zeros(1)).any():
            continue
        A, y = se2.in_other_frame(m.z, poses)
        x, _ = robust(A, y)
        rest = y - A @ x
        seen = [robust_sigma(np.concatenate((rest.real, rest.imag)))]
        if sensor == POSE and robot.settings(POSE).heading and np.isfinite(poses[:, 2]).all():
            off = np.exp(1.0j * (m.z[:, 2] - poses[:, 2]))
            seen.append(math.degrees(robust_sigma(np.angle(off / np.mean(off)))))
        found += _of_claim(drive, robot, sensor, "by the truth", seen)
    return found


def _of_claim(drive: Drive, robot: Robot, sensor: str, source: str, seen: Sequence[float]) -> list[Finding]:
    """Return a finding if the errors `seen` of positions [m] (and headings [deg]) exceed those claimed."""
    if sensor not in drive.measurements:
        return []
    keys, claimed = REGISTRY[sensor].noise_keys, REGISTRY[sensor].claimed(drive.measurements[sensor])
    now = claimed.get(keys[0], getattr(robot.settings(sensor), keys[0]))
    if seen[0] < MAX_CLAIM_RATIO * now:
        return []
    who = "messages claim" if claimed else "settings say"
    words = f"{source} its positions are wrong by {seen[0]:.2g} m (1 sigma), its {who} {now:.2g} m"
    fixes = [f"{sensor}.covariance=sigma"] if claimed else []
    fixes += [f"{sensor}.{key}={value:.2g}" for key, value in zip(keys, seen, strict=False)]
    return [Finding(sensor, CLAIM, words, tuple(fixes))]


def of_east(drive: Drive, robot: Robot) -> list[Finding]:
    """Return the finding on the direction of east by the truth, which the filter would estimate on every drive."""
    fit = by_truth(drive, GPS) if robot.settings(GPS).east_deg is None else None
    if fit is None or not math.degrees(fit.turn_sigma) < MAX_EAST_SIGMA_DEG:
        return []
    east, sigma = -math.degrees(fit.turn), math.degrees(fit.turn_sigma)
    words = f"the direction of east is estimated on every drive; by the truth it is {east:z.2f}°"
    return [Finding(GPS, EAST, f"{words} (1 sigma {sigma:.1g}°)", (f"gps.east_deg={east:z.2f}",))]


class Antenna(NamedTuple):
    """Antenna position on the base by the headings of one run; also the clock error with the same effect."""

    rest: float  # m, median residual of the steps
    x: float  # m
    y: float  # m
    sigma: float  # m
    early: float  # s by which the stamps of the fixes would be early; negative: late


def of_antenna(drive: Drive, robot: Robot, runs: Iterable[Estimates]) -> tuple[Finding, tuple[str, ...]] | None:
    """Return a finding on the antenna's position on the base, and an alternative fix (the clock), if any.

    `runs` do not use the fixes, whose noise would be in the headings. The run that explains the fixes best is
    used.
    """
    settings, exact = robot.settings(GPS), by_truth(drive, GPS)
    known = exact is not None and math.isfinite(exact.sigma)
    fits = [] if known else [a for e in runs if (a := _antenna(drive, settings, e)) is not None]
    beside = min(fits, key=lambda fit: fit.rest, default=None)
    found = exact if known else beside
    if found is None:
        return None
    away = math.hypot(found.x - settings.x, found.y - settings.y)
    if away < max(MIN_ANTENNA_M, ANTENNA_SIGMAS * found.sigma):
        return None
    words = (
        f"{'by the truth its antenna sits' if known else 'its antenna seems to sit'} at ({found.x:z.2f}, "
        f"{found.y:z.2f}) m on the base (1 sigma {found.sigma:.2g}), not at ({settings.x:g}, {settings.y:g})"
    )
    rival: tuple[str, ...] = ()
    if beside is not None:
        words += f", or its fixes are {abs(beside.early):.2f} s {'early' if beside.early > 0.0 else 'late'}"
        rival = (f"gps.time_offset={settings.time_offset + beside.early:z.3f}",)
    fixes = f"gps.x={found.x:z.3f}", f"gps.y={found.y:z.3f}"
    return Finding(GPS, ANTENNA, words, fixes, away > SEVERE_ANTENNA_M), rival


def _antenna(drive: Drive, settings: Any, run: Estimates) -> Antenna | None:
    """Fit the antenna to the fixes by the headings of a run; None for a drive that is too short or too straight.

    Points are complex numbers. Over WINDOW_S, the fixes change by a (dp + dr l). dp is the change of the axle's
    position by the wheels' distances and the run's headings, dr that of exp(i theta), l the antenna position, and
    the factor a rotates the map to east and north. At a constant speed, a late fix has the same effect as an
    antenna further back.
    """
    m, theta = drive.measurements[GPS], np.unwrap(run.pose[:, 2])
    path = axle_path(Truth("", run.t, run.pose[:, :2], theta), drive.wheels)
    last = np.searchsorted(m.t, m.t + WINDOW_S)
    first = np.flatnonzero(last < len(m.t))
    last = last[first]
    if path is None or len(first) < MIN_WINDOWS:
        return None
    before, p, after = (np.interp(m.t + s, run.t, path @ (1.0, 1.0j)) for s in (-SPEED_S, 0.0, SPEED_S))
    pointing, speed = np.exp(1.0j * np.interp(m.t, run.t, theta)), (after - before) / (2.0 * SPEED_S)
    y, moved, turned, faster = (c[last] - c[first] for c in (m.z @ (1.0, 1.0j), p, pointing, speed))
    if (np.abs(turned) ** 2).sum() < MIN_TURNED:
        return None

    def lever(some: Any) -> tuple[float, float]:
        ratio, _ = _ratio(moved[some], turned[some], y[some])
        return ratio.real, ratio.imag

    ratio, rest = _ratio(moved, turned, y)
    sigma = float(np.hypot(*jackknife(lever, len(y), STRETCH_COUNT)))
    lever_now = np.exp(1.0j * np.angle(np.vdot(moved, y))) * (settings.x + 1.0j * settings.y) * turned
    early, _ = _ratio(moved, faster, y - lever_now)
    return Antenna(rest, ratio.real, ratio.imag, sigma, early.real)


def _ratio(moved: Plane, other: Plane, y: Plane) -> tuple[complex, float]:
    """Fit a * moved + b * other = y to complex columns (n,); return b / a and the median residual [m]."""
    A = np.stack((moved, other), axis=-1)
    x, _ = robust(A, y)
    return complex(x[1] / x[0]), float(np.median(np.abs(y - A @ x)))
