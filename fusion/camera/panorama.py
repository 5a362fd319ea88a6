"""Landmark detection as in the paper (section II): filter, red, grey, unwrap, Hough lines, bearing.

This is slow; `detect.radial_candidates` finds the same bearing without unwrapping. The definitions for both (red
pixels, candidates) are here.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from locfuse.fusion.data import Array, Ints
from locfuse.fusion.se2 import TAU

from .opencv import cv2
from .optics import Optics, omni_1, paper_omni_1, picture_angle

Picture = NDArray[np.uint8]

EDGE_PX = 2.0  # px, resolution of an edge: a JPEG stores colour at half resolution
SHADE_SHARE = 0.02  # error of the centre by light from one side, as a share of the width
MAX_LEAN = 0.1  # largest slope of a "vertical" Hough line: px sideways per px of height
CACHE_LINE_BYTES = 64  # bytes of a cache line
MAX_CANDIDATES = 8  # candidates kept of one picture, the largest first


class Red(NamedTuple):
    """Conditions of a red landmark: on the colour of its pixels, and on the size of its radial line.

    A pixel is red if R - max(G, B) >= max(minimum, ratio R).
    """

    ratio: float = 0.4  # least (R - max(G, B)) / R
    minimum: float = 30.0  # grey levels; the colour of a pixel below is noise
    length: float = 12.0  # px, least length along the radius
    slender: float = 1.5  # least length / width

    def halved(self) -> Red:
        """Return these conditions for a picture scaled to half its width and height: half the least length."""
        return self._replace(length=self.length / 2.0)


class RedCandidate(NamedTuple):
    """Vertical red object in a picture."""

    theta: float  # rad, picture angle of the object's middle, [0, 2 pi)
    variance: float  # rad^2
    pixels: float  # area in the raw picture
    length: float  # px along the radius
    width: float  # rad
    radius: float  # px, radius of the object's middle

    def doubled(self) -> RedCandidate:
        """Return a candidate found in a half-size picture, in pixels of the full picture.

        Its edges have the resolution EDGE_PX in the full picture, since the colour has half resolution anyway.
        """
        length, radius = 2.0 * self.length, 2.0 * self.radius
        known = variance(self.theta, radius, length, self.width)
        return RedCandidate(self.theta, known, 4.0 * self.pixels, length, self.width, radius)


def red_grey(picture: Picture, red: Red) -> Picture:
    """Return the redness (h, w) of a BGR picture: R - max(G, B) for red pixels, else 0.

    On a grey background, R - max(G, B) is proportional to the part of a pixel that a red object covers, which
    gives sub-pixel accuracy. The condition on the ratio makes red independent of brightness.
    """
    excess, r = red_excess(picture, red, room_for_planes(picture.shape[:2]))
    return red_share(excess, r, red)


def red_excess(picture: Picture, red: Red, room: list[Picture]) -> tuple[Picture, Picture]:
    """Return (R - max(G, B), R) of a BGR picture, both (h, w); the first is 0 if it is below red.minimum.

    The results are in the buffers `room`: to allocate new memory would take several times as long as the
    arithmetic (benchmarks: "omni bearing").
    """
    b, g, r = room
    cv2.split(picture, room)
    cv2.subtract(r, cv2.max(b, g, dst=b), dst=b)
    cv2.threshold(b, max(red.minimum, 1.0) - 1.0, 0, cv2.THRESH_TOZERO, dst=b)
    return b, r


def red_share(excess: Picture, r: Picture, red: Red) -> Picture:
    """Return the excess R - max(G, B) (h, w) where it is at least `red.ratio` times R, else 0."""
    enough = cv2.compare(excess, cv2.convertScaleAbs(r, alpha=red.ratio), cv2.CMP_GE)
    return np.asarray(cv2.bitwise_and(excess, enough), np.uint8)


def room_for_planes(shape: tuple[int, ...]) -> list[Picture]:
    """Return three buffers (h, w) for the colour planes of a picture.

    They begin at different bytes of a cache line: cv2.split is ten times slower with equally aligned arrays.
    """
    size = shape[0] * shape[1]
    stride = -(-size // CACHE_LINE_BYTES) * CACHE_LINE_BYTES + 1
    room = np.empty(3 * stride, np.uint8)
    return [room[k * stride :][:size].reshape(shape) for k in range(3)]


@lru_cache(maxsize=4)
def unwrap_maps(optics: Optics, printed: bool) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the picture's coordinates (x_0, y_0), both (rows, W), for all panorama pixels."""
    y_p, x_p = np.meshgrid(np.arange(optics.rows, dtype=float), np.arange(optics.width), indexing="ij")
    x_0, y_0 = paper_omni_1(x_p, y_p, optics.x_c) if printed else omni_1(x_p, y_p, optics)
    return x_0.astype(np.float32), y_0.astype(np.float32)


def unwrap(picture: Picture, optics: Optics, printed: bool = False) -> Picture:
    """Return the panorama (rows, W[, 3]) of a picture (h, w[, 3]) by omni eq. (1), as printed or corrected."""
    x_0, y_0 = unwrap_maps(optics, printed)
    return np.asarray(cv2.remap(picture, x_0, y_0, cv2.INTER_LINEAR), np.uint8)


