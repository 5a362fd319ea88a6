"""Submaps: the graph of their poses, the path through one, and the frozen lines of those that the robot left.

Each submap has an anchor (its frame in the map); edges are relative poses, or measure an anchor's pose absolutely
(compass, GPS: edges from NOWHERE). The graph is solved by scan_matching.solve (Lu and Milios 1997; Grisetti et
al., "A tutorial on graph-based SLAM", 2010).

If few walls are long, or clutter is extracted as walls, submap and pose drift together. A chain of matched scans
is more accurate, since it uses all points. It corrects the pose when the robot leaves the submap, before the next
submap begins. Lines and matches come from the same scans, so their errors are correlated: the variances of the
pose are increased first (tracker.ADDED_P_SHARE).

In the robot's frame, the errors of all walls are correlated, since they share the error of the pose. So the walls'
positions relative to each other are known much better than relative to the robot. The next submap begins with the
walls that it shares, and their joint covariance, which contains these correlations.
"""

from __future__ import annotations

import math
from array import array
from typing import NamedTuple

import numpy as np
from msgspec.structs import replace

from locfuse.fusion import se2
from locfuse.fusion.data import Array, Ints, Measurements
from locfuse.fusion.ekf.belief_arrays import JointBelief
from locfuse.fusion.ekf.map_frame import Pose
from locfuse.fusion.mount import Mount
from locfuse.fusion.scan_matching.neighbours import by_wheels, key_scans
from locfuse.fusion.scan_matching.solve import NOWHERE, Edges, Problem, relative
from locfuse.fusion.sensor import Equation
from locfuse.fusion.statistics import chi_square

from .line_map import COLUMN_NAMES, MIN_HITS, LineMap
from .scan import Scan

MIN_STEP = 1e-9  # m, rad: Gauss-Newton stops after a smaller step
EXACT_VARIANCE = 1e-12  # m^2, rad^2: added to covariances, which may be zero, before inversion
MIN_EIGENVALUE = 1e-14  # least eigenvalue of a correlation matrix: smaller ones are rounding errors


class Edge(NamedTuple):
    """Pose of anchor `to` relative to anchor `of`, or relative to the map if `of` is NOWHERE."""

    of: int
    to: int
    z: Array  # (3,)
    information: Array  # (3, 3)


class Anchors:
    """Anchor poses in the map, (n, 3), and the edges between the anchors."""

    def __init__(self) -> None:
        self.pose: Array = np.zeros((0, 3))
        self.edges: list[Edge] = []
        self._P: Array | None = None  # (n, 3, n, 3) joint covariance; None after a change of the edges

    def __len__(self) -> int:
        """Return the number of anchors."""
        return len(self.pose)

    def append(self, of: int, z: Array, P: Array) -> int:
        """Add an anchor with pose z (3,) and covariance P (3, 3) relative to anchor `of`; return its index.

        If `of` is NOWHERE, the pose is relative to the map frame.
        """
        self.pose = np.vstack((self.pose, z if of == NOWHERE else se2.compose(self.pose[of], z)))
        self.add(Edge(of, len(self.pose) - 1, np.asarray(z), inverted(P)))
        return len(self.pose) - 1

    def add(self, edge: Edge) -> None:
        """Add an edge."""
        self.edges.append(edge)
        self._P = None

    def remove(self, edge: Edge) -> None:
        """Remove an edge."""
        self.edges = [e for e in self.edges if e is not edge]
        self._P = None

    def scale_covariances(self, of: int, to: int, factor: float) -> None:
        """Multiply the covariances of the edges between consecutive anchors from `of` to `to` by `factor`.

        It is chi-square over degrees of freedom, an estimate of the ratio of actual to claimed covariance.
        """
        first, last = min(of, to), max(of, to)
        self.edges = [
            e._replace(information=e.information / factor)
            if e.of != NOWHERE and e.to == e.of + 1 and first <= e.of < last
            else e
            for e in self.edges
        ]
        self._P = None

    def beside(self, node: int) -> set[int]:
        """Return the indices of the anchors that share an edge with anchor `node`."""
        edges = [e for e in self.edges if e.of != NOWHERE and node in (e.of, e.to)]
        return {e.to if e.of == node else e.of for e in edges}

    def covariance(self, node: int) -> Array:
        """Return the covariance (3, 3) of the pose of an anchor, in the map frame."""
        return self._joint()[node, :, node]

    def relative(self, of: int, to: int) -> tuple[Array, Array]:
        """Return the pose (3,) of anchor `to` relative to anchor `of`, and its covariance (3, 3)."""
        z, P = relative(self.pose, self._joint(), np.array([of]), np.array([to]))
        return z[0], P[0]

    def _joint(self) -> Array:
        """Return the joint covariance of all anchor poses, (n, 3, n, 3)."""
        if self._P is None:
            self._P = Problem().normal(self.pose, self._all_edges()).joint(np.arange(len(self.pose)))
        return self._P

    def cost(self) -> float:
        """Return the chi-square of the graph: the sum of e' Omega e over all edges."""
        return float(self._all_edges().chi2(self.pose).sum())

    def solve(self) -> None:
        """Optimise the anchor poses by least squares."""
        self.pose, normal = Problem().solve(self.pose, self._all_edges(), min_step=MIN_STEP)
        self._P = normal.joint(np.arange(len(self.pose)))

    def _all_edges(self) -> Edges:
        i, j, z, information = (np.array(column) for column in zip(*self.edges, strict=True))
        return Edges.of(i, j, z, information, np.inf)


