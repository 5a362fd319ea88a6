"""Parsing of the MCAP records that locfuse reads: single records, and all records of a chunk.

Specification: https://mcap.dev/spec.
"""

from __future__ import annotations

import struct
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from locfuse.formats.columns import Bytes, view
from locfuse.fusion.data import Ints

from .decompress import DamagedError
from .source import Messages, Records, by_channel, most_records

MAGIC = b"\x89MCAP0\r\n"

HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, CHUNK_INDEX = range(1, 9)
ATTACHMENT, ATTACHMENT_INDEX, STATISTICS, METADATA, METADATA_INDEX, SUMMARY_OFFSET, DATA_END = range(9, 16)
PRIVATE = 0x80  # opcodes from here on are private to an application and skipped

RECORD = struct.Struct("<BQ")  # opcode, content length
FOOTER_LENGTH = 20
TOO_SHORT = "a record is shorter than its content"
MESSAGE_HEADER = 22  # channel, sequence, log time, publish time


class Schema(NamedTuple):
    """A message definition `data` in the language `encoding` (ros2msg, protobuf, ...)."""

    id: int
    name: str
    encoding: str
    data: bytes


class Channel(NamedTuple):
    """A channel: the messages of one topic from one writer."""

    id: int
    schema_id: int
    topic: str
    message_encoding: str


class ChunkIndex(NamedTuple):
    """A ChunkIndex record of the summary: offsets of a chunk and of its message indexes."""

    offset: int
    length: int
    index_length: int
    indexes: dict[int, int]  # channel -> file offset of its message index
    compression: str
    packed: int  # bytes, compressed
    plain: int  # bytes, uncompressed
    first: int  # log time of the first message, ns
    last: int


class Statistics(NamedTuple):
    """The numbers of messages, attachments and chunks of a file."""

    messages: int
    attachments: int
    chunks: int
    counts: dict[int, int]  # channel -> messages


# layout letter (text, bytes, bytes, map) -> struct letter of the length word before the value
LENGTH = {"s": "I", "b": "I", "d": "Q", "m": "I"}


def values(data: bytes, layout: str, at: int = 0) -> list[Any]:
    """Parse values in the order of `layout`, from offset `at` on; return the values and their end offset.

    Letters of the layout: B, H, I, Q an integer, s a text, b bytes with a 4-byte length, d bytes with an 8-byte
    length, m a map from 2-byte keys to 8-byte values. Raises DamagedError if the data end too early.
    """
    found: list[Any] = []
    try:
        for letter in layout:
            (value,) = struct.unpack_from("<" + LENGTH.get(letter, letter), data, at)
            at += struct.calcsize("<" + LENGTH.get(letter, letter))
            if letter in LENGTH:
                piece = data[at : at + value]
                if len(piece) < value or (letter == "m" and value % 10):
                    raise DamagedError(TOO_SHORT)
                at += value
                value = piece.decode("utf-8", "replace") if letter == "s" else piece
                if letter == "m":
                    value = dict(struct.iter_unpack("<HQ", piece))
            found.append(value)
    except struct.error:
        raise DamagedError(TOO_SHORT) from None
    return [*found, at]


def schema(data: bytes) -> Schema:
    """Parse the content of a Schema record."""
    return Schema(*values(data, "Hssb")[:-1])


def channel(data: bytes) -> Channel:
    """Parse the content of a Channel record."""
    return Channel(*values(data, "HHss")[:-1])


def chunk_index(data: bytes) -> ChunkIndex:
    """Parse the content of a ChunkIndex record."""
    first, last, offset, length, indexes, index_length, compression, packed, plain, _ = values(data, "QQQQmQsQQ")
    return ChunkIndex(offset, length, index_length, indexes, compression, packed, plain, first, last)


def message_index(data: bytes) -> tuple[int, NDArray[Any]]:
    """Parse the content of a MessageIndex record: (channel, (k, 2) uint64 log time and offset in the chunk)."""
    ident, entries, _ = values(data, "Hb")
    if len(entries) % 16:
        raise DamagedError(TOO_SHORT)
    return ident, np.frombuffer(entries, "<u8").reshape(-1, 2)


def attachment(data: bytes) -> tuple[str, bytes, int]:
    """Parse the content of an Attachment record: (name, bytes, CRC-32 of the content before it; 0: no CRC)."""
    _, _, name, _, content, crc, _ = values(data, "QQssdI")
    return name, content, crc


def statistics(data: bytes) -> Statistics:
    """Parse the content of a Statistics record."""
    messages, _, _, attachments, _, chunks, _, _, counts, _ = values(data, "QHIIIIQQm")
    return Statistics(messages, attachments, chunks, counts)


# --- The messages of a chunk: record by record, and after damage by the chunk's message indexes
# An index entry is used only if it points to a Message record of its channel and log time.

Index = dict[int, NDArray[np.uint64]]  # channel -> (k, 2) log time [ns], offset of the record in the chunk
Definition = tuple[int, int, int]  # opcode, offset and length of the content

PAYLOAD_OFFSET_BYTES = RECORD.size + MESSAGE_HEADER  # bytes from a Message record's start to its payload


def records(data: Bytes, packed: int, index: Index) -> Records:
    """Find the records in a chunk's decompressed bytes; `packed` is its compressed size [bytes].

    `index` locates messages after damage. Raises DamagedError for more records than `most_records(packed)`.
    """
    scanned = scan(data, most_records(packed))
    if scanned.end == len(data) or not index:
        return scanned
    offsets: list[int] = []
    end = 0
    for offset in _confirmed(data, index).tolist():
        if offset >= end:  # not inside the message before
            offsets.append(offset)
            end = offset + RECORD.size + RECORD.unpack_from(data.data, offset)[1]
    followed = _followed(data, np.array(offsets, np.int64))
    return Records(_gather(data, followed), scanned.definitions, scanned.end)


def scan(data: Bytes, most: int | None = None) -> Records:
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


def _gather(data: Bytes, offsets: Ints) -> dict[int, Messages]:
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


def _confirmed(data: Bytes, index: Index) -> Ints:
    """Return the offsets of index entries that point to a Message record of their channel and log time."""
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


def _followed(data: Bytes, offsets: Ints) -> Ints:
    """Return those `offsets` of messages after which a valid record or the end of the data follows.

    A message that is left out contains the damage.
    """
    ends = offsets + RECORD.size + view(data, "<u8", offsets + 1).astype(np.int64)
    inside = ends < len(data)
    opcode = data[np.where(inside, ends, 0)]
    valid = (opcode != 0) & ((opcode <= DATA_END) | (opcode >= PRIVATE))
    kept: Ints = offsets[(ends == len(data)) | (inside & valid)]
    return kept
