"""Decoding of image messages to BGR pictures (h, w, 3) uint8; if it fails, the reason is returned instead."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from locfuse.fusion.data import Stream

from .opencv import MAX_PIXELS, cv2, listened, reports_damage
from .optics import FIELDS

PNG = b"\x89PNG\r\n\x1a\n"
JPEG, EOI = b"\xff\xd8", b"\xff\xd9"
MIN_TAIL_BYTES = 8  # fewer bytes than follow a frame header
FRAMES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}  # SOF markers: the frame's size follows
BARE = frozenset({0x01, *range(0xD0, 0xD8)})  # markers without a length
END = frozenset({0xD9, 0xDA})  # end of image, start of scan: the frame header comes before these markers
COLOUR_COMPONENTS = 3  # components of a colour picture: Y, Cb, Cr
Picture = NDArray[np.uint8]
PICTURES_AT_ONCE = 16  # pictures held undecoded at a time
# reasons why a message has no picture
NO_COLOUR = "no_colour"  # grey (mono8): red needs colour
UNREADABLE = "unreadable"  # truncated, or neither JPEG nor PNG
NOT_WHOLE = "not_whole"  # damaged data: the picture is wrong after the damage
TOO_LARGE = "too_large"  # more than MAX_PIXELS
TOO_SHORT = "too_short"  # less data than height x step
UNKNOWN_ENCODING = "unknown_encoding"
GREY = ("mono", "8UC1", "16UC1", "32FC1")
# encoding -> (channels, conversion to BGR)
_ENCODINGS: dict[str, tuple[int, int | None]] = {
    "bgr8": (3, None),
    "8UC3": (3, None),
    "rgb8": (3, cv2.COLOR_RGB2BGR),
    "bgra8": (4, cv2.COLOR_BGRA2BGR),
    "rgba8": (4, cv2.COLOR_RGBA2BGR),
}


def image_size(data: memoryview) -> tuple[int, int] | None:
    """Return (width, height) [px] from the header of a JPEG or PNG; None if it is neither or truncated."""
    if bytes(data[:8]) == PNG and bytes(data[12:16]) == b"IHDR" and b"IEND" in bytes(data[24:]):
        return int.from_bytes(data[16:20], "big"), int.from_bytes(data[20:24], "big")
    return _jpeg_size(data, _frame(data)) if bytes(data[:2]) == JPEG else None


def _is_coarse(data: memoryview, at: int | None) -> bool:
    """Return whether a JPEG with its frame header at `at` has colour at half resolution (4:2:0, 4:2:2)."""
    if at is None or len(data) < at + 10 + 3 * COLOUR_COMPONENTS or data[at + 9] != COLOUR_COMPONENTS:
        return False
    sampling = [data[at + 11 + 3 * k] for k in range(COLOUR_COMPONENTS)]  # horizontal in the high half of the byte
    return all(sampling[0] >> 4 >= 2 * (other >> 4) > 0 for other in sampling[1:])


def _jpeg_size(data: memoryview, at: int | None) -> tuple[int, int] | None:
    if at is None:
        return None
    # the end mark is nearly always last; it cannot occur inside a scan, where 0 follows every 0xFF
    whole = EOI in bytes(data[-MIN_TAIL_BYTES:]) or EOI in bytes(data[at + 9 :])
    height, width = (int.from_bytes(data[at + k : at + k + 2], "big") for k in (5, 7))
    return (width, height) if whole else None


def _frame(data: memoryview) -> int | None:
    """Return the index of a JPEG's frame header (ITU-T T.81, B.2.2); None if there is none."""
    at = 2
    while at + 9 <= len(data) and data[at] == 0xFF:
        marker = data[at + 1]
        if marker in FRAMES:
            return at
        if marker in END:
            return None
        if marker == 0xFF:  # fill byte
            at += 1
        elif marker in BARE:
            at += 2
        else:
            at += 2 + max(2, int.from_bytes(data[at + 2 : at + 4], "big"))
    return None


