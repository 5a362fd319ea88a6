"""The measured lines of one scan."""

from __future__ import annotations

import numpy as np

from locfuse.fusion.data import Array, Measurements
from locfuse.fusion.lines.extract import LINE, rows_of

BLOCK = 4096  # lines that become one table at a time: an hour of them need not be there at once


class Scan:
    """Measured lines of one scan in the base frame, k of them."""

    __slots__ = ("rows",)

    def __init__(self, rows: Array) -> None:
        """Rows (k, 7): r [m], psi [rad], R as 00, 01, 11, both ends [m] along the tangent (-sin psi, cos psi)."""
        self.rows = rows

    @classmethod
    def of(cls, z: Array, R: Array, ends: Array) -> Scan:
        """Return the scan of lines z (k, 2), R (k, 2, 2), ends (k, 2)."""
        return cls(rows_of(z, R, ends))

    @property
    def z(self) -> Array:
        """(k, 2) r, psi."""
        return self.rows[:, :2]

    @property
    def R(self) -> Array:
        """(k, 2, 2)."""
        R: Array = self.rows[:, (2, 3, 3, 4)].reshape(-1, 2, 2)
        return R

    @property
    def ends(self) -> Array:
        """(k, 2) m along the tangent."""
        return self.rows[:, 5:]

    @property
    def lengths(self) -> Array:
        """(k,) m."""
        length: Array = self.rows[:, 6] - self.rows[:, 5]
        return length


class Scans:
    """Reads the laser's measurements scan by scan, in the order of time."""

    def __init__(self) -> None:
        self._of: Measurements | None = None
        self._begin = self._end = 0
        self._rows: Array = np.zeros((0, LINE))

    def read(self, m: Measurements, first: int, last: int) -> Array:
        """Return rows first:last as one table (k, 7)."""
        if m is not self._of or first < self._begin or last > self._end:
            self._of, self._begin, self._end = m, first, max(last, min(first + BLOCK, len(m.z)))
            at = slice(self._begin, self._end)
            self._rows = rows_of(m.z[at], m.covariances(at), m.extra["ends"][at])
        return self._rows[first - self._begin : last - self._begin]
