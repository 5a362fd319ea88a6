"""The path through one submap: scans along it, and the pose by matching them when the submap is left.

A small map and the pose in it drift together where few walls are long, or clutter is taken for walls. A chain
of matched scans, in which all that was seen counts, gives the way better. It is taken in where the map is left:
the next map then begins where both agree. The variances of the pose have grown before by what no filter counts
(tracker.ADDED_P_SHARE), since the lines and the matches are of the same scans.
"""

from __future__ import annotations

import math
from array import array
from typing import NamedTuple

import numpy as np
from msgspec.structs import replace

from locfuse.fusion import se2
from locfuse.fusion.chi_square import chi_square
from locfuse.fusion.data import Array, Measurements
from locfuse.fusion.ekf.belief_arrays import JointBelief
from locfuse.fusion.ekf.map_frame import Pose
from locfuse.fusion.mount import Mount
from locfuse.fusion.scan_matching.key_scans import KeyScans, key_scans
from locfuse.fusion.scan_matching.neighbours import by_wheels
from locfuse.fusion.scan_matching.solve import Edges, Problem, relative
from locfuse.fusion.sensor import Equation

from .anchors import MIN_STEP, inverted
from .scan import Scan

STRIDE_M, TURN_RAD = 0.75, math.radians(45.0)  # m, rad between two scans that are kept
MAX_SIGHTS = 60  # of a map: more add nothing
# along a way: with fewer it is inexact, and a map in which the robot stayed longer holds together better than it
MIN_KEYS, MAX_KEYS = 4, 100
FILTER_P = np.square(np.diag((0.02, 0.02, np.radians(0.3))))  # of the filter's way to the next key scan, variances
MAX_CHI2 = chi_square(0.999, 3)
KERNEL_WIDTH_FACTORS = (1e6, 100.0, 1.0)  # of the kernels of the matches: the first counts all of them
# rad per metre, 1 sigma: the heading of matched scans drifts with the way, since a laser looks a little down, or
# its angles are not quite what it says. On two real robots it was 0.05 degrees
DRIFT_RAD_PER_M = np.radians(0.05)
DERIVATIVE_STEP = 1e-6  # m, rad: step of a numerical derivative


class Sight(NamedTuple):
    """A scan with its time and its pose in the submap."""

    t: float  # s
    pose: Array  # (3,)
    scan: Scan


class Way:
    """Scans along the path through a submap: what is visible from where."""

    def __init__(self) -> None:
        self.sights: list[Sight] = []
        self.length = 0.0  # m
        self._last: Pose | None = None
        self._kept: Pose = (0.0, 0.0, 0.0)  # where the last scan was kept

    def resume(self) -> None:
        """Continue a path that was left; the time between is not part of it."""
        self._last = None

    def goes(self, pose: Pose) -> bool:
        """Add the next pose, and return whether a scan from there should be kept."""
        x, y, theta = pose
        if self._last is not None:
            self.length += math.hypot(x - self._last[0], y - self._last[1])
        self._last = pose
        if not self.sights:
            return True
        if len(self.sights) >= MAX_SIGHTS:
            return False
        a, b, turn = self._kept
        return math.hypot(x - a, y - b) >= STRIDE_M or abs(se2.wrap(theta - turn)) >= TURN_RAD

    def keep(self, t: float, pose: Pose, scan: Scan) -> None:
        """Keep a scan that was taken at a pose."""
        self.sights.append(Sight(t, np.array(pose), scan))
        self._kept = pose

    def nearest(self, place: Array) -> Sight:
        """Return the scan that was taken nearest to a place (2,) [m] of its map."""
        return min(self.sights, key=lambda sight: math.hypot(*(sight.pose[:2] - place)))