def vertical_lines(panorama: Picture, red: Red) -> Ints:
    """Return vertical Hough lines (n, 3) in a grey panorama: column at mid-height, first row, last row.

    The first columns are repeated after the last one, so that a landmark at column 0 is not divided.
    """
    rows, width = panorama.shape
    wrapped = np.hstack((panorama, panorama[:, : width // 12]))
    binary = np.where(wrapped > 0, np.uint8(255), np.uint8(0))
    length = min(red.length, rows)
    found = cv2.HoughLinesP(binary, 1, np.pi / 180, int(length), minLineLength=length, maxLineGap=4)
    x1, y1, x2, y2 = _lines(found).T
    upright = np.abs(x2 - x1) <= MAX_LEAN * np.abs(y2 - y1)
    lines = np.stack(((x1 + x2) // 2 % width, np.minimum(y1, y2), np.maximum(y1, y2)), axis=1)
    return np.asarray(lines[upright], np.int64)


def _lines(found: Any) -> Ints:
    """Return the result of HoughLinesP as (n, 4): (n, 1, 4) in OpenCV 4, (n, 4) in OpenCV 5, or None."""
    return np.empty((0, 4), np.int64) if found is None else np.asarray(found, np.int64).reshape(-1, 4)


def candidates(picture: Picture, optics: Optics, red: Red, printed: bool = False) -> list[RedCandidate]:
    """Return the vertical red objects in a BGR picture by the paper's method, largest first."""
    grey = red_grey(np.asarray(cv2.medianBlur(picture, 3), np.uint8), red)  # the paper's digital filter
    panorama = unwrap(grey, optics, printed)
    inner = 0.0 if printed else optics.inner
    found: list[RedCandidate] = []
    taken = np.zeros(panorama.shape[1], bool)
    lines = vertical_lines(panorama, red)
    for x_p, top, bottom in lines[np.argsort(lines[:, 1] - lines[:, 2], kind="stable")].tolist():
        if not taken[x_p]:
            columns, weight = _blob(panorama[top : bottom + 1], x_p)
            taken[columns % len(taken)] = True
            found.append(_measured(panorama, columns, weight, inner))
    return largest(found, red)


def _blob(band: Picture, x_p: int) -> tuple[Ints, Array]:
    """Return columns (k,) and weights (k,) of the red object around column x_p of the panorama.

    If the object crosses the edge of the panorama, some columns are negative, or equal to its width or larger.
    """
    width = band.shape[1]
    bright = band[band > 0]
    weight = np.minimum(band, cap(bright)).sum(axis=0, dtype=float) if len(bright) else np.zeros(width)
    profile = np.roll(weight, width // 2 - x_p)
    empty = np.flatnonzero(profile == 0)
    middle = np.searchsorted(empty, width // 2)
    left = int(empty[middle - 1]) + 1 if middle > 0 else 0
    right = int(empty[middle]) if middle < len(empty) else width
    return np.arange(left, right) + x_p - width // 2, profile[left:right]


def _measured(panorama: Picture, columns: Ints, weight: Array, inner: float) -> RedCandidate:
    """Return the candidate in these columns of the panorama; its angle is that of the weighted mean column."""
    width = panorama.shape[1]
    area = panorama[:, columns % width] > 0
    rows = np.flatnonzero(area.any(axis=1))
    r = inner + rows
    x_p = float((columns * weight).sum() / weight.sum())
    across = float(weight.sum() / weight.max()) * TAU / width
    pixels = float((area.sum(axis=1)[rows] * r).sum() * TAU / width)
    theta = float(picture_angle(np.asarray(x_p), width)) % TAU
    radius = float(r.mean())
    return RedCandidate(theta, variance(theta, radius, len(rows), across), pixels, len(rows), across, radius)


def cap(grey: NDArray[Any]) -> float:
    """Return the largest grey level for the weight of a pixel, so that shading does not shift the centre."""
    return 0.75 * float(grey.mean())


def variance(theta: float, radius: float, length: float, width: float) -> float:
    """Return the variance [rad^2] of a candidate's direction by pixel size and uneven light.

    One edge in one pixel row has the variance EDGE_PX^2 / 12, and the middle of two edges half of that.
    Neighbouring rows have the same error if the edge runs along the pixel grid. So only `1 + length min(|sin|,
    |cos|)` rows count as independent: the number of grid lines that the edge crosses. Uneven light adds
    SHADE_SHARE of the width.
    """
    crossed = 1.0 + length * min(abs(math.sin(theta)), abs(math.cos(theta)))
    return EDGE_PX**2 / (24.0 * max(radius, 1.0) ** 2 * crossed) + (SHADE_SHARE * width) ** 2


def largest(found: list[RedCandidate], red: Red) -> list[RedCandidate]:
    """Return the candidates that are long and slender enough (`red`), largest first, at most MAX_CANDIDATES."""
    lines = [c for c in found if c.length >= max(red.length, red.slender * c.width * c.radius)]
    return sorted(lines, key=lambda c: (-c.pixels, c.theta))[:MAX_CANDIDATES]
