"""Submaps: frozen lines of the submaps that the robot left, and the walls shared by one submap and the next.

In the robot's frame, the errors of all walls are correlated, since they share the error of the pose. So the walls'
positions relative to each other are known much better than relative to the robot. The next submap begins with
these walls and their joint covariance, which contains these correlations.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from locfuse.fusion import se2
from locfuse.fusion.data import Array, Ints
from locfuse.fusion.ekf.belief_arrays import JointBelief

from .line_map import COLUMN_NAMES, MIN_HITS, LineMap
from .scan import Scan
from .submap_path import SubmapPath

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
