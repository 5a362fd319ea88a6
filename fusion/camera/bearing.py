"""The bearing of a known landmark as a function of the pose, right and as printed."""

from __future__ import annotations

import math

from locfuse.fusion.core import bearings as core
from locfuse.fusion.core.room import Room
from locfuse.fusion.se2 import wrap

Point = tuple[float, float]
Row = tuple[float, float, float]
MIN_DISTANCE_M = 0.05  # m: nearer than this the camera is inside the landmark
H_ORIENTATION: Row = (0.0, 0.0, 1.0)  # the camera's row of eq. 13, as printed


def paper_orientation(direction: float, bearing: float) -> float:
    """gamma_k of eq. 16 [rad]: the landmark's direction in the map minus its bearing in the base frame."""
    return direction - bearing


def predict_bearing(
    pose: tuple[float, float, float], landmark: Point, lever: Point, yaw: float
) -> tuple[float, Row] | None:
    """Return h(x) [rad] and its row H (x, y, theta) for a camera at `lever`, `yaw` on the base.

    None where the camera is inside the landmark.
    """
    seen = _seen(pose, landmark, lever, yaw)
    return None if seen is None else (wrap(seen[0]), (seen[1], seen[2], seen[3]))


def bearing_by_mount(pose: tuple[float, float, float], landmark: Point, lever: Point) -> Row:
    """Return the derivative of the predicted bearing by the camera's x, y and yaw on the base; NaN inside it."""
    seen = _seen(pose, landmark, lever, 0.0)
    return (math.nan, math.nan, math.nan) if seen is None else (seen[4], seen[5], seen[6])


def _seen(pose: tuple[float, float, float], landmark: Point, lever: Point, yaw: float) -> list[float] | None:
    """Return the bearing and its derivatives by pose and mount (7,), as the core has them."""
    room = Room.here(core)
    out = room.floats(core.RAY)
    found = room.functions.bearing(room.flat((pose,)), *landmark, *lever, yaw, MIN_DISTANCE_M, out)
    return room.listed(out, core.RAY) if found else None
