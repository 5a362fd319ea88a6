"""Finding the messages of an MCAP chunk: record by record, and after damage by the chunk's message indexes.

An index entry counts only if it points at a Message record of its channel and log time.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from locfuse.formats.columns import view
from locfuse.fusion.data import Ints

from .chunked import Records, most_records
from .decompress import DamagedError
from .mcap_records import CHANNEL, DATA_END, MESSAGE, MESSAGE_HEADER, PRIVATE, RECORD, SCHEMA
from .source import Messages, by_channel

Index = dict[int, NDArray[np.uint64]]  # channel -> (k, 2) log time [ns], offset of the record in the chunk
Definition = tuple[int, int, int]  # opcode, offset and length of the content

PAYLOAD_OFFSET_BYTES = RECORD.size + MESSAGE_HEADER  # bytes from a Message record's start to its payload


def records(data: NDArray[np.uint8], packed: int, index: Index) -> Records:
    """Find the records in a chunk's decompressed bytes; `packed` is its compressed size [bytes].

    `index` locates messages after damage. Raises DamagedError for more records than `most_records(packed)`.
    """
    scanned = scan(data, most_records(packed))
    if scanned.end == len(data) or not index:
        return scanned
    offsets = _disjoint(data, _confirmed(data, index))
    return Records(_gather(data, _followed(data, offsets)), scanned.definitions, scanned.end)


def scan(data: NDArray[np.uint8], most: int | None = None) -> Records:
    """Read the records of a chunk up to its end or the first invalid record.

    Raises DamagedError at more than `most` records.
    """
    most = len(data) if most is None else most
    view_of, size, at = data.data, len(data), 0
    offsets: list[int] = []
    definitions: list[Definition] = []
    for _ in range(most):
        if at + RECORD.size > size:
            break
        opcode, length = RECORD.unpack_from(view_of, at)
        end = at + RECORD.size + length
        valid = length >= MESSAGE_HEADER if opcode == MESSAGE else opcode in {SCHEMA, CHANNEL} or opcode >= PRIVATE
        if end > size or not valid:
            break
        if opcode == MESSAGE:
            offsets.append(at)
        elif opcode < PRIVATE:
            definitions.append((opcode, at + RECORD.size, length))
        at = end
    else:
        if at + RECORD.size <= size:
            raise DamagedError(f"a chunk unpacks to more than {most} records, the cap for its size")
    if offsets and not len(_followed(data, np.array(offsets[-1:], np.int64))):
        at = offsets.pop()
    return Records(_gather(data, np.array(offsets, np.int64)), definitions, at)


def _gather(data: NDArray[np.uint8], offsets: Ints) -> dict[int, Messages]:
    """Return the Message records at these offsets, by channel."""
    if not len(offsets):
        return {}
    channel = view(data, "<u2", offsets + RECORD.size)
    everything = Messages(
        offsets + PAYLOAD_OFFSET_BYTES,
        view(data, "<u8", offsets + 1).astype(np.int64) - MESSAGE_HEADER,
        view(data, "<u8", offsets + RECORD.size + 6).astype(np.int64),
        view(data, "<u4", offsets + RECORD.size + 2).astype(np.int64),
        view(data, "<u8", offsets + RECORD.size + 14).astype(np.int64),
    )
    return by_channel(channel, everything)


def _confirmed(data: NDArray[np.uint8], index: Index) -> Ints:
    """Return the offsets of index entries that point at a Message record with their channel and log time."""
    entries = np.concatenate([np.empty((0, 2), "<u8"), *index.values()])
    channel = np.repeat(np.array(list(index), np.int64), [len(part) for part in index.values()])
    log_time, offsets = entries[:, 0], entries[:, 1].astype(np.int64)
    if len(data) < PAYLOAD_OFFSET_BYTES:
        return offsets[:0]
    inside = (offsets >= 0) & (offsets <= len(data) - PAYLOAD_OFFSET_BYTES)
    at = np.where(inside, offsets, 0)
    length = view(data, "<u8", at + 1)
    good = (
        inside
        & (data[at] == MESSAGE)
        & (view(data, "<u2", at + RECORD.size) == channel)
        & (view(data, "<u8", at + RECORD.size + 6) == log_time)
        & (length >= MESSAGE_HEADER)
        & (length <= (len(data) - RECORD.size - at).astype(np.uint64))
    )
    return np.sort(offsets[good])


def _followed(data: NDArray[np.uint8], offsets: Ints) -> Ints:
    """Return those `offsets` of messages that end at a valid record or at the end of the data.

    Any other message contains the damage.
    """
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
