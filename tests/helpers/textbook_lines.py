"""Split and merge as the textbook has it: recursive, point by point, no batches. An oracle, not a product."""

from __future__ import annotations

import math

import numpy as np

from locfuse.fusion.data import Array


def split(points: Array, tolerance: Array, start: int = 0) -> list[int]:
    """Return where the straight pieces of points (k, 2) start: cut at the farthest point from the chord."""
    (x0, y0), (x1, y1) = points[0], points[-1]
    length = math.hypot(x1 - x0, y1 - y0)
    worst, at = 1.0, 0
    for i in range(1, len(points) - 1):
        x, y = points[i]
        off = abs((x1 - x0) * (y - y0) - (y1 - y0) * (x - x0)) / length / tolerance[i]
        if off > worst:
            worst, at = off, i
    if not at:
        return [start]
    return split(points[:at], tolerance[:at], start) + split(points[at:], tolerance[at:], start + at)


def misfit(points: Array, weights: Array) -> float:
    """Weighted sum of squared distances to the best line: the smallest singular value, squared."""
    centred = points - np.average(points, axis=0, weights=weights)
    return float(np.linalg.svd(centred * np.sqrt(weights)[:, None], compute_uv=False)[-1] ** 2) * (len(points) > 1)


def merge(points: Array, weights: Array, starts: list[int], limit: float) -> list[int]:
    """Join the two neighbours that are most nearly one line, again and again, while that costs under `limit`."""
    starts = [*starts, len(points)]

    def square(a: int, b: int) -> float:
        return misfit(points[starts[a] : starts[b]], weights[starts[a] : starts[b]])

    while len(starts) > 2:
        pairs = range(len(starts) - 2)
        cost = [square(i, i + 2) - square(i, i + 1) - square(i + 1, i + 2) for i in pairs]
        best = int(np.argmin(cost))
        if cost[best] >= limit:
            break
        del starts[best + 1]
    return starts[:-1]