def inverted(P: Array) -> Array:
    """Return the information matrix (3, 3) of a covariance P (3, 3) that may be singular.

    P is scaled to a correlation matrix first: the sigmas of position and heading may differ by a factor of 10^9.
    """
    P = se2.symmetric(P) + EXACT_VARIANCE * np.eye(3)
    scale = np.sqrt(np.diagonal(P))
    values, vectors = np.linalg.eigh(P / np.outer(scale, scale))
    half = vectors / np.sqrt(np.maximum(values, MIN_EIGENVALUE)) / scale[:, None]
    return np.asarray(half @ half.T, np.float64)


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


# added variances [m^2, rad^2], and added share of a variance: both keep covariances invertible
MIN_VARIANCE, MIN_VARIANCE_SHARE = 1e-18, 1e-9


class SharedWalls(NamedTuple):
    """Walls (k) that are copied from the submap that the robot leaves to the next one, in the robot's frame."""

    r: Array  # (k,) m, from the robot
    psi: Array  # (k,) rad, base frame
    ends: Array  # (k, 2) m along the tangent (-sin psi, cos psi)
    hits: Ints  # (k,) how often each was seen
    P: Array  # (2k, 2k) joint covariance of (r, psi), wall by wall


def shared_walls(lines: LineMap, at: Ints, belief: JointBelief) -> SharedWalls:
    """Return the walls with indices `at` (k,), which are states, in the robot's frame, with their covariance."""
    rho, beta = lines.values(belief)[at].T
    c, s = np.cos(beta), np.sin(beta)
    dx, dy = (np.array([belief.x, belief.y]) - lines.anchor[at]).T
    r, along = rho - dx * c - dy * s, dy * c - dx * s
    ends = np.stack((lines.lo[at] - along, lines.hi[at] - along), axis=-1)
    k = np.arange(len(at))
    by = np.zeros((len(at), 2, 3 + 2 * len(at)))  # derivatives by the pose, then by the walls (kernels.sight)
    by[:, 0, 0], by[:, 0, 1], by[:, 1, 2] = -c, -s, -1.0
    by[k, 0, 3 + 2 * k], by[k, 0, 4 + 2 * k], by[k, 1, 4 + 2 * k] = 1.0, -along, 1.0
    H = by.reshape(2 * len(at), -1)
    states = np.concatenate((np.arange(3), lines.states(at)))
    P = H @ belief.covariance[np.ix_(states, states)] @ H.T
    return SharedWalls(r, beta - belief.theta, ends, lines.hits[at], se2.symmetric(P))


def heading_among(lines: LineMap, at: Ints, belief: JointBelief) -> float:
    """Return the standard deviation of the heading [rad] relative to the walls with indices `at` (k,).

    This is the accuracy of the last scans, without the common drift of robot and walls.
    """
    states = np.append(2, lines.states(at))
    P = belief.covariance[np.ix_(states, states)]
    size = np.sqrt(np.maximum(np.diagonal(P), MIN_VARIANCE))
    unit = P / np.outer(size, size) + MIN_VARIANCE_SHARE * np.eye(len(P))
    return float(size[0] / np.sqrt(np.linalg.inv(unit)[0, 0]))


