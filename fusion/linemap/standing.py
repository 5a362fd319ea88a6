"""Scans of a robot that stands still: what repeats in every scan is not independent, and counts only a few times.

A line's error has a part that is new in every scan and a part that stays while the robot stays: a wall is no
plane, and the range error of a beam depends on its angle, the surface and the temperature. The second never
averages out, and no data sheet says how large it is. So of n scans at rest only the 1st, 2nd, 4th, 8th ... enter
the filter: ten of a minute at 10 Hz, sixteen of an hour. Each is the mean of the scans since the one before, with
the covariance of one, so that what does average out does. They also hold the robot where it is: encoders tremble
at rest, and their noise alone would let the pose drift. A scan in between costs a comparison with the first.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from locfuse.fusion.core import rests, tables
from locfuse.fusion.core.room import Room
from locfuse.fusion.data import Ints

from .scan import Scan

MAX_ROLLED_M, MAX_TURNED_RAD = 0.001, math.radians(0.1)  # since the first scan: encoders tremble by a tick
SAME_D2 = 25.0  # squared distance within which two lines of two scans are one
SAME_LENGTH = 0.5  # share of the longer one's length that two sights of one line have in common
SAME_SHARE = 0.5  # share of the seen length that must be the same: less, and something has moved


class Standing:
    """The scans since the wheels stood still."""

    def __init__(self) -> None:
        self._rolled = (0.0, 0.0, 0.0)  # x, y [m], theta [rad] by the wheels since the first scan
        self._scans = 0  # at rest; 0: none yet
        self._first: Scan | None = None
        self._lines = np.zeros((0, 4))  # r, psi and ends: of the first scan, and what others showed beside them
        self._sums = np.zeros((0, 2))  # of the scans since the last use, off these
        self._counts: Ints = np.zeros(0, np.intp)

    def rolled(self, u: Sequence[float]) -> None:
        """Take in wheel motion: x, y [m], theta [rad]. So small a motion may be summed component by component."""
        x, y, theta = self._rolled
        self._rolled = (x + u[0], y + u[1], theta + u[2])

    def since(self) -> tuple[float, float, float]:
        """Return the motion since the scan that the next one is compared with; infinite where there is none."""
        return self._rolled if self._first is not None else (math.inf, math.inf, math.inf)

    def moved(self, rolled: tuple[float, float, float]) -> None:
        """Take over that motion where somebody else has summed it up."""
        self._rolled = rolled

    def begin(self, scan: Scan) -> None:
        """Let a scan of a robot that drives be the one that the next is compared with."""
        self._scans, self._first = 1, scan

    def forget(self) -> None:
        """Let the next scan be the first."""
        self._first = None

    def take(self, scan: Scan) -> Scan | None:
        """Return what a scan says: itself, or at rest the mean since the last use; None where it only repeats."""
        x, y, theta = self._rolled
        if self._first is None or x * x + y * y > MAX_ROLLED_M**2 or not -MAX_TURNED_RAD < theta < MAX_TURNED_RAD:
            self._rolled = (0.0, 0.0, 0.0)  # driving: no more than this
            self.begin(scan)
            return scan
        if self._scans == 1:
            self._begin_sums(self._first)
        same = self._same(scan)
        length = scan.ends[:, 1] - scan.ends[:, 0]
        if float(length[same >= 0].sum()) < SAME_SHARE * float(length.sum()):
            return scan  # somebody stands before the laser, or the robot was carried away
        self._add(scan, same)
        if not Room.here(rests).functions.counts(self._scans):
            return None
        z = self._lines[same, :2] + self._sums[same] / self._counts[same, None]
        self._sums[:], self._counts[:] = 0.0, 0
        return Scan(z, scan.R, scan.ends)

    def table(self, lines: int, repeated: int = 0) -> Any:
        """Return the rest for the core, with room for scans of so many lines, and their verdict if they repeat."""
        known, room = len(self._lines), np.empty(len(self._lines), np.intp)
        return Room.here(tables).on_arrays.Rest(
            self._lines, self._sums, self._counts, known, self._scans, SAME_D2, SAME_LENGTH, repeated,
            np.empty(lines, np.intp), room, np.empty(known), 0,
        )  # fmt: skip

    def repeated(self, scans: int) -> None:
        """Take in that the core added so many scans to the sums."""
        self._scans += scans

    def _begin_sums(self, scan: Scan) -> None:
        self._lines = np.hstack((scan.z, scan.ends))
        self._sums, self._counts = np.zeros_like(scan.z), np.zeros(len(scan.z), np.intp)

    def _add(self, scan: Scan, same: Ints) -> None:
        """Take a scan into the sums; a line that repeats none begins one, which `same` (k,) names from here on."""
        new = np.flatnonzero(same < 0)
        if len(new):
            same[new] = len(self._lines) + np.arange(len(new))
            self._lines = np.vstack((self._lines, np.hstack((scan.z[new], scan.ends[new]))))
            self._sums = np.vstack((self._sums, np.zeros((len(new), 2))))
            self._counts = np.append(self._counts, np.zeros(len(new), np.intp))
        rest = self.table(0)
        rows = scan.rows()
        Room.here(rests).on_arrays.add_repeated(rows, 0, len(rows), rest, same)
        self._scans += 1

    def _same(self, scan: Scan) -> Ints:
        """Return for each line of a scan (k,) the one that it repeats, -1 for none."""
        rows = scan.rows()
        same = np.empty(len(rows), np.intp)
        Room.here(rests).on_arrays.repeats(rows, 0, len(rows), self.table(0), same)
        return same
