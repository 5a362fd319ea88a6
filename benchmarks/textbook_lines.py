"""Lines scan by scan: recursive split, merge by refitting, total least squares. The usual NumPy way."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
TOLERANCE, MIN_POINTS, MIN_LENGTH = 0.09, 5, 0.3


def extract(scan: Array, angles: Array) -> list[tuple[float, float]]:
    """Return (r, psi) of the lines of one scan."""
    good = np.isfinite(scan) & (scan > 0)
    points = np.stack((scan * np.cos(angles), scan * np.sin(angles)), axis=1)[good]
    pieces = merged(points, split(points, 0, len(points)))
    lines = [fit(points[a:b]) for a, b in pieces if b - a >= MIN_POINTS and span(points[a:b]) >= MIN_LENGTH]
    return [(r, psi) for r, psi, _ in lines]


def split(points: Array, a: int, b: int) -> list[tuple[int, int]]:
    """Cut points[a:b] where a point is far from the chord, recursively."""
    if b - a < 3:
        return [(a, b)]
    along = points[b - 1] - points[a]
    off = np.abs(along[0] * (points[a:b, 1] - points[a, 1]) - along[1] * (points[a:b, 0] - points[a, 0]))
    i = int(off.argmax())
    if off[i] <= TOLERANCE * np.hypot(*along) or i == 0:
        return [(a, b)]
    return split(points, a, a + i) + split(points, a + i, b)


def merged(points: Array, pieces: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """Join neighbours whose common line is near all their points."""
    done = [pieces[0]]
    for a, b in pieces[1:]:
        start = done[-1][0]
        if b - start >= 3 and fit(points[start:b])[2] < TOLERANCE:
            done[-1] = (start, b)
        else:
            done.append((a, b))
    return done


def span(points: Array) -> float:
    """Return the distance between the end points [m]."""
    return float(np.hypot(*(points[-1] - points[0])))


def fit(points: Array) -> tuple[float, float, float]:
    """Return r, psi and the largest residual of the total-least-squares line."""
    mean = points.mean(axis=0)
    dx, dy = (points - mean).T
    psi = 0.5 * np.arctan2(-2.0 * (dx * dy).sum(), (dy * dy - dx * dx).sum())
    n = np.array([np.cos(psi), np.sin(psi)])
    return float(mean @ n), float(psi), float(np.abs((points - mean) @ n).max())
