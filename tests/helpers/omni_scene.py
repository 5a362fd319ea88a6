"""Vertical red poles seen in a hyperbolic mirror: pictures made from the mirror's equation, not from the product.

Written apart from fusion (and from sample_logs), so that no mistake is shared: a pixel's ray is turned into an
azimuth and an elevation, and the ray is held against the pole in three dimensions.
"""

import math
from functools import cache

import msgspec
import numpy as np
from numpy.typing import NDArray

Picture = NDArray[np.uint8]
Floats = NDArray[np.float32]

MIRROR_A, MIRROR_B, FOCAL = 28.095, 23.4125, 320.0  # mm, mm, px
RED = (40, 35, 205)  # blue, green, red


class Lens(msgspec.Struct, frozen=True):
    """A picture's geometry; azimuth is counter-clockwise from forward, seen from above."""

    width: int = 640
    height: int = 480
    x_c: float = 318.3
    y_c: float = 241.6
    inner: float = 60.0
    outer: float = 232.0
    zero_deg: float = 0.0  # azimuth seen straight down in the picture
    clockwise: bool = False
    fine: int = 2  # rays per pixel and axis; 1: jagged edges


class Pole(msgspec.Struct, frozen=True):
    """A vertical cylinder; heights over the mirror's focus."""

    bearing_deg: float
    distance: float = 3.0
    radius: float = 0.05
    bottom: float = -0.6
    top: float = 0.6
    colour: tuple[int, int, int] = RED


@cache
def rays(lens: Lens) -> tuple[Floats, Floats, Floats]:
    """Cosine and sine of the azimuth and tangent of the elevation of fine x fine rays per pixel."""
    step = (np.arange(lens.fine) - (lens.fine - 1) / 2) / lens.fine
    x = (np.arange(lens.width)[:, None] + step).ravel() - lens.x_c
    y = (np.arange(lens.height)[:, None] + step).ravel() - lens.y_c
    x, y = np.meshgrid(x, y)
    from_down_to_right = np.arctan2(x, y)
    turn = -from_down_to_right if lens.clockwise else from_down_to_right
    azimuth = turn + math.radians(lens.zero_deg)
    g = np.arctan2(FOCAL, np.hypot(x, y))
    b, c = MIRROR_B, math.hypot(MIRROR_A, MIRROR_B)
    tangent = ((b * b + c * c) * np.sin(g) - 2 * b * c) / ((b * b - c * c) * np.cos(g))
    cos, sin, slope = (v.astype(np.float32) for v in (np.cos(azimuth), np.sin(azimuth), tangent))
    return cos, sin, slope


@cache
def empty(lens: Lens, grey: int) -> Picture:
    """The mirror without any pole."""
    y, x = np.mgrid[: lens.height, : lens.width]
    r = np.hypot(x - lens.x_c, y - lens.y_c)
    level = np.where((r < lens.inner) | (r > lens.outer), 8, grey).astype(np.uint8)
    return np.repeat(level[..., None], 3, axis=2)


def picture(lens: Lens, *poles: Pole, grey: int = 150) -> Picture:
    """The picture (h, w, 3) of poles in an evenly grey world, antialiased; black outside the mirror."""
    cos, sin, slope = rays(lens)
    shot = empty(lens, grey).copy()
    mirror = shot[..., 0] == grey
    for pole in poles:
        along, across = math.cos(math.radians(pole.bearing_deg)), math.sin(math.radians(pole.bearing_deg))
        hit = np.abs(cos * across - sin * along) <= pole.radius / pole.distance
        hit &= (cos * along + sin * across > 0) & (slope >= pole.bottom / pole.distance)
        hit &= slope <= pole.top / pole.distance
        shares = hit.reshape(lens.height, lens.fine, lens.width, lens.fine).mean(axis=(1, 3))
        on = np.nonzero((shares > 0) & mirror)
        share = shares[on][:, None]
        shot[on] = np.rint(shot[on] * (1 - share) + np.array(pole.colour) * share).astype(np.uint8)
    return shot


def wrapped_deg(angle: float) -> float:
    """An angle in [-180, 180) degrees."""
    return (angle + 180.0) % 360.0 - 180.0
