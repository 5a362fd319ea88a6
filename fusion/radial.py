"""The fast landmark detection: a vertical line is a radial line in the raw picture, so nothing is unwrapped.

Red pixels inside the mirror are few, and only those get an angle. The bearing is that of `panorama`
(tests/test_panorama.py holds the two together).
"""

from __future__ import annotations

import threading
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from .cv import cv2
from .data import Array
from .optics import Optics
from .panorama import Candidate, Picture, Red, cap, largest, red_grey, variance
from .se2 import TAU

GAP = 2.0  # px: red pixels further apart than this, along the circle, belong to two things
CLUSTERS = 32  # clusters looked at in one picture, the largest first: noise can make thousands
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


def _planes(shape: tuple[int, ...]) -> Picture:
    """Return this thread's room (3, h, w) for the planes of a picture."""
    planes: Picture | None = getattr(_ROOM, "planes", None)
    if planes is None or planes.shape[1:] != shape:
        planes = _ROOM.planes = np.empty((3, *shape), np.uint8)
    return planes


def red_pixels(picture: Picture, optics: Optics, red: Red) -> tuple[NDArray[np.int64], Array]:
    """Return the red pixels (n, 2) x, y inside the mirror, lone ones left out, and how red each is (n,)."""
    rows, columns, mirror = _window(*picture.shape[:2], optics)
    if mirror.size == 0:
        return np.empty((0, 2), np.int64), np.empty(0)
    grey = red_grey(picture[rows, columns], red, _planes(mirror.shape))
    cv2.bitwise_and(grey, mirror, dst=grey)
    x, y, w, h = cv2.boundingRect(grey)
    left, top = max(0, x - 1), max(0, y - 1)  # the noise filter sees one pixel more
    part = grey[top : y + h + 1, left : x + w + 1]
    if w == 0:
        return np.empty((0, 2), np.int64), np.empty(0)
    found = cv2.findNonZero(cv2.min(part, cv2.medianBlur(part, 3)))
    xy = np.empty((0, 2), np.int64) if found is None else np.asarray(found, np.int64).reshape(-1, 2)
    level = part[xy[:, 1], xy[:, 0]].astype(float)
    return xy + np.array((left + columns.start, top + rows.start)), level


def candidates(picture: Picture, optics: Optics, red: Red) -> list[Candidate]:
    """Return the vertical red things of a BGR picture, the largest first."""
    xy, level = red_pixels(picture, optics, red)
    x, y = xy[:, 0] - optics.x_c, xy[:, 1] - optics.y_c
    r, theta = np.hypot(x, y), np.arctan2(x, y)
    parts = _clusters(theta, r, red.length)
    h, w = picture.shape[:2]
    edge = (xy[:, 0] == 0) | (xy[:, 1] == 0) | (xy[:, 0] == w - 1) | (xy[:, 1] == h - 1)
    found = (_measured(_unwrapped(theta[i]), r[i], level[i], edge[i]) for i in parts)
    return largest([c for c in found if c is not None], red)


def _clusters(theta: Array, r: Array, least: float) -> list[NDArray[np.int64]]:
    """Return the pixels of each thing: neighbours along the circle less than GAP apart, column 0 included."""
    order = np.argsort(theta, kind="stable")
    if len(order) < max(least, 1):
        return []
    around = np.append(order, order[0])
    step = np.diff(theta[around])
    step[-1] += TAU
    ends = np.flatnonzero(step * 0.5 * (r[around[1:]] + r[around[:-1]]) > GAP) + 1
    if len(ends) == 0:
        return [order]
    turned = np.roll(order, -ends[-1])
    parts = np.split(turned, np.cumsum(np.diff(ends, prepend=ends[-1] - len(order)))[:-1])
    return sorted((p for p in parts if len(p) >= least), key=len, reverse=True)[:CLUSTERS]


def _unwrapped(theta: Array) -> Array:
    """Return the angles (n,) of one thing without a jump where theta passes pi."""
    return np.asarray(theta[0] + (theta - theta[0]) % TAU)


def _measured(theta: Array, r: Array, level: Array, edge: NDArray[np.bool_]) -> Candidate | None:
    """Return the candidate made of these pixels (n,); its middle is their centre of weight."""
    if edge.any():  # the picture's border cuts slantwise: keep the circles that are whole
        whole = r < r[edge].min() - 1.0
        theta, r, level = theta[whole], r[whole], level[whole]
    if len(r) == 0:
        return None
    weight = np.minimum(level, cap(level))
    middle = float(weight @ theta / weight.sum()) % TAU
    rings = np.bincount((r - r.min()).astype(np.int64))
    length = float((rings > 0).sum())
    radius = float(0.5 * (r.min() + r.max()))
    width = len(r) / (length * radius)
    return Candidate(middle, variance(middle, radius, length, width), float(len(r)), length, width, radius)
