"""A log file compressed as a whole (rosbag2 "file mode": .mcap.zstd, .db3.zstd), unpacked to a temporary file."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path
from typing import BinaryIO

import zstandard

from locfuse.formats.url import Place
from locfuse.formats.whole_files import scratch_prefix
from locfuse.fusion.data import LocfuseError

from .file_bytes import FileBytes
from .losses import Losses

ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
PIECE_BYTES = 1 << 20
HEAD_BYTES = 18  # of the longest frame header
MIN_CAP_BYTES = 1 << 30  # any file may unpack to a gigabyte,
MAX_UNPACK_RATIO = 200  # a larger one to so many times its size (real bags: 2 to 20)


def unpack_file(data: FileBytes, losses: Losses) -> FileBytes:
    """Return the unpacked bytes; what a cut-off or damaged file still gives is kept and the rest counted."""
    return data.unpacked(lambda packed: _unpacked(packed, data.path, losses))


def _unpacked(packed: Path, name: Place, losses: Losses) -> Path:
    """Return a temporary file with what `packed` holds; messages call it `name`."""
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
    if not total:
        raise LocfuseError(f"{name}: its compression is damaged from the beginning ({size} bytes)")
    if not complete or total < declared:
        losses.add(str(name), "the compression is damaged or cut off", 0, max(declared - total, 0))


def _declared_size(head: bytes) -> int:
    """Return the size that the first frame declares, 0 where it declares none."""
    try:
        return max(zstandard.frame_content_size(head), 0)
    except zstandard.ZstdError:
        return 0
