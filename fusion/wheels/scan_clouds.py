"""The scans of a whole log as thinned points in the base frame, and the surfaces of some of them at a time."""

from __future__ import annotations

from typing import cast

import msgspec
import numpy as np
from numpy.typing import NDArray

from locfuse.fusion.data import Array, Ints, Stream
from locfuse.fusion.lines.points import SCANS_PER_BLOCK, Longest, left_out
from locfuse.fusion.lines.scans import Laser, equal_scans, points_in_base
from locfuse.fusion.scan_matching.clouds import MAX_RANGE_M, Clouds
from locfuse.fusion.sensor import WheelMotion

from .motion import Wheels

MAX_POINTS = 240  # of a scan: neighbouring beams say nothing new
FIELDS = ("angle_min", "angle_increment", "time_increment", "range_min", "range_max", "ranges")
# the motion of a robot of which nothing is known yet: none
STANDING = Wheels.from_twists(np.array([0.0, 1.0]), np.zeros((1, 3)), 1.0, 0.0)


class Scans(msgspec.Struct, frozen=True):
    """All scans of a log in time order: their points in the base frame, evenly thinned."""

    t: Array  # (n,) s since the stream's first stamp: the instants to which they are deskewed
    points: list[NDArray[np.float32]]  # n of (k, 2) [m], in the order of the beams: an hour of them fits in memory
    origin: Array  # (2,) m, the laser on the base
    skewed: bool  # whether any scan takes time

    def clouds(self, rows: Ints) -> Clouds:
        """Return the points and surfaces of some scans."""
        return Clouds.of_scans([self.points[row].astype(np.float64) for row in rows.tolist()], self.origin)


def read_scans(stream: Stream, laser: Laser, wheels: WheelMotion) -> Scans:
    """Return the scans of a stream; `wheels` gives the robot's motion during each.

    A range that the driver writes where nothing came back is left out, unless `laser` says how far it sees.
    """
    return left_out(laser, lambda understood, longest: _read(stream, understood, wheels, longest))[0]


def _read(stream: Stream, laser: Laser, wheels: WheelMotion, longest: Longest) -> Scans:
    """Return the scans of a stream; `longest` counts all of its ranges."""
    stamps: Array = (stream.t_ns - stream.t_ns[0]) * np.float64(1e-9)
    t = stamps.copy()
    points: list[NDArray[np.float32]] = [np.zeros((0, 2), np.float32)] * len(t)
    skewed = False
    for rows, columns in stream.blocks(*FIELDS, rows=SCANS_PER_BLOCK):
        skewed |= bool(np.any(cast("Array", columns["time_increment"]) > 0.0)) and laser.deskew
        for group, scans in equal_scans(columns):
            longest.add(scans["ranges"], scans["range_max"])
            at = rows[group]
            xy, t[at] = points_in_base(scans, stamps[at], laser, wheels)
            for row, p in zip(at.tolist(), xy, strict=True):
                points[row] = _thinned(p, laser.mount[:2]).astype(np.float32)
    return Scans(np.maximum.accumulate(t), points, laser.mount[:2], skewed)  # sweeps of different lengths overlap


def _thinned(points: Array, origin: Array) -> Array:
    """Return the points (k, 2) that are near enough to be useful, evenly thinned."""
    near = points[np.hypot(*(points - origin).T) < MAX_RANGE_M]  # False for NaN: no return
    thinned: Array = near[:: max(1, -(-len(near) // MAX_POINTS))]
    return thinned
