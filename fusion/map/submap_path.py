"""Path through one submap: its scans, and the pose by scan matching when the robot leaves the submap.

If few walls are long, or clutter is extracted as walls, submap and pose drift together. A chain of matched scans
is more accurate, since it uses all points. It corrects the pose when the robot leaves the submap, before the next
submap begins. Lines and matches come from the same scans, so their errors are correlated: the variances of the
pose are increased first (tracker.ADDED_P_SHARE).
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
from locfuse.fusion.scan_matching.neighbours import by_wheels, key_scans
from locfuse.fusion.scan_matching.solve import Edges, Problem, relative
from locfuse.fusion.sensor import Equation

from .anchors import MIN_STEP, inverted
from .scan import Scan

STRIDE_M, TURN_RAD = 0.75, math.radians(45.0)  # m, rad between two scans that are kept
MAX_SIGHTS = 60  # kept scans of one submap: more do not help
# limits of the number of key scans: a shorter chain is inexact, a longer one less accurate than the submap
MIN_KEYS, MAX_KEYS = 4, 100
# covariance of the filter's motion to the next key scan
FILTER_P = np.square(np.diag((0.02, 0.02, np.radians(0.3))))
MAX_CHI2 = chi_square(0.999, 3)
KERNEL_WIDTH_FACTORS = (1e6, 100.0, 1.0)  # graduated kernel widths of the matches: the first uses all matches
# rad per metre, 1 sigma: heading drift of scan matching by a tilted laser or wrong beam angles; 0.05 degrees on
# two real robots
DRIFT_RAD_PER_M = np.radians(0.05)
DERIVATIVE_STEP = 1e-6  # m, rad: step of a numerical derivative


class PlacedScan(NamedTuple):
    """A scan with its time and the pose of the robot in the submap."""

    t: float  # s
    pose: Array  # (3,)
    scan: Scan


class SubmapPath:
    """Path through a submap, with scans from poses along the path."""

    def __init__(self) -> None:
        self.sights: list[PlacedScan] = []
        self.length = 0.0  # m
        self._last: Pose | None = None
        self._kept: Pose = (0.0, 0.0, 0.0)  # pose of the last kept scan

    def resume(self) -> None:
        """Continue the path after a time in other submaps, without adding the distance driven there."""
        self._last = None

    def extend(self, pose: Pose) -> bool:
        """Extend the path to the next pose; return whether to keep a scan from this pose."""
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
        """Keep a scan taken at a pose."""
        self.sights.append(PlacedScan(t, np.array(pose), scan))
        self._kept = pose

    def nearest(self, place: Array) -> PlacedScan:
        """Return the scan taken nearest to a position (2,) [m] in the submap."""
        return min(self.sights, key=lambda sight: math.hypot(*(sight.pose[:2] - place)))


class ScanMatchedPath:
    """Path through one submap by scan matching, and the filter's poses to compare it with."""

    def __init__(self, m: Measurements, reading: int, pose: Pose) -> None:
        self._m, self._readings, self._poses = m, array("q", (reading,)), array("d", pose)

    def add(self, reading: int, pose: Pose) -> None:
        """Add the filter's pose in the submap at the next reading."""
        self._readings.append(reading)
        self._poses.extend(pose)

    def end(self, mount: Mount | None, belief: JointBelief) -> None:
        """Correct the belief by the scan-matched motion between the first and the last key scan in the submap.

        For the path before the first and after the last key scan (at most 0.5 m), the filter's poses are used.
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
        matches = keys.matches.take((keys.matches.i >= first) & (keys.matches.j <= last))
        z, R = end_pose(keys.steps[first:last], replace(matches, i=matches.i - first, j=matches.j - first))
        equation = compared(z, R + 2.0 * FILTER_P, begin, se2.between(np.array(belief.pose()), end), mount, belief)
        S = equation.H @ belief.covariance[np.ix_(equation.columns, equation.columns)] @ equation.H.T + equation.R
        worse = float(equation.y @ np.linalg.solve(S, equation.y)) / 3.0
        # both are overconfident: increase both covariances, as in Anchors.scale_covariances
        if worse > MAX_CHI2 / 3.0:
            belief.add_variance(np.arange(3), (worse - 1.0) * np.diagonal(belief.matrix()))
            equation = equation._replace(R=worse * equation.R)
        y, columns, H, R = (part.tolist() for part in equation)
        belief.know(y, R, columns, H)


def end_pose(steps: Array, matches: Edges) -> tuple[Array, Array]:
    """Return the pose (3,) of the last key scan relative to the first, and its covariance (3, 3), by all matches.

    The motions `steps` (n, 3) between neighbours get a low weight. Matches that contradict the others are
    down-weighted.
    """
    n = len(steps)
    k = np.arange(n)
    loose = Edges.of(k, k + 1, steps, by_wheels(steps), np.inf)
    begin = Edges.known(0, np.zeros(3), inverted(np.zeros((3, 3))))
    edges = Edges.joined(loose, matches)
    x, normal = Problem(begin).solve(se2.chain(steps), edges, KERNEL_WIDTH_FACTORS, MIN_STEP)
    z, R = relative(x[[0, n]], normal.joint(np.array([0, n])), np.array([0]), np.array([1]))
    drifting = se2.between(x[:-1], x[1:])
    drifting[:, 2] += DRIFT_RAD_PER_M * np.hypot(drifting[:, 0], drifting[:, 1])
    drift = np.asarray(se2.compose(x[0], se2.chain(drifting)[-1])) - z[0]
    return z[0], R[0] + np.outer(drift, drift)


def compared(z: Array, R: Array, begin: Array, back: Array, mount: Mount | None, belief: JointBelief) -> Equation:
    """Return the measurement equation of a scan-matched motion z (3,) with covariance R (3, 3).

    It corrects the robot's pose and the laser mount. The motion begins at the pose `begin` (3,) in the submap, and
    ends at the pose `back` (3,) in the frame of the robot's present pose. The scans are in the base frame by the
    configured laser mount; the belief's mount may differ.
    """
    free, columns = ([], ()) if mount is None else (list(mount.free), mount.columns(belief))
    place, mounted = np.array(belief.pose()), np.zeros(3) if mount is None else np.array(mount.now(belief))
    configured = np.zeros(3) if mount is None else np.array(mount.configured)

    def motion(x: Array) -> Array:
        now = mounted.copy()
        now[free] = x[3:]
        aside = se2.compose(now, se2.inverse(configured))
        return se2.between(aside, se2.compose(se2.between(begin, se2.compose(x[:3], back)), aside))

    x = np.append(place, mounted[free])
    steps = DERIVATIVE_STEP * np.eye(len(x))
    H = np.stack([(motion(x + d) - motion(x - d)) / (2.0 * DERIVATIVE_STEP) for d in steps], axis=-1)
    y = z - motion(x)
    y[2] = se2.wrap(float(y[2]))
    return Equation(y, np.array((0, 1, 2, *columns)), H, R)
