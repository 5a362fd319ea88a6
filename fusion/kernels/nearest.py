"""Nearest point of a cloud, for the points of many clouds at once.

The points of a cloud lie in rows of height ROW_M, sorted by x in each row. A search begins in the row of the
wanted place, and ends where the next row, or the next point of a row, is further than the nearest point so far.
"""

from __future__ import annotations

import numpy as np

from locfuse.fusion.data import Array, Ints

from .arrays import view

try:
    import cython
except ImportError:  # Cython is only needed to compile
    from . import uncompiled as cython
if not cython.compiled:
    from .uncompiled import floor

ROW_M = 0.25  # height of a row
FAR_ROWS = 1e9  # places so far from a cloud have no nearest point
COMPILED = bool(cython.compiled)  # interpreted, a search takes 20 us


class Best:
    """Nearest point so far: its index `point`, -1 for none, and its squared distance [m^2]."""

    def __init__(self) -> None:
        """Begin without a point."""
        self.square, self.point = 0.0, -1


class CloudRows:
    """Points of n clouds in rows.

    Cloud c has the rows first[c]:first[c + 1]; the lowest has its lower edge at bottom[c] * ROW_M. Row r has the
    points begin[r]:begin[r + 1] of x, y [m], in the order of x; `point` are their indices before sorting.
    """

    def __init__(self, first: Ints, bottom: Array, begin: Ints, points: tuple[Array, Array, Ints]) -> None:
        """`points` are x, y and `point`, (m,) each."""
        self.first, self.begin = view(first, np.intp), view(begin, np.intp)
        self.bottom = view(bottom)
        self.x, self.y, self.point = view(points[0]), view(points[1]), view(points[2], np.intp)
        self.best = Best()  # of the place that is searched


def cloud_rows(xy: Array, cloud: Ints, n: int) -> CloudRows:
    """Sort the points xy (m, 2) [m] of n clouds into rows; `cloud` (m,) is the cloud of each point, increasing."""
    level = np.floor(xy[:, 1] / ROW_M)
    counts = np.bincount(cloud, minlength=n)
    bottom, rows = np.zeros(n), np.zeros(n, np.intp)
    some = np.flatnonzero(counts)
    if len(some):
        at = (np.cumsum(counts) - counts)[some]
        bottom[some] = np.minimum.reduceat(level, at)
        rows[some] = np.maximum.reduceat(level, at) - bottom[some] + 1.0
    first = np.concatenate((np.zeros(1, np.intp), np.cumsum(rows)))
    row = first[cloud] + (level - bottom[cloud]).astype(np.intp)
    order = np.lexsort((xy[:, 0], row))
    begin = np.searchsorted(row[order], np.arange(first[-1] + 1))
    return CloudRows(first, bottom, begin, (xy[order, 0], xy[order, 1], order))


def find_nearest(rows: CloudRows, xy: Array, cloud: Ints, reach: float, out: Ints) -> None:
    """Write to `out` (q,) the point of cloud `cloud` (q,) that is nearest to xy (q, 2) [m].

    -1 if none is nearer than `reach` [m].
    """
    best = rows.best
    for q in range(xy.shape[0]):
        best.square, best.point = reach * reach, -1
        search(rows, xy[q, 0], xy[q, 1], cloud[q], best)
        out[q] = best.point


def search(rows: CloudRows, x: float, y: float, cloud: int, best: Best) -> None:
    """Find the point of a cloud that is nearest to (x, y) [m], if it is nearer than `best`."""
    count = rows.first[cloud + 1] - rows.first[cloud]
    level = floor(y / ROW_M) - rows.bottom[cloud]
    if not -FAR_ROWS < level < FAR_ROWS:  # or NaN
        return
    level = min(max(level, 0.0), count - 1.0)
    begin = int(level)
    for up in range(2):
        k = begin + up
        while 0 <= k < count:
            low = (rows.bottom[cloud] + k) * ROW_M
            away = max(low - y, y - low - ROW_M, 0.0)
            if away * away >= best.square:
                break
            search_row(rows, rows.first[cloud] + k, x, y, best)
            k += 1 if up else -1


def search_row(rows: CloudRows, row: int, x: float, y: float, best: Best) -> None:
    """Find the point of a row that is nearest to (x, y) [m], if it is nearer than `best`."""
    begin, end = rows.begin[row], rows.begin[row + 1]
    low, high = begin, end
    while low < high:  # the first point that is not left of x
        middle = (low + high) // 2
        if rows.x[middle] < x:
            low = middle + 1
        else:
            high = middle
    for right in range(2):
        i = low if right else low - 1
        while begin <= i < end:
            dx, dy = rows.x[i] - x, rows.y[i] - y
            if dx * dx >= best.square:
                break
            if dx * dx + dy * dy < best.square:
                best.square, best.point = dx * dx + dy * dy, rows.point[i]
            i += 1 if right else -1
