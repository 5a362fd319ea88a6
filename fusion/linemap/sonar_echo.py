"""Which wall of a line map answers a sonar, and how its distance depends on pose and wall."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from locfuse.fusion.data import Array
from locfuse.fusion.ekf.belief_arrays import JointBelief
from locfuse.fusion.se2 import wrap_all

from .line_map import LineMap

CLEAR = 3.0  # standard deviations by which something may stand nearer before it is the one to answer
OVERHANG = 0.05  # m: a wall may go on this far beyond what was seen of it


class Cone(NamedTuple):
    """Where a sonar sits on the base, and what it hears."""

    x: float  # m
    y: float
    yaw: float  # rad
    half: float  # rad, half of the opening angle
    widen: float  # rad, slack for walls that stand square just outside of it


class Echo(NamedTuple):
    """The wall that should answer."""

    distance: float  # m, predicted
    line: int  # id in the map
    H: tuple[tuple[float, float, float], ...]  # (1, 3) by the pose
    columns: tuple[int, ...]  # states of the wall, none where it is not a state
    H_block: tuple[tuple[float, ...], ...]  # (1, 2) by (rho, beta)
    map_variance: float  # m^2, of a wall that is not a state


def nearest_echo(lines: LineMap, belief: JointBelief, cone: Cone, sigma: float) -> Echo | None:
    """Return the nearest wall that stands square to the cone, None where there is none or something is nearer."""
    values = lines.values(belief)
    lx, ly = _turned(belief.theta, cone.x, cone.y)
    dx, dy = belief.x + lx - lines.anchor[:, 0], belief.y + ly - lines.anchor[:, 1]
    c, s = np.cos(values[:, 1]), np.sin(values[:, 1])
    distance = values[:, 0] - dx * c - dy * s
    foot = dy * c - dx * s  # of the sonar along the wall, from its anchor
    off = wrap_all(values[:, 1] - belief.theta - cone.yaw)
    square = (np.abs(off) <= cone.half + cone.widen) & (distance > 0.0)
    square &= (foot >= lines.lo - OVERHANG) & (foot <= lines.hi + OVERHANG)
    if not square.any():
        return None
    j = int(np.flatnonzero(square)[np.argmin(distance[square])])
    slanted = _slanted(lines, distance, foot, off, cone.half)
    slanted[square] = np.inf
    if float(slanted.min()) < float(distance[j]) - CLEAR * sigma:
        return None
    u = float(dx[j] * s[j] - dy[j] * c[j])
    column = int(lines.column[j])
    by_turn = float(c[j] * ly - s[j] * lx)  # -n . dp/dtheta, the lever arm of the sonar
    own = lines.P[j]
    is_state = column >= 0
    variance = 0.0 if is_state else float(own[0, 0] + u * (2.0 * own[0, 1] + u * own[1, 1]))
    return Echo(
        float(distance[j]),
        int(lines.ids[j]),
        ((-float(c[j]), -float(s[j]), by_turn),),
        (column, column + 1) if is_state else (),
        ((1.0, u),) if is_state else (),
        variance,
    )


def _slanted(lines: LineMap, distance: Array, foot: Array, off: Array, half: float) -> Array:
    """Distance (J,) at which an edge of the cone meets each wall, or at which a wall ends in it; inf for none."""
    nearest = np.full(len(distance), np.inf)
    for edge in (-half, half):
        slope = np.cos(off - edge)
        with np.errstate(divide="ignore", invalid="ignore"):
            away = distance / slope
            at = foot + distance * np.tan(edge - off)
        hit = (slope > 1e-6) & (distance > 0.0) & (at >= lines.lo) & (at <= lines.hi)
        nearest = np.where(hit, np.minimum(nearest, away), nearest)
    for end in (lines.lo, lines.hi):
        along = end - foot
        away = np.hypot(distance, along)
        direction = np.arctan2(along, distance) + off
        hit = (np.abs(wrap_all(direction)) <= half) & (distance > 0.0)
        nearest = np.where(hit, np.minimum(nearest, away), nearest)
    return nearest


def _turned(theta: float, x: float, y: float) -> tuple[float, float]:
    c, s = math.cos(theta), math.sin(theta)
    return c * x - s * y, s * x + c * y
