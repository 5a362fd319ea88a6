"""Detection of red vertical objects in image messages, by several threads.

Vertical objects are radial lines in the raw picture, so no panorama is needed: angle and radius are computed only
for the few red pixels inside the mirror. The bearing equals that of `panorama` (tests/camera/test_bearings.py).

OpenCV releases Python's global interpreter lock while it decodes, so a few threads share a block of pictures. The
result does not depend on the number of threads.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache, partial
from typing import Any, Literal, NamedTuple

import msgspec
import numpy as np
from msgspec.structs import replace

from locfuse.fusion.data import Array, Stream
from locfuse.fusion.se2 import TAU

from . import panorama
from .images import coarse_size, decode, messages
from .opencv import cv2
from .optics import Optics
from .panorama import Picture, Red, RedCandidate, cap, largest, red_excess, red_share, room_for_planes, variance

MIN_RED_NEIGHBOURS = 5  # least red pixels among a pixel and its eight neighbours: their median is then red
MAX_GAP_PX = 2.0  # larger gaps along the circle separate two objects
_ROOM = threading.local()  # buffers, reused for the next picture


@lru_cache(maxsize=4)
def _window(height: int, width: int, optics: Optics) -> tuple[slice, slice, Picture]:
    """Return the rows and columns of the picture around the mirror, and a mask there (255 inside the mirror)."""
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
    """Return the three buffers (h, w) of this thread for the colour planes of a picture."""
    planes: list[Picture] = getattr(_ROOM, "planes", [])
    if not planes or planes[0].shape != shape:
        planes = _ROOM.planes = room_for_planes(shape)
    return planes


def radial_candidates(picture: Picture, optics: Optics, red: Red) -> list[RedCandidate]:
    """Return the vertical red objects in a BGR picture, largest first."""
    rows, columns, mirror = _window(*picture.shape[:2], optics)
    if mirror.size == 0:
        return []
    excess, r = red_excess(picture[rows, columns], red, _planes(mirror.shape))
    cv2.bitwise_and(excess, mirror, dst=excess)
    x, y, w, h = cv2.boundingRect(excess)
    # one pixel larger, for the neighbours of red pixels; outside the window the nearest pixel is repeated
    part = slice(max(y - 1, 0), y + h + 1), slice(max(x - 1, 0), x + w + 1)
    level = red_share(excess[part], r[part], red)
    reds = cv2.boxFilter(np.minimum(level, 1), -1, (3, 3), normalize=False, borderType=cv2.BORDER_REPLICATE)
    at = np.nonzero((level > 0) & (reds >= MIN_RED_NEIGHBOURS))
    if len(at[0]) < max(red.length, 1.0):
        return []
    i, j = at[1] + part[1].start + columns.start, at[0] + part[0].start + rows.start
    edge = (i == 0) | (j == 0) | (i == picture.shape[1] - 1) | (j == picture.shape[0] - 1)
    dx, dy = i - optics.x_c, j - optics.y_c
    pixels = np.stack((np.arctan2(dx, dy), np.sqrt(dx * dx + dy * dy), level[at], edge))
    found = [_measured(*_without_edge(thing)) for thing in _objects(pixels) if thing.shape[1] >= red.length]
    return largest([thing for thing in found if thing is not None], red)


def _objects(pixels: Array) -> list[Array]:
    """Group red pixels (4, n) into objects (4, k).

    Rows: angle [rad], radius [px], level, whether at the picture's edge. Gaps between the pixels of an object are
    at most MAX_GAP_PX along the circle.
    """
    pixels = pixels[:, np.argsort(pixels[0], kind="stable")]
    theta, radius = pixels[:2]
    apart = (np.append(theta[1:], theta[0] + TAU) - theta) * 0.5 * (radius + np.roll(radius, -1))
    last = np.flatnonzero(apart > MAX_GAP_PX)  # the last pixel of each object
    if not len(last):
        return [pixels]
    turned = (last[-1] + 1) % len(theta)  # the last object may continue at the first pixels
    ends = np.sort((last - turned) % len(theta)) + 1
    return np.split(np.roll(pixels, -turned, axis=1), ends[:-1], axis=1)


def _without_edge(thing: Array) -> Array:
    """Return an object's pixels at smaller radii than those where it touches the edge of the picture."""
    edge = thing[3] > 0.0
    return thing[:3, thing[1] < thing[1, edge].min() - 1.0] if edge.any() else thing[:3]


