"""Decompression that cannot be made to fill the memory: known codecs only, sizes capped and checked.

A 65 kB file can expand to gigabytes, and zstd ignores its own limit where a frame declares its size, so both
the declared and the actual size are held against the cap before and while bytes are made.
"""

from __future__ import annotations

import bz2
from collections.abc import Callable

import lz4.frame
import zstandard

from locfuse.formats.caps import MAX_CHUNK

Codec = Callable[[bytes, int], bytes]  # (data, at most so many bytes) -> bytes


class DamagedError(ValueError):
    """Bytes that are not what they should be; the message is the reason, a few words."""


def decompress(data: bytes, compression: str, size: int) -> bytes:
    """Return exactly `size` bytes, or raise DamagedError with the reason."""
    if size == 0 and not data:
        return b""
    if size > MAX_CHUNK:
        raise DamagedError(f"a chunk claims more than {MAX_CHUNK >> 20} MiB")
    out = _codec(compression)(data, size + 1)
    if len(out) != size:
        raise DamagedError("a chunk's size is not the declared one")
    return out


def decompress_prefix(data: bytes, compression: str, size: int) -> bytes:
    """Return what a cut-off stream still gives: at most `size` bytes."""
    limit = min(size, MAX_CHUNK)
    if compression == "zstd":
        return _zstd_prefix(data, limit)
    if compression == "lz4":
        return _lz4_prefix(data, limit)
    return _codec(compression)(data, limit)


def _codec(compression: str) -> Codec:
    try:
        return CODECS[compression]
    except KeyError:
        raise DamagedError(f"unknown compression {compression[:16]!r}") from None


def _stored(data: bytes, limit: int) -> bytes:
    return data[:limit]


def _zstd(data: bytes, limit: int) -> bytes:
    try:
        declared = zstandard.frame_content_size(data)
        if declared == limit - 1:  # the ordinary case: one frame that says its size, the one expected
            return zstandard.ZstdDecompressor().decompress(data)
        return zstandard.ZstdDecompressor().stream_reader(data, read_across_frames=True).read(limit)
    except zstandard.ZstdError:
        raise DamagedError("a chunk does not decompress (zstd)") from None


def _lz4(data: bytes, limit: int) -> bytes:
    try:
        plain: bytes = lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=limit)
        return plain
    except (RuntimeError, EOFError):
        raise DamagedError("a chunk does not decompress (lz4)") from None


def _bz2(data: bytes, limit: int) -> bytes:
    try:
        return bz2.BZ2Decompressor().decompress(data, max_length=limit)
    except (OSError, EOFError):
        raise DamagedError("a chunk does not decompress (bz2)") from None


def _zstd_prefix(data: bytes, limit: int) -> bytes:
    reader = zstandard.ZstdDecompressor().stream_reader(data, read_across_frames=True)
    parts: list[bytes] = []
    room = limit
    try:
        while room > 0 and (part := reader.read(min(room, 1 << 16))):
            parts.append(part)
            room -= len(part)
    except zstandard.ZstdError:
        pass
    return b"".join(parts)


def _lz4_prefix(data: bytes, limit: int) -> bytes:
    decoder = lz4.frame.LZ4FrameDecompressor()
    parts: list[bytes] = []
    room = limit
    try:
        part = decoder.decompress(data, max_length=min(room, 1 << 16))
        while part and room > 0:
            parts.append(part)
            room -= len(part)
            if decoder.eof or room <= 0:
                break
            part = decoder.decompress(b"", max_length=min(room, 1 << 16))
    except (RuntimeError, EOFError):
        pass
    return b"".join(parts)


CODECS: dict[str, Codec] = {"": _stored, "zstd": _zstd, "lz4": _lz4, "bz2": _bz2}
