"""Point clouds of scans, with the surface normal at each point.

The surface at a point is the line fitted to the points of neighbouring beams, if they lie on a line.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Self

import msgspec
import numpy as np
from msgspec.structs import astuple

from locfuse.fusion import se2
from locfuse.fusion.data import Array, Ints, Measurements, totals

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
    n, sums, squares = np.zeros(m), np.zeros((m, 2)), np.zeros((m, 3))
    at = np.arange(m)
    for shift in range(-NEIGHBOUR_BEAMS, NEIGHBOUR_BEAMS + 1):
        j = np.clip(at + shift, 0, m - 1)
        ours = (piece[j] == piece) & (j == at + shift)
        d = np.where(ours[:, None], xy[j] - xy, 0.0)
        n += ours
        sums += d
        squares += d[:, [0, 0, 1]] * d[:, [0, 1, 1]]
    mean = sums / n[:, None]
    xx, xyv, yy = (squares / n[:, None] - mean[:, [0, 0, 1]] * mean[:, [0, 1, 1]]).T
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
