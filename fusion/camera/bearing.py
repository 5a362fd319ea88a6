"""The bearing of a known landmark as a function of the pose, right and as printed."""

from __future__ import annotations

import math

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
    c, s = math.cos(pose[2]), math.sin(pose[2])
    dx = landmark[0] - pose[0] - c * lever[0] + s * lever[1]
    dy = landmark[1] - pose[1] - s * lever[0] - c * lever[1]
    q = dx * dx + dy * dy
    if q < MIN_DISTANCE_M**2:
        return None
    turn = -1.0 - (lever[0] * (dx * c + dy * s) + lever[1] * (dy * c - dx * s)) / q
    return wrap(math.atan2(dy, dx) - pose[2] - yaw), (dy / q, -dx / q, turn)


def bearing_by_mount(pose: tuple[float, float, float], landmark: Point, lever: Point) -> Row:
    """Return the derivative of the predicted bearing by the camera's x, y and yaw on the base."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    dx = landmark[0] - pose[0] - c * lever[0] + s * lever[1]
    dy = landmark[1] - pose[1] - s * lever[0] - c * lever[1]
    q = dx * dx + dy * dy
    return (dy * c - dx * s) / q, -(dx * c + dy * s) / q, -1.0
