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

import numpy as np

from locfuse.fusion.data import Array, Ints
from locfuse.fusion.se2 import wrap_all

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
        self._z = np.zeros((0, 2))  # lines of the first scan, and those that others showed beside them
        self._ends = np.zeros((0, 2))
        self._sum = np.zeros((0, 2))  # of the scans since the last use, off these
        self._count: Ints = np.zeros(0, np.int64)

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
        if self._scans & (self._scans - 1):
            return None
        z = self._z[same] + self._sum[same] / self._count[same, None]
        self._sum[:], self._count[:] = 0.0, 0
        return Scan(z, scan.R, scan.ends)

    def _begin_sums(self, scan: Scan) -> None:
        self._z, self._ends = scan.z, scan.ends
        self._sum, self._count = np.zeros_like(scan.z), np.zeros(len(scan.z), np.int64)

    def _add(self, scan: Scan, same: Ints) -> None:
        """Take a scan into the sums; a line that repeats none begins one, which `same` (k,) names from here on."""
        new = np.flatnonzero(same < 0)
        if len(new):
            same[new] = len(self._z) + np.arange(len(new))
            self._z, self._ends = np.vstack((self._z, scan.z[new])), np.vstack((self._ends, scan.ends[new]))
            self._sum = np.vstack((self._sum, np.zeros((len(new), 2))))
            self._count = np.append(self._count, np.zeros(len(new), np.int64))
        self._sum[same] += _apart(scan.z, self._z[same])
        self._count[same] += 1
        self._scans += 1

    def _same(self, scan: Scan) -> Ints:
        """Return for each line of a scan (k,) the one that it repeats, -1 for none."""
        a, b = np.moveaxis(_apart(scan.z[:, None], self._z), -1, 0)
        R = scan.R[:, None]
        det = R[..., 0, 0] * R[..., 1, 1] - R[..., 0, 1] ** 2
        d2 = (R[..., 1, 1] * a**2 - 2.0 * R[..., 0, 1] * a * b + R[..., 0, 0] * b**2) / (2.0 * det)
        own, there = scan.ends[:, None], self._ends
        common = np.minimum(own[..., 1], there[:, 1]) - np.maximum(own[..., 0], there[:, 0])
        longer = np.maximum(own[..., 1] - own[..., 0], there[:, 1] - there[:, 0])
        d2 = np.where(common > SAME_LENGTH * longer, d2, np.inf)
        k = np.arange(len(d2))
        best = d2.argmin(axis=1)
        mutual = d2.argmin(axis=0)[best] == k
        return np.where((d2[k, best] < SAME_D2) & mutual, best, -1)


def _apart(z: Array, first: Array) -> Array:
    """Return z - first (..., 2), the angle wrapped."""
    out = z - first
    out[..., 1] = wrap_all(out[..., 1])
    return out
