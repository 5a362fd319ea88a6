"""Point-to-line matching of many pairs of scans at once, as point clouds with the surface normal at each point.

The surface at a point is the line fitted to the points of neighbouring beams, if they lie on a line. In a corridor
the points do not constrain the position along it, so a prior from wheel odometry is needed (Censi 2008, "An ICP
variant using a point-to-line metric").

The pose of a pair of clouds (i, j) is that of cloud j in the frame of cloud i, (x, y, theta). Its information is
also in the frame of i.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Self

import msgspec
import numpy as np
from msgspec.structs import astuple

from locfuse.fusion import se2
from locfuse.fusion.data import Array, Ints, Measurements, consecutive, totals
from locfuse.fusion.kernels import nearest
from locfuse.fusion.kernels.arrays import view

MAX_BEAMS = 360  # largest number of matched beams of a scan: more take time, without a better match
NEIGHBOUR_BEAMS = 3  # a surface is fitted to this many beams on each side
MIN_NEIGHBOURS, MAX_SPREAD_M = 3, 0.03  # surface: least number of neighbours, largest distance from the line
MAX_GAP_M, GAP_SPACINGS = 0.25, 5.0  # neighbours further apart (m, beam spacings) belong to different surfaces
MAX_RANGE_M = 30.0
CELL_M = 0.05  # grid cell in which `thinned` keeps one point


class Columns(msgspec.Struct, frozen=True):
    """Record of arrays with equal length, like a table."""

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(astuple(self)[0])

    def take(self, at: Any) -> Self:
        """Return the rows at the indices `at`, or where the mask `at` is true."""
        return type(self)(*(column[at] for column in astuple(self)))

    @classmethod
    def joined(cls, *parts: Self) -> Self:
        """Return several tables as one, row after row."""
        return cls(*(np.concatenate(columns) for columns in zip(*map(astuple, parts), strict=True)))


class Clouds(msgspec.Struct, frozen=True):
    """Points of n clouds in one array: cloud i has the rows first[i]:first[i + 1]."""

    first: Ints  # (n + 1,)
    xy: Array  # (m, 2) [m], each cloud in its own frame
    normal: Array  # (m, 2) unit normals towards the laser; NaN if there is no surface

    @classmethod
    def of_scans(cls, scans: Sequence[Array], origin: Array) -> Clouds:
        """Build clouds with normals from scans (k, 2) [m] in beam order; `origin` (2,) is the laser's position."""
        first = totals([len(p) for p in scans]).astype(np.int64)
        xy = np.concatenate([np.zeros((0, 2)), *scans])
        return cls(first, xy, normals(xy, np.repeat(np.arange(len(scans)), np.diff(first)), origin))

    def kept(self, rows: Ints) -> Clouds:
        """Return clouds with only the points in these rows (k,), which increase."""
        first = totals(np.bincount(self.owner[rows], minlength=len(self)))
        return Clouds(first, self.xy[rows], self.normal[rows])

    def __len__(self) -> int:
        """Return the number of clouds."""
        return len(self.first) - 1

    @property
    def owner(self) -> Ints:
        """Return the index of the cloud of each point, (m,)."""
        return np.repeat(np.arange(len(self)), np.diff(self.first))

    def rows(self, clouds: Ints) -> tuple[Ints, Ints]:
        """Return the rows of all points of these clouds, and for each row the position of its cloud in `clouds`.

        `clouds` (p,) are indices of clouds.
        """
        counts = np.diff(self.first)[clouds]
        ends = np.cumsum(counts)
        position = np.repeat(np.arange(len(clouds)), counts)
        return np.arange(ends[-1] if len(ends) else 0) + (self.first[clouds] - ends + counts)[position], position


