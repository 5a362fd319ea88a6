"""Geometry of omni-directional pictures: from pixels to bearings (omni eq. 1).

Pixel (i, j) has its centre at x = i (right), y = j (down). The picture angle theta is 0 downwards in the picture
and grows counter-clockwise on the screen (down, right, up, left), as in eq. (1).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from locfuse.fusion.data import Array
from locfuse.fusion.se2 import TAU, wrap_all

COMPRESSED, RAW = ("data", "format"), ("data", "width", "height", "encoding", "step")
# message type -> fields of the picture
FIELDS: dict[str, tuple[str, ...]] = {
    "sensor_msgs/msg/CompressedImage": COMPRESSED,
    "sensor_msgs/msg/Image": RAW,
    **dict.fromkeys(("foxglove.CompressedImage", "foxglove_msgs/msg/CompressedImage"), COMPRESSED),
    **dict.fromkeys(("foxglove.RawImage", "foxglove_msgs/msg/RawImage"), RAW),
}


class Optics(NamedTuple):
    """Calibration of an omni-directional picture."""

    x_c: float  # px, the mirror's axis in the picture
    y_c: float  # px
    inner: float  # px, radius of row 0 of the panorama; pixels inside this circle show the robot itself
    outer: float  # px, radius where the mirror ends
    width: int = 720  # columns of the panorama
    zero: float = 0.0  # rad, bearing of column 0 in the camera's frame
    clockwise: bool = False  # whether columns proceed clockwise in the world, seen from above

    def halved(self) -> Optics:
        """Return the calibration for the picture scaled to half its width and height."""
        x, y = (self.x_c - 0.5) / 2.0, (self.y_c - 0.5) / 2.0
        return self._replace(x_c=x, y_c=y, inner=self.inner / 2.0, outer=self.outer / 2.0)

    @property
    def rows(self) -> int:
        """Height of the panorama [px]."""
        return max(1, int(self.outer - self.inner) + 1)


def omni_1(x_p: Array, y_p: Array, optics: Optics) -> tuple[Array, Array]:
    """Return picture pixels (x_0, y_0) for panorama pixels (x_p, y_p), any shape: omni eq. (1), corrected.

    The printed equation has x_c in both lines, theta = x_p / 2 degrees and r = y_p. The correct one has y_c in the
    second line, theta = 2 pi x_p / W for W columns, and r = r_inner + y_p.
    """
    theta = picture_angle(x_p, optics.width)
    r = optics.inner + y_p
    return optics.x_c + r * np.sin(theta), optics.y_c + r * np.cos(theta)


def paper_omni_1(x_p: Array, y_p: Array, x_c: float) -> tuple[Array, Array]:
    """Return the picture's pixels (x_0, y_0) by omni eq. (1) as printed: theta = x_p / 2 [deg], r = y_p."""
    theta = np.radians(x_p / 2.0)
    return x_c + y_p * np.sin(theta), x_c + y_p * np.cos(theta)


def picture_angle(x_p: Array, width: int) -> Array:
    """Return theta = 2 pi x_p / W [rad] of panorama columns; for W = 720 this is the paper's x_p / 2 [deg]."""
    return TAU * np.asarray(x_p, float) / width


def column(theta: Array, width: int) -> Array:
    """Return the panorama column x_p in [0, W) of picture angles [rad]."""
    return np.asarray(np.mod(theta, TAU) * width / TAU)


def bearing(theta: Array, optics: Optics) -> Array:
    """Return the bearings [rad, -pi..pi, camera frame, counter-clockwise] of picture angles theta [rad]."""
    return np.asarray(wrap_all(optics.zero + (-theta if optics.clockwise else theta)))


def angle_of_bearing(phi: Array, optics: Optics) -> Array:
    """Return the picture angles [rad] of bearings phi [rad, camera frame]: the inverse of `bearing`."""
    return np.asarray(np.mod(optics.zero - phi if optics.clockwise else phi - optics.zero, TAU))
