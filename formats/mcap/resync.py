"""After damage: where in the file do records go on?"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Collection

import numpy as np

from locfuse.formats.container.decompress import CODECS, DamagedError
from locfuse.formats.container.file_bytes import FileBytes

from . import records as rec
from .summary import Summary

SEARCH_BYTES = 1 << 20
CHUNK_HEAD = rec.RECORD.size + 64  # bytes that hold a chunk's header


class Resync:
    """Finds the next place that can be read: by the chunk index, else by looking for records."""

    def __init__(self, data: FileBytes, summary: Summary | None) -> None:
        self.data = data
        self.starts = sorted(summary.chunks) if summary else []
        self.end = summary.start if summary else data.size

    def next(self, at: int, chunked: bool, channels: Collection[int]) -> int | None:
        """Return the offset of the next chunk at or after `at` (in an unchunked file: message), None without."""
        if self.starts:
            i = bisect_left(self.starts, at)
            return self.starts[i] if i < len(self.starts) else None
        return self._search(at, chunked, channels)

    def _search(self, at: int, chunked: bool, channels: Collection[int]) -> int | None:
        while at + rec.RECORD.size <= self.end:
            window = np.frombuffer(self.data.read(at, SEARCH_BYTES), np.uint8)
            n = len(window) - rec.RECORD.size + 1
            wanted = window[:n] == rec.CHUNK
            if not chunked:
                wanted |= window[:n] == rec.MESSAGE
            wanted &= (window[5 : n + 5] == 0) & (window[6 : n + 6] == 0)  # shorter than 4 GiB
            for i in np.flatnonzero(wanted).tolist():
                if self._is_chunk(at + i) or (not chunked and self._are_records(at + i, channels)):
                    return at + int(i)
            at += n
        return None

    def _is_chunk(self, at: int) -> bool:
        head = self.data.read(at, CHUNK_HEAD)
        if len(head) < rec.RECORD.size or head[0] != rec.CHUNK:
            return False
        length = rec.opcode_and_length(head)[1]
        try:
            header = rec.chunk_header(head[rec.RECORD.size :])
        except DamagedError:
            return False
        fits = at + rec.RECORD.size + length <= self.data.size
        return fits and header.compression in CODECS and header.start + header.length == length

    def _are_records(self, at: int, channels: Collection[int]) -> bool:
        """Tell whether three plausible records in a row begin here, messages of known channels only."""
        for _ in range(3):
            head = self.data.read(at, rec.RECORD.size + 2)
            if len(head) < rec.RECORD.size + 2:
                return False
            opcode, length = rec.opcode_and_length(head)
            if opcode == rec.MESSAGE and rec.Cursor(head, rec.RECORD.size).integer("H") not in channels:
                return False
            if not 0 < opcode <= rec.DATA_END or at + rec.RECORD.size + length > self.data.size:
                return False
            if opcode == rec.DATA_END:
                return True
            at += rec.RECORD.size + length
        return True
