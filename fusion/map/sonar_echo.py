"""Sonar measurement model: the wall that returns the echo, its distance, and the derivatives of the distance."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from locfuse.fusion.ekf.belief_arrays import JointBelief
from locfuse.fusion.se2 import wrap

from .line_map import LineMap

MAX_OVERHANG_M = 0.05  # m that a wall may extend beyond its seen part
CLEAR_SIGMAS = 3.0  # standard deviations: no prediction if another wall is nearer than the echo by more
MIN_SLOPE = 1e-6  # least cosine at which an edge of the cone meets a wall


class Cone(NamedTuple):
    """Mount of a sonar on the base, and the opening angle of its cone."""

    x: float  # m
    y: float
    yaw: float  # rad
    half: float  # rad, half of the opening angle
    widen: float  # rad, added to `half` for walls perpendicular to a ray just outside the cone


class Echo(NamedTuple):
    """Predicted echo: distance, wall and derivatives."""

    distance: float  # m, predicted
    line: int  # id in the map
    H: tuple[tuple[float, float, float], ...]  # (1, 3) derivative by the pose
    columns: tuple[int, ...]  # state columns of the wall; empty if the wall is not a state
    H_block: tuple[tuple[float, ...], ...]  # (1, 2) derivative by (rho, beta)
    map_variance: float  # m^2, variance of the distance by a wall that is not a state


def nearest_echo(lines: LineMap, belief: JointBelief, cone: Cone, sigma: float) -> Echo | None:
    """Predict the echo of the nearest wall perpendicular to a ray; None without one, or if it is occluded."""
    px, py, theta = belief.pose()
    if not math.isfinite(theta):
        return None
    c, s = math.cos(theta), math.sin(theta)
    lever_x, lever_y = c * cone.x - s * cone.y, s * cone.x + c * cone.y
    half = max(min(cone.half, math.pi), 0.0)  # a message may hold any value
    axis, widest = theta + cone.yaw, half + cone.widen
    rho, beta = lines.values(belief).T
    with np.errstate(invalid="ignore"):  # an infinite beta gives NaN, which returns no echo
        n_x, n_y = np.cos(beta), np.sin(beta)
    dx, dy = px + lever_x - lines.anchor[:, 0], py + lever_y - lines.anchor[:, 1]
    distance, foot = rho - dx * n_x - dy * n_y, dy * n_x - dx * n_y
    perpendicular = math.cos(axis) * n_x + math.sin(axis) * n_y >= (math.cos(widest) if widest < math.pi else -2.0)
    perpendicular &= (lines.lo - MAX_OVERHANG_M <= foot) & (foot <= lines.hi + MAX_OVERHANG_M)
    ahead = distance > 0.0
    echoing = (perpendicular & ahead).nonzero()[0]
    if not len(echoing):
        return None
    j = int(echoing[distance[echoing].argmin()])
    nearest = distance.item(j)
    clear = nearest - CLEAR_SIGMAS * sigma
    # a wall met at an angle is at least as far as its perpendicular distance
    for k in ((distance < clear) & ahead & ~perpendicular).nonzero()[0].tolist():
        ends, off = (lines.lo.item(k), lines.hi.item(k)), wrap(beta.item(k) - axis)
        if _oblique_range(distance.item(k), foot.item(k), off, half, ends) < clear:
            return None
    by_x, by_y, u = -n_x.item(j), -n_y.item(j), -foot.item(j)
    H = ((by_x, by_y, by_y * lever_x - by_x * lever_y),)
    column = lines.column.item(j)
    if column >= 0:
        return Echo(nearest, lines.ids.item(j), H, (column, column + 1), ((1.0, u),), 0.0)
    (rr, rb), (_, bb) = lines.P[j].tolist()
    return Echo(nearest, lines.ids.item(j), H, (), (), rr + u * (2.0 * rb + u * bb))


def _oblique_range(distance: float, foot: float, off: float, half: float, ends: tuple[float, float]) -> float:
    """Return the least distance [m] of the wall on the edges of the cone, and of wall ends inside the cone.

    It is inf if an edge does not meet the wall and no end is inside. `half` [rad] is half the opening angle;
    `ends` [m] are along the wall.

    The perpendicular on the wall has the length `distance`, meets the wall at `foot` [m along it], and its
    direction differs from the cone's axis by `off` [rad].
    """
    nearest = math.inf
    for edge, end in ((-half, ends[0]), (half, ends[1])):
        slope = math.cos(off - edge)
        if slope > MIN_SLOPE and ends[0] <= foot + distance * math.tan(edge - off) <= ends[1]:
            nearest = min(nearest, distance / slope)
        along = end - foot
        if abs(wrap(math.atan2(along, distance) + off)) <= half:
            nearest = min(nearest, math.sqrt(distance * distance + along * along))
    return nearest
