"""Split and merge of laser scans into straight pieces, all scans of a batch at once.

The textbook algorithm (Nguyen, Martinelli, Tomatis, Siegwart: "A comparison of line extraction algorithms using
2D laser rangefinder for indoor mobile robotics", IROS 2005) recurses scan by scan. Here all pieces of one depth of
the recursion are cut together, so that the work per beam is NumPy's. Nothing crosses from one scan to another:
the result does not depend on what else is in the batch, not even in the last bit.

Pieces are given by `first` (p + 1,): piece i owns the points first[i]:first[i + 1].
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from locfuse.fusion.data import Array, Ints

from .fit import Mask, misfit

Floats = NDArray[Any]  # of single or double precision


def split(x: Floats, y: Floats, tolerance: Floats, first: Ints) -> Ints:
    """Cut runs of points into straight pieces and return their `first`, (p + 1,).

    A piece whose farthest point lies more than its `tolerance` [m] from the chord between the piece's end points
    is cut there; the farthest point starts the second half. Points x, y [m] and tolerance are (k,).
    """
    cuts, bounds, at = [first], first, first[:-1]  # at: where the pieces begin among all points
    while len(x):
        excess = _off_chord(x, y, bounds)
        excess /= tolerance
        greatest = np.maximum.reduceat(excess, bounds[:-1])
        found, counts = greatest > 1.0, np.diff(bounds)
        stay = np.flatnonzero(np.repeat(found, counts))
        x, y, tolerance, excess = x.take(stay), y.take(stay), tolerance.take(stay), excess.take(stay)
        counts, at = counts[found], at[found]
        left = _first_hits(excess, greatest[found], counts)
        halves = np.stack((left, counts - left), axis=1).ravel()
        bounds = np.concatenate(([0], np.cumsum(halves)))
        at = np.stack((at, at + left), axis=1).ravel()
        cuts.append(at[1::2])
    return np.sort(np.concatenate(cuts))


def chords(x: Floats, y: Floats, first: Ints) -> tuple[Floats, Floats, Floats]:
    """Return unit normal (nx, ny) and offset n.P [m] of the line through each piece's end points, each (p,)."""
    x0, y0 = x[first[:-1]], y[first[:-1]]
    dx, dy = x[first[1:] - 1] - x0, y[first[1:] - 1] - y0
    length = np.hypot(dx, dy)
    point = length == 0  # one point, or a loop that closes exactly: any direction will do
    length[point], dy[point] = 1.0, -1.0
    nx, ny = -dy / length, dx / length
    return nx, ny, nx * x0 + ny * y0


def _off_chord(x: Floats, y: Floats, first: Ints) -> Floats:
    """Return every point's distance from its piece's chord [m], (k,)."""
    nx, ny, offset = (np.repeat(a, np.diff(first)) for a in chords(x, y, first))
    nx *= x
    ny *= y
    nx += ny
    nx -= offset
    return np.asarray(np.abs(nx, out=nx))


def _first_hits(values: Floats, greatest: Floats, counts: Ints) -> Ints:
    """Return how far into its piece each piece's greatest value stands, the earliest of equals, (p,)."""
    hits = np.flatnonzero(values == np.repeat(greatest, counts))
    begin = np.cumsum(counts) - counts
    return hits[np.searchsorted(hits, begin)] - begin


def merge(moments: Array, linked: Mask, limit: float) -> Ints:
    """Join neighbouring pieces that are statistically one line; return the groups' bounds among them, (g + 1,).

    Two pieces are one line if fitting them as one raises the weighted sum of squares by less than `limit`: a
    likelihood ratio, chi-square with 2 degrees of freedom. The best pairs go first. `moments` (6, p) are those of
    `fit.misfit`, weighted by 1/variance; `linked` (p - 1,) says which neighbours may be joined at all.
    """
    pieces = moments.shape[1]
    rows, own = moments.T.copy(), misfit(moments)
    after, before = np.arange(1, pieces + 2), np.arange(-1, pieces)  # the last row stands for no piece
    cost = np.full(pieces + 1, np.inf)  # of joining a piece with the one after it
    pair = np.flatnonzero(linked)
    alive = np.ones(pieces, bool)
    while len(pair):
        cost[pair] = misfit((rows[pair] + rows[after[pair]]).T) - own[pair] - own[after[pair]]
        low = np.flatnonzero(cost < limit)
        best = low[(cost[low] < cost[before[low]]) & (cost[low] <= cost[after[low]])]
        gone = after[best]
        rows[best] += rows[gone]
        own[best] = misfit(rows[best].T)
        cost[best] = cost[gone]
        cost[gone] = np.inf
        after[best] = after[gone]
        before[after[best]] = best
        alive[gone] = False
        pair = np.concatenate((before[best], best))
        pair = pair[np.isfinite(cost[pair])]
    return np.append(np.flatnonzero(alive), pieces)
