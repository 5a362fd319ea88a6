"""Messages of a remote file by byte ranges: single messages of stored chunks, whole compressed chunks.

The message indexes of a stored chunk hold where its messages begin; each ends where the next one begins, of
whatever channel.
The bytes that come are held against index and summary as far as they can be: a chunk's checksum needs all of it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from locfuse.formats.columns import view
from locfuse.fusion.data import Ints

from . import mcap_records as rec
from .decompress import DamagedError
from .file_bytes import FileBytes
from .losses import Losses
from .mcap_chunk import PAYLOAD_OFFSET_BYTES, credible
from .mcap_survey import (
    CHUNK_HEAD,
    LARGE_CHUNK_BYTES,
    ChunkRef,
    FileSummary,
    Part,
    Survey,
    put_in_order,
    read_summary,
)
from .source import Messages

CHUNK_FRONT = 8 + 8 + 8 + 4 + 4 + 8  # bytes before a chunk's content, but for the name of the compression
INDEX_FRONT = 2 + 4  # bytes of a message index before its entries
ENTRY_BYTES = 16  # bytes


def promised(data: FileBytes) -> Survey | None:
    """Return the survey by a file's summary; None if the summary is not reliable without reading the file."""
    summary = read_summary(data)
    if summary is None or summary.statistics is None:
        return None
    parts = [_chunk(entry) for _, entry in sorted(summary.chunks.items())]
    chunks = [part for part in parts if part is not None]
    if len(chunks) < len(parts) or not _consistent(summary, summary.statistics, chunks):
        return None
    found: list[Part] = list(chunks)
    put_in_order(found)
    return Survey(
        found,
        summary.schemas,
        summary.channels,
        [(a.offset + rec.RECORD.size, a.length - rec.RECORD.size) for a in sorted(summary.attachments)],
        summary.counts,
    )


