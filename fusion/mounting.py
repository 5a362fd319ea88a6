"""How a sensor is turned on the base, in three dimensions."""

from __future__ import annotations

import math

import numpy as np

from .data import Array


def rotation(roll_deg: float, pitch_deg: float, yaw_deg: float) -> Array:
    """Return R (3, 3) = Rz(yaw) Ry(pitch) Rx(roll), from the sensor's axes to the base's, as in URDF."""
    r, p, y = (math.radians(angle) for angle in (roll_deg, pitch_deg, yaw_deg))
    cr, sr, cp, sp, cy, sy = math.cos(r), math.sin(r), math.cos(p), math.sin(p), math.cos(y), math.sin(y)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def rotated(q: Array, v: Array) -> Array:
    """Return vector v (3,) turned by quaternions (n, 4) x, y, z, w of any length, (n, 3)."""
    n = (q**2).sum(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        axis, w = q[:, :3] / np.sqrt(n)[:, None], q[:, 3] / np.sqrt(n)
    t = 2.0 * np.cross(axis, v)
    turned: Array = v + w[:, None] * t + np.cross(axis, t)
    return turned
