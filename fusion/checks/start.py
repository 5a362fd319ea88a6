"""Start checks: the configured start pose against the start of the drive by the truth."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from msgspec.structs import replace

from locfuse.fusion import se2
from locfuse.fusion.data import Array, Drive, Truth
from locfuse.fusion.robot import Robot
from locfuse.fusion.wheels.motion import STANDS_M

from .finding import Finding

START = "start"  # code of the finding
SEVERE_START_ERROR_M, SEVERE_START_ERROR_RAD = 0.1, math.radians(5.0)
MIN_START_ERROR_M, MIN_START_ERROR_RAD = 0.02, math.radians(1.0)  # limits for a truth with headings
DRIVES_S = 0.5  # s after the first reading: a robot that drives rolls more than STANDS_M in this time
START_SIGMAS = 3.0  # of the combined sigma of configured and true start
SHAPE_WAY_M, POSE_WAY_M = 3.0, 0.1  # m of the drive that are used to find the start pose: by points, by poses
MIN_SHAPE_EXTENT_M = 0.3  # m, extent of the points


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
    unsure = (f"start.sigma_theta_deg={math.degrees(aside):.1f}",) if aside else ()
    fixes = (f"start.x={x:.3f}", f"start.y={y:.3f}", f"start.theta_deg={degrees:.1f}", *unsure, *moments)
    return [Finding("truth", START, words, fixes, severe)]


def start_by_shape(truth: Truth, drive: Drive) -> tuple[str, ...]:
    """Return the start settings by the shape of the path of a truth without headings; () if unclear."""
    fitted = start_pose(truth, drive) if truth.theta is None else None
    if fitted is None or fitted.t != float(drive.wheels.t[0]):
        return ()
    x, y, theta = fitted.pose.tolist()
    return f"start.x={x:.3f}", f"start.y={y:.3f}", f"start.theta_deg={math.degrees(theta):.1f}"


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
    moved = float(wheels.driven(first) - wheels.driven(wheels.t[0])) > POSE_WAY_M
    at = first if moved else float(wheels.t[0])
    return TruthStart(np.array([*place, se2.wrap(turn)]), way, heading_sigma, spread, at)
