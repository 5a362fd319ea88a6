"""The fast landmark detection: a vertical line is a radial line in the raw picture, so nothing is unwrapped.

Red pixels inside the mirror are few, and only those get an angle. The bearing is that of `panorama`
(tests/camera/test_panorama.py holds the two together).
"""

from __future__ import annotations

import threading
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from locfuse.fusion.data import Array
from locfuse.fusion.se2 import TAU

from .opencv import cv2
from .optics import Optics
from .panorama import Candidate, Picture, Red, cap, largest, red_excess, red_share, room_for_planes, variance

MAX_GAP_PX = 2.0  # px: red pixels further apart than this, along the circle, belong to two things
MAX_CLUSTERS = 32  # clusters looked at in one picture, the largest first: noise can make thousands
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


def red_pixels(picture: Picture, optics: Optics, red: Red) -> NDArray[np.int64]:
    """Return the red pixels inside the mirror, lone ones left out: columns x, y, and how red, (3, n)."""
    rows, columns, mirror = _window(*picture.shape[:2], optics)
    if mirror.size == 0:
        return np.empty((3, 0), np.int64)
    excess, r = red_excess(picture[rows, columns], red, _planes(mirror.shape))
    cv2.bitwise_and(excess, mirror, dst=excess)
    x, y, w, h = cv2.boundingRect(excess)
    left, top = max(0, x - 1), max(0, y - 1)  # the noise filter sees one pixel more
    part = np.s_[top : y + h + 1, left : x + w + 1]
    if w == 0:
        return np.empty((3, 0), np.int64)
    grey = red_share(excess[part], r[part], red)
    found = cv2.findNonZero(cv2.min(grey, cv2.medianBlur(grey, 3)))
    if found is None:
        return np.empty((3, 0), np.int64)
    i, j = np.asarray(found, np.int64).reshape(-1, 2).T
    return np.stack((i + (left + columns.start), j + (top + rows.start), grey[j, i]))


def candidates(picture: Picture, optics: Optics, red: Red) -> list[Candidate]:
    """Return the vertical red things of a BGR picture, the largest first."""
    x, y, level = red_pixels(picture, optics, red)
    if len(x) < red.length:
        return []
    dx, dy = x - optics.x_c, y - optics.y_c
    r, theta = np.hypot(dx, dy), np.arctan2(dx, dy)
    parts = _clusters(theta, r, red.length)
    h, w = picture.shape[:2]
    if optics.outer > min(optics.x_c, optics.y_c, w - 1 - optics.x_c, h - 1 - optics.y_c):
        edge = (x == 0) | (y == 0) | (x == w - 1) | (y == h - 1)
        parts = [_whole_circles(part, r, edge) for part in parts]
    return largest([_measured(_unwrapped(theta[i]), r[i], level[i]) for i in parts if len(i)], red)


def _clusters(theta: Array, r: Array, least: float) -> list[NDArray[np.int64]]:
    """Return the pixels of each thing: neighbours along the circle at most MAX_GAP_PX apart, column 0 included."""
    order = np.argsort(theta, kind="stable")
    t, twice = theta[order], 2.0 * r[order]
    apart = (t[1:] - t[:-1]) * (twice[1:] + twice[:-1])  # four times the arc [px]
    parts = np.split(order, np.flatnonzero(apart > 4.0 * MAX_GAP_PX) + 1)
    if len(parts) > 1 and (t[0] + TAU - t[-1]) * (twice[0] + twice[-1]) <= 4.0 * MAX_GAP_PX:
        parts[0] = np.concatenate((parts.pop(), parts[0]))
    return sorted((part for part in parts if len(part) >= least), key=len, reverse=True)[:MAX_CLUSTERS]


def _whole_circles(part: NDArray[np.int64], r: Array, edge: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return the pixels of a thing on circles that the picture's border, which cuts slantwise, leaves whole."""
    cut = r[part[edge[part]]]
    return part[r[part] < cut.min() - 1.0] if len(cut) else part


def _unwrapped(theta: Array) -> Array:
    """Return the angles (n,) of one thing, which begins at theta[0], without a jump where theta passes pi."""
    return theta if theta[0] <= theta[-1] else np.where(theta < theta[0], theta + TAU, theta)


def _measured(theta: Array, r: Array, level: NDArray[np.int64]) -> Candidate:
    """Return the candidate made of these pixels (n,); its middle is their centre of weight."""
    weight = np.minimum(level, cap(level))
    middle = float(weight @ theta / weight.sum()) % TAU
    near, far = float(r.min()), float(r.max())
    rings = np.bincount((r - near).astype(np.int64))
    length, radius = float(np.count_nonzero(rings)), 0.5 * (near + far)
    width = len(r) / (length * radius)
    return Candidate(middle, variance(middle, radius, length, width), float(len(r)), length, width, radius)
