"""Is this small map a part of that one? Walls and free space must say so, and nothing else may fit as well.

Pairs of walls of one map are laid onto pairs of walls of the other; what the graph of anchors does not allow is
left out. The place that explains most is refined wall by wall. It counts where no other explains nearly as much,
and where the scans that made either map do not see through the walls of the other.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from locfuse.fusion import se2
from locfuse.fusion.data import Array, Ints

from .frozen import as_scan
from .line_map import LineMap
from .relocalise import distinct, explained, hypotheses, seen_through
from .scan import Scan
from .way import Way

MIN_HITS = 4  # of a wall that counts
PAIRED = 10  # longest walls of the new map from which pairs are made
GATE = 16.3  # chi-square with 3 degrees of freedom at 99.9 %
WIDER = 4.0  # times the covariance of where a map is expected to lie: some drives go wrong by more than it says
SLACK = np.diag(np.square((0.3, 0.3, math.radians(4.0))))  # m, rad: by which a pair of walls misses the place
LEAST = 5  # walls that each of two maps must have
MANY, LONG = (5, 6.0), (3, 15.0)  # walls, and m of them, that a place must explain: many, or long ones
SURELY = (8, 20.0)  # the same where it lies beyond what the covariance of the way allows
NEAR = 0.75  # m: standard deviation of where a map is expected, up to which a few long walls are enough
RIVAL, APART, TURNED = 0.75, 0.6, math.radians(15.0)  # share of the best one's length; m and rad that make a rival
MAX_TURNED = 4  # rivals in other directions, beyond which free space is not asked
MAX_THROUGH = 0.08  # share of the walls behind walls of the other map, beyond what is so within either map
ROUNDS = ((0.3, math.radians(6.0)), (0.2, math.radians(4.0)), (0.12, math.radians(3.0)), (0.12, math.radians(3.0)))
FLAT, STRAIGHT = 0.03, math.radians(0.5)  # m, rad: how well two pieces of one wall agree
SHORT = 0.3  # m of a wall that both maps must have seen
MAP_XY, MAP_THETA = 0.03, math.radians(0.3)  # m, rad: how well a small map keeps its shape
WEAK = np.diag((1e-2, 1e-2, 1e-1))  # information that keeps what no wall tells finite


class Closure(NamedTuple):
    """Where the frame of one map lies in another's."""

    pose: Array  # (3,)
    P: Array  # (3, 3) large along what no wall tells
    length: float  # m of walls that agree
    walls: int


class Here(NamedTuple):
    """A map with its way, in its own frame."""

    lines: LineMap
    values: Array  # (J, 2)
    P: Array  # (J, 2, 2)
    way: Way


def find_closure(there: Here, here: Here, expected: Array, P: Array) -> Closure | None:
    """Return where map `here` lies in map `there`, None where it does not or where that is not clear.

    `expected` (3,) and P (3, 3) are what is known of it already.
    """
    scan = as_scan(here.lines, here.values, here.P, MIN_HITS)
    known = np.flatnonzero(there.lines.hits >= MIN_HITS)
    if min(len(scan.z), len(known)) < LEAST:
        return None
    poses = hypotheses(scan, there.lines, there.values, known, PAIRED)
    off = poses - expected
    off[:, 2] = se2.wrap_all(off[:, 2])
    poses = poses[np.einsum("hi,ij,hj->h", off, np.linalg.inv(WIDER * P + SLACK), off) <= GATE]
    if not len(poses):
        return None
    share, _, count = explained(poses, scan, there.lines, there.values, known)
    length = share * float((scan.ends[:, 1] - scan.ends[:, 0]).sum())
    length = np.where((length >= 0.5 * MANY[1]) & (count >= 3), length, 0.0)
    best = int(np.argmax(length))
    if length[best] <= 0.0:
        return None
    alike = poses[length > RIVAL * length[best]]
    rivals = alike - poses[best]
    turned = np.abs(se2.wrap_all(rivals[:, 2])) > TURNED
    if not _all_contradicted(there, here, distinct(alike[turned])):
        return None
    found = _refined(poses[best], scan, there, known, expected, P)
    if found is None or not _enough(found, expected, P):
        return None
    if contradicted(there, here, found.pose):
        return None
    return found._replace(P=found.P + left_open(rivals[~turned]))


def _enough(found: Closure, expected: Array, P: Array) -> bool:
    """Return whether a place explains enough walls; the less it is expected, the more it must."""
    off = found.pose - expected
    off[2] = se2.wrap(float(off[2]))
    if off @ np.linalg.solve(P + SLACK, off) > GATE:
        asked: tuple[tuple[int, float], ...] = (SURELY,)
    else:
        asked = (MANY, LONG) if float(P[0, 0] + P[1, 1]) < NEAR**2 else (MANY,)
    return any(found.walls >= n and found.length >= m for n, m in asked)


def _all_contradicted(there: Here, here: Here, poses: Array) -> bool:
    """Return whether free space rules out all of these places (h, 3)."""
    return len(poses) <= MAX_TURNED and all(contradicted(there, here, pose) for pose in poses)


