"""Thinning without visible change: a curve keeps the least and the greatest value of every interval.

A screen is about 2000 pixels wide, so a curve of 4000 extremes draws the same picture as one of 10^6 points,
spikes included; every n-th point would lose the spikes, which are what one looks for.
"""

from __future__ import annotations

import numpy as np

from locfuse.fusion.data import Array, Ints

MAX_CURVE_POINTS = 4000
MAX_SCANS = 2000


def evenly(n: int, limit: int) -> Ints:
    """Return at most `limit` positions of n, evenly spaced, with both ends."""
    if n <= limit:
        return np.arange(n)
    return np.unique(np.rint(np.linspace(0, n - 1, limit)).astype(np.int64))


def extremes(values: Array, limit: int) -> Ints:
    """Return at most `limit` positions (p,) of the curve values (n,) or curves (n, k), in order.

    Every bucket gives the positions of its least and its greatest value, of each curve; NaN is never one.
    Both ends are kept.
    """
    n = len(values)
    if n <= limit:
        return np.arange(n)
    curves = values.reshape(n, -1)
    k = curves.shape[1]
    buckets = max(1, (limit - 2) // (2 * k))
    width = -(-n // buckets)
    flat = np.full((buckets * width, k), np.nan)
    flat[:n] = curves
    padded = flat.reshape(buckets, width, k)
    gap = np.isnan(padded)
    low = np.where(gap, np.inf, padded).argmin(axis=1)
    high = np.where(gap, -np.inf, padded).argmax(axis=1)
    start = (np.arange(buckets) * width)[:, None]
    picks = np.concatenate(((start + low).ravel(), (start + high).ravel(), [0, n - 1]))
    return np.unique(picks[picks < n])
