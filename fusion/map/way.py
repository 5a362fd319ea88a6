"""The way through one map: scans along it, and the pose by matching them, where the map is left.

A small map and the pose in it drift together where few walls are long, or clutter is taken for walls. A chain
of matched scans, in which all that was seen counts, tells the way better. It is taken in where the map is left:
the next map then begins where both say. The variances of the pose have grown before by what no filter counts
(tracker.LESS_SURE), since the lines and the matches are of the same scans.
"""

from __future__ import annotations

import math
from array import array
from typing import NamedTuple

import numpy as np

from locfuse.fusion import se2
from locfuse.fusion.chi_square import chi_square
from locfuse.fusion.data import Array, Ints, Measurements
from locfuse.fusion.ekf.belief_arrays import JointBelief
from locfuse.fusion.ekf.map_frame import Pose
from locfuse.fusion.mount import Mount
from locfuse.fusion.scan_matching.key_scans import KeyScans, key_scans
from locfuse.fusion.scan_matching.neighbours import by_wheels
from locfuse.fusion.sensor import Equation

from .anchors import Anchors, Edge
from .scan import Scan

STRIDE, TURN = 0.75, math.radians(45.0)  # m, rad between two scans that are kept
MANY_SIGHTS = 60  # of a map: more say nothing new
# along a way: with fewer it says little, and a map in which the robot stayed longer holds together better than it
FEWEST_KEYS, MOST_KEYS = 4, 100
BY_FILTER = np.square(
    np.diag((0.02, 0.02, np.radians(0.3)))
)  # of the filter's way to the next key scan, variances
GATE = chi_square(0.999, 3)
WIDTHS = (40.0, 4.0)  # sigmas beyond which a match loses its weight, round by round
# rad per metre, 1 sigma: the heading of matched scans drifts with the way, since a laser looks a little down, or
# its angles are not quite what it says. On two real robots it was 0.05 degrees
BEND = np.radians(0.05)
SMALL = 1e-6  # m, rad: step of a numerical derivative


class Sight(NamedTuple):
    """A scan, when, and where in the map it was taken."""

    t: float  # s
    pose: Array  # (3,)
    scan: Scan


class Way:
    """Scans along the way through a map: what one must be able to see from where."""

    def __init__(self) -> None:
        self.sights: list[Sight] = []
        self.length = 0.0  # m
        self._last: Pose | None = None
        self._kept: Pose = (0.0, 0.0, 0.0)  # where the last scan was kept

    def resume(self) -> None:
        """Go on with a way that was left: what lies between is no way."""
        self._last = None

    def goes(self, pose: Pose) -> bool:
        """Take in the next pose, and tell whether a scan from there is worth keeping."""
        x, y, theta = pose
        if self._last is not None:
            self.length += math.hypot(x - self._last[0], y - self._last[1])
        self._last = pose
        if not self.sights:
            return True
        if len(self.sights) >= MANY_SIGHTS:
            return False
        a, b, turn = self._kept
        return math.hypot(x - a, y - b) >= STRIDE or abs(se2.wrap(theta - turn)) >= TURN

    def keep(self, t: float, pose: Pose, scan: Scan) -> None:
        """Keep a scan that was taken at a pose."""
        self.sights.append(Sight(t, np.array(pose), scan))
        self._kept = pose

    def nearest(self, place: Array) -> Sight:
        """Return the scan that was taken nearest to a place (2,) [m] of its map."""
        return min(self.sights, key=lambda sight: math.hypot(*(sight.pose[:2] - place)))


