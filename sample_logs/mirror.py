"""Hyperbolic mirror of an omni-directional camera: viewing direction of every pixel.

The mirror is the sheet Z > 0 of Z^2/b^2 - rho^2/a^2 = 1 with its hollow side down; its foci are at +c and -c,
c^2 = a^2 + b^2. The camera's pinhole is at -c and looks up. A ray towards +c is reflected to -c, so all rays of
the picture pass through the focus +c: their azimuths do not change, only their elevations.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from locfuse.fusion.data import Array, Ints
from locfuse.fusion.se2 import wrap_all

from .scenario import CameraSpec


class Rays(NamedTuple):
    """Pixels inside the mirror, sorted by azimuth, with their viewing directions."""

    pixel: Ints  # (n,) index into the flattened image
    azimuth: Array  # (n,) rad in [-pi, pi), from the camera's forward axis, counter-clockwise seen from above
    slope: Array  # (n,) tangent of the elevation


def slope(radius: Array, camera: CameraSpec) -> Array:
    """Return the tangent of the elevation seen at `radius` [px] from the mirror's axis in the picture."""
    a, b = camera.mirror_a, camera.mirror_b
    c = np.hypot(a, b)
    ray = np.hypot(camera.focal, radius)
    sin, cos = camera.focal / ray, radius / ray  # of the elevation of the ray that leaves the pinhole
    return np.asarray(((b**2 + c**2) * sin - 2 * b * c) / ((b**2 - c**2) * cos))


def azimuth(u: Array, v: Array, camera: CameraSpec) -> Array:
    """Return the azimuths [rad, -pi..pi, camera frame] of pixels (u, v) (paper eq. 1)."""
    right_of_down = np.arctan2(u - camera.centre[0], v - camera.centre[1])
    turn = -right_of_down if camera.clockwise else right_of_down
    return wrap_all(turn + np.radians(camera.zero_deg))


def rays(camera: CameraSpec) -> Rays:
    """Return the viewing rays of all pixels between the inner and the outer circle of the mirror."""
    width, height = camera.size
    v, u = np.mgrid[:height, :width].astype(np.float64)
    radius = np.hypot(u - camera.centre[0], v - camera.centre[1])
    pixel = np.flatnonzero((radius >= camera.inner) & (radius <= camera.outer))
    looks = azimuth(u.ravel()[pixel], v.ravel()[pixel], camera)
    order = np.argsort(looks, kind="stable")
    return Rays(pixel[order], looks[order], slope(radius.ravel()[pixel[order]], camera))
