"""Decompression with bounded memory: known codecs only, sizes capped and checked.

A 65 kB file can expand to gigabytes, and zstd ignores its own limit if a frame declares its size. So both the
declared and the actual size are compared with the cap.
"""

from __future__ import annotations

import bz2
import io
import os
import tempfile
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, BinaryIO

import lz4.frame
import zstandard

from locfuse.formats.inputs import MAX_CHUNK
from locfuse.formats.whole_files import scratch_prefix
from locfuse.fusion.data import LocfuseError

from .file_bytes import FileBytes

MAX_PIECE_BYTES = 1 << 16  # unpacked at once from a cut-off stream


class Unpacked:
    """A readable stream of the bytes that a bz2 or lz4 decompressor unpacks from `data`."""

    def __init__(self, decompressor: Any, data: bytes) -> None:
        self._decompressor = decompressor
        self._data = data

    def read(self, n: int) -> bytes:
        """Return at most n more bytes, b"" at the end."""
        data, self._data = self._data, b""  # the decompressor keeps what it has not unpacked
        return b"" if self._decompressor.eof else self._decompressor.decompress(data, max_length=n)


CODECS: dict[str, Callable[[bytes], Any]] = {  # compression -> the stream of unpacked bytes
    "": io.BytesIO,
    "zstd": lambda data: zstandard.ZstdDecompressor().stream_reader(data, read_across_frames=True),
    "lz4": lambda data: Unpacked(lz4.frame.LZ4FrameDecompressor(), data),
    "bz2": lambda data: Unpacked(bz2.BZ2Decompressor(), data),
}
ERRORS = (zstandard.ZstdError, RuntimeError, EOFError, OSError)  # raised by these streams


class DamagedError(ValueError):
    """Error for damaged bytes; the message is the reason."""


def decompress(data: bytes, compression: str, size: int) -> bytes:
    """Return the decompressed data, exactly `size` bytes. Raises DamagedError."""
    if size == 0 and not data:
        return b""
    if size > MAX_CHUNK:
        raise DamagedError(f"a chunk claims more than {MAX_CHUNK >> 20} MiB")
    try:
        out: bytes = _stream(data, compression).read(size + 1)
    except ERRORS:
        raise DamagedError(f"a chunk does not decompress ({compression})") from None
    if len(out) != size:
        raise DamagedError("a chunk's size is not the declared one")
    return out


def decompress_prefix(data: bytes, compression: str, size: int) -> bytes:
    """Return the first bytes of a cut-off stream, decompressed, at most `size`."""
    stream = _stream(data, compression)
    parts: list[bytes] = []
    room = min(size, MAX_CHUNK)
    with suppress(*ERRORS):
        while room > 0 and (part := stream.read(min(room, MAX_PIECE_BYTES))):
            parts.append(part)
            room -= len(part)
    return b"".join(parts)


def _stream(data: bytes, compression: str) -> Any:
    try:
        return CODECS[compression](data)
    except KeyError:
        raise DamagedError(f"unknown compression {compression[:16]!r}") from None


# --- A log file compressed as a whole (rosbag2 "file mode": .mcap.zstd, .db3.zstd), unpacked to a temporary file

ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
PIECE_BYTES = 1 << 12  # of input per step, which unpack to at most 128 MiB: 4 bytes can hold a block of 128 KiB
HEAD_BYTES = 18  # the longest zstd frame header
MIN_CAP_BYTES = 1 << 30  # any file may unpack to a gigabyte,
MAX_UNPACK_RATIO = 200  # or to this multiple of its size (real bags: 2 to 20)


def unpack_file(data: FileBytes) -> None:
    """Unpack a local zstd file to a temporary file; afterwards `data` reads from the temporary file.

    A damaged or cut-off rest of the file is recorded as a loss.
    """
    handle, place = tempfile.mkstemp(prefix=scratch_prefix())
    temporary = Path(place)
    try:
        with os.fdopen(handle, "wb") as plain:
            _unpack(data, plain)
    except OSError as problem:
        temporary.unlink()
        raise LocfuseError(f"{data.path}: cannot be unpacked to {temporary.parent}: {problem.strerror}") from None
    except BaseException:
        temporary.unlink()
        raise
    data.use_unpacked(temporary)


def _unpack(data: FileBytes, plain: BinaryIO) -> None:
    cap = max(MIN_CAP_BYTES, MAX_UNPACK_RATIO * data.size)
    total, whole = 0, True
    declared = 0  # unpacked bytes that the first frame declares, if any
    with data.where.open("rb") as packed:
        with suppress(zstandard.ZstdError):
            declared = max(zstandard.frame_content_size(packed.read(HEAD_BYTES)), 0)
        packed.seek(0)
        frame = zstandard.ZstdDecompressor().decompressobj()
        try:
            while rest := packed.read(PIECE_BYTES):
                while rest:
                    if frame.eof:
                        frame = zstandard.ZstdDecompressor().decompressobj()
                    piece = frame.decompress(rest)
                    rest = frame.unused_data
                    total += len(piece)
                    if total > cap:
                        words = f"{data.path}: unpacks to more than {cap >> 20} MiB; try: zstd -d {data.path.name}"
                        raise LocfuseError(words)
                    plain.write(piece)
        except zstandard.ZstdError:
            whole = False
    if not total:
        raise LocfuseError(f"{data.path}: its compression is damaged from the beginning ({data.size} bytes)")
    if not whole or not frame.eof or total < declared:
        data.lose("the compression is damaged or cut off", 0, max(declared - total, 0))
