"""Split and merge of laser scans into straight pieces, all scans of a batch at once.

The textbook algorithm (Nguyen, Martinelli, Tomatis, Siegwart: "A comparison of line extraction algorithms using
2D laser rangefinder for indoor mobile robotics", IROS 2005) recurses scan by scan. Here all pieces of one depth of
the recursion are cut together, so that the work per beam is NumPy's. Nothing crosses from one scan to another:
the result does not depend on what else is in the batch, not even in the last bit.

Pieces are given by `first` (p + 1,): piece i owns the points first[i]:first[i + 1].
"""

from __future__ import annotations

import numpy as np

from .data import Array, Ints
from .line_beams import argmax_each
from .line_fit import Mask, misfit


def split(x: Array, y: Array, tolerance: Array, first: Ints) -> Ints:
    """Cut runs of points into straight pieces and return their `first`, (p + 1,).

    A piece whose farthest point lies more than its `tolerance` [m] from the chord between the piece's end points
    is cut there; the farthest point starts the second half. Points x, y [m] and tolerance are (k,).
    """
    cuts, bounds, origin = [first], first, np.arange(len(x))
    while len(origin):
        excess = _off_chord(x, y, tolerance, bounds)
        vertex = argmax_each(excess, bounds)
        found = excess[vertex] > 1.0
        stay = np.flatnonzero(np.repeat(found, np.diff(bounds)))
        cuts.append(origin[vertex[found]])
        halves = np.stack((vertex - bounds[:-1], bounds[1:] - vertex), axis=1)[found]
        bounds = np.concatenate(([0], np.cumsum(halves)))
        x, y, tolerance = x.take(stay), y.take(stay), tolerance.take(stay)
        origin = origin.take(stay)
    return np.sort(np.concatenate(cuts))


def chords(x: Array, y: Array, first: Ints) -> tuple[Array, Array, Array]:
    """Return unit normal (nx, ny) and offset n.P [m] of the line through each piece's end points, each (p,)."""
    x0, y0 = x[first[:-1]], y[first[:-1]]
    dx, dy = x[first[1:] - 1] - x0, y[first[1:] - 1] - y0
    length = np.hypot(dx, dy)
    point = length == 0  # one point, or a loop that closes exactly: any direction will do
    length[point], dy[point] = 1.0, -1.0
    nx, ny = -dy / length, dx / length
    return nx, ny, nx * x0 + ny * y0


def _off_chord(x: Array, y: Array, tolerance: Array, first: Ints) -> Array:
    """Return every point's distance from its piece's chord, in units of its tolerance, (k,)."""
    nx, ny, offset = (np.repeat(a, np.diff(first)) for a in chords(x, y, first))
    nx *= x
    ny *= y
    nx += ny
    nx -= offset
    np.abs(nx, out=nx)
    nx /= tolerance
    return nx


def merge(moments: Array, linked: Mask, limit: float) -> Ints:
    """Join neighbouring pieces that are statistically one line; return the groups' bounds among them, (g + 1,).

    Two pieces are one line if fitting them as one raises the weighted sum of squares by less than `limit`: a
    likelihood ratio, chi-square with 2 degrees of freedom. The best pairs go first. `moments` (6, p) are those of
    `line_fit.misfit`, weighted by 1/variance; `linked` (p - 1,) says which neighbours may be joined at all.
    """
    rows, start = moments.T.copy(), np.arange(moments.shape[1])
    own, cost = misfit(moments), np.full(len(linked), np.inf)
    pair = np.flatnonzero(linked)
    while len(pair):
        cost[pair] = misfit((rows[pair] + rows[pair + 1]).T) - own[pair] - own[pair + 1]
        best = np.flatnonzero(_lowest(cost, limit))
        rows[best] += rows[best + 1]
        own[best] = misfit(rows[best].T)
        keep = np.ones(len(start), bool)
        keep[best + 1] = False
        rows, own, start, cost = rows[keep], own[keep], start[keep], cost[keep[1:]]
        joined = best - np.arange(len(best))  # the pairs on both sides of a new group must be compared again
        pair = np.concatenate((joined - 1, joined))
        pair = pair[(pair >= 0) & (pair < len(cost))]
        pair = pair[np.isfinite(cost[pair])]
    return np.append(start, moments.shape[1])


def _lowest(cost: Array, limit: float) -> Mask:
    """Return the pairs to join now: cost below the limit and below both neighbours' (the earlier wins a tie)."""
    low = cost < limit
    low[1:] &= cost[1:] < cost[:-1]
    low[:-1] &= cost[:-1] <= cost[1:]
    return np.asarray(low)
