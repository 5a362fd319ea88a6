"""Bytes of a file at any offset, with bounded memory."""

from __future__ import annotations

import os
import weakref
import zlib
from pathlib import Path

from locfuse.fusion.data import LocfuseError

WINDOW_BYTES = 1 << 18


class FileBytes:
    """Random access to a file with a read-ahead window: never more in memory than asked for plus the window.

    The file is opened for each read (some microseconds per chunk), so that nothing needs to be closed. Where it
    had to be unpacked, the bytes are those of a temporary file that goes when this object goes.
    """

    def __init__(self, path: Path, unpacked: Path | None = None) -> None:
        self.path = path  # what to call it
        self.where = unpacked or path  # where the bytes are
        self.size = self.where.stat().st_size
        self._start = 0
        self._window = b""
        if unpacked is not None:
            weakref.finalize(self, unpacked.unlink, missing_ok=True)

    def read(self, at: int, n: int) -> bytes:
        """Return up to n bytes from `at` on (fewer at the end of the file)."""
        if n > WINDOW_BYTES:
            return self._pread(n, at)
        offset = at - self._start
        if not 0 <= offset <= len(self._window) - n:
            self._window = self._pread(WINDOW_BYTES, at)
            self._start, offset = at, 0
        return self._window[offset : offset + n]

    def crc32(self, start: int, stop: int) -> int:
        """Return the checksum of the bytes from `start` up to `stop`."""
        crc = 0
        for at in range(start, stop, WINDOW_BYTES):
            crc = zlib.crc32(self._pread(min(WINDOW_BYTES, stop - at), at), crc)
        return crc

    def _pread(self, n: int, at: int) -> bytes:
        try:
            with self.where.open("rb", buffering=0) as file:
                return os.pread(file.fileno(), n, at)
        except OSError as problem:
            raise LocfuseError(f"{self.path}: cannot be read: {problem.strerror}") from None
