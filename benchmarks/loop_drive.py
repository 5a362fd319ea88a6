"""A robot that drives rounded rectangles in a room with plates on its walls, in closed form and vectorised."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

WIDTH, HEIGHT = 10.0, 8.0  # m, the room
PLATE = 0.8  # m, how far a plate stands out from its wall
MARGIN = 2.0  # m between the way and the walls
CORNER = 0.8  # m, the way's corner radius
LANDMARK = (5.0, 4.0)  # m: in the middle, the laser does not see it


@dataclass(frozen=True)
class Loop:
    """Where the robot is at any time: constant speed along a rounded rectangle, counter-clockwise."""

    speed: float = 0.4  # m/s

    @property
    def pieces(self) -> tuple[Array, Array]:
        """Lengths [m] and curvatures [1/m] of the eight pieces of a lap: straight, arc, straight, arc..."""
        long, short = WIDTH - 2 * (MARGIN + CORNER), HEIGHT - 2 * (MARGIN + CORNER)
        arc = CORNER * math.pi / 2
        return np.array([long, arc, short, arc] * 2), np.array([0.0, 1.0 / CORNER] * 4)

    def way(self, t: Array) -> Array:
        """Return the way driven by t (...,) [s], [m]."""
        return self.speed * t

    def pose(self, t: Array) -> Array:
        """Return the pose (..., 3) at t (...,) [s]; the heading counts whole turns."""
        length, curvature = self.pieces
        ends = np.cumsum(length)
        lap, s = np.divmod(self.way(t), ends[-1])
        piece = np.minimum(np.searchsorted(ends, s, side="right"), 7)
        ds = s - (ends - length)[piece]
        corner = self._corners()[piece]
        turn = curvature[piece] * ds
        chord = ds * np.sinc(turn / (2 * np.pi))
        heading = corner[..., 2] + turn / 2
        x, y = corner[..., 0] + chord * np.cos(heading), corner[..., 1] + chord * np.sin(heading)
        return np.stack((x, y, corner[..., 2] + turn + 2 * np.pi * lap), axis=-1)

    def _corners(self) -> Array:
        poses = [np.array([MARGIN + CORNER, MARGIN, 0.0])]
        for length, curvature in zip(*self.pieces, strict=True):
            heading = poses[-1][2]
            turn = curvature * length
            chord = length * np.sinc(turn / (2 * np.pi))
            step = [chord * np.cos(heading + turn / 2), chord * np.sin(heading + turn / 2), turn]
            poses.append(poses[-1] + step)
        return np.array(poses[:8])


def walls(count: int) -> Array:
    """Return the room's four walls and count - 4 plates on them, (count, 4) x0, y0, x1, y1 [m]."""
    corners = np.array([(0, 0), (WIDTH, 0), (WIDTH, HEIGHT), (0, HEIGHT), (0, 0)], float)
    room = np.concatenate((corners[:-1], corners[1:]), axis=1)
    plates = []
    for s in (np.arange(count - 4) + 0.6) / max(count - 4, 1) * 2 * (WIDTH + HEIGHT):
        side = int(np.searchsorted(np.cumsum([WIDTH, HEIGHT, WIDTH, HEIGHT]), s))
        along = (corners[side + 1] - corners[side]) / np.linalg.norm(corners[side + 1] - corners[side])
        foot = corners[side] + along * (s - (0.0, WIDTH, WIDTH + HEIGHT, 2 * WIDTH + HEIGHT)[side])
        plates.append([*foot, *(foot + PLATE * np.array([-along[1], along[0]]))])
    return np.concatenate((room, np.array(plates).reshape(-1, 4)))


def ranges(segments: Array, poses: Array, angles: Array) -> Array:
    """Return how far the beams go, (n, b) m: from poses (n, 3) or (n, b, 3) along angles (b,) or (n, b)."""
    pose = poses if poses.ndim == 3 else poses[:, None]
    x, y = pose[..., 0], pose[..., 1]
    c, s = np.cos(pose[..., 2] + angles), np.sin(pose[..., 2] + angles)
    nearest = np.full(c.shape, np.inf)
    for x0, y0, x1, y1 in segments:
        dx, dy = x1 - x0, y1 - y0
        with np.errstate(divide="ignore", invalid="ignore"):
            inverse = 1.0 / (c * dy - s * dx)
            distance = ((x0 - x) * dy - (y0 - y) * dx) * inverse
            share = ((x0 - x) * s - (y0 - y) * c) * inverse
        hit = (distance > 0) & (share >= 0) & (share <= 1) & (distance < nearest)
        nearest[hit] = distance[hit]
    return nearest


class OmniView:
    """Draws what an omni-directional camera sees of a red post on a grey floor."""

    def __init__(self, size: tuple[int, int], rng: np.random.Generator) -> None:
        width, height = size
        self.centre = (width / 2, height / 2)
        self.outer = 0.48 * min(size)
        self.inner = 0.25 * self.outer
        grey = np.clip(rng.normal(120.0, 20.0, (height, width)), 0, 255).astype(np.uint8)
        self.background = cv2.cvtColor(cv2.GaussianBlur(grey, (0, 0), 0.8), cv2.COLOR_GRAY2BGR)

    def jpeg(self, pose: Array) -> bytes:
        """Return the picture from a pose (3,): a red radial bar towards the landmark; straight down is ahead."""
        dx, dy = LANDMARK[0] - pose[0], LANDMARK[1] - pose[1]
        bearing, half = math.atan2(dy, dx) - pose[2], 0.06 / math.hypot(dx, dy)
        picture = self.background.copy()
        bar = [
            (self.centre[0] + r * math.sin(bearing + a), self.centre[1] + r * math.cos(bearing + a))
            for r, a in ((0.4, half), (0.9, half), (0.9, -half), (0.4, -half))
            for r in (r * self.outer,)
        ]
        points = np.round(np.array(bar) * 16).astype(np.int32)
        cv2.fillPoly(picture, [points], (30, 30, 200), lineType=cv2.LINE_AA, shift=4)
        return bytes(cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, 85])[1])
