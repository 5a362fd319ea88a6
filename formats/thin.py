"""Thinning of curves without visible change: each interval keeps its smallest and its largest value.

A screen is about 2000 pixels wide. So 4000 extremes give the same picture as 10^6 points, with all spikes; every
n-th point alone would lose spikes.
"""

from __future__ import annotations

import numpy as np

from locfuse.fusion.data import Array, Ints

MAX_CURVE_POINTS = 4000
MAX_SCANS = 2000


def extremes(values: Array, limit: int) -> Ints:
    """Return at most `limit` indices (p,), increasing, of a curve (n,) or of curves (n, k).

    These are the indices of the smallest and the largest value (not NaN) of each curve in each interval, and both
    ends.
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