def clouds_of(m: Measurements, readings: Ints) -> Clouds:
    """Return the point clouds with normals of laser readings (n,)."""
    if m.points is None:
        return Clouds.of_scans([np.zeros((0, 2))] * len(readings), np.zeros(2))
    origin = m.points.mount[:2]
    return Clouds.of_scans([few(points, origin, MAX_BEAMS) for points in m.points.read(readings)], origin)


def few(points: Array, origin: Array, most: int) -> Array:
    """Return at most `most` points (k, 2) of a scan, evenly thinned.

    Points further than MAX_RANGE_M from the laser at `origin` are left out.
    """
    near: Array = points[np.hypot(*(points - origin).T) < MAX_RANGE_M]  # False for NaN (no return)
    return near[:: max(1, -(-len(near) // most))]


def normals(xy: Array, owner: Ints, origin: Array) -> Array:
    """Return unit normals (m, 2) that point to the laser, at points (m, 2) in beam order.

    `owner` (m,) is the index of each point's scan. A normal is NaN if there is no surface.
    """
    m = len(xy)
    if not m:
        return np.zeros((0, 2))
    step = np.hypot(*(np.diff(xy, axis=0)).T)
    ranges = np.hypot(*(xy - origin).T)
    usual = _median_of_each(step / np.maximum(0.5 * (ranges[1:] + ranges[:-1]), 0.1), owner[1:])
    joined = (step < np.maximum(MAX_GAP_M, GAP_SPACINGS * usual * ranges[1:])) & (owner[1:] == owner[:-1])
    piece = totals(~joined)
    n, sum_x, sum_y, sum_xx, sum_xy, sum_yy = sums = np.zeros((6, m))
    n += 1.0  # the point itself
    for shift in range(1, min(NEIGHBOUR_BEAMS, m - 1) + 1):
        ours = piece[shift:] == piece[:-shift]
        x, y = (np.where(ours, column[shift:] - column[:-shift], 0.0) for column in xy.T)
        sums[0, :-shift] += ours
        sums[0, shift:] += ours
        for total, part, sign in zip(
            sums[1:], (x, y, x * x, x * y, y * y), (-1.0, -1.0, 1.0, 1.0, 1.0), strict=True
        ):
            total[:-shift] += part
            total[shift:] += sign * part
    mean_x, mean_y = sum_x / n, sum_y / n
    xx, xyv, yy = sum_xx / n - mean_x * mean_x, sum_xy / n - mean_x * mean_y, sum_yy / n - mean_y * mean_y
    half, apart = 0.5 * (xx + yy), np.hypot(0.5 * (xx - yy), xyv)
    along = 0.5 * np.arctan2(2.0 * xyv, xx - yy)
    thin = np.maximum(half - apart, 0.0)
    good = (n > MIN_NEIGHBOURS) & (thin < MAX_SPREAD_M**2) & (half + apart > 9.0 * thin)
    normal = np.stack((-np.sin(along), np.cos(along)), axis=-1)
    normal *= np.where((normal * (xy - origin)).sum(axis=1) > 0.0, -1.0, 1.0)[:, None]
    return np.where(good[:, None], normal, np.nan)


def _median_of_each(values: Array, owner: Ints) -> Array:
    """Return for each value (k,) the median over all values of its scan.

    `owner` (k,), sorted, is the index of the scan of each value.
    """
    order = np.lexsort((values, owner))
    first = np.flatnonzero(np.diff(owner, prepend=-1))
    counts = np.diff(np.append(first, len(owner)))
    middle: Array = values[order[first + counts // 2]]
    return np.repeat(middle, counts)


def merged(clouds: Clouds, groups: list[Ints], poses: list[Array]) -> Clouds:
    """Merge the clouds of each group into one cloud.

    `groups` are indices (k,) of clouds; `poses` are the poses (k, 3) of these clouds in the frame of their group,
    which is the frame of the merged cloud.
    """
    xy, normal, counts = [np.zeros((0, 2))], [np.zeros((0, 2))], [0]
    for group, pose in zip(groups, poses, strict=True):
        rows, position = clouds.rows(group)
        at = pose[position]
        xy.append(se2.transform(at, clouds.xy[rows]))
        normal.append(se2.rotated(at[:, 2], clouds.normal[rows]))
        counts.append(len(rows))
    return Clouds(np.cumsum(counts), np.concatenate(xy), np.concatenate(normal))


def thinned(clouds: Clouds) -> Clouds:
    """Return clouds with at most one surface point per grid cell of CELL_M.

    Overlapping scans in a cloud repeat surfaces.
    """
    rows = np.flatnonzero(np.isfinite(clouds.normal[:, 0]))
    square = np.floor(clouds.xy[rows] / CELL_M).astype(np.int64) + (1 << 20)
    of = clouds.owner[rows]
    _, unique = np.unique((of << 42) + (square[:, 0] << 21) + square[:, 1], return_index=True)
    return clouds.kept(rows[np.sort(unique)])


LAYER_M = 1e4  # distance of two clouds in a search tree
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
    """Clouds to which other clouds are matched: their surface points, sorted for a search.

    Interpreted, the kernel would be slow, so a search tree takes its place, with a layer for each cloud.
    """

    def __init__(self, clouds: Clouds) -> None:
        rows = np.flatnonzero(np.isfinite(clouds.normal[:, 0]))
        self.xy, self.normal, owner = clouds.xy[rows], clouds.normal[rows], clouds.owner[rows]
        self._rows = self._tree = None
        if nearest.COMPILED:
            self._rows = nearest.cloud_rows(self.xy, owner, len(clouds))
        elif len(rows):
            from scipy.spatial import cKDTree

            self._tree = cKDTree(np.column_stack((self.xy, LAYER_M * owner)))

    def nearest(self, xy: Array, clouds: Ints, reach: float) -> Ints:
        """Return the row of the nearest surface point in cloud `clouds` (m,), for points (m, 2).

        It is -1 if there is none within `reach` [m].
        """
        row = np.full(len(xy), -1, np.intp)
        if self._rows is not None:
            nearest.find_nearest(self._rows, view(xy), view(clouds, np.intp), reach, row)
        elif self._tree is not None:
            places = np.column_stack((xy, LAYER_M * clouds))
            row = self._tree.query(places, distance_upper_bound=reach, workers=1)[1]
            row[row == len(self.xy)] = -1
        return row


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


def _turned(c: Array, s: Array, v: Array) -> Array:
    """Return vectors v (k, 2) turned by angles with cosine c and sine s, (k,) each."""
    return np.column_stack((c * v[:, 0] - s * v[:, 1], s * v[:, 0] + c * v[:, 1]))


class _PointPairs(msgspec.Struct, frozen=True):
    """Matched points of all pairs of clouds; points without a point within reach are left out."""

    n: int  # number of pairs of clouds
    of: Ints  # (k,) index of the pair of clouds
    e: Array  # (k,) signed distance [m] from the line through the matched point
    row: Array  # (k, 3) derivative of e by the pose

    @classmethod
    def made(cls, targets: Targets, i: Ints, sources: Clouds, j: Ints, pose: Array, reach: float) -> _PointPairs:
        rows, of = sources.rows(j)
        c, s = np.cos(pose[:, 2])[of], np.sin(pose[:, 2])[of]
        arm = _turned(c, s, sources.xy[rows])
        at = arm + pose[of, :2]
        partner = targets.nearest(at, i[of], reach)
        near = np.flatnonzero(partner >= 0)
        partner = partner[near]
        own, normal = _turned(c[near], s[near], sources.normal[rows[near]]), targets.normal[partner]
        with np.errstate(invalid="ignore"):
            other_side = (own * normal).sum(axis=1) < MIN_FACING  # False for a point without its own surface
        same = np.flatnonzero(~other_side)
        near, normal, partner = near[same], normal[same], partner[same]
        of, arm, at = of[near], arm[near], at[near]
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
