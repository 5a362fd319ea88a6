"""The measured lines of one scan: arrays, and plain floats where a loop reads them."""

from __future__ import annotations

import msgspec
import numpy as np

from locfuse.fusion.data import Array, Measurements

from .laser_mount import Seat

BLOCK = 4096  # lines that become plain floats at a time: an hour of them would be a hundred megabytes
Floats = list[list[float]]  # (k, 7) r, psi, R as 00, 01, 11, and both ends


class Scan(msgspec.Struct, frozen=True, gc=False):
    """Measured lines of one scan in the base frame, k of them."""

    z: Array  # (k, 2) r, psi
    R: Array  # (k, 2, 2)
    ends: Array  # (k, 2) along the tangent (-sin psi, cos psi)
    seat: Seat | None = None  # where the laser's mount is uncertain
    floats: Floats | None = None  # the same as plain floats, where somebody has them

    def rows(self) -> Floats:
        """Return the lines as plain floats (k, 7)."""
        return floats_of(self.z, self.R, self.ends) if self.floats is None else self.floats


def floats_of(z: Array, R: Array, ends: Array) -> Floats:
    """Return lines as plain floats (k, 7)."""
    rows: Floats = np.column_stack((z, R[:, 0, 0], R[:, 0, 1], R[:, 1, 1], ends)).tolist()
    return rows


class Scans:
    """Reads the laser's measurements scan by scan, in the order of time."""

    def __init__(self) -> None:
        self._of: Measurements | None = None
        self._begin = self._end = 0
        self._R: Array = np.zeros((0, 2, 2))
        self._floats: Floats = []

    def read(self, m: Measurements, first: int, last: int) -> Scan:
        """Return rows first:last as one scan."""
        if m is not self._of or first < self._begin or last > self._end:
            self._of, self._begin, self._end = m, first, max(last, min(first + BLOCK, len(m.z)))
            at = slice(self._begin, self._end)
            self._R = m.covariances(at)
            self._floats = floats_of(m.z[at], self._R, m.extra["ends"][at])
        at, held = slice(first, last), slice(first - self._begin, last - self._begin)
        return Scan(m.z[at], self._R[held], m.extra["ends"][at], None, self._floats[held])
