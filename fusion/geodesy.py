"""From latitude and longitude to metres east and north of a place (WGS 84)."""

from __future__ import annotations

import numpy as np

from .data import Array

SEMI_MAJOR_AXIS_M = 6_378_137.0  # of WGS 84
FLATTENING = 1.0 / 298.257223563
E2 = FLATTENING * (2.0 - FLATTENING)


def east_north(latitude: Array, longitude: Array, origin: tuple[float, float]) -> Array:
    """Return (n, 2) metres east and north of `origin` (latitude, longitude [deg]) on its tangent plane.

    Heights are left out: points are taken on the ellipsoid, so that a receiver's vertical error moves nothing.
    """
    phi, lam = np.radians(origin)
    d = _earth_centred(np.radians(latitude), np.radians(longitude)) - _earth_centred(
        np.asarray(phi), np.asarray(lam)
    )
    s, c, sl, cl = np.sin(phi), np.cos(phi), np.sin(lam), np.cos(lam)
    east = -sl * d[..., 0] + cl * d[..., 1]
    north = -s * cl * d[..., 0] - s * sl * d[..., 1] + c * d[..., 2]
    return np.stack((east, north), axis=-1)


def _earth_centred(phi: Array, lam: Array) -> Array:
    """Earth-centred coordinates (..., 3) [m] of points on the ellipsoid."""
    n = SEMI_MAJOR_AXIS_M / np.sqrt(1.0 - E2 * np.sin(phi) ** 2)
    return np.stack(
        (n * np.cos(phi) * np.cos(lam), n * np.cos(phi) * np.sin(lam), n * (1.0 - E2) * np.sin(phi)), axis=-1
    )
