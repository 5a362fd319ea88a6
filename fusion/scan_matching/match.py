"""Point-to-line scan matching of many pairs of clouds at once, with a prior for unconstrained directions.

In a corridor the points do not constrain the position along it, so a prior from wheel odometry is needed (Censi
2008, "An ICP variant using a point-to-line metric"). One search tree finds the nearest points of all pairs: each
cloud has its own layer in the tree, far from all others.

The pose of a pair of clouds (i, j) is that of cloud j in the frame of cloud i, (x, y, theta). Its information is
also in the frame of i.
"""

from __future__ import annotations

import msgspec
import numpy as np
from msgspec.structs import astuple

from locfuse.fusion import se2
from locfuse.fusion.data import Array, Ints, consecutive

from .clouds import Clouds, Columns

LAYER_M = 1e4  # distance of the layers of two clouds in the search tree
NOWHERE_M = 1e6  # coordinate that is out of reach of all points
RADII_M = (0.5, 0.4, 0.3, 0.2, 0.15, 0.15, 0.15)  # largest distance of matched points in each iteration
SIGMA_M = 0.03  # standard deviation of a point's distance from its line
DEPENDENT_POINTS = 16.0  # errors of neighbouring points are correlated: this many points count as one
FLOOR_M, FLOOR_RAD = 0.01, np.radians(0.2)  # least standard deviations of a match
MIN_FACING = 0.7  # least cosine between the normals of matched points: a wall has two sides
INLIER_M = 0.1  # largest distance of an inlier from the matched line
# m, rad: 1 sigma of a weak prior, which gives a solution in directions without points (along a corridor)
MAX_ALONE_SIGMAS = (0.3, 0.3, np.radians(10.0))
MATCHED_POINTS = 120  # matched points of one cloud: more take time, and neighbouring points add little
POINTS_AT_ONCE = 1_000_000
SETTLED_M = 2e-4  # m, rad: a pair with a smaller step has converged


class Matches(Columns, frozen=True):
    """Matches of p pairs of clouds: relative poses and quality."""

    pose: Array  # (p, 3)
    alone: Array  # (p, 3) pose without the prior, for a graph that has the prior as a separate edge
    information: Array  # (p, 3, 3) of `alone`
    inliers: Array  # (p,) share of inliers among the matched points
    overlap: Array  # (p,) share of matched points among all points
    rms: Array  # (p,) m, rms distance of the inliers from the matched lines

    def put(self, at: Ints, others: Matches) -> None:
        """Replace the matches at the indices `at` (k,) by others."""
        for column, other in zip(astuple(self), astuple(others), strict=True):
            column[at] = other


class Targets:
    """Clouds to which other clouds are matched: their surface points in one search tree."""

    def __init__(self, clouds: Clouds) -> None:
        from scipy.spatial import cKDTree

        rows = np.flatnonzero(np.isfinite(clouds.normal[:, 0]))
        self.xy, self.normal, layer = clouds.xy[rows], clouds.normal[rows], LAYER_M * clouds.owner[rows]
        if not len(rows):  # an empty tree is not possible, so add a surface that is out of reach
            self.xy, self.normal, layer = np.full((1, 2), NOWHERE_M), np.zeros((1, 2)), np.zeros(1)
        self._tree = cKDTree(np.column_stack((self.xy, layer)))

    def nearest(self, xy: Array, clouds: Ints, reach: float) -> tuple[Array, Ints]:
        """Return distance and row of the nearest surface point in cloud `clouds` (m,), for points (m, 2).

        The distance is inf if there is none within `reach` [m].
        """
        places = np.column_stack((xy, LAYER_M * clouds))
        distance, row = self._tree.query(places, distance_upper_bound=reach, workers=1)
        return distance, np.minimum(row, len(self.xy) - 1)


