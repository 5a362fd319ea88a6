"""After damage: where in the file do records go on?"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Collection

import numpy as np
from numpy.typing import NDArray

from . import mcap_records as rec
from .decompress import CODECS, DamagedError
from .file_bytes import FileBytes
from .mcap_summary import Summary

SEARCH_BYTES = 1 << 20
CHUNK_HEAD = rec.RECORD.size + 64  # bytes that hold a chunk's header


class Resync:
    """Finds the next place that can be read: by the chunk index, else by looking for records."""

    def __init__(self, data: FileBytes, summary: Summary | None) -> None:
        self.data = data
        self.starts = sorted(summary.chunks) if summary else []
        self.end = summary.start if summary else data.size
        self._window = range(0)  # the bytes last searched
        self._places: NDArray[np.int64] = np.empty(0, np.int64)  # where in them a record might begin
        self._chunked = False  # whether these are places of chunks only

    def next(self, at: int, chunked: bool, channels: Collection[int]) -> int | None:
        """Return the offset of the next chunk at or after `at` (in an unchunked file: message), None without."""
        if self.starts:
            i = bisect_left(self.starts, at)
            return self.starts[i] if i < len(self.starts) else None
        return self._search(at, chunked, channels)

    def _search(self, at: int, chunked: bool, channels: Collection[int]) -> int | None:
        while at + rec.RECORD.size <= self.end:
            if at not in self._window or chunked != self._chunked:
                self._search_window(at, chunked)
            for i in range(int(np.searchsorted(self._places, at)), len(self._places)):
                place = int(self._places[i])
                if self._is_chunk(place) or (not chunked and self._are_records(place, channels)):
                    return place
            at = self._window.stop
        return None

    def _search_window(self, at: int, chunked: bool) -> None:
        """Note where a record might begin, once for all holes in these bytes."""
        window = np.frombuffer(self.data.read(at, SEARCH_BYTES), np.uint8)
        n = len(window) - rec.RECORD.size + 1
        wanted = window[:n] == rec.CHUNK
        if not chunked:
            wanted |= window[:n] == rec.MESSAGE
        wanted &= np.ndarray((n,), "<u4", window, 5, (1,)) == 0  # the upper half of the length: shorter than 4 GiB
        self._window, self._chunked = range(at, at + n), chunked
        self._places = np.flatnonzero(wanted) + at

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
