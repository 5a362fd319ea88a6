"""A log file compressed as a whole (rosbag2 "file mode": .mcap.zstd, .db3.zstd), unpacked to a temporary file."""

from __future__ import annotations

import os
import struct
from pathlib import Path
from typing import BinaryIO

import zstandard

from locfuse.formats.whole_files import scratch_prefix
from locfuse.fusion.data import LocfuseError

from .file_bytes import FileBytes
from .losses import Losses
from .url import Place

ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
PIECE_BYTES = 1 << 20
HEAD_BYTES = 18  # of the longest frame header
BLOCK_HEAD_BYTES, CHECKSUM_BYTES, SKIPPED_HEAD_BYTES = 3, 4, 8
CHECKSUM_FLAG = 4  # in the byte behind the magic number
REPEATED = 1  # kind of a block: one byte that stands for many
SKIPPED_MAGIC = 0x184D2A50  # of frames that hold no data, its last four bits at will
MIN_CAP_BYTES = 1 << 30  # any file may unpack to a gigabyte,
MAX_UNPACK_RATIO = 200  # a larger one to so many times its size (real bags: 2 to 20)


def unpack_file(data: FileBytes, losses: Losses) -> FileBytes:
    """Return the unpacked bytes; what a cut-off or damaged file still gives is kept and the rest counted."""
    return data.unpacked(lambda packed: _unpacked(packed, data.path, losses))


def _unpacked(packed: Path, name: Place, losses: Losses) -> Path:
    """Return a temporary file with what `packed` holds; messages call it `name`."""
    import tempfile

    handle, place = tempfile.mkstemp(prefix=scratch_prefix())
    temporary = Path(place)
    try:
        with os.fdopen(handle, "wb") as plain:
            _unpack(packed, name, plain, losses)
    except OSError as problem:
        temporary.unlink()
        raise LocfuseError(f"{name}: cannot be unpacked to {temporary.parent}: {problem.strerror}") from None
    except BaseException:
        temporary.unlink()
        raise
    return temporary


def _unpack(path: Path, name: Place, plain: BinaryIO, losses: Losses) -> None:
    size = path.stat().st_size
    cap = max(MIN_CAP_BYTES, MAX_UNPACK_RATIO * size)
    total, complete = 0, True
    with path.open("rb") as packed:
        declared = _declared_size(packed.read(HEAD_BYTES))
        packed.seek(0)
        reader = zstandard.ZstdDecompressor().stream_reader(packed, read_across_frames=True)
        try:
            while piece := reader.read(PIECE_BYTES):
                total += len(piece)
                if total > cap:
                    raise LocfuseError(f"{name}: unpacks to more than {cap >> 20} MiB; try: zstd -d {name.name}")
                plain.write(piece)
        except zstandard.ZstdError:
            complete = False
        complete = complete and _ends_whole(packed, size)
    if not total:
        raise LocfuseError(f"{name}: its compression is damaged from the beginning ({size} bytes)")
    if not complete or total < declared:
        losses.add(str(name), "the compression is damaged or cut off", 0, max(declared - total, 0))


def _ends_whole(packed: BinaryIO, size: int) -> bool:
    """Tell whether the last frame ends where the file does, by the lengths of its blocks.

    A frame need not say its size, and of a cut-off frame the library returns what there is without an error.
    Format: RFC 8878, section 3.1.
    """
    at = 0
    while at < size:
        packed.seek(at)
        head = packed.read(HEAD_BYTES)
        if len(head) < SKIPPED_HEAD_BYTES:
            return False
        magic, length = struct.unpack_from("<II", head)
        if magic & ~0xF == SKIPPED_MAGIC:
            at += SKIPPED_HEAD_BYTES + length
            continue
        try:
            checksum = CHECKSUM_BYTES if head[4] & CHECKSUM_FLAG else 0
            at = _end_of_blocks(packed, at + zstandard.frame_header_size(head)) + checksum
        except (zstandard.ZstdError, EOFError):
            return False
    return at == size


def _end_of_blocks(packed: BinaryIO, at: int) -> int:
    """Return where the last block of a frame ends. Raises EOFError where the file ends before."""
    last = False
    while not last:
        packed.seek(at)
        head = packed.read(BLOCK_HEAD_BYTES)
        if len(head) < BLOCK_HEAD_BYTES:
            raise EOFError
        word = int.from_bytes(head, "little")
        last, repeated = bool(word & 1), (word >> 1) & 3 == REPEATED
        at += BLOCK_HEAD_BYTES + (1 if repeated else word >> 3)
    return at


def _declared_size(head: bytes) -> int:
    """Return the size that the first frame declares, 0 where it declares none."""
    try:
        return max(zstandard.frame_content_size(head), 0)
    except zstandard.ZstdError:
        return 0
