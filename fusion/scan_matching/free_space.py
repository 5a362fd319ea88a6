"""Free space: if a scan looks through a wall that another scan saw, one of the two poses is wrong."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np

from locfuse.fusion import se2
from locfuse.fusion.data import Array, Ints

from .clouds import Clouds

BIN_COUNT = 360
MARGIN_M, MARGIN_SHARE = 0.3, 0.03  # a point must lie so much before what was seen behind it
PAIRS_AT_ONCE = 2000  # of keys: the points of more take hundreds of MB
MIN_POINTS = 20  # in the field of view of the other scan: fewer decide nothing


class Views(msgspec.Struct, frozen=True):
    """The free range of every key scan in each direction."""

    origin: Array  # (2,) the laser on the base
    depth: Array  # (n, BINS) m; NaN where nothing returned

    @classmethod
    def of(cls, clouds: Clouds, origin: Array) -> Views:
        """Return the views of scans; in each direction the shortest range there and beside it."""
        depth = np.full((len(clouds), BIN_COUNT), np.inf)
        bins, ranges = _polar(clouds.xy - origin)
        np.minimum.at(depth, (clouds.owner, bins), ranges)
        nearest = np.minimum.reduce([np.roll(depth, s, axis=1) for s in (-1, 0, 1)])
        return cls(origin, np.where(np.isfinite(nearest), nearest, np.nan))

    def contradicted(self, clouds: Clouds, i: Ints, j: Ints, pose: Array) -> tuple[Any, Any]:
        """Count for pairs of keys (p,) the points of j that i looked through, and those within the view of i."""
        pieces = np.array_split(np.arange(len(i)), len(i) // PAIRS_AT_ONCE + 1)
        counts = [self._counted(clouds, i[some], j[some], pose[some]) for some in pieces]
        bad, judged = (np.concatenate(each) for each in zip(*counts, strict=True))
        return bad, judged

    def _counted(self, clouds: Clouds, i: Ints, j: Ints, pose: Array) -> tuple[Any, Any]:
        rows, of = clouds.rows(j)
        at = se2.transform(pose[of], clouds.xy[rows]) - self.origin
        bins, ranges = _polar(at)
        seen = self.depth[i[of], bins]
        judged = np.isfinite(seen)
        with np.errstate(invalid="ignore"):
            through = ranges < seen * (1.0 - MARGIN_SHARE) - MARGIN_M
        return np.bincount(of, through, len(i)), np.bincount(of, judged, len(i))


def _polar(points: Array) -> tuple[Ints, Array]:
    bins = (
        np.floor((np.arctan2(points[:, 1], points[:, 0]) / (2.0 * np.pi) % 1.0) * BIN_COUNT).astype(np.int64)
        % BIN_COUNT
    )
    return bins, np.hypot(points[:, 0], points[:, 1])
