"""Omni-directional camera: pictures of the room in a hyperbolic mirror, as JPEG with noise and blur.

The mirror is the sheet Z > 0 of Z^2/b^2 - rho^2/a^2 = 1 with its hollow side down; its foci are at +c and -c,
c^2 = a^2 + b^2. The camera's pinhole is at -c and looks up. A ray towards +c is reflected to -c, so all rays of
the picture pass through the focus +c: their azimuths do not change, only their elevations.

The room is rendered by ray tracing: nearest floor, ceiling, wall, plate or cylinder, with lighting. Rays are
sorted by azimuth, so that only one slice of rays can hit an object. Each ray of the slice is intersected exactly.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from locfuse.fusion.data import Array, Ints, Mask
from locfuse.fusion.se2 import wrap_all

from .robot import SimulatedRobot
from .scenario import CameraSpec
from .table import Colour, Pillar
from .world import World

Floats = NDArray[np.float32]

AMBIENT_LIGHT = 0.6  # light without direction
LAMP_LIGHT_M2 = 4.0  # m^2: brightness of one lamp, times cosine over squared distance
MIN_DISTANCE_M = 0.01  # m: a nearer hit is the camera itself
SLICE_MARGIN_RAD = 1e-3  # rad, by which a slice is wider than its object


class Surface(IntEnum):
    """Kind of surface that a ray hits; cylinder k has the number PAINTED + k."""

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
    """Nearest hit of each ray: distance, surface, position and normal."""

    dx: Floats  # (n,) direction in plan, unit length, map frame
    dy: Floats
    slope: Floats  # (n,) height gained per metre in plan
    way: Floats  # (n,) m in plan, distance of the hit
    surface: NDArray[np.int8]  # (n,) kind of surface
    along: Floats  # (n,) m, position on a wall
    nx: Floats  # (n,) horizontal part of the surface normal, 0 for floor, ceiling and lids
    ny: Floats
    colours: dict[int, Colour]  # of the painted surfaces

    def put(
        self,
        part: slice,
        seen: Mask,
        way: Floats,
        surface: int,
        along: Floats,
        nx: Floats | float,
        ny: Floats | float,
    ) -> None:
        """Replace the hits of rays in a slice where `seen` is true."""
        self.way[part] = np.where(seen, way, self.way[part])
        self.surface[part][seen] = surface
        self.along[part] = np.where(seen, along, self.along[part])
        self.nx[part] = np.where(seen, nx, self.nx[part])
        self.ny[part] = np.where(seen, ny, self.ny[part])


def shade(hits: Hits, eye: Array, lamps: Array) -> Floats:
    """Return the colour of each ray, (n, 3) red, green, blue in 0..255."""
    way = np.minimum(hits.way, np.float32(100))  # 100 m: limit for rays that leave through an open door
    x, y = np.float32(eye[0]) + way * hits.dx, np.float32(eye[1]) + way * hits.dy
    z = np.float32(eye[2]) + way * hits.slope
    flat = (hits.nx == 0) & (hits.ny == 0)
    up = np.where(hits.surface == Surface.CEILING, np.float32(-1), np.float32(1))
    nz = np.where(flat, up, np.float32(0))
    light = np.full_like(x, AMBIENT_LIGHT)
    for lamp in lamps.astype(np.float32):
        lx, ly, lz = lamp[0] - x, lamp[1] - y, lamp[2] - z
        square = lx * lx + ly * ly + lz * lz + np.float32(0.3)
        facing = np.maximum(lx * hits.nx + ly * hits.ny + lz * nz, 0)
        light += np.float32(LAMP_LIGHT_M2) * facing / (square * np.sqrt(square))
    palette: dict[int, Colour] = {**COLOUR, **hits.colours}
    table = np.array([palette.get(i, (0, 0, 0)) for i in range(max(palette) + 1)], np.float32)
    rgb = table[hits.surface]
    rgb *= (light * _texture(hits, x, y, z))[:, None]
    return rgb


def _texture(hits: Hits, x: Floats, y: Floats, z: Floats) -> Floats:
    """Return the relative brightness of the surface pattern at each hit."""
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


def _side_or_lid(
    eye_z: float, slope: Floats, way_in: Floats, way_out: Floats, pillar: Pillar
) -> tuple[Floats, Mask]:
    """Return the distances at which rays hit a cylinder's side or lid (inf for none), and whether it is a lid."""
    z_in, z_out = eye_z + way_in * slope, eye_z + way_out * slope
    side = (z_in >= pillar.bottom) & (z_in <= pillar.top)
    top = ~side & (z_in > pillar.top) & (z_out < pillar.top)
    bottom = ~side & (z_in < pillar.bottom) & (z_out > pillar.bottom)
    with np.errstate(divide="ignore", invalid="ignore"):
        lid = np.where(top, pillar.top - eye_z, pillar.bottom - eye_z) / slope
    way = np.where(side, way_in, np.where(top | bottom, lid, np.inf))
    return way.astype(np.float32), top | bottom


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


