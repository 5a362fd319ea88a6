"""Range and bearing to a point (Thrun, Burgard and Fox 2005, 6.6.2), with their derivatives."""

from __future__ import annotations

from locfuse.fusion.se2 import direction, sight

Point = tuple[float, float]
Row = tuple[float, float, float]
MIN_DISTANCE_M = 1e-3  # m: nearer than this a bearing has no direction


def detector_at(pose: tuple[float, float, float], mount: tuple[float, float, float]) -> Point:
    """Return where the detector is in the map, of a robot at a pose x, y [m], theta [rad]."""
    c, s = direction(pose[2])
    return pose[0] + c * mount[0] - s * mount[1], pose[1] + s * mount[0] + c * mount[1]


def predict(pose: Row, place: Point, mount: Row) -> tuple[Point, tuple[Row, Row]] | None:
    """Return (range [m], bearing [rad]) of a landmark, and their derivatives by the robot's x, y, theta."""
    seen = sight(pose, place, mount, MIN_DISTANCE_M)
    if seen is None:
        return None
    bearing, distance, by_pose, (by_lever_x, by_lever_y, _) = seen
    turned = -distance * (mount[0] * by_lever_x + mount[1] * by_lever_y)
    by_range = by_pose[1] * distance, -by_pose[0] * distance, turned
    return (distance, bearing), (by_range, by_pose)