def sources_of(clouds: Clouds, most: int = MATCHED_POINTS) -> Clouds:
    """Return the surface points to match, evenly thinned to about `most` points per cloud."""
    rows = np.flatnonzero(np.isfinite(clouds.normal[:, 0]))
    owner = clouds.owner[rows]
    counts = np.bincount(owner, minlength=len(clouds))
    nth = np.arange(len(rows)) - (np.cumsum(counts) - counts)[owner]
    return clouds.kept(rows[nth % np.maximum(counts // most, 1)[owner] == 0])


def match(
    targets: Targets, i: Ints, sources: Clouds, j: Ints, guess: Array, prior: Array, reach: float = RADII_M[0]
) -> Matches:
    """Match clouds j (p,) of `sources` with clouds i (p,) of `targets`, from initial poses `guess` (p, 3).

    `prior` (p, 3, 3) is the information of `guess`, in the frame of i. Points further apart than `reach` [m] do
    not match.
    """
    counts = np.diff(sources.first)[j]
    parts = consecutive(np.cumsum(counts) // POINTS_AT_ONCE)
    return Matches.joined(*(_match(targets, i[at], sources, j[at], guess[at], prior[at], reach) for at in parts))


def overlap(targets: Targets, i: Ints, sources: Clouds, j: Ints, pose: Array, reach: float) -> Array:
    """Return the share (p,) of the points in clouds j, at poses (p, 3), that are near a point of cloud i."""
    return _PointPairs.made(targets, i, sources, j, pose, reach).quality(np.diff(sources.first)[j])[1]


def _match(
    targets: Targets, i: Ints, sources: Clouds, j: Ints, guess: Array, prior: Array, reach: float
) -> Matches:
    pose, moving = guess.copy(), np.arange(len(i))
    scale = reach / RADII_M[0]
    for radius in RADII_M:
        within = max(radius * scale, RADII_M[-1])
        pairs = _PointPairs.made(targets, i[moving], sources, j[moving], pose[moving], within)
        H, g = pairs.normal_equations()
        off = se2.difference(guess[moving], pose[moving])
        Lambda = prior[moving]
        g = g + np.einsum("nij,nj->ni", Lambda, off)
        step = np.linalg.solve(H + Lambda + 1e-6 * np.eye(3), g[..., None])[..., 0]
        pose[moving] += step
        if radius * scale <= RADII_M[-1]:
            moving = moving[np.abs(step).max(axis=1) > SETTLED_M]
        if not len(moving):
            break
    last = _PointPairs.made(targets, i, sources, j, pose, RADII_M[0])
    H, _ = last.normal_equations()
    pulled = np.einsum("nij,nj->ni", prior, se2.difference(pose, guess))
    alone = pose + np.linalg.solve(H + np.diag(1.0 / np.square(MAX_ALONE_SIGMAS)), pulled[..., None])[..., 0]
    # the variances of x, y, theta grow by FLOOR_M^2 and FLOOR_RAD^2; a singular matrix stays singular
    floor = np.diag([FLOOR_M**2, FLOOR_M**2, FLOOR_RAD**2])
    information = se2.symmetric(H @ np.linalg.inv(np.eye(3) + floor @ H))
    return Matches(pose, alone, information, *last.quality(np.diff(sources.first)[j]))


class _PointPairs(msgspec.Struct, frozen=True):
    """Matched points of all pairs of clouds; points without a point within reach are left out."""

    n: int  # number of pairs of clouds
    of: Ints  # (k,) index of the pair of clouds
    e: Array  # (k,) signed distance [m] from the line through the matched point
    row: Array  # (k, 3) derivative of e by the pose

    @classmethod
    def made(cls, targets: Targets, i: Ints, sources: Clouds, j: Ints, pose: Array, reach: float) -> _PointPairs:
        rows, of = sources.rows(j)
        turn = pose[of, 2]
        arm = se2.rotated(turn, sources.xy[rows])
        at = arm + pose[of, :2]
        distance, partner = targets.nearest(at, i[of], reach)
        near = np.isfinite(distance)
        own = se2.rotated(turn, sources.normal[rows])
        normal = targets.normal[partner]
        with np.errstate(invalid="ignore"):
            other_side = (own * normal).sum(axis=1) < MIN_FACING  # False for a point without its own surface
        near &= ~other_side
        of, arm, at, normal, partner = of[near], arm[near], at[near], normal[near], partner[near]
        e = ((at - targets.xy[partner]) * normal).sum(axis=1)
        by_turn = normal[:, 1] * arm[:, 0] - normal[:, 0] * arm[:, 1]
        return cls(len(i), of, e, np.column_stack((normal, by_turn)))

    def normal_equations(self) -> tuple[Array, Array]:
        """Return H (n, 3, 3) and g (n, 3) of the normal equations.

        Cauchy weights reduce the effect of outliers such as people and doors.
        """
        w = 1.0 / (1.0 + (self.e / (2.0 * SIGMA_M)) ** 2) / (DEPENDENT_POINTS * SIGMA_M**2)
        H, g = np.empty((self.n, 3, 3)), np.empty((self.n, 3))
        for a in range(3):
            wa = w * self.row[:, a]
            g[:, a] = -np.bincount(self.of, wa * self.e, self.n)
            for b in range(a, 3):
                H[:, a, b] = H[:, b, a] = np.bincount(self.of, wa * self.row[:, b], self.n)
        return H, g

    def quality(self, counts: Ints) -> tuple[Array, Array, Array]:
        """Return share of inliers among matched points, share of matched points, rms distance of inliers."""
        paired = np.bincount(self.of, minlength=self.n)
        fits = np.abs(self.e) < INLIER_M
        good = np.bincount(self.of, fits, self.n)
        squares = np.bincount(self.of, np.where(fits, self.e**2, 0.0), self.n)
        rms = np.sqrt(squares / np.maximum(good, 1))
        return good / np.maximum(paired, 1), paired / np.maximum(counts, 1), rms