DECK = (38.0, 38.0, 40.0)  # colour of the robot in the middle of the mirror
BLACK = (6.0, 6.0, 6.0)  # colour around the mirror
FLICKER_SHARE = 0.02  # relative standard deviation of the exposure from image to image


class OmniCamera:
    """Omni-directional camera sensor: takes pictures at the robot's true pose."""

    name, topic, msgtype = "camera", "/omni/image/compressed", "sensor_msgs/msg/CompressedImage"
    frame_id = "omni_camera"
    duration = 0.0

    def __init__(self, camera: CameraSpec, scene: World, robot: SimulatedRobot, rng: np.random.Generator) -> None:
        self.settings, self.scene, self.robot, self.rng = camera, scene, robot, rng
        self.period, self.phase, self.latency = 1 / camera.rate, camera.phase, camera.latency
        self.mount = np.array([camera.x, camera.y, np.radians(camera.yaw_deg)])
        self.painter = Painter(camera, scene)

    def read(self, t: float) -> dict[str, Any]:
        """Return the message fields of a JPEG picture taken at t [s]."""
        pose = self.robot.sensor_pose("camera", np.array([t]), self.mount)[0]
        image = expose(self.painter.paint(pose, t), self.settings, self.rng)
        quality = [cv2.IMWRITE_JPEG_QUALITY, self.settings.quality]
        _, jpeg = cv2.imencode(".jpg", image, quality)
        return {"format": "jpeg", "data": jpeg.tobytes()}


