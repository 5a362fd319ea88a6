"""Messages that were compressed one by one (rosbag2 "message mode"): told by their first bytes, unpacked here.

No serialised message begins with zstd's magic number, so this needs no metadata.yaml, which crashes lose.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import zstandard
from numpy.typing import NDArray

from locfuse.formats.caps import MAX_MESSAGE
from locfuse.formats.columns import view

from .source import Messages

ZSTD_MAGIC = 0xFD2FB528
BATCH_BYTES = 16 * 1024 * 1024  # bytes of unpacked messages handed on at once

Bytes = NDArray[np.uint8]


def unpack(data: Bytes, messages: Messages) -> Iterator[tuple[Bytes, Messages]]:
    """Yield the messages as they are, or unpacked in portions; one that does not unpack comes out empty."""
    if not _packed(data, messages):
        yield data, messages
        return
    pieces: list[bytes] = []
    first, size = 0, 0
    for i, (at, n) in enumerate(zip(messages.start.tolist(), messages.length.tolist(), strict=True)):
        pieces.append(_unpacked(data[at : at + n].tobytes()))
        size += len(pieces[-1])
        if size >= BATCH_BYTES:
            yield _portion(pieces, messages.take(slice(first, i + 1)))
            pieces, first, size = [], i + 1, 0
    if pieces:
        yield _portion(pieces, messages.take(slice(first, None)))


def _packed(data: Bytes, messages: Messages) -> bool:
    whole = messages.length >= 4
    return bool(whole.any() and (view(data, "<u4", messages.start[whole]) == ZSTD_MAGIC).any())


def _unpacked(message: bytes) -> bytes:
    if int.from_bytes(message[:4], "little") != ZSTD_MAGIC:
        return message
    try:
        declared = zstandard.frame_content_size(message)  # -1: the frame does not say
        plain = zstandard.ZstdDecompressor().stream_reader(message, read_across_frames=True).read(MAX_MESSAGE + 1)
    except zstandard.ZstdError:
        return b""
    return plain if declared <= len(plain) <= MAX_MESSAGE else b""  # a cut-off frame gives less


def _portion(pieces: list[bytes], messages: Messages) -> tuple[Bytes, Messages]:
    ends = np.cumsum([len(piece) for piece in pieces], dtype=np.int64)
    length = np.diff(ends, prepend=0)
    return np.frombuffer(b"".join(pieces), np.uint8), messages._replace(start=ends - length, length=length)
