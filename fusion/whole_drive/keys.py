"""Key poses: the readings that the graph is made of.

A key every half metre or 20 degrees; between two of them the wheels are good enough.
"""

from __future__ import annotations

import numpy as np

from locfuse.fusion.data import Ints
from locfuse.fusion.scan_matching.key_scans import spaced

from .odometry import Odometry

KEY_WAY_M, KEY_TURN_RAD = 0.5, np.radians(20.0)


def choose_keys(odometry: Odometry, instants: Ints) -> Ints:
    """Return which of the readings at `instants` become keys: their positions (k,), the first one among them."""
    return spaced(odometry.way()[instants], odometry.pose[instants, 2], KEY_WAY_M, KEY_TURN_RAD)