class Painter:
    """Renderer of pictures without lens and sensor errors, by tracing one bundle of rays in the room."""

    def __init__(self, camera: CameraSpec, scene: World) -> None:
        self.camera, self.scene = camera, scene
        self.rays = rays(camera)
        self.cos, self.sin = (f(self.rays.azimuth).astype(np.float32) for f in (np.cos, np.sin))
        self.slope = self.rays.slope.astype(np.float32)
        w, h = scene.room.size
        lamp = scene.room.height - 0.1
        self.lamps = np.array([(w / 4, h / 2, lamp), (3 * w / 4, h / 2, lamp)])
        width, height = camera.size
        v, u = np.mgrid[:height, :width]
        radius = np.hypot(u - camera.centre[0], v - camera.centre[1])
        self.background = np.where((radius < camera.inner)[..., None], DECK, BLACK).astype(np.float32)

    def paint(self, pose: Array, t: float) -> NDArray[np.float32]:
        """Return the picture (height, width, 3), RGB, seen from the camera pose (3,) at t [s]."""
        eye = np.array([pose[0], pose[1], self.camera.z, pose[2]])
        seen = shade(self.trace(eye, t), eye, self.lamps)
        image = self.background.copy()
        image.reshape(-1, 3)[self.rays.pixel] = seen
        return image

    def trace(self, eye: Array, t: float) -> Hits:
        """Return the first hits of the pixels' rays from `eye` = (x, y, z, heading) at t [s]."""
        room, scene = self.scene.room, self.scene
        c, s = float(np.cos(eye[3])), float(np.sin(eye[3]))
        down = self.slope < 0
        with np.errstate(divide="ignore"):
            way = np.where(down, -eye[2] / self.slope, (room.height - eye[2]) / self.slope).astype(np.float32)
        surface = np.where(down, Surface.FLOOR, Surface.CEILING).astype(np.int8)
        dx, dy = c * self.cos - s * self.sin, s * self.cos + c * self.sin
        along, nx, ny = np.zeros((3, len(way)), np.float32)
        hits = Hits(dx, dy, self.slope, way, surface, along, nx, ny, {})
        for ring in scene.rings:
            self._ring(hits, eye, ring, room.height)
        for segment in scene.walls:
            self._wall(hits, eye, segment, room.height, Surface.WALL)
        for segment in scene.plates:
            self._wall(hits, eye, segment, room.plate_height, Surface.PLATE)
        for pillar in scene.pillars(t):
            self._cylinder(hits, eye, pillar)
        return hits

    def _wall(self, hits: Hits, eye: Array, segment: Array, height: float, surface: Surface) -> None:
        ends = segment.reshape(2, 2) - eye[:2]
        along = ends[1] - ends[0]
        length = float(np.hypot(*along))
        ux, uy = (along / length).tolist()
        gap = float(ends[0] @ (uy, -ux))  # m, from the eye to the wall's line along its normal
        if abs(gap) < MIN_DISTANCE_M:
            return  # seen edge-on
        begin, z = float(ends[0] @ (ux, uy)), float(eye[2])
        facing = -1.0 if gap > 0 else 1.0  # turns the normal towards the eye
        for part in self._slices(ends, float(eye[3])):
            dx, dy = hits.dx[part], hits.dy[part]
            with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
                way = gap / (dx * uy - dy * ux)
                at = way * (dx * ux + dy * uy) - begin
                seen = (way > MIN_DISTANCE_M) & (way < hits.way[part]) & (at >= 0) & (at <= length)
                seen &= z + way * hits.slope[part] <= height
            hits.put(part, seen, way, surface, at, facing * uy, -facing * ux)

    def _ring(self, hits: Hits, eye: Array, ring: Array, height: float) -> None:
        x, y, radius = (ring - (eye[0], eye[1], 0.0)).tolist()  # centre relative to the eye
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
        if distance <= pillar.radius + MIN_DISTANCE_M:
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
            seen = (square > 0) & (way > MIN_DISTANCE_M) & (way < hits.way[part])
            outward = np.where(lid, np.float32(0), np.float32(1 / pillar.radius))
            nx, ny = (way * dx - x) * outward, (way * dy - y) * outward
            hits.put(part, seen, way, surface, np.zeros_like(way), nx, ny)

    def _slices(self, ends: Array, heading: float) -> Iterator[slice]:
        """Yield the slices of rays with azimuths between two directions `ends` (2, 2)."""
        a, b = np.arctan2(ends[:, 1], ends[:, 0]) - heading
        span = (b - a + np.pi) % (2 * np.pi) - np.pi
        first = (min(a, a + span) - SLICE_MARGIN_RAD + np.pi) % (2 * np.pi) - np.pi
        last = first + abs(span) + 2 * SLICE_MARGIN_RAD
        i, j = np.searchsorted(self.rays.azimuth, (first, last))
        yield slice(int(i), int(j))
        if last > np.pi:
            yield slice(0, int(np.searchsorted(self.rays.azimuth, last - 2 * np.pi)))


def expose(light: NDArray[np.float32], camera: CameraSpec, rng: np.random.Generator) -> NDArray[np.uint8]:
    """Return the picture (height, width, 3), BGR, with exposure error, blur and noise."""
    gain = camera.brightness * (1 + FLICKER_SHARE * rng.standard_normal())
    image = np.multiply(cv2.cvtColor(light, cv2.COLOR_RGB2BGR), gain, dtype=np.float32)
    if camera.blur > 0:
        cv2.GaussianBlur(image, (0, 0), camera.blur, dst=image)
    image += np.float32(camera.noise) * rng.standard_normal(image.shape, np.float32)
    return np.asarray(np.clip(image, 0, 255), np.uint8)
