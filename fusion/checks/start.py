"""Start checks: the configured start pose against the start of the drive by the truth."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from msgspec.structs import replace

from locfuse.fusion import se2
from locfuse.fusion.data import Array, Drive, Ints, Truth
from locfuse.fusion.robot import Robot
from locfuse.fusion.statistics import jackknife, robust_sigma
from locfuse.fusion.wheels.motion import STANDS_M

from .finding import Finding
from .tracked_point import axle_path

START = "start"  # code of the finding
SEVERE_START_ERROR_M, SEVERE_START_ERROR_RAD = 0.1, math.radians(5.0)
MIN_START_ERROR_M, MIN_START_ERROR_RAD = 0.02, math.radians(1.0)  # limits for a truth with headings
DRIVES_S = 0.5  # s after the first reading: a robot that drives rolls more than STANDS_M in this time
START_SIGMAS = 3.0  # of the combined sigma of configured and true start
SHAPE_WAY_M, POSE_WAY_M = 3.0, 0.1  # m of the drive that are used to find the start pose: by points, by poses
MIN_SHAPE_EXTENT_M = 0.3  # m, extent of the points
PATH_PARTS, MIN_PATH_POSES = 8, 40  # parts of a run's path, each left out once; poses of the truth beside it
MAX_PATH_SCALE = 0.015  # largest relative error of the path's scale: lasers are right to about 1 %
FEW_READINGS = 5  # fewer readings do not show their noise


def of_start(
    truth: Truth, drive: Drive, robot: Robot, aside: float = 0.0, by_points: bool = False
) -> list[Finding]:
    """Return a finding if the configured start differs from the start pose by the truth.

    If the robot drives sideways by the angle `aside` [rad], the heading is found from the shape of the path.
    `by_points`: the truth has positions only, and its headings are those of the configured start.
    """
    fitted = start_pose(truth, drive, by_shape=aside > 0.0)
    if fitted is None:
        return []
    moment = fitted.t or robot.start.at
    at = np.float64(moment if isinstance(moment, float) else 0.0)
    both = np.stack((np.array(robot.start.pose), fitted.pose))
    wheels = drive.wheels
    configured, (x, y, theta) = se2.compose(both, wheels.relative(wheels.t[0], at)).tolist()
    away, turn = math.hypot(x - configured[0], y - configured[1]), abs(se2.wrap(theta - configured[2]))
    severe = away > SEVERE_START_ERROR_M or turn > SEVERE_START_ERROR_RAD
    least = (MIN_START_ERROR_M, MIN_START_ERROR_RAD)
    if truth.theta is None or aside or by_points:
        least = (SEVERE_START_ERROR_M, SEVERE_START_ERROR_RAD)
    place_sigma = fitted.place_sigma(robot, truth)
    turn_sigma = math.hypot(math.radians(robot.start.sigma_theta_deg), fitted.sigma)
    if away < least[0] + START_SIGMAS * place_sigma and turn < least[1] + START_SIGMAS * turn_sigma:
        if truth.theta is not None:
            return []
        # if the configured heading is right, the first positions show the place, which the path's shape hides
        headings = configured[2] + wheels.heading(truth.t) - wheels.heading(at)
        return of_start(replace(truth, theta=headings), drive, robot, by_points=True)
    drives = severe and robot.start_given and wheels.driven(wheels.t[0] + DRIVES_S) > STANDS_M
    begun = ", and the robot drives at the first reading: its beginning may be lost" if drives else ""
    where = f"the drive is at {at:.1f} s" if fitted.t else "the drive starts"
    turned = "" if by_points else f" and {math.degrees(turn):.1f} deg"
    words = (
        f"it starts {away:.2f} m{turned} from where {where}{begun}; set the start, or "
        "judge the shape only (--align origin)"
    )
    degrees = math.degrees(se2.wrap(theta))
    moments = (f"start.at={at:.2f}",) if fitted.t else ()
    unsure = [f"start.sigma_theta_deg={math.degrees(aside):.1f}"] if aside else []
    if truth.theta is not None and not (aside or by_points) and START_SIGMAS * fitted.sigma > MIN_START_ERROR_RAD:
        unsure = [
            f"start.sigma_xy={fitted.spread / math.sqrt(2.0):.3f}",
            f"start.sigma_theta_deg={math.degrees(fitted.sigma):.1f}",
        ]
    digits = 1 if truth.theta is None else 2
    fixes = (
        f"start.x={x:.3f}",
        f"start.y={y:.3f}",
        f"start.theta_deg={round(degrees, digits)}",
        *unsure,
        *moments,
    )
    return [Finding("truth", START, words, fixes, severe)]


def start_by_shape(truth: Truth, drive: Drive) -> tuple[str, ...]:
    """Return the start settings by the shape of the path of a truth without headings; () if unclear."""
    fitted = start_pose(truth, drive) if truth.theta is None else None
    if fitted is None or fitted.t != float(drive.wheels.t[0]):
        return ()
    x, y, theta = fitted.pose.tolist()
    return f"start.x={x:.3f}", f"start.y={y:.3f}", f"start.theta_deg={math.degrees(theta):.1f}"


def start_by_path(truth: Truth, path: Array, P: Array, drive: Drive, robot: Robot) -> Finding | None:
    """Return the finding on a wrong start by the path of a run; None if the first readings show it better.

    `path` (q, 3) are the run's poses at the truth's stamps, `P` (q, 3, 3) their covariances. All of it is laid on
    the truth, and the start moves with it. Errors are those of a jackknife over PATH_PARTS parts of the drive, and
    what the run claims: its map may be turned at the start.
    """
    first, known = start_pose(truth, drive), np.isfinite(path[:, 0])
    if first is None or first.t != float(drive.wheels.t[0]) or robot.start.at or known.sum() < MIN_PATH_POSES:
        return None
    own = path[known, :2] + se2.rotated(path[known, 2], np.tile(truth.point, (int(known.sum()), 1)))
    seen, configured = truth.xy[known], np.array(robot.start.pose)

    def moved(rows: Ints) -> Array:
        a, b = own[rows], seen[rows]
        turn, _ = se2.laid_on(a, b)
        place = b.mean(axis=0) + se2.rotated(np.array(turn), configured[:2] - a.mean(axis=0))
        return np.array([*place, configured[2] + turn])

    sigma = jackknife(moved, len(own), PATH_PARTS)
    # an error of the heading moves the path by its distance from the start
    far = math.sqrt(float(np.square(own - configured[:2]).sum(axis=1).mean()))
    claimed = math.sqrt(float(np.median(P[known, 0, 0] + P[known, 1, 1])))
    larger = se2.laid_on(own, seen)[1] - 1.0  # by a wrong scale the path's middle is at a wrong distance
    if abs(larger) > MAX_PATH_SCALE:
        return None
    if math.hypot(*sigma[:2], far * sigma[2], claimed, far * larger) > math.hypot(first.spread, far * first.sigma):
        return None
    x, y, theta = moved(np.arange(len(own))).tolist()
    away, turn = math.hypot(x - configured[0], y - configured[1]), abs(theta - configured[2])
    words = (
        f"by the laser's whole path it starts {away:.2f} m and {math.degrees(turn):.1f} deg from where the drive "
        f"starts (1 sigma {math.hypot(*sigma[:2]):.3f} m, {math.degrees(sigma[2]):.2f} deg)"
    )
    sure = away > MIN_START_ERROR_M + START_SIGMAS * math.hypot(*sigma[:2], robot.start.sigma_xy)
    turned = math.hypot(sigma[2], math.radians(robot.start.sigma_theta_deg))
    if not (sure or turn > MIN_START_ERROR_RAD + START_SIGMAS * turned):
        return None
    severe = away > SEVERE_START_ERROR_M or turn > SEVERE_START_ERROR_RAD
    degrees = math.degrees(se2.wrap(theta))
    fixes = (f"start.x={x:.3f}", f"start.y={y:.3f}", f"start.theta_deg={round(degrees, 2)}")
    return Finding("truth", START, words, fixes, severe)


class TruthStart(NamedTuple):
    """Start pose of the drive by the truth."""

    pose: Array  # (3,) of the base at the first wheel reading
    way: float  # m of the drive that were used
    sigma: float  # rad, of the heading: by slip, or by noise of the truth's headings
    spread: float  # m, standard error by the truth's positions
    t: float  # s: start of the truth if the robot moved before it, else the first wheel reading

    def place_sigma(self, robot: Robot, truth: Truth) -> float:
        """Return the sigma [m] of the difference between the start positions in robot.toml and by the truth."""
        # the path is aligned about its middle: an error of the heading moves the start by half the path times it
        return math.hypot(robot.start.sigma_xy, 0.5 * self.way * self.sigma, self.spread, truth.sigma)


def start_pose(truth: Truth, drive: Drive, by_shape: bool = False) -> TruthStart | None:
    """Return the start pose by the truth; None if the first metres of the drive do not show it.

    It follows from the first poses of a truth with headings, else from the shape of its first metres.
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
        heading_sigma = math.sqrt(2.0 * wheels.noise * way) / wheels.track
    else:
        heading_sigma = float(np.std(se2.wrap_all(turns - turn))) / math.sqrt(len(points))
    spread = float(np.hypot(*(places - place).std(axis=0))) / math.sqrt(len(points))
    if headings is not None and len(points) < FEW_READINGS <= len(truth.t):  # the whole drive shows their noise
        steps = se2.wrap_all(np.diff(headings - wheels.heading(truth.t)))
        path = axle_path(truth, wheels)
        aside = np.zeros(1) if path is None else np.diff(truth.xy - path, axis=0)
        turned, apart = (robust_sigma(part) / math.sqrt(2.0 * len(points)) for part in (steps, aside))
        heading_sigma, spread = max(heading_sigma, turned), max(spread, math.sqrt(2.0) * apart)
    moved = float(wheels.driven(first) - wheels.driven(wheels.t[0])) > POSE_WAY_M
    at = first if moved else float(wheels.t[0])
    return TruthStart(np.array([*place, se2.wrap(turn)]), way, heading_sigma, spread, at)