def left_open(rivals: Array) -> Array:
    """Return the covariance (3, 3) that rivals leave, other places (n, 3) from the best one, as good.

    Along a corridor there are many; across it and in heading they agree.
    """
    apart = rivals[np.hypot(*rivals[:, :2].T) > APART, :2]
    P = np.zeros((3, 3))
    if len(apart):
        P[:2, :2] = apart.T @ apart * (np.square(apart).sum(axis=1).max() / np.square(apart).sum())
    return P


def contradicted(there: Here, here: Here, pose: Array) -> bool:
    """Return whether scans of either map see through walls of the other, more than through those of their own.

    What is known of a wall reaches over its doors, so that a little is seen through any.
    """
    across = _through(here.way, pose, there) + _through(there.way, se2.inverse(pose), here)
    within = _through(here.way, np.zeros(3), here) + _through(there.way, np.zeros(3), there)
    return 0.5 * (across - within) > MAX_THROUGH


def _through(way: Way, frame: Array, other: Here) -> float:
    """Return the mean share that scans see behind the walls of a map in which their frame lies at `frame`."""
    if not way.sights:
        return 0.0
    places = [se2.compose(frame, sight.pose).tolist() for sight in way.sights]
    return float(
        np.mean(
            [
                seen_through(sight.scan, other.lines, other.values, x, y, theta)
                for sight, (x, y, theta) in zip(way.sights, places, strict=True)
            ]
        )
    )


def _refined(pose: Array, scan: Scan, there: Here, known: Ints, expected: Array, P: Array) -> Closure | None:
    """Lay the walls of the scan onto those of the map: Gauss-Newton over pairs that are the same wall."""
    prior = np.linalg.inv(P + np.diag((1e-6, 1e-6, 1e-8)))
    x = pose.copy()
    x[2] = expected[2] + se2.wrap(float(x[2] - expected[2]))
    for near, turned in ROUNDS:
        J, e, W, lengths = _same_walls(x, scan, there, known, near, turned)
        if not len(lengths):
            return None
        data = J.T @ (W[:, None] * J)
        x = x - np.linalg.solve(data + prior, J.T @ (W * e) + prior @ (x - expected))
    weak = data + WEAK
    z = x - np.linalg.solve(weak, J.T @ (W * e))  # what the walls alone say
    spread = np.linalg.inv(weak) + np.diag(np.square((MAP_XY, MAP_XY, MAP_THETA)))
    return Closure(z, spread, float(lengths.sum()), len(lengths))


def _same_walls(
    x: Array, scan: Scan, there: Here, known: Ints, near: float, turned: float
) -> tuple[Array, Array, Array, Array]:
    """Return J (2p, 3), residuals (2p,), weights (2p,) of p pairs of walls, and the lengths (p,) they share."""
    lines, values = there.lines, there.values[known]
    beta = values[:, 1]
    c, s = np.cos(beta), np.sin(beta)
    cb, sb = np.cos(scan.z[:, 1] + x[2]), np.sin(scan.z[:, 1] + x[2])
    foot = x[:2] + scan.z[:, :1] * np.stack((cb, sb), axis=-1)  # (k, 2)
    tangent = np.stack((-sb, cb), axis=-1)
    ends = foot[:, None] + scan.ends[:, :, None] * tangent[:, None]  # (k, 2, 2)
    away = ends[:, None] - lines.anchor[known][None, :, None]  # (k, J, 2, 2)
    along = away[..., 1] * c[:, None] - away[..., 0] * s[:, None]  # (k, J, 2)
    lo = np.maximum(along.min(axis=2), lines.lo[known])
    hi = np.minimum(along.max(axis=2), lines.hi[known])
    middle = 0.5 * (lo + hi)
    turn = se2.wrap_all(scan.z[:, 1, None] + x[2] - beta)
    across = away[..., 0] * c[:, None] + away[..., 1] * s[:, None] - values[:, 0, None]  # (k, J, 2) of both ends
    run = along[..., 1] - along[..., 0]
    share = (middle - along[..., 0]) / np.where(np.abs(run) > 1e-9, run, 1e-9)
    offset = across[..., 0] + share * (across[..., 1] - across[..., 0])
    fits = (hi - lo > SHORT) & (np.abs(turn) < turned) & (np.abs(offset) < near)
    cost = np.where(fits, np.square(offset / near) + np.square(turn / turned), np.inf)
    k = np.flatnonzero(np.isfinite(cost).any(axis=1))
    j = np.argmin(cost[k], axis=1)
    point = ends[k, 0] + share[k, j, None] * (ends[k, 1] - ends[k, 0])
    arm = point - x[:2]
    length = hi[k, j] - lo[k, j]
    own, other = scan.R[k], there.P[known][j]
    J = np.zeros((2 * len(k), 3))
    J[::2, 0], J[::2, 1], J[::2, 2] = c[j], s[j], -c[j] * arm[:, 1] + s[j] * arm[:, 0]
    J[1::2, 2] = 1.0
    e = np.stack((offset[k, j], turn[k, j]), axis=-1).reshape(-1)
    straight = STRAIGHT**2 + 12.0 * np.square(0.01 / length) + own[:, 1, 1] + other[:, 1, 1]
    W = 1.0 / np.stack((FLAT**2 + other[:, 0, 0], straight), axis=-1).reshape(-1)
    return J, e, W, length