class WayByScans:
    """The path through one submap, and the filter's pose in it at the readings since it began."""

    def __init__(self, m: Measurements, reading: int, pose: Pose) -> None:
        self._m, self._readings, self._poses = m, array("q", (reading,)), array("d", pose)

    def went(self, reading: int, pose: Pose) -> None:
        """Add the robot's pose in the submap at the next reading."""
        self._readings.append(reading)
        self._poses.extend(pose)

    def end(self, mount: Mount | None, belief: JointBelief) -> None:
        """Correct the belief by the matches between the first and the last key scan in the submap.

        What lies before the one and behind the other, half a metre at most, the filter knows well.
        """
        if self._m.points is None:
            return
        keys, readings = key_scans(self._m), np.array(self._readings)
        on_key = np.flatnonzero(np.isin(readings, keys.readings))
        if not len(on_key):
            return
        begin, end = np.array(self._poses).reshape(-1, 3)[on_key[[0, -1]]]
        first, last = np.searchsorted(keys.readings, readings[on_key[[0, -1]]]).tolist()
        if not MIN_KEYS <= last - first < MAX_KEYS:
            return
        z, R = end_of_way(*way_between(keys, first, last))
        equation = compared(z, R + 2.0 * FILTER_P, begin, se2.between(np.array(belief.pose()), end), mount, belief)
        S = equation.H @ belief.covariance[np.ix_(equation.columns, equation.columns)] @ equation.H.T + equation.R
        worse = float(equation.y @ np.linalg.solve(S, equation.y)) / 3.0
        if worse > MAX_CHI2 / 3.0:  # both claim too little: the variance factor, as in Anchors.loosen
            belief.loosen(np.arange(3), (worse - 1.0) * np.diagonal(belief.matrix()))
            equation = equation._replace(R=worse * equation.R)
        y, columns, H, R = (part.tolist() for part in equation)
        belief.know(y, R, columns, H)


def way_between(keys: KeyScans, first: int, last: int) -> tuple[Array, Edges]:
    """Return the steps (n, 3) from key `first` to key `last`, and the matches among these n + 1 keys."""
    found = keys.matches.take((keys.matches.i >= first) & (keys.matches.j <= last))
    return keys.steps[first:last], replace(found, i=found.i - first, j=found.j - first)


def end_of_way(steps: Array, matches: Edges) -> tuple[Array, Array]:
    """Return the last key of a path relative to the first, (3,), and its covariance (3, 3), by all matches.

    The steps (n, 3) hold the keys loosely. A match that contradicts the others loses its weight.
    """
    n = len(steps)
    k = np.arange(n)
    loose = Edges.of(k, k + 1, steps, by_wheels(steps), np.inf)
    begin = Edges.known(0, np.zeros(3), inverted(np.zeros((3, 3))))
    x, normal = Problem(begin).solve(
        se2.chain(steps), Edges.joined(loose, matches), KERNEL_WIDTH_FACTORS, MIN_STEP
    )
    z, R = relative(x[[0, n]], normal.joint(np.array([0, n])), np.array([0]), np.array([1]))
    drift = _bent(x) - z[0]
    return z[0], R[0] + np.outer(drift, drift)


def _bent(x: Array) -> Array:
    """Return the end pose of a path x (n, 3) whose headings drift by DRIFT_RAD_PER_M."""
    steps = se2.between(x[:-1], x[1:])
    steps[:, 2] += DRIFT_RAD_PER_M * np.hypot(steps[:, 0], steps[:, 1])
    return np.asarray(se2.compose(x[0], se2.chain(steps)[-1]))


def compared(z: Array, R: Array, begin: Array, back: Array, mount: Mount | None, belief: JointBelief) -> Equation:
    """Return the equation by which a path z (3,) from scans, with covariance R, corrects pose and mount.

    It led from `begin` (3,) in the map to `back` (3,), which is seen from the pose. The scans are of a base on
    which the laser is mounted as configured; the belief may have another mount.
    """
    free, columns = ([], ()) if mount is None else (list(mount.free), mount.columns(belief))
    place, sits = np.array(belief.pose()), np.zeros(3) if mount is None else np.array(mount.now(belief))
    configured = np.zeros(3) if mount is None else np.array(mount.configured)

    def way(x: Array) -> Array:
        now = sits.copy()
        now[free] = x[3:]
        aside = se2.compose(now, se2.inverse(configured))
        return se2.between(aside, se2.compose(se2.between(begin, se2.compose(x[:3], back)), aside))

    x = np.append(place, sits[free])
    H = np.stack(
        [(way(x + d) - way(x - d)) / (2.0 * DERIVATIVE_STEP) for d in DERIVATIVE_STEP * np.eye(len(x))], axis=-1
    )
    y = z - way(x)
    y[2] = se2.wrap(float(y[2]))
    return Equation(y, np.array((0, 1, 2, *columns)), H, R)
