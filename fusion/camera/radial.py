"""The fast landmark detection: a vertical line is a radial line in the raw picture, so nothing is unwrapped.

Red pixels inside the mirror are few, and only they get an angle (`kernels.red`). The bearing is that of `panorama`
(tests/camera/test_panorama.py holds the two together).
"""

from __future__ import annotations

import threading
from functools import lru_cache

import numpy as np

from locfuse.fusion.kernels import red as kernel
from locfuse.fusion.kernels.arrays import view

from .opencv import cv2
from .optics import Optics
from .panorama import Candidate, Picture, Red, largest, red_excess, room_for_planes, variance

_ROOM = threading.local()  # memory that one picture leaves for the next


@lru_cache(maxsize=4)
def _window(height: int, width: int, optics: Optics) -> tuple[slice, slice, Picture]:
    """Return the rows and columns that hold the mirror, and its mask (255 inside) there."""
    columns, rows = (
        slice(max(0, int(c - optics.outer)), max(0, min(size, int(c + optics.outer) + 2)))
        for c, size in ((optics.x_c, width), (optics.y_c, height))
    )
    y = np.arange(rows.start, rows.stop)[:, None] - optics.y_c
    x = np.arange(columns.start, columns.stop)[None, :] - optics.x_c
    square = x**2 + y**2
    inside = (square >= optics.inner**2) & (square <= optics.outer**2)
    return rows, columns, np.where(inside, np.uint8(255), np.uint8(0))


def _planes(shape: tuple[int, ...]) -> list[Picture]:
    """Return this thread's room for the three colour planes (h, w) of a picture."""
    planes: list[Picture] = getattr(_ROOM, "planes", [])
    if not planes or planes[0].shape != shape:
        planes = _ROOM.planes = room_for_planes(shape)
    return planes


def candidates(picture: Picture, optics: Optics, red: Red) -> list[Candidate]:
    """Return the vertical red things of a BGR picture, the largest first."""
    rows, columns, mirror = _window(*picture.shape[:2], optics)
    if mirror.size == 0:
        return []
    excess, r = red_excess(picture[rows, columns], red, _planes(mirror.shape))
    cv2.bitwise_and(excess, mirror, dst=excess)
    x, y, w, h = cv2.boundingRect(excess)
    points = cv2.findNonZero(excess[y : y + h, x : x + w]) if w else None
    if points is None or len(points) < red.length:
        return []
    at = np.asarray(points, np.int32).reshape(-1, 2)
    at += np.array((x, y), np.int32)
    window = kernel.Window(excess, r, _least(red.ratio), columns.start, rows.start)
    circle = kernel.Circle(optics.x_c, optics.y_c, picture.shape[1], picture.shape[0], optics.outer)
    pixels, out = kernel.Pixels(len(at), red.length, optics.outer), np.empty((len(at), kernel.THING_NUMBERS))
    found = kernel.find_things(window, circle, view(at, np.int32), pixels, view(out))
    return largest([_candidate(*thing) for thing in out[:found].tolist()], red)


def _candidate(theta: float, pixels: float, length: float, width: float, radius: float) -> Candidate:
    return Candidate(theta, variance(theta, radius, length, width), pixels, length, width, radius)


@lru_cache(maxsize=4)
def _least(ratio: float) -> Picture:
    """Return what excess is enough for every level of red, (256,)."""
    return np.asarray(cv2.convertScaleAbs(np.arange(256, dtype=np.uint8), alpha=ratio), np.uint8).ravel()
