"""Range and bearing to a point (Thrun, Burgard and Fox 2005, 6.6.2), with their derivatives."""

from __future__ import annotations

import math

Point = tuple[float, float]
TOUCHING_M = 1e-3  # m: nearer than this a bearing has no direction


def detector_at(pose: tuple[float, float, float], mount: tuple[float, float, float]) -> Point:
    """Return where the detector is in the map, of a robot at a pose x, y [m], theta [rad]."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    return pose[0] + c * mount[0] - s * mount[1], pose[1] + s * mount[0] + c * mount[1]


def predict(
    pose: tuple[float, float, float], place: Point, mount: tuple[float, float, float]
) -> tuple[Point, tuple[tuple[float, float, float], tuple[float, float, float]]] | None:
    """Return (range [m], bearing [rad]) of a landmark, and their derivatives by the robot's x, y, theta."""
    x, y = detector_at(pose, mount)
    dx, dy = place[0] - x, place[1] - y
    r = math.hypot(dx, dy)
    if r < TOUCHING_M:
        return None
    # the detector moves by (ax, ay) per radian that the robot turns
    ax, ay = pose[1] - y, x - pose[0]
    q = r * r
    by_range = (-dx / r, -dy / r, -(dx * ax + dy * ay) / r)
    by_bearing = (dy / q, -dx / q, (dy * ax - dx * ay) / q - 1.0)
    return (r, math.atan2(dy, dx) - pose[2] - mount[2]), (by_range, by_bearing)