def _chunk(entry: rec.ChunkIndex) -> ChunkRef | None:
    """Return a chunk with its message indexes; None if its entry contradicts itself or it is too large."""
    front = CHUNK_FRONT + len(entry.compression.encode())
    if entry.length != rec.RECORD.size + front + entry.packed:
        return None
    if not entry.compression and entry.packed > LARGE_CHUNK_BYTES:
        return None
    header = rec.ChunkHeader(entry.plain, 0, entry.compression, front, entry.packed, entry.first, entry.last)
    indexes = _indexes(entry)
    if indexes is None:
        return None
    counts = {ident: (length - INDEX_FRONT) // ENTRY_BYTES for ident, (_, length) in indexes.items()}
    return ChunkRef(entry.offset, header, indexes, available=entry.packed, counts=counts, promised=True)


def _indexes(entry: rec.ChunkIndex) -> dict[int, tuple[int, int]] | None:
    """Return channel -> (file offset, length) of the message indexes, which follow the chunk without a gap."""
    begin = entry.offset + entry.length
    order = sorted((at, ident) for ident, at in entry.indexes.items())
    ends = [*(at for at, _ in order[1:]), begin + entry.index_length]
    found = {}
    if not order or order[0][0] != begin:
        return None
    for (at, ident), end in zip(order, ends, strict=True):
        length = end - at - rec.RECORD.size
        if length < INDEX_FRONT or (length - INDEX_FRONT) % ENTRY_BYTES:
            return None
        found[ident] = (at + rec.RECORD.size, length)
    return found


def _consistent(summary: FileSummary, statistics: rec.Statistics, chunks: list[ChunkRef]) -> bool:
    """Return whether chunks, counts and definitions agree: then no needed record lies between the chunks."""
    total: Counter[int] = Counter()
    for chunk in chunks:
        total.update(chunk.counts or {})
    ends = [chunk.start + chunk.size for chunk in chunks]
    apart = all(b.offset >= end for (_, b), end in zip(pairwise(chunks), ends, strict=False))
    return (
        total == Counter(statistics.counts)
        and total.total() == statistics.messages
        and len(chunks) == statistics.chunks
        and len(summary.attachments) == statistics.attachments
        and total.keys() <= summary.channels.keys()
        and all(summary.channels[ident].schema_id in {0, *summary.schemas} for ident in total)
        and apart
        and (not ends or ends[-1] <= summary.start)
        and all(a.length > rec.RECORD.size for a in summary.attachments)
    )


# --- Messages by ranges: of stored chunks the messages alone, of packed ones the whole chunk

Span = tuple[int, int]  # start, stop [bytes] in the file

GROUP_BYTES = 16 * 1024 * 1024  # wanted at once
ANOTHER_HEADER = "a chunk is not what the summary says"
ELSEWHERE = "messages are not where the index says"


class WantedChunk:
    """The wanted messages of one chunk, and its place in the file."""

    def __init__(self, data: FileBytes, chunk: ChunkRef, channels: Collection[int]) -> None:
        self.chunk = chunk
        self.whole = bool(chunk.header.compression) or (chunk.counts or {}).keys() <= set(channels)
        self._data = data
        self._channels = channels
        self._found: tuple[Ints, NDArray[np.uint64], Ints, Ints] | None = None

    @property
    def index_span(self) -> Span:
        """Where the message indexes of the chunk lie."""
        begins = [at for at, _ in self.chunk.index.values()]
        ends = [at + length for at, length in self.chunk.index.values()]
        return min(begins), max(ends)

    @property
    def _places(self) -> tuple[Ints, NDArray[np.uint64], Ints, Ints]:
        """Channel, log time, start and stop in the chunk of all wanted messages. Raises DamagedError."""
        if self._found is None:
            self._found = _places(self._data, self.chunk, self._channels)
        return self._found

    @property
    def spans(self) -> list[Span]:
        """The ranges to load before it is read."""
        if self.whole:
            return [(self.chunk.offset, self.index_span[1])]
        try:
            _, _, start, stop = self._places
        except DamagedError:
            return []
        return list(zip((self.chunk.start + start).tolist(), (self.chunk.start + stop).tolist(), strict=True))

    @property
    def n_bytes(self) -> int:
        """How many bytes are wanted."""
        return sum(stop - start for start, stop in self.spans)

    def messages(self, losses: Losses) -> tuple[NDArray[np.uint8], dict[int, Messages]]:
        """Return the records of the wanted messages in one buffer, and their offsets in it."""
        name, at = str(self._data.path), self.chunk.offset
        try:
            channel, log_time, start, stop = self._places
        except DamagedError as problem:
            lost = sum(n for ident, n in (self.chunk.counts or {}).items() if ident in self._channels)
            losses.add(name, str(problem), at, self.chunk.size, lost)
            return np.empty(0, np.uint8), {}
        pieces = [self._data.read(a, b - a) for a, b in self.spans]
        data = np.frombuffer(b"".join(pieces), np.uint8)
        offsets = np.concatenate(([0], np.cumsum(stop - start)[:-1])).astype(np.int64)
        good = credible(data, channel, log_time, offsets)
        length = np.zeros(len(offsets), np.int64)
        length[good] = view(data, "<u8", offsets[good] + 1).astype(np.int64)
        good &= rec.RECORD.size + length <= stop - start
        if not good.all():
            losses.add(name, ELSEWHERE, at, int((stop - start)[~good].sum()), int((~good).sum()))
        return data, _by_channel(data, channel[good], log_time[good], offsets[good], length[good])


def _places(
    data: FileBytes, chunk: ChunkRef, channels: Collection[int]
) -> tuple[Ints, NDArray[np.uint64], Ints, Ints]:
    found = [rec.message_index(data.read(at, length)) for at, length in chunk.index.values()]
    if [ident for ident, _ in found] != list(chunk.index):
        raise DamagedError("a message index that contradicts itself")
    entries = np.concatenate([pairs for _, pairs in found])
    channel = np.repeat([ident for ident, _ in found], [len(pairs) for _, pairs in found])
    order = np.argsort(entries[:, 1], kind="stable")
    start = entries[order, 1].astype(np.int64)
    stop = np.append(start[1:], chunk.header.uncompressed_size)
    if len(start) and (start[0] < 0 or (stop - start < PAYLOAD_OFFSET_BYTES).any()):
        raise DamagedError("a message index that contradicts itself")
    wanted = np.isin(channel[order], list(channels))
    return channel[order][wanted], entries[order, 0][wanted], start[wanted], stop[wanted]


def _by_channel(
    data: NDArray[np.uint8], channel: Ints, log_time: NDArray[np.uint64], offsets: Ints, length: Ints
) -> dict[int, Messages]:
    everything = Messages(
        offsets + PAYLOAD_OFFSET_BYTES,
        length - rec.MESSAGE_HEADER,
        log_time.astype(np.int64),
        view(data, "<u4", offsets + rec.RECORD.size + 2).astype(np.int64),
    )
    return {int(ident): everything.take(channel == ident) for ident in np.unique(channel)}


def wanted_of(data: FileBytes, chunks: Sequence[ChunkRef], channels: Collection[int]) -> list[WantedChunk]:
    """Return the wanted parts of the chunks, after loading the message indexes."""
    found = [WantedChunk(data, chunk, channels) for chunk in chunks]
    data.fetch(one.index_span for one in found if not one.whole)
    return found


def fetched(data: FileBytes, wanted: Sequence[WantedChunk]) -> Iterator[WantedChunk]:
    """Yield the wanted chunks after their bytes were fetched, several chunks in one request."""
    group: list[WantedChunk] = []
    size = 0
    for one in wanted:
        group.append(one)
        size += one.n_bytes
        if size >= GROUP_BYTES:
            yield from _at_hand(data, group)
            group, size = [], 0
    yield from _at_hand(data, group)


def _at_hand(data: FileBytes, group: Sequence[WantedChunk]) -> Iterator[WantedChunk]:
    data.fetch(span for one in group for span in one.spans)
    yield from group


def own_header(data: FileBytes, chunk: ChunkRef) -> rec.ChunkHeader:
    """Return a chunk's own header. Raises DamagedError if it differs from the summary's."""
    head = data.read(chunk.offset, CHUNK_HEAD)
    opcode, _ = rec.opcode_and_length(head)
    header = rec.chunk_header(head[rec.RECORD.size :])
    if opcode != rec.CHUNK or header._replace(crc=0) != chunk.header._replace(crc=0):
        raise DamagedError(ANOTHER_HEADER)
    return header
