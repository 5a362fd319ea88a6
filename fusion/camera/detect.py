"""Detection of red vertical objects in image messages, by several threads.

OpenCV releases Python's global interpreter lock while it decodes, so a few threads share a block of pictures. The
result does not depend on the number of threads.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any, Literal, NamedTuple

import msgspec
import numpy as np
from msgspec import field
from msgspec.structs import replace

from locfuse.fusion.data import Stream

from . import panorama, radial
from .images import coarse_size, decode, messages
from .optics import Optics
from .panorama import Picture, Red, RedCandidate

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
    red: Red = field(default_factory=Red)
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
            found = radial.candidates(picture, optics, self.red)
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
        found = radial.candidates(self.coloured(picture), optics.halved(), self.red.halved())
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
