"""The survey of a file that is elsewhere: what its summary promises, without a look at the rest.

The walk (survey) would touch every chunk. Here the summary is believed where all it says fits together; what is
read later is held against it then. A file whose summary is missing or contradicts itself is copied and walked.
"""

from __future__ import annotations

from collections import Counter
from itertools import pairwise

from . import mcap_records as rec
from .file_bytes import FileBytes
from .mcap_parts import ChunkRef, Part, Survey, put_in_order
from .mcap_summary import Summary, read_summary
from .mcap_survey import LARGE_CHUNK_BYTES

CHUNK_FRONT = 8 + 8 + 8 + 4 + 4 + 8  # bytes before a chunk's content, but for the name of the compression
INDEX_FRONT = 2 + 4  # bytes of a message index before its entries
ENTRY = 16  # bytes


def promised(data: FileBytes) -> Survey | None:
    """Return what the summary of a file says, None where it cannot be believed without a walk."""
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
    """Return a chunk with its message indexes, None where the entry contradicts itself or it is too large."""
    front = CHUNK_FRONT + len(entry.compression.encode())
    if entry.length != rec.RECORD.size + front + entry.packed:
        return None
    if not entry.compression and entry.packed > LARGE_CHUNK_BYTES:
        return None
    header = rec.ChunkHeader(entry.plain, 0, entry.compression, front, entry.packed, entry.first, entry.last)
    indexes = _indexes(entry)
    if indexes is None:
        return None
    counts = {ident: (length - INDEX_FRONT) // ENTRY for ident, (_, length) in indexes.items()}
    return ChunkRef(entry.offset, header, indexes, available=entry.packed, counts=counts, promised=True)


def _indexes(entry: rec.ChunkIndex) -> dict[int, tuple[int, int]] | None:
    """Return channel -> (file offset, length) of the message indexes, which lie behind the chunk without a gap."""
    begin = entry.offset + entry.length
    order = sorted((at, ident) for ident, at in entry.indexes.items())
    ends = [*(at for at, _ in order[1:]), begin + entry.index_length]
    found = {}
    if not order or order[0][0] != begin:
        return None
    for (at, ident), end in zip(order, ends, strict=True):
        length = end - at - rec.RECORD.size
        if length < INDEX_FRONT or (length - INDEX_FRONT) % ENTRY:
            return None
        found[ident] = (at + rec.RECORD.size, length)
    return found


def _consistent(summary: Summary, statistics: rec.Statistics, chunks: list[ChunkRef]) -> bool:
    """Tell whether chunks, counts and definitions agree: then nothing lies between the chunks that matters."""
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
