"""Lines measured in one scan, and averaging of the scans of a robot at rest.

A line's error has an independent part in every scan, and a part that is constant while the robot is at rest: walls
are not planes, and range errors depend on angle, surface and temperature. The constant part does not average out,
and data sheets do not give its size. So of n scans at rest only the 1st, 2nd, 4th, 8th ... are used by the filter:
ten in a minute at 10 Hz, sixteen in an hour. Each used scan is the mean of the scans since the last used one, with
the covariance of a single scan, so that independent errors average out. These scans also prevent drift of the pose
by encoder noise at rest. Other scans are only compared with the first one.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import msgspec
import numpy as np

from locfuse.fusion.data import Array, Ints, Measurements
from locfuse.fusion.lines.extract import LINE_COLUMNS, of_rows, rows_of
from locfuse.fusion.se2 import wrap_all

LINES_AT_ONCE = 4096  # lines converted at a time, to save memory


class Scan(msgspec.Struct, frozen=True, eq=False):
    """Lines (k) measured in one scan, in the base frame."""

    rows: Array  # (k, 7): r [m], psi [rad], R as 00, 01, 11, both ends [m] along the tangent (-sin psi, cos psi)

    @classmethod
    def of(cls, z: Array, R: Array, ends: Array) -> Scan:
        """Return the scan of lines z (k, 2) with covariances R (k, 2, 2) and ends (k, 2)."""
        return cls(rows_of(z, R, ends))

    @property
    def z(self) -> Array:
        """Return the lines (k, 2): r [m], psi [rad]."""
        return self.rows[:, :2]

    @property
    def R(self) -> Array:
        """Return the covariances of (r, psi), (k, 2, 2) [m^2, rad^2]."""
        return of_rows(self.rows)[1]

    @property
    def ends(self) -> Array:
        """Return both ends of each line, (k, 2) [m along its tangent]."""
        return self.rows[:, 5:]


class LineReader:
    """Reader of the lines in laser measurements, for scans in order of time; it converts many lines at once."""

    def __init__(self) -> None:
        self._of: Measurements | None = None
        self._begin = self._end = 0
        self._rows: Array = np.zeros((0, LINE_COLUMNS))

    def read(self, m: Measurements, first: int, last: int) -> Array:
        """Return the lines with indices first to last - 1 of laser measurements m, as a table (k, 7).

        Each row is r [m], psi [rad], the covariance R_00, R_01, R_11, and both ends [m] along the line.
        """
        if m is not self._of or first < self._begin or last > self._end:
            self._of, self._begin, self._end = m, first, max(last, min(first + LINES_AT_ONCE, len(m.z)))
            at = slice(self._begin, self._end)
            self._rows = rows_of(m.z[at], m.covariances(at), m.extra["ends"][at])
        return self._rows[first - self._begin : last - self._begin]


MAX_ROLLED_M, MAX_TURNED_RAD = 0.001, math.radians(0.1)  # motion since the first scan that counts as rest
SAME_D2 = 25.0  # largest squared Mahalanobis distance between lines of two scans that are equal
SAME_LENGTH = 0.5  # least common length of equal lines, as share of the longer one
SAME_SHARE = 0.5  # least share of line length that must be equal at rest: with less, something has moved


class Standing:
    """Averages the scans since the robot stopped; a scan is a table of lines (k, 7)."""

    def __init__(self) -> None:
        self._rolled = (0.0, 0.0, 0.0)  # x, y [m], theta [rad] by the wheels since the first scan
        self._scans = 0  # at rest
        self._first: Array | None = None  # (k, 7) first scan at rest
        self._lines = np.zeros((0, 4))  # r, psi and ends: of the first scan, and new lines of later scans
        self._sums = np.zeros((0, 2))  # sums of (r, psi) minus `_lines`, over the scans since the last used one
        self._counts: Ints = np.zeros(0, np.intp)  # number of summands

    def rolled(self, u: Sequence[float]) -> None:
        """Add the wheel-odometry motion u = (x [m], y [m], theta [rad]) to the motion since the first scan.

        Motions of a robot at rest are small, so their components are summed.
        """
        x, y, theta = self._rolled
        self._rolled = (x + u[0], y + u[1], theta + u[2])

    def forget(self) -> None:
        """Drop all scans."""
        self._first = None

    def take(self, rows: Array) -> Array | None:
        """Return the lines to use: the scan itself if the robot moves, else the mean of scans at rest, or None."""
        x, y, theta = self._rolled
        drives = x * x + y * y > MAX_ROLLED_M**2 or not -MAX_TURNED_RAD < theta < MAX_TURNED_RAD
        if drives or self._first is None:
            self._rolled = (0.0, 0.0, 0.0)
            self._scans, self._first = 1, rows
            return rows
        if self._scans == 1:
            self._lines = self._first[:, (0, 1, 5, 6)]
            self._sums, self._counts = np.zeros((len(self._first), 2)), np.zeros(len(self._first), np.intp)
        same = self._same(rows)
        length = rows[:, 6] - rows[:, 5]
        if float(length[same >= 0].sum()) < SAME_SHARE * float(length.sum()):
            return rows  # something moved: a person stands in front of the laser, or the robot was carried
        self._add(rows, same)
        if self._scans & (self._scans - 1):  # only the 1st, 2nd, 4th, 8th ... is used
            return None
        mean = rows.copy()
        mean[:, :2] = self._lines[same, :2] + self._sums[same] / self._counts[same, None]
        self._sums[:], self._counts[:] = 0.0, 0
        return mean

    def _add(self, rows: Array, same: Ints) -> None:
        """Add line k of a scan to the sum of the equal earlier line `same[k]`; for -1, begin a new sum."""
        new = np.flatnonzero(same < 0)
        if len(new):
            same[new] = len(self._lines) + np.arange(len(new))
            self._lines = np.vstack((self._lines, rows[new][:, (0, 1, 5, 6)]))
            self._sums = np.vstack((self._sums, np.zeros((len(new), 2))))
            self._counts = np.append(self._counts, np.zeros(len(new), np.intp))
        off = rows[:, :2] - self._lines[same, :2]
        off[:, 1] = wrap_all(off[:, 1])
        self._sums[same] += off  # the indices are unique
        self._counts[same] += 1
        self._scans += 1

    def _same(self, rows: Array) -> Ints:
        """Return for each line of a scan (k,) the index of the equal earlier line; -1 without one.

        Two lines are equal if each is the other's nearest, within SAME_D2, and their common length is large
        enough.
        """
        known, k = self._lines, np.arange(len(rows))
        if not len(rows) or not len(known):
            return np.full(len(rows), -1, np.intp)
        begin, end = rows[:, 5:6], rows[:, 6:7]
        common = np.minimum(end, known[:, 3]) - np.maximum(begin, known[:, 2])
        longer = np.maximum(end - begin, known[:, 3] - known[:, 2])
        v_r, v_both, v_psi = rows[:, 2:3], rows[:, 3:4], rows[:, 4:5]
        det = v_r * v_psi - v_both * v_both
        r, psi = rows[:, 0:1] - known[:, 0], wrap_all(rows[:, 1:2] - known[:, 1])
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            d2 = (v_psi * r * r - 2.0 * v_both * r * psi + v_r * psi * psi) / (2.0 * det)
            d2 = np.where((common > SAME_LENGTH * longer) & (det > 0.0) & np.isfinite(d2), d2, np.inf)
        nearest: Ints = d2.argmin(axis=1)
        mutual = (d2[k, nearest] < SAME_D2) & (d2.argmin(axis=0)[nearest] == k)
        return np.where(mutual, nearest, -1)