def compressed(data: Any, layout: str, coarse: tuple[int, int] | None = None) -> Picture | str:
    """Return the BGR picture of a sensor_msgs/CompressedImage, or the reason why there is none.

    `layout` is the format in the message: "jpeg", or image_transport's "bgr8; jpeg compressed bgr8". With
    "compressed rgb8", R and B are swapped in the file. An EXIF rotation is not applied. If the full size `coarse`
    (height, width) [px] is not None, the picture is decoded at half size.
    """
    encoding, _, rest = layout.partition(";")
    if encoding.startswith(GREY):
        return NO_COLOUR
    size = coarse or image_size(memoryview(data).cast("B"))
    if size is None:
        return UNREADABLE
    if size[0] * size[1] > MAX_PIXELS:
        return TOO_LARGE
    picture, words = listened(lambda: _decoded(data, coarse is not None))
    if picture is None:
        return UNREADABLE
    if reports_damage(words):
        return NOT_WHOLE
    if picture.ndim != 3:
        return NO_COLOUR
    swapped = "compressed rgb" in rest
    return np.asarray(cv2.cvtColor(picture, cv2.COLOR_RGB2BGR) if swapped else picture, np.uint8)


def coarse_size(message: tuple[Any, ...]) -> tuple[int, int] | None:
    """Return (height, width) [px] of a message's picture, if it is a JPEG with colour at half resolution.

    Else return None.
    """
    if len(message) != 2:
        return None
    data = memoryview(message[0]).cast("B")
    at = _frame(data) if bytes(data[:2]) == JPEG else None
    size = _jpeg_size(data, at) if _is_coarse(data, at) else None
    return None if size is None else (size[1], size[0])


def _decoded(data: Any, half: bool) -> NDArray[Any] | None:
    flags = cv2.IMREAD_REDUCED_COLOR_2 if half else cv2.IMREAD_ANYCOLOR
    flags |= cv2.IMREAD_IGNORE_ORIENTATION
    try:
        return cast("NDArray[Any] | None", cv2.imdecode(np.frombuffer(data, np.uint8), flags))
    except cv2.error:
        return None


def raw(data: Any, width: int, height: int, encoding: str, step: int) -> Picture | str:
    """Return the BGR picture of a sensor_msgs/Image, or the reason why there is none.

    A row takes `step` bytes, perhaps with padding at its end.
    """
    if encoding not in _ENCODINGS:
        return NO_COLOUR if encoding.startswith(GREY) else UNKNOWN_ENCODING
    channels, conversion = _ENCODINGS[encoding]
    if width * height > MAX_PIXELS:
        return TOO_LARGE
    if min(width, height) < 1 or step < width * channels or len(data) < height * step:
        return TOO_SHORT
    rows = np.frombuffer(data, np.uint8, count=height * step).reshape(height, step)
    pixels = rows[:, : width * channels].reshape(height, width, channels)
    return pixels if conversion is None else np.asarray(cv2.cvtColor(pixels, conversion), np.uint8)


def decode(message: tuple[Any, ...], coarse: tuple[int, int] | None = None) -> Picture | str:
    """Return the BGR picture (h, w, 3) of a message, or the reason why there is none; `message` has its `FIELDS`.

    If the full size `coarse` (height, width) [px] is not None, a compressed picture is decoded at half size.
    """
    if len(message) == 2:
        return compressed(*message, coarse)
    data, width, height, encoding, step = message
    return raw(data, int(width), int(height), encoding, int(step))


def messages(stream: Stream, rows: int = PICTURES_AT_ONCE) -> Iterator[list[tuple[int, tuple[Any, ...]]]]:
    """Yield blocks of (row number, fields) of a stream's undecoded pictures."""
    fields = FIELDS[stream.msgtype]
    for numbers, columns in stream.blocks(*fields, rows=rows):
        values: list[Any] = [columns[name] for name in fields]
        yield list(zip(numbers.tolist(), zip(*values, strict=True), strict=True))
