"""Reading files of chunks (MCAP, ROS 1 bag) chunk by chunk, with bounded memory."""

from __future__ import annotations

from abc import abstractmethod
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from typing import Any, NamedTuple

import msgspec
import numpy as np

from locfuse.formats.caps import FREE_RECORDS, MAX_CHUNK
from locfuse.formats.columns import Bytes

from .decompress import DamagedError, decompress, decompress_prefix
from .source import Batch, Messages, Source

CUT_OFF = "the file is cut off inside a chunk"
NO_RECORD = "a chunk holds bytes that are no record"


class Part(msgspec.Struct):
    """A part of a file: one chunk, or consecutive messages outside chunks."""

    offset: int  # of the chunk record in the file
    start: int  # of the content in the file
    size: int  # bytes of content; in a cut-off file only those that are present
    compression: str = ""
    plain: int | None = None  # uncompressed bytes; None outside chunks
    cut_off: bool = False  # whether the file ends inside this part
    counts: dict[int, int] | None = None  # channel -> messages, once known
    span: tuple[int, int] = (0, 0)  # log times of its first and last message, ns


class Records(NamedTuple):
    """The messages and channel definitions of one part of a file."""

    messages: dict[int, Messages]
    definitions: list[Any]  # of channels; their type depends on the file format
    end: int  # offset of the first invalid record; without damage, the size of the part


def most_records(packed: int) -> int:
    """Return the largest accepted number of records in a chunk of `packed` compressed bytes.

    FREE_RECORDS are always accepted; each further record needs at least one compressed byte.
    """
    return FREE_RECORDS + packed


class ChunkedSource(Source):
    """A file of parts (chunks) that are read one after the other."""

    parts: Sequence[Part]  # in reading order

    @abstractmethod
    def search(self, part: Part, data: Bytes) -> Records:
        """Find the records in the uncompressed bytes of a part. Raises DamagedError."""

    def batches(self, wanted: Collection[int]) -> Iterator[Batch]:
        """Yield the messages of the wanted channels in file order."""
        for part in self.parts:
            if part.counts is not None and not part.counts.keys() & wanted:
                continue
            data, found = self.load(part)
            if messages := {ident: m for ident, m in found.messages.items() if ident in wanted}:
                yield Batch(data, messages)

    def load(self, part: Part) -> tuple[Bytes, Records]:
        """Return a part's uncompressed bytes and its records; record losses and message counts."""
        known = None if part.counts is None else sum(part.counts.values())
        try:
            data = np.frombuffer(self.unpacked(part), np.uint8)
            found = self.search(part, data)
        except DamagedError as problem:
            self.data.lose(str(problem), part.offset, part.size, known)
            data, found = np.empty(0, np.uint8), Records({}, [], 0)
        else:
            if found.end < len(data) or part.cut_off:
                reason = CUT_OFF if part.cut_off else NO_RECORD
                n = sum(len(m.start) for m in found.messages.values())
                missing = None if known is None else max(known - n, 0)
                self.data.lose(reason, part.offset, len(data) - found.end, missing)
        if part.counts is None:
            part.counts = {ident: len(m.start) for ident, m in found.messages.items()}
        return data, found

    def unpacked(self, part: Part) -> bytes:
        """Return the uncompressed bytes of a part. Raises DamagedError."""
        if part.size > MAX_CHUNK:
            raise DamagedError(f"a chunk is larger than {MAX_CHUNK >> 20} MiB")
        packed = self.data.read(part.start, part.size)
        if part.plain is None:
            return packed
        return (decompress_prefix if part.cut_off else decompress)(packed, part.compression, part.plain)

    def counted(self) -> Counter[int]:
        """Return channel -> number of messages in all parts."""
        total: Counter[int] = Counter()
        for part in self.parts:
            total.update(part.counts or {})
        return total
