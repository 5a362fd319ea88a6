"""Conversion of latitude and longitude to metres east and north of an origin (WGS 84 ellipsoid)."""

from __future__ import annotations

import numpy as np

from .data import Array, LocfuseError, plausible

SEMI_MAJOR_AXIS_M = 6_378_137.0  # of WGS 84
FLATTENING = 1.0 / 298.257223563
E2 = FLATTENING * (2.0 - FLATTENING)
MAX_MAP_M = 1e5  # m from a map's origin to a fix in it


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


def on_map(where: Array, origin: tuple[float, float] | None, role: str) -> Array:
    """Return metres (n, 2) east and north of the map's origin for fixes (n, 2) [deg]; None: of the first fix.

    Raises LocfuseError if the fixes of a role are far from the configured origin of its map.
    """
    finite = where[plausible(where).all(axis=1)]
    if origin is None or not len(finite):
        first = finite[0].tolist() if len(finite) else (0.0, 0.0)
        return east_north(where[:, 0], where[:, 1], (first[0], first[1]))
    usual = np.median(finite, axis=0)
    read = {"": usual, "exchanged": usual[::-1], "in radians": np.degrees(usual)}
    apart = {how: float(np.hypot(*east_north(place[0], place[1], origin))) for how, place in read.items()}
    if apart[""] >= MAX_MAP_M:
        how = min(apart, key=lambda one: apart[one])
        likely = f": latitude and longitude look {how}" if apart[how] < MAX_MAP_M else ""
        far = f"{1e-3 * apart['']:.0f} km from {role}.origin{likely}."
        words = f"its fixes ({usual[0]:.4f}, {usual[1]:.4f}) lie {far}"
        raise LocfuseError(words, role=role, hint="Correct the fixes or the origin.")
    return east_north(where[:, 0], where[:, 1], origin)


def _earth_centred(phi: Array, lam: Array) -> Array:
    """Return earth-centred coordinates (..., 3) [m] of latitudes phi and longitudes lam [rad] at height 0."""
    n = SEMI_MAJOR_AXIS_M / np.sqrt(1.0 - E2 * np.sin(phi) ** 2)
    along = n * np.cos(phi)
    return np.stack((along * np.cos(lam), along * np.sin(lam), n * (1.0 - E2) * np.sin(phi)), axis=-1)
