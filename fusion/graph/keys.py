"""Key poses: the readings that the graph is made of.

A key every half metre or 20 degrees; between two of them the wheels are good enough.
"""

from __future__ import annotations

import numpy as np

from locfuse.fusion.data import Ints

from .odometry import Odometry

KEY_WAY_M, KEY_TURN_RAD = 0.5, np.radians(20.0)


def choose_keys(odometry: Odometry, instants: Ints) -> Ints:
    """Return which of the readings at `instants` become keys: their positions (k,), the first one among them."""
    way, heading = odometry.way()[instants].tolist(), odometry.pose[instants, 2].tolist()
    chosen, last_way, last_heading = [], -np.inf, 0.0
    for i, (s, theta) in enumerate(zip(way, heading, strict=True)):
        if s - last_way >= KEY_WAY_M or abs(theta - last_heading) >= KEY_TURN_RAD:
            chosen.append(i)
            last_way, last_heading = s, theta
    return np.array(chosen, dtype=np.int64)
