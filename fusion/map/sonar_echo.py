"""The wall that returns a sonar's echo, and the derivatives of its distance by pose and wall."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from locfuse.fusion.data import Array
from locfuse.fusion.ekf.belief_arrays import JointBelief
from locfuse.fusion.se2 import wrap

from .line_map import LineMap

MAX_OVERHANG_M = 0.05  # m that a wall may go on beyond what was seen of it
CLEAR_SIGMAS = 3.0  # standard deviations by which something may stand nearer before it is the one to answer
MIN_SLOPE = 1e-6  # cosine from which an edge of the cone meets a wall at all


class Cone(NamedTuple):
    """Mount of a sonar on the base, and its cone."""

    x: float  # m
    y: float
    yaw: float  # rad
    half: float  # rad, half of the opening angle
    widen: float  # rad, slack for walls that stand square just outside of it


class Echo(NamedTuple):
    """The wall that is predicted to return the echo."""

    distance: float  # m, predicted
    line: int  # id in the map
    H: tuple[tuple[float, float, float], ...]  # (1, 3) by the pose
    columns: tuple[int, ...]  # states of the wall, none where it is not a state
    H_block: tuple[tuple[float, ...], ...]  # (1, 2) by (rho, beta)
    map_variance: float  # m^2, of a wall that is not a state


def nearest_echo(lines: LineMap, belief: JointBelief, cone: Cone, sigma: float) -> Echo | None:
    """Return the nearest wall perpendicular to a ray of the cone; None if there is none or something is nearer."""
    px, py, theta = belief.pose()
    if not math.isfinite(theta):
        return None
    c, s = math.cos(theta), math.sin(theta)
    lever_x, lever_y = c * cone.x - s * cone.y, s * cone.x + c * cone.y
    half = max(min(cone.half, math.pi), 0.0)  # none is wider than all around, whatever a message holds
    axis, widest = theta + cone.yaw, half + cone.widen
    rho, beta = _values(lines, belief)
    with np.errstate(invalid="ignore"):  # of a direction that is infinite: NaN, which answers nothing
        n_x, n_y = np.cos(beta), np.sin(beta)
    dx, dy = px + lever_x - lines.anchor[:, 0], py + lever_y - lines.anchor[:, 1]
    distance, foot = rho - dx * n_x - dy * n_y, dy * n_x - dx * n_y
    square = math.cos(axis) * n_x + math.sin(axis) * n_y >= (math.cos(widest) if widest < math.pi else -2.0)
    square &= (lines.lo - MAX_OVERHANG_M <= foot) & (foot <= lines.hi + MAX_OVERHANG_M)
    ahead = distance > 0.0
    answers = (square & ahead).nonzero()[0]
    if not len(answers):
        return None
    j = int(answers[distance[answers].argmin()])
    nearest = distance.item(j)
    clear = nearest - CLEAR_SIGMAS * sigma
    # what is met on a slant is no nearer than the foot on its wall
    for k in ((distance < clear) & ahead & ~square).nonzero()[0].tolist():
        ends, off = (lines.lo.item(k), lines.hi.item(k)), wrap(beta.item(k) - axis)
        if _slanted(distance.item(k), foot.item(k), off, half, ends) < clear:
            return None
    by_x, by_y, u = -n_x.item(j), -n_y.item(j), -foot.item(j)
    H = ((by_x, by_y, by_y * lever_x - by_x * lever_y),)
    column = lines.column.item(j)
    if column >= 0:
        return Echo(nearest, lines.ids.item(j), H, (column, column + 1), ((1.0, u),), 0.0)
    (rr, rb), (_, bb) = lines.P[j].tolist()
    return Echo(nearest, lines.ids.item(j), H, (), (), rr + u * (2.0 * rb + u * bb))


def _values(lines: LineMap, belief: JointBelief) -> tuple[Array, Array]:
    """Return rho [m] and beta [rad] of every line, (J,) each."""
    if lines.column[0] < 0:
        return lines.value[:, 0], lines.value[:, 1]
    return belief.state[lines.column], belief.state[lines.column + 1]


def _slanted(distance: float, foot: float, off: float, half: float, ends: tuple[float, float]) -> float:
    """Return the distance [m] at which an edge of the cone meets a wall, or the wall ends inside the cone.

    The wall's nearest point is `distance` away and at `foot` on it, in a direction `off` [rad] the cone's axis.
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