def _measured(theta: Array, radius: Array, level: Array) -> RedCandidate | None:
    """Return the candidate for an object of k pixels; None without pixels or if all are on the mirror's axis.

    Its angle is the weighted mean angle; the weight of a pixel is its level, limited to `cap`.
    """
    if not len(theta) or not radius.max() > 0.0:
        return None
    near, weight = radius.min(), np.minimum(level, cap(level))
    angle = np.where(theta < theta[0], theta + TAU, theta)
    middle = float((weight * angle).sum() / weight.sum()) % TAU
    length = float(len(np.unique((radius - near).astype(np.intp))))
    centre = 0.5 * float(near + radius.max())
    width = len(theta) / (length * centre)
    return RedCandidate(middle, variance(middle, centre, length, width), len(theta), length, width, centre)


Chain = Literal["fast", "paper", "printed"]
MAX_THREADS = 4  # more threads would only wait for the interpreter lock
MIN_HALF_RADIUS_PX = 120.0  # px, smallest radius of the mirror for detection at half size


class Detection(NamedTuple):
    """Landmark candidates in one picture."""

    shape: tuple[int, int]  # px, height and width
    optics: Optics
    candidates: list[RedCandidate]


class Detector(msgspec.Struct, frozen=True):
    """Detector of red vertical objects; None: the calibration value follows from the size of the picture."""

    chain: Chain = "fast"
    red: Red = Red()
    centre: tuple[float, float] | None = None  # px
    inner: float | None = None  # px
    outer: float | None = None  # px
    width: int = 720
    zero: float = 0.0  # rad
    clockwise: bool = False
    swapped: bool = False  # pictures are RGB

    def optics(self, shape: tuple[int, ...]) -> Optics:
        """Return the calibration for pictures (h, w, 3); default: the largest circle about the middle."""
        height, width = shape[:2]
        x, y = self.centre or ((width - 1) / 2.0, (height - 1) / 2.0)
        outer = self.outer or max(1.0, min(x, y, width - 1 - x, height - 1 - y))
        inner = outer / 4.0 if self.inner is None else self.inner
        return Optics(x, y, inner, outer, self.width, self.zero, self.clockwise)

    def looks_like(self, other: Detector) -> bool:
        """Return whether both detectors find the same candidates.

        Then they differ at most in `zero` and `clockwise`, which only convert angles to bearings.
        """
        return replace(self, zero=other.zero, clockwise=other.clockwise) == other

    def coloured(self, picture: Picture) -> Picture:
        """Return a picture with channels in the order blue, green, red."""
        return np.ascontiguousarray(picture[..., ::-1]) if self.swapped else picture

    def find(self, picture: Picture) -> Detection:
        """Return the candidates in a BGR picture, largest first."""
        optics, picture = self.optics(picture.shape), self.coloured(picture)
        if self.chain == "fast":
            found = radial_candidates(picture, optics, self.red)
        else:
            found = panorama.candidates(picture, optics, self.red, printed=self.chain == "printed")
        return Detection((picture.shape[0], picture.shape[1]), optics, found)

    def is_half_enough(self, shape: tuple[int, int]) -> bool:
        """Return whether detection at half size is exact enough for a picture (h, w).

        The picture has colour at half resolution.
        """
        return self.chain == "fast" and self.optics(shape).outer >= MIN_HALF_RADIUS_PX

    def find_in_half(self, picture: Picture, shape: tuple[int, int]) -> Detection:
        """Return the candidates in a half-size picture, in pixels of the full picture `shape` (h, w)."""
        optics = self.optics(shape)
        found = radial_candidates(self.coloured(picture), optics.halved(), self.red.halved())
        return Detection(shape, optics, [candidate.doubled() for candidate in found])


def detect(message: tuple[Any, ...], detector: Detector) -> Detection | str:
    """Return the red objects in the picture of one message, or the reason why it cannot be decoded.

    A JPEG with colour at half resolution is decoded at half size: a third of the work, with no loss of colour.
    """
    shape = coarse_size(message)
    if shape is not None and detector.is_half_enough(shape):
        picture = decode(message, shape)
        return picture if isinstance(picture, str) else detector.find_in_half(picture, shape)
    picture = decode(message)
    return picture if isinstance(picture, str) else detector.find(picture)


def detections(stream: Stream, detector: Detector) -> Iterator[tuple[int, Detection | str]]:
    """Yield (row number, detection or reason why there is none) for every message of a stream, in order."""
    with ThreadPoolExecutor(min(MAX_THREADS, os.cpu_count() or 1)) as pool:
        for block in messages(stream):
            found = pool.map(partial(detect, detector=detector), [fields for _, fields in block])
            yield from zip((row for row, _ in block), found, strict=True)
