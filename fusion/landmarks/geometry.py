"""Range and bearing to a point (Thrun, Burgard and Fox 2005, 6.6.2), with their derivatives."""

from __future__ import annotations

import math

from locfuse.fusion.core import bearings, sightings
from locfuse.fusion.core.room import Room

Point = tuple[float, float]
Row = tuple[float, float, float]


def detector_at(pose: tuple[float, float, float], mount: tuple[float, float, float]) -> Point:
    """Return where the detector is in the map, of a robot at a pose x, y [m], theta [rad]."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    return pose[0] + c * mount[0] - s * mount[1], pose[1] + s * mount[0] + c * mount[1]


def predict(pose: Row, place: Point, mount: Row) -> tuple[Point, tuple[Row, Row]] | None:
    """Return (range [m], bearing [rad]) of a landmark, and their derivatives by the robot's x, y, theta."""
    room = Room.here(bearings)
    ray, by = room.floats(bearings.RAY), room.floats(3)
    if not room.functions.bearing(room.flat((pose,)), *place, *mount, sightings.TOUCHING, ray):
        return None
    room.beside(sightings).functions.by_range(ray, mount[0], mount[1], 1.0, by)
    angle, bx, by_y, bt, *_, distance = room.listed(ray, bearings.RAY)
    rx, ry, rt = room.listed(by, 3)
    return (distance, angle), ((rx, ry, rt), (bx, by_y, bt))
