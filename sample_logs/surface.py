"""Appearance of surfaces: cement walls, wooden plates, a tiled floor, painted cylinders, lit from the ceiling."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from locfuse.fusion.data import Array

from .table import Colour

Floats = NDArray[np.float32]

AMBIENT = 0.6  # light that comes from everywhere
LAMP = 4.0  # m^2: brightness of one lamp, times cosine over squared distance


class Surface(IntEnum):
    """The surface that a ray hits; from PAINTED on, one number per cylinder."""

    FLOOR = 0
    CEILING = 1
    WALL = 2
    PLATE = 3
    PAINTED = 4


COLOUR: dict[int, Colour] = {  # red, green, blue
    Surface.FLOOR: (150, 148, 140),
    Surface.CEILING: (215, 215, 210),
    Surface.WALL: (165, 163, 158),
    Surface.PLATE: (188, 152, 108),
}


@dataclass
class Hits:
    """The nearest hits of every ray so far."""

    dx: Floats  # (n,) direction in plan, unit length, map frame
    dy: Floats
    slope: Floats  # (n,) height gained per metre in plan
    way: Floats  # (n,) m in plan, to the nearest thing
    surface: NDArray[np.int8]  # (n,) what it is
    along: Floats  # (n,) m, position on a wall
    nx: Floats  # (n,) horizontal part of its normal, 0 for floor, ceiling and lids
    ny: Floats
    colours: dict[int, Colour]  # of the painted surfaces

    def put(
        self,
        part: slice,
        seen: NDArray[np.bool_],
        way: Floats,
        surface: int,
        along: Floats,
        nx: Floats | float,
        ny: Floats | float,
    ) -> None:
        """Set the hits of a slice's rays, where `seen` is true, to a new object."""
        self.way[part] = np.where(seen, way, self.way[part])
        self.surface[part][seen] = surface
        self.along[part] = np.where(seen, along, self.along[part])
        self.nx[part] = np.where(seen, nx, self.nx[part])
        self.ny[part] = np.where(seen, ny, self.ny[part])


def shade(hits: Hits, eye: Array, lamps: Array) -> Floats:
    """Return the colour of every ray, (n, 3) red, green, blue in 0..255."""
    way = np.minimum(hits.way, np.float32(100))  # an open door: the floor goes on, but not for ever
    x, y = np.float32(eye[0]) + way * hits.dx, np.float32(eye[1]) + way * hits.dy
    z = np.float32(eye[2]) + way * hits.slope
    light = _light(hits, x, y, z, lamps)
    palette: dict[int, Colour] = {**COLOUR, **hits.colours}
    table = np.array([palette.get(i, (0, 0, 0)) for i in range(max(palette) + 1)], np.float32)
    rgb = table[hits.surface]
    rgb *= (light * _texture(hits, x, y, z))[:, None]
    return rgb


def _light(hits: Hits, x: Floats, y: Floats, z: Floats, lamps: Array) -> Floats:
    flat = (hits.nx == 0) & (hits.ny == 0)
    up = np.where(hits.surface == Surface.CEILING, np.float32(-1), np.float32(1))
    nz = np.where(flat, up, np.float32(0))
    light = np.full_like(x, AMBIENT)
    for lamp in lamps.astype(np.float32):
        lx, ly, lz = lamp[0] - x, lamp[1] - y, lamp[2] - z
        square = lx * lx + ly * ly + lz * lz + np.float32(0.3)
        facing = np.maximum(lx * hits.nx + ly * hits.ny + lz * nz, 0)
        light += np.float32(LAMP) * facing / (square * np.sqrt(square))
    return light


def _texture(hits: Hits, x: Floats, y: Floats, z: Floats) -> Floats:
    """Return the relative brightness of the material at each point."""
    texture = np.ones_like(x)
    for surface, pattern in ((Surface.FLOOR, _tiles), (Surface.WALL, _cement), (Surface.PLATE, _planks)):
        on = np.flatnonzero(hits.surface == surface)
        texture[on] = pattern(x[on], y[on]) if surface == Surface.FLOOR else pattern(hits.along[on], z[on])
    return texture


def _tiles(x: Floats, y: Floats) -> Floats:
    odd = (np.floor(x * 2) + np.floor(y * 2)) % 2
    return np.asarray(np.float32(0.94) + np.float32(0.10) * odd)


def _cement(along: Floats, z: Floats) -> Floats:
    stains = np.float32(0.05) * np.sin(along * 3.1 + 2 * np.sin(z * 2.3)) * np.sin(z * 4.7 + along * 1.3)
    skirting = np.where(z < 0.12, np.float32(-0.35), np.float32(0))
    return np.asarray(np.float32(1) + stains + skirting)


def _planks(along: Floats, z: Floats) -> Floats:
    plank = np.floor(along / np.float32(0.2))
    tone = np.float32(0.08) * np.sin(plank * 12.9)
    grain = np.float32(0.05) * np.sin(along * 90 + 3 * np.sin(z * 5 + plank))
    joint = np.where(along % np.float32(0.2) < 0.012, np.float32(-0.4), np.float32(0))
    return np.asarray(np.float32(1) + tone + grain + joint)
