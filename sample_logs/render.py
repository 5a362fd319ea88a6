"""Ray tracing from one point in the room: the nearest of floor, ceiling, walls, plates and cylinders.

Rays come sorted by azimuth, so that whatever spans an angle touches one slice of them; inside the slice
every ray is intersected exactly.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from locfuse.fusion.data import Array

from .mirror import Rays
from .surface import Hits, Surface
from .table import Pillar

Floats = NDArray[np.float32]
NEAR = 0.01  # m: what is nearer is the camera itself
NO_RINGS = np.zeros((0, 3))
MARGIN = 1e-3  # rad, by which a slice is wider than the thing it holds


class Standing(NamedTuple):
    """Vertical rectangles of one material."""

    segments: Array  # (m, 4) x1, y1, x2, y2 [m]
    height: float
    surface: Surface


class View:
    """Traces a fixed bundle of rays through one scene after another."""

    def __init__(self, rays: Rays) -> None:
        self.rays = rays
        self.cos, self.sin = (f(rays.azimuth).astype(np.float32) for f in (np.cos, np.sin))
        self.slope = rays.slope.astype(np.float32)

    def trace(
        self,
        eye: Array,
        standing: list[Standing],
        pillars: tuple[Pillar, ...],
        ceiling: float,
        rings: Array = NO_RINGS,
    ) -> Hits:
        """Return the first hit of every ray from `eye` = (x, y, z, heading), and its place.

        `rings` (l, 3) are round walls up to the ceiling: x, y, radius [m], seen from inside.
        """
        hits = self._empty_room(eye, ceiling)
        for ring in rings:
            self._ring(hits, eye, ring, ceiling)
        for kind in standing:
            for segment in kind.segments:
                self._wall(hits, eye, segment, kind)
        for pillar in pillars:
            self._cylinder(hits, eye, pillar)
        return hits

    def _empty_room(self, eye: Array, ceiling: float) -> Hits:
        c, s = float(np.cos(eye[3])), float(np.sin(eye[3]))
        down = self.slope < 0
        with np.errstate(divide="ignore"):
            way = np.where(down, -eye[2] / self.slope, (ceiling - eye[2]) / self.slope)
        along, nx, ny = np.zeros((3, len(way)), np.float32)
        return Hits(
            dx=c * self.cos - s * self.sin,
            dy=s * self.cos + c * self.sin,
            slope=self.slope,
            way=way.astype(np.float32),
            surface=np.where(down, Surface.FLOOR, Surface.CEILING).astype(np.int8),
            along=along,
            nx=nx,
            ny=ny,
            colours={},
        )

    def _wall(self, hits: Hits, eye: Array, segment: Array, kind: Standing) -> None:
        ends = segment.reshape(2, 2) - eye[:2]
        along = ends[1] - ends[0]
        length = float(np.hypot(*along))
        ux, uy = (along / length).tolist()
        gap = float(ends[0] @ (uy, -ux))  # m, from the eye to the wall's line along its normal
        if abs(gap) < NEAR:
            return  # seen edge-on
        begin, z = float(ends[0] @ (ux, uy)), float(eye[2])
        facing = -1.0 if gap > 0 else 1.0  # turns the normal towards the eye
        for part in self._slices(ends, float(eye[3])):
            dx, dy = hits.dx[part], hits.dy[part]
            with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
                way = gap / (dx * uy - dy * ux)
                at = way * (dx * ux + dy * uy) - begin
                seen = (way > NEAR) & (way < hits.way[part]) & (at >= 0) & (at <= length)
                seen &= z + way * hits.slope[part] <= kind.height
            hits.put(part, seen, way, kind.surface, at, facing * uy, -facing * ux)

    def _ring(self, hits: Hits, eye: Array, ring: Array, height: float) -> None:
        x, y, radius = (ring - (eye[0], eye[1], 0.0)).tolist()  # centre as seen from the eye
        power = radius**2 - x * x - y * y
        if power <= 0:
            return  # the camera is outside
        ahead = hits.dx * x + hits.dy * y
        way = (ahead + np.sqrt(power + ahead**2)).astype(np.float32)
        out_x, out_y = way * hits.dx - x, way * hits.dy - y  # from the centre to where the ray ends
        seen = (way < hits.way) & (float(eye[2]) + way * hits.slope <= height)
        along = np.float32(radius) * np.arctan2(out_y, out_x)
        hits.put(slice(None), seen, way, Surface.WALL, along, -out_x / radius, -out_y / radius)

    def _cylinder(self, hits: Hits, eye: Array, pillar: Pillar) -> None:
        x, y = pillar.x - float(eye[0]), pillar.y - float(eye[1])
        distance = float(np.hypot(x, y))
        if distance <= pillar.radius + NEAR:
            return  # the camera is inside
        surface = Surface.PAINTED + len(hits.colours)
        hits.colours[surface] = pillar.colour
        half, middle = np.arcsin(pillar.radius / distance), np.arctan2(y, x)
        rim = np.array([[np.cos(middle + a), np.sin(middle + a)] for a in (-half, half)])
        for part in self._slices(rim, float(eye[3])):
            dx, dy = hits.dx[part], hits.dy[part]
            ahead = dx * x + dy * y
            square = pillar.radius**2 - (dx * y - dy * x) ** 2
            chord = np.sqrt(np.maximum(square, 0))
            way, lid = _side_or_lid(float(eye[2]), hits.slope[part], ahead - chord, ahead + chord, pillar)
            seen = (square > 0) & (way > NEAR) & (way < hits.way[part])
            outward = np.where(lid, np.float32(0), np.float32(1 / pillar.radius))
            nx, ny = (way * dx - x) * outward, (way * dy - y) * outward
            hits.put(part, seen, way, surface, np.zeros_like(way), nx, ny)

    def _slices(self, ends: Array, heading: float) -> Iterator[slice]:
        """Yield the slices of rays between two directions (2, 2) less than half a turn apart."""
        a, b = np.arctan2(ends[:, 1], ends[:, 0]) - heading
        span = (b - a + np.pi) % (2 * np.pi) - np.pi
        first = (min(a, a + span) - MARGIN + np.pi) % (2 * np.pi) - np.pi
        last = first + abs(span) + 2 * MARGIN
        i, j = np.searchsorted(self.rays.azimuth, (first, last))
        yield slice(int(i), int(j))
        if last > np.pi:
            yield slice(0, int(np.searchsorted(self.rays.azimuth, last - 2 * np.pi)))


def _side_or_lid(
    eye_z: float, slope: Floats, way_in: Floats, way_out: Floats, pillar: Pillar
) -> tuple[Floats, NDArray[np.bool_]]:
    """Return the distance of a cylinder's side or lid along a ray (inf: no hit), and whether it is a lid."""
    z_in, z_out = eye_z + way_in * slope, eye_z + way_out * slope
    side = (z_in >= pillar.bottom) & (z_in <= pillar.top)
    top = ~side & (z_in > pillar.top) & (z_out < pillar.top)
    bottom = ~side & (z_in < pillar.bottom) & (z_out > pillar.bottom)
    with np.errstate(divide="ignore", invalid="ignore"):
        lid = np.where(top, pillar.top - eye_z, pillar.bottom - eye_z) / slope
    way = np.where(side, way_in, np.where(top | bottom, lid, np.inf))
    return way.astype(np.float32), top | bottom
