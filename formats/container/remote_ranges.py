"""Ranges of bytes: which of those asked for are fetched together, and which are kept."""

from __future__ import annotations

from bisect import bisect_right, insort
from collections import OrderedDict
from collections.abc import Iterable, Iterator

Span = tuple[int, int]  # start, stop [bytes]

MAX_GAP_BYTES = 32 * 1024  # between two ranges that are fetched together: a request costs more than these
MAX_TOGETHER_BYTES = 8 * 1024 * 1024  # of one request: a dropped connection loses no more


def joined(spans: Iterable[Span], gap: int = MAX_GAP_BYTES) -> Iterator[Span]:
    """Yield ranges that hold all `spans`, with those joined that lie close to each other."""
    start = stop = -1
    for a, b in sorted(spans):
        if stop >= 0 and a - stop <= gap and max(b, stop) - start <= MAX_TOGETHER_BYTES:
            stop = max(stop, b)
            continue
        if stop > start:
            yield start, stop
        start, stop = a, b
    if stop > start:
        yield start, stop


def cut(spans: Iterable[Span], size: int = MAX_TOGETHER_BYTES) -> Iterator[Span]:
    """Yield the same bytes in ranges of at most `size`."""
    for start, stop in spans:
        for at in range(start, stop, size):
            yield at, min(at + size, stop)


class Ranges:
    """Ranges that were fetched, up to a number of bytes; those unused for longest go first."""

    def __init__(self, capacity: int) -> None:
        self.capacity = capacity
        self._held: OrderedDict[int, bytes] = OrderedDict()  # start -> bytes, least recently used first
        self._starts: list[int] = []
        self._size = 0

    def put(self, start: int, data: bytes) -> None:
        """Keep the bytes from `start` on."""
        known = self._held.get(start)
        if known is not None and len(known) >= len(data):
            self._held.move_to_end(start)
            return
        if known is None:
            insort(self._starts, start)
        self._size += len(data) - len(known or b"")
        self._held[start] = data
        self._held.move_to_end(start)
        while self._size > self.capacity and len(self._held) > 1:
            gone, old = self._held.popitem(last=False)
            self._starts.remove(gone)
            self._size -= len(old)

    def get(self, start: int, stop: int) -> bytes | None:
        """Return the bytes of a range, None where not all of them are here."""
        pieces: list[bytes] = []
        while start < stop:
            i = bisect_right(self._starts, start) - 1
            first = self._starts[i] if i >= 0 else start
            data = self._held.get(first, b"")
            if start >= first + len(data):
                return None
            self._held.move_to_end(first)
            pieces.append(data[start - first : stop - first])
            start += len(pieces[-1])
        return pieces[0] if len(pieces) == 1 else b"".join(pieces)
