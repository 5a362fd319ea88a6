"""Plane geometry for figures and exports (ellipses, quaternions, walls), and thinning of curves."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from locfuse.fusion.data import PLANE_ROWS, Array, Ints, MapLine, matrices

ELLIPSE_SIGMAS = 3.0
BAND_POINTS = 9  # points along a wall


def ellipses(P: Array) -> tuple[Array, Array]:
    """Return half axes (n, 2) and direction (n,) of the 3-sigma ellipses of position covariances (n, >=2, >=2)."""
    xx, yy, xy = P[:, 0, 0], P[:, 1, 1], P[:, 0, 1]
    mean, half = 0.5 * (xx + yy), np.hypot(0.5 * (xx - yy), xy)
    values = np.maximum(np.stack((mean + half, mean - half), axis=-1), 0.0)
    return ELLIPSE_SIGMAS * np.sqrt(values), 0.5 * np.arctan2(2.0 * xy, xx - yy)


def quaternions(angle: Array) -> Array:
    """Return quaternions x, y, z, w (n, 4) of rotations by `angle` (n,) [rad] about z."""
    zero = np.zeros_like(angle)
    return np.column_stack((zero, zero, np.sin(0.5 * angle), np.cos(0.5 * angle)))


def spatial_covariance(triangles: Array) -> Array:
    """Return covariances (n, 6, 6) of x, y, z, roll, pitch, yaw from triangles (n, 6) of those of x, y, yaw."""
    P = np.zeros((len(triangles), 6, 6))
    P[:, np.array(PLANE_ROWS)[:, None], PLANE_ROWS] = matrices(triangles)
    return P


def segments(z: Array, ends: Array) -> Array:
    """Return the end points (k, 2, 2) [m] of segments on lines z (k, 2) = (r [m], psi [rad]) in normal form.

    `ends` (k, 2) [m] are measured from the foot of the normal, in the direction (-sin psi, cos psi).
    """
    c, s = np.cos(z[:, 1]), np.sin(z[:, 1])
    foot = np.stack((z[:, 0] * c, z[:, 0] * s), axis=-1)
    along = np.stack((-s, c), axis=-1)
    points: Array = foot[:, None] + ends[:, :, None] * along[:, None]
    return points


def walls(lines: Sequence[MapLine]) -> Array:
    """Return both ends of map lines, (k, 2, 2) [m, map frame]."""
    z = np.array([(line.rho, line.beta) for line in lines]).reshape(-1, 2)
    return segments(z, np.array([line.ends for line in lines]).reshape(-1, 2))


def wall_band(line: MapLine) -> Array:
    """Return the outline (2 BAND_POINTS + 1, 2) [m] of a map line's 3-sigma area, with the first point repeated.

    At the coordinate t along the tangent, the error across the line is drho - t dbeta, so the area is narrowest
    near the middle of the line.
    """
    t, P = np.linspace(*line.ends, BAND_POINTS), line.P_map
    variance = P[0, 0] - 2.0 * t * P[0, 1] + t**2 * P[1, 1]
    width = ELLIPSE_SIGMAS * np.sqrt(np.maximum(variance, 0.0))
    normal = np.array([math.cos(line.beta), math.sin(line.beta)])
    middle = segments(np.full((BAND_POINTS, 2), (line.rho, line.beta)), np.column_stack((t, t)))[:, 0]
    out, back = middle + width[:, None] * normal, middle - width[:, None] * normal
    return np.concatenate((out, back[::-1], out[:1]))


# --- Thinning of curves without visible change: each interval keeps its smallest and its largest value
# A screen is about 2000 pixels wide. So 4000 extremes give the same picture as 10^6 points, with all spikes; every
# n-th point alone would lose spikes.

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


def broken(x: Array, y: Array, period: float) -> tuple[Array, Array]:
    """Return a curve (n,) with NaN where y, such as an angle, jumps by more than half of its period."""
    at = np.flatnonzero(np.abs(np.diff(y)) > 0.5 * period) + 1
    return np.insert(x, at, np.nan), np.insert(y, at, np.nan)
