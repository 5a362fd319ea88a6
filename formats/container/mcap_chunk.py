"""The inside of a chunk: find every message by a valid message index, else record by record.

The index is believed only after all of it was checked at once: each entry points at a Message record of its
channel and log time, and what lies between the messages are whole Schema and Channel records.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from locfuse.formats.columns import view
from locfuse.fusion.data import Ints

from .chunked import Records, most_records
from .decompress import DamagedError
from .mcap_records import CHANNEL, DATA_END, MESSAGE, MESSAGE_HEADER, PRIVATE, RECORD, SCHEMA
from .source import Messages, by_channel

Index = dict[int, NDArray[np.uint64]]  # channel -> (k, 2) log time, offset of the record in the chunk
Definition = tuple[int, int, int]  # opcode, place and length of the content

PAYLOAD_OFFSET_BYTES = RECORD.size + MESSAGE_HEADER  # bytes from a Message record's start to its payload


def records(data: NDArray[np.uint8], index: Index | None, packed: int | None = None) -> Records:
    """Find the records of a chunk's decompressed bytes; `packed` is their number of bytes in the file.

    Raises DamagedError where so few bytes unpack to absurdly many records.
    """
    most = most_records(len(data) if packed is None else packed)
    if index is not None and (found := _by_index(data, index, most)) is not None:
        return found
    scanned = scan(data, most)
    if not index or scanned.end == len(data):
        return scanned
    return _salvage(data, scanned, index)


def scan(data: NDArray[np.uint8], most: int | None = None) -> Records:
    """Read record by record until the end or the first impossible record.

    Raises DamagedError at more than `most` records.
    """
    offsets, definitions, end = _walk(data.data, 0, len(data), len(data) if most is None else most)
    if offsets and not len(_followed(data, np.array(offsets[-1:], np.int64))):
        end = offsets.pop()
    return Records(_gather(data, np.array(offsets, np.int64)), definitions, end)


def _walk(data: memoryview, at: int, stop: int, most: int) -> tuple[list[int], list[Definition], int]:
    """Return the offsets of the messages from `at` to `stop`, the definitions, and where the records end."""
    offsets: list[int] = []
    definitions: list[Definition] = []
    for _ in range(most):
        if at + RECORD.size > stop:
            break
        opcode, length = RECORD.unpack_from(data, at)
        end = at + RECORD.size + length
        if end > stop or not _allowed(opcode, length):
            break
        if opcode == MESSAGE:
            offsets.append(at)
        elif opcode < PRIVATE:
            definitions.append((opcode, at + RECORD.size, length))
        at = end
    else:
        if at + RECORD.size <= stop:
            raise DamagedError(f"a chunk unpacks to more than {most} records, the cap for its size")
    return offsets, definitions, at


def _allowed(opcode: int, length: int) -> bool:
    return (opcode == MESSAGE and length >= MESSAGE_HEADER) or opcode in {SCHEMA, CHANNEL} or opcode >= PRIVATE


def _gather(data: NDArray[np.uint8], offsets: Ints) -> dict[int, Messages]:
    """Group Message records by channel."""
    if not len(offsets):
        return {}
    channel = view(data, "<u2", offsets + RECORD.size)
    everything = Messages(
        offsets + PAYLOAD_OFFSET_BYTES,
        view(data, "<u8", offsets + 1).astype(np.int64) - MESSAGE_HEADER,
        view(data, "<u8", offsets + RECORD.size + 6).astype(np.int64),
        view(data, "<u4", offsets + RECORD.size + 2).astype(np.int64),
    )
    return by_channel(channel, everything)


def credible(
    data: NDArray[np.uint8], channel: Ints, log_time: NDArray[np.uint64], offsets: Ints
) -> NDArray[np.bool_]:
    """Return which index entries (k,) point at a Message record of their channel and log time."""
    if len(data) < PAYLOAD_OFFSET_BYTES:
        return np.zeros(len(offsets), bool)
    inside = (offsets >= 0) & (offsets <= len(data) - PAYLOAD_OFFSET_BYTES)
    at = np.where(inside, offsets, 0)
    length = view(data, "<u8", at + 1)
    found: NDArray[np.bool_] = (
        inside
        & (data[at] == MESSAGE)
        & (view(data, "<u2", at + RECORD.size) == channel)
        & (view(data, "<u8", at + RECORD.size + 6) == log_time)
        & (length >= MESSAGE_HEADER)
        & (length <= (len(data) - RECORD.size - at).astype(np.uint64))
    )
    return found


def _flatten(index: Index) -> tuple[Ints, NDArray[np.uint64], Ints]:
    """Return all entries as columns (channel, log time, offset), sorted by offset."""
    entries = np.concatenate([np.empty((0, 2), "<u8"), *index.values()])
    channel = np.repeat(np.array(list(index), np.int64), [len(part) for part in index.values()])
    offsets = entries[:, 1].astype(np.int64)
    order = np.argsort(offsets, kind="stable")
    return channel[order], entries[order, 0], offsets[order]


def _by_index(data: NDArray[np.uint8], index: Index, most: int) -> Records | None:
    channel, log_time, offsets = _flatten(index)
    if not credible(data, channel, log_time, offsets).all():
        return None
    ends = offsets + RECORD.size + view(data, "<u8", offsets + 1).astype(np.int64)
    definitions: list[Definition] = []
    for at, stop in _gaps(offsets, ends, len(data)):
        if at > stop:
            return None
        missed, between, end = _walk(data.data, at, stop, most)
        if missed or end != stop:
            return None
        definitions += between
    start = offsets + PAYLOAD_OFFSET_BYTES
    everything = Messages(
        start, ends - start, log_time.astype(np.int64), view(data, "<u4", offsets + 11).astype(np.int64)
    )
    return Records(by_channel(channel, everything), definitions, len(data))


def _gaps(offsets: Ints, ends: Ints, size: int) -> Iterator[tuple[int, int]]:
    """Yield the byte ranges between the messages (overlaps come out with start > stop)."""
    starts = np.concatenate(([0], ends))
    stops = np.concatenate((offsets, [size]))
    for i in np.flatnonzero(starts != stops):
        yield int(starts[i]), int(stops[i])


def _salvage(data: NDArray[np.uint8], scanned: Records, index: Index) -> Records:
    """Read a damaged chunk: messages that the index lists and the bytes confirm, before and after the damage."""
    channel, log_time, offsets = _flatten(index)
    good = offsets[credible(data, channel, log_time, offsets)]
    return Records(_gather(data, _followed(data, _disjoint(data, good))), scanned.definitions, scanned.end)


def _followed(data: NDArray[np.uint8], offsets: Ints) -> Ints:
    """Return the messages (offsets) after which a valid record follows; others contain the damage."""
    ends = offsets + RECORD.size + view(data, "<u8", offsets + 1).astype(np.int64)
    inside = ends < len(data)
    opcode = data[np.where(inside, ends, 0)]
    kept: Ints = offsets[
        (ends == len(data)) | (inside & (opcode != 0) & ((opcode <= DATA_END) | (opcode >= PRIVATE)))
    ]
    return kept


def _disjoint(data: NDArray[np.uint8], offsets: Ints) -> Ints:
    kept: list[int] = []
    end = 0
    for offset in offsets.tolist():
        if offset >= end:
            kept.append(offset)
            end = offset + RECORD.size + RECORD.unpack_from(data.data, offset)[1]
    return np.array(kept, np.int64)
