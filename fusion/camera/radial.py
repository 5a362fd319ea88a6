"""The fast landmark detection: a vertical line is a radial line in the raw picture, so nothing is unwrapped.

Red pixels inside the mirror are few, and only those get an angle (`core.red`). The bearing is that of `panorama`
(tests/camera/test_panorama.py holds the two together).
"""

from __future__ import annotations

import threading
from functools import lru_cache
from typing import Any

import numpy as np

from locfuse.fusion.core import red as core
from locfuse.fusion.core import tables
from locfuse.fusion.core.room import Room

from .opencv import cv2
from .optics import Optics
from .panorama import Candidate, Picture, Red, largest, red_excess, room_for_planes, variance

MAX_GAP_PX = 2.0  # px: red pixels further apart than this, along the circle, belong to two things
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
    seen = excess, r, _least(red.ratio), at, *mirror.shape, columns.start, rows.start
    found = _things(seen, len(at), picture.shape, optics, red)
    return largest([_candidate(*thing) for thing in found], red)


def _things(
    seen: tuple[Any, ...], n: int, shape: tuple[int, ...], optics: Optics, red: Red
) -> list[tuple[float, ...]]:
    """Return what n pixels of a picture (h, w, 3) show, as `core.red` has it; `seen` is the window's beginning."""
    (h, w), x, y = shape[:2], optics.x_c, optics.y_c
    cut = optics.outer > min(x, y, w - 1 - x, h - 1 - y)
    numbers, wholes, out = np.empty((3, n)), np.empty((3, n), np.intp), np.empty((n, core.MEASURED))
    room = *numbers, *wholes, np.empty(int(optics.outer) + 2, np.intp)
    window = Room.here(tables).on_arrays.Window(*seen, x, y, w, h, cut, red.length, MAX_GAP_PX, *room)
    things: list[tuple[float, ...]] = out[: Room.here(core).on_arrays.things(window, n, out)].tolist()
    return things


def _candidate(theta: float, pixels: float, length: float, width: float, radius: float) -> Candidate:
    return Candidate(theta, variance(theta, radius, length, width), pixels, length, width, radius)


@lru_cache(maxsize=4)
def _least(ratio: float) -> Picture:
    """Return what excess is enough for every level of red, (256,)."""
    return np.asarray(cv2.convertScaleAbs(np.arange(256, dtype=np.uint8), alpha=ratio), np.uint8).ravel()
