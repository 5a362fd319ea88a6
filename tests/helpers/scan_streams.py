"""A stream of laser scans, each of one turn, as a log holds them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from locfuse.fusion.data import Array, ArrayStream, Column, Ragged

SCAN = "sensor_msgs/msg/LaserScan"


def scan_stream(t_ns: Sequence[int], ranges: Array) -> ArrayStream:
    """Return scans of `ranges` (k, beams) [m] that begin behind the laser and turn to the left."""
    n, beams = ranges.shape
    data: dict[str, Column] = {
        "angle_min": np.full(n, -np.pi),
        "angle_increment": np.full(n, 2.0 * np.pi / beams),
        "time_increment": np.zeros(n),
        "range_min": np.full(n, 0.05),
        "range_max": np.full(n, 12.0),
        "ranges": Ragged(ranges.ravel(), np.arange(n + 1) * beams),
    }
    return ArrayStream("/scan", SCAN, np.array(t_ns), data)
