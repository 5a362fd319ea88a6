"""Conversion of latitude and longitude to metres east and north of an origin (WGS 84 ellipsoid)."""

from __future__ import annotations

import numpy as np

from .data import Array

SEMI_MAJOR_AXIS_M = 6_378_137.0  # of WGS 84
FLATTENING = 1.0 / 298.257223563
E2 = FLATTENING * (2.0 - FLATTENING)


def east_north(latitude: Array, longitude: Array, origin: tuple[float, float]) -> Array:
    """Return metres (n, 2) east and north of `origin` (latitude, longitude [deg]), on the tangent plane there.

    Heights are set to 0, so that a receiver's vertical error has no effect.
    """
    phi, lam = np.radians(origin)
    there, here = (np.radians(latitude), np.radians(longitude)), (np.asarray(phi), np.asarray(lam))
    d = _earth_centred(*there) - _earth_centred(*here)
    s, c, sl, cl = np.sin(phi), np.cos(phi), np.sin(lam), np.cos(lam)
    east = -sl * d[..., 0] + cl * d[..., 1]
    north = -s * cl * d[..., 0] - s * sl * d[..., 1] + c * d[..., 2]
    return np.stack((east, north), axis=-1)


def _earth_centred(phi: Array, lam: Array) -> Array:
    """Return earth-centred coordinates (..., 3) [m] of latitudes phi and longitudes lam [rad] at height 0."""
    n = SEMI_MAJOR_AXIS_M / np.sqrt(1.0 - E2 * np.sin(phi) ** 2)
    along = n * np.cos(phi)
    return np.stack((along * np.cos(lam), along * np.sin(lam), n * (1.0 - E2) * np.sin(phi)), axis=-1)
