"""Does the drive start where the truth says? By its first pose, or by the shape of the first metres."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from locfuse.fusion import se2
from locfuse.fusion.data import Array, Drive, Truth
from locfuse.fusion.robot import Robot

from .finding import Finding

START = "start"  # code of the finding
SEVERE_START_ERROR_M, SEVERE_START_ERROR_RAD = 0.1, math.radians(5.0)
MIN_START_ERROR_M, MIN_START_ERROR_RAD = (
    0.02,
    math.radians(1.0),
)  # by poses; the shape of points tells it less exactly
SIGMAS = 3.0  # standard deviations of the start, as it is configured and as it is told
SHAPE_WAY_M, POSE_WAY_M = 3.0, 0.1  # m of the drive from which the start pose is told: by points, by poses
MIN_SHAPE_EXTENT_M = 0.3  # m, extent of the points


def of_start(truth: Truth, drive: Drive, robot: Robot) -> list[Finding]:
    """Compare the start pose with the one that lays the wheels' first way over the truth's."""
    fitted = start_pose(truth, drive)
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
    if truth.theta is None:
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
    fixes = (f"start.x={x:.3f}", f"start.y={y:.3f}", f"start.theta_deg={degrees:.1f}", *moments)
    return [Finding("truth", START, words, fixes, severe)]


class Start(NamedTuple):
    """Where the truth says that the drive started."""

    pose: Array  # (3,) of the base at the first wheel reading, as the wheels lead back to it
    way: float  # m of the drive from which it is told
    sigma: float  # rad by which the wheels may have turned wrongly meanwhile, or the truth's headings scatter
    spread: float  # m by which the truth's places scatter
    t: float  # s at which the truth begins, where the robot has moved by then; else at the first reading


def start_pose(truth: Truth, drive: Drive) -> Start | None:
    """Return where the drive started; None if its first metres do not show it.

    A truth with headings tells at once, points only by the shape of the first metres of the truth.
    """
    wheels = drive.wheels
    inside = (truth.t >= wheels.t[0]) & (truth.t <= wheels.t[-1])
    way, fewest = (SHAPE_WAY_M, 5) if truth.theta is None else (POSE_WAY_M, 1)
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
    if truth.theta is not None:
        turns = se2.wrap_all(truth.theta[inside] - own[:, 2])
        turn, metre = float(turns[0] + np.median(se2.wrap_all(turns - turns[0]))), 1.0
    elif float(np.ptp(points, axis=0).max()) < MIN_SHAPE_EXTENT_M:
        return None
    else:
        turn, metre = se2.laid_on(points, tracked)
    places = tracked - metre * se2.rotated(np.full(len(points), turn), points)
    place = np.median(places, axis=0)
    if truth.theta is None:
        blur = math.sqrt(2.0 * wheels.noise * way) / wheels.track
    else:
        blur = float(np.std(se2.wrap_all(turns - turn))) / math.sqrt(len(points))
    spread = float(np.hypot(*(places - place).std(axis=0))) / math.sqrt(len(points))
    moved = float(wheels.driven(first) - wheels.driven(wheels.t[0])) > POSE_WAY_M
    return Start(np.array([*place, se2.wrap(turn)]), way, blur, spread, first if moved else float(wheels.t[0]))
