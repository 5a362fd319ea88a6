"""Which wall of a line map answers a sonar, and how its distance depends on pose and wall."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from locfuse.fusion.core import echoes as core
from locfuse.fusion.core.room import Room
from locfuse.fusion.ekf.belief_arrays import JointBelief

from .line_map import LineMap


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
    on, out = Room.here(core).on_arrays, np.empty(core.ECHO)
    j = on.answering(belief.arrays[0], lines.table(), *belief.pose(), *cone, sigma, out)
    if j < 0:
        return None
    distance, by_x, by_y, by_turn, u, variance = out.tolist()
    column = int(lines.column[j])
    is_state = column >= 0
    return Echo(
        distance,
        int(lines.ids[j]),
        ((by_x, by_y, by_turn),),
        (column, column + 1) if is_state else (),
        ((1.0, u),) if is_state else (),
        variance,
    )