def begin_submap(shared: SharedWalls, lines: LineMap, belief: JointBelief, scan: int) -> None:
    """Begin a submap with the shared walls and the pose exactly 0; `scan` is the number of the last scan.

    The anchor point of each wall is the middle of its seen part, so rho is 0 and beta is psi.
    """
    c, s = np.cos(shared.psi), np.sin(shared.psi)
    middle, half = shared.ends.mean(axis=1), 0.5 * np.diff(shared.ends, axis=1)[:, 0]
    anchors = np.stack((shared.r * c - middle * s, shared.r * s + middle * c), axis=-1)
    values = np.stack((np.zeros(len(c)), shared.psi), axis=-1)
    T = np.eye(2 * len(c))
    k = 2 * np.arange(len(c))
    T[k, k + 1] = -middle
    P = T @ shared.P @ T.T
    first = belief.augment(values.reshape(-1), np.zeros((2 * len(c), 3)), P)
    for j, (anchor, value) in enumerate(zip(anchors, values, strict=True)):
        own = slice(2 * j, 2 * j + 2)
        lines.append(anchor, value, P[own, own], first + 2 * j, (-float(half[j]), float(half[j])), scan)
    lines.hits[:] = shared.hits


class FrozenMap(NamedTuple):
    """Submap that the robot left, in the frame of its anchor."""

    anchor: int  # index in the graph
    lines: LineMap  # no line is a state
    path: SubmapPath
    box: tuple[Array, Array]  # (2,) m: least and greatest x, y of the lines and the path
    origin: Array  # (3,) pose of the robot where the submap began, in the frame of the anchor
    joint: Array  # (2J, 2J) joint covariance of (rho, beta), line by line


def frozen(anchor: int, lines: LineMap, path: SubmapPath, origin: Array, belief: JointBelief) -> FrozenMap:
    """Return a copy of the present submap with its present values and covariances, independent of the belief."""
    own = {name: getattr(lines, name).copy() for name in COLUMN_NAMES if name != "P"}
    own |= {"column": np.full(len(lines), -1, np.int64), "value": np.array(lines.values(belief))}
    kept = LineMap(**own, next_id=lines.next_id, P=np.array(lines.covariances(belief)))
    rho, beta = kept.value[:, :1], kept.value[:, 1]
    n = np.stack((np.cos(beta), np.sin(beta)), axis=-1)
    tangent, foot = np.stack((-n[:, 1], n[:, 0]), axis=-1), kept.anchor + rho * n
    ends = (foot + extent[:, None] * tangent for extent in (kept.lo, kept.hi))
    points = np.vstack((*ends, *(sight.pose[None, :2] for sight in path.sights)))
    box, at = (points.min(axis=0), points.max(axis=0)), lines.states(np.s_[:])
    return FrozenMap(anchor, kept, path, box, origin, belief.covariance[np.ix_(at, at)])


def thaw(kept: LineMap, lines: LineMap, first_column: int) -> None:
    """Copy the lines of a frozen submap into `lines` as states, the first at column `first_column`."""
    for name in ("ids", "anchor", "lo", "hi", "hits", "value", "P"):
        setattr(lines, name, getattr(kept, name).copy())
    lines.column = first_column + 2 * np.arange(len(kept))


def as_scan(lines: LineMap) -> Scan:
    """Convert frozen lines to a scan taken at the origin of their frame.

    Only lines seen at least MIN_HITS times are used; (r, psi) of the scan is (rho, beta) about the origin.
    """
    at, values, P = np.flatnonzero(lines.hits >= MIN_HITS), lines.value, lines.P
    c, s = np.cos(values[at, 1]), np.sin(values[at, 1])
    ax, ay = lines.anchor[at].T
    along = ay * c - ax * s
    z = np.stack((values[at, 0] + ax * c + ay * s, se2.wrap_all(values[at, 1])), axis=-1)
    G = np.zeros((len(at), 2, 2))
    G[:, 0, 0] = G[:, 1, 1] = 1.0
    G[:, 0, 1] = along
    R = se2.propagated(G, P[at])
    ends = np.stack((lines.lo[at] + along, lines.hi[at] + along), axis=-1)
    return Scan.of(z, R, ends)
