"""An occupancy grid: which cells are walls, which are free, and where they lie in the map."""

from __future__ import annotations

import msgspec
import numpy as np
from numpy.typing import NDArray

from locfuse.fusion import se2
from locfuse.fusion.data import Array

Mask = NDArray[np.bool_]


class Grid(msgspec.Struct, frozen=True):
    """Cells (rows, columns), the first row and column at the origin; what is neither is unknown."""

    occupied: Mask
    free: Mask
    cell: float  # m
    origin: Array  # (3,) x, y [m], yaw [rad] of the lower left corner of the first cell, map frame

    def to_map(self, places: Array) -> Array:
        """Return places (n, 2), in cells from the lower left corner as x, y, in the map [m]."""
        return np.asarray(se2.transform(self.origin, self.cell * places))