class WayByScans:
    """The way through one map, and where in it the filter had the robot at the readings since it began."""

    def __init__(self, m: Measurements, reading: int, pose: Pose) -> None:
        self._m, self._readings, self._poses = m, array("q", (reading,)), array("d", pose)

    def went(self, reading: int, pose: Pose) -> None:
        """Take in where the robot was in the map at the next reading."""
        self._readings.append(reading)
        self._poses.extend(pose)

    def end(self, mount: Mount | None, belief: JointBelief) -> None:
        """Correct the belief by the matches between the first and the last key scan in the map.

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
        if not FEWEST_KEYS <= last - first < MOST_KEYS:
            return
        z, R = told(way_between(keys, first, last))
        equation = compared(
            z, R + 2.0 * BY_FILTER, begin, se2.between(np.array(belief.pose()), end), mount, belief
        )
        S = equation.H @ belief.covariance[np.ix_(equation.columns, equation.columns)] @ equation.H.T + equation.R
        worse = float(equation.y @ np.linalg.solve(S, equation.y)) / 3.0
        if worse > GATE / 3.0:  # both claim too little: the variance factor, as in Anchors.loosen
            belief.loosen(np.arange(3), (worse - 1.0) * np.diagonal(belief.matrix()))
            equation = equation._replace(R=worse * equation.R)
        y, columns, H, R = (part.tolist() for part in equation)
        belief.know(y, R, columns, H)


class Matched(NamedTuple):
    """n + 1 key scans along a way, and p matches among them."""

    steps: Array  # (n, 3) from key to key, by the match or else by the wheels
    i: Ints  # (p,) the earlier key of a match
    j: Ints  # (p,)
    pose: Array  # (p, 3) key j seen from key i
    information: Array  # (p, 3, 3) in the frame of key i


def way_between(keys: KeyScans, first: int, last: int) -> Matched:
    """Return the way from key `first` to key `last`."""
    among = keys.among(first, last)
    i, j = keys.i[among] - first, keys.j[among] - first
    return Matched(keys.steps[first:last], i, j, keys.pose[among], keys.information[among])


def told(way: Matched) -> tuple[Array, Array]:
    """Return the last key of a way seen from the first, (3,), and its covariance (3, 3), by all matches.

    Matches that contradict the others count less and less (WIDTHS, a Geman-McClure kernel).
    """
    steps, i, j, pose, information = way
    graph = _solved(steps, i, j, pose, information)
    for width in WIDTHS:
        weights = _weights(graph.errors()[1 + len(steps) :], information, width)
        graph = _solved(steps, i, j, pose, weights[:, None, None] * information)
    z, R = graph.relative(0, len(steps))
    bend = _bent(graph.pose) - z
    return z, R + np.outer(bend, bend)


def _solved(steps: Array, i: Ints, j: Ints, pose: Array, information: Array) -> Anchors:
    """Return the keys as anchors, held by steps (n, 3) loosely and by matches (p, 3) of keys j seen from i."""
    graph, loose = Anchors(), np.linalg.inv(by_wheels(steps))
    graph.first(np.zeros(3), np.zeros((3, 3)))
    for n, step in enumerate(steps):
        graph.next(n, step, loose[n])
    for of, to, z, L in zip(i.tolist(), j.tolist(), pose, information, strict=True):
        graph.add(Edge(of, to, z, L))
    graph.solve()
    return graph


def _weights(e: Array, information: Array, width: float) -> Array:
    chi2 = np.einsum("ni,nij,nj->n", e, information, e)
    weights: Array = (width**2 / (width**2 + chi2)) ** 2
    return weights


def _bent(x: Array) -> Array:
    """Return where a way of poses x (n, 3) ends if all its headings drift by BEND from metre to metre."""
    steps = se2.between(x[:-1], x[1:])
    steps[:, 2] += BEND * np.hypot(steps[:, 0], steps[:, 1])
    return np.asarray(se2.compose(x[0], se2.chain(steps)[-1]))


def compared(z: Array, R: Array, begin: Array, back: Array, mount: Mount | None, belief: JointBelief) -> Equation:
    """Return what a way z (3,) by the scans, with covariance R, says of the pose and the mount.

    It led from `begin` (3,) in the map to `back` (3,), which is seen from the pose. The scans say it of a base on
    which the laser sits as told, which may not be as the belief has it.
    """
    free, columns = ([], ()) if mount is None else (list(mount.free), mount.columns(belief))
    place, sits = np.array(belief.pose()), np.zeros(3) if mount is None else np.array(mount.now(belief))
    told = np.zeros(3) if mount is None else np.array(mount.told)

    def way(x: Array) -> Array:
        now = sits.copy()
        now[free] = x[3:]
        aside = se2.compose(now, se2.inverse(told))
        return se2.between(aside, se2.compose(se2.between(begin, se2.compose(x[:3], back)), aside))

    x = np.append(place, sits[free])
    H = np.stack([(way(x + d) - way(x - d)) / (2.0 * SMALL) for d in SMALL * np.eye(len(x))], axis=-1)
    y = z - way(x)
    y[2] = se2.wrap(float(y[2]))
    return Equation(y, np.array((0, 1, 2, *columns)), H, R)
