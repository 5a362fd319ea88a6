"""The measured lines of one scan."""

from __future__ import annotations

from typing import NamedTuple

import msgspec
import numpy as np

from locfuse.fusion.data import Array, Ints, Measurements
from locfuse.fusion.lines.extract import LINE, of_rows, rows_in_base, rows_of

from .laser_mount import Seat

BLOCK = 4096  # lines that become one table at a time: an hour of them need not be there at once


class Scan(msgspec.Struct, frozen=True, gc=False):
    """Measured lines of one scan in the base frame, k of them."""

    z: Array  # (k, 2) r, psi
    R: Array  # (k, 2, 2)
    ends: Array  # (k, 2) along the tangent (-sin psi, cos psi)
    seat: Seat | None = None  # where the laser's mount is uncertain
    table: Array | None = None  # the same as one table, where somebody has it

    def rows(self) -> Array:
        """Return the lines as one table (k, 7): r, psi, R as 00, 01, 11, and both ends."""
        return rows_of(self.z, self.R, self.ends) if self.table is None else self.table


class Scans:
    """Reads the laser's measurements scan by scan, in the order of time."""

    def __init__(self) -> None:
        self._of: Measurements | None = None
        self._begin = self._end = 0
        self._R: Array = np.zeros((0, 2, 2))
        self._rows: Array = np.zeros((0, LINE))

    def read(self, m: Measurements, first: int, last: int) -> Scan:
        """Return rows first:last as one scan."""
        if m is not self._of or first < self._begin or last > self._end:
            self._of, self._begin, self._end = m, first, max(last, min(first + BLOCK, len(m.z)))
            at = slice(self._begin, self._end)
            self._R = m.covariances(at)
            self._rows = rows_of(m.z[at], self._R, m.extra["ends"][at])
        at, held = slice(first, last), slice(first - self._begin, last - self._begin)
        return Scan(m.z[at], self._R[held], m.extra["ends"][at], None, self._rows[held])


class Where(NamedTuple):
    """Where the robot was at n scans that the core took."""

    of: Measurements
    readings: Ints  # (n,) which scans
    before: Array  # (n, 3) predicted, x, y [m], theta [rad]
    mount: Array  # (n, 3) how the laser's mount, as it was predicted, moved their lines
    after: Array  # (n, 3) corrected

    def rows(self, k: int) -> tuple[int, int]:
        """First row of scan k of these and end in the measurements."""
        i = int(self.readings[k])
        return int(self.of.first[i]), int(self.of.first[i + 1])

    def seated(self, k: int, scan: Scan) -> Scan:
        """Return the lines of scan k in the base by the mount of that time."""
        x, y, yaw = self.mount[k].tolist()
        table = rows_in_base(scan.rows(), x, y, yaw)
        return Scan(*of_rows(table), None, table)
