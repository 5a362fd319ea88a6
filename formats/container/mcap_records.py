"""The MCAP records we read, as plain values. Specification: https://mcap.dev/spec."""

from __future__ import annotations

import struct
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .decompress import DamagedError

MAGIC = b"\x89MCAP0\r\n"

HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, CHUNK_INDEX = range(1, 9)
ATTACHMENT, ATTACHMENT_INDEX, STATISTICS, METADATA, METADATA_INDEX, SUMMARY_OFFSET, DATA_END = range(9, 16)
PRIVATE = 0x80  # opcodes from here on are private to an application and skipped

RECORD = struct.Struct("<BQ")  # opcode, content length
FOOTER_LENGTH = 20
TOO_SHORT = "a record is shorter than its content"
MESSAGE_HEADER = 22  # channel, sequence, log time, publish time


class Schema(NamedTuple):
    """A message definition: `encoding` is the language of `data`."""

    id: int
    name: str
    encoding: str
    data: bytes


class Channel(NamedTuple):
    """A topic as one writer declared it."""

    id: int
    schema_id: int
    topic: str
    message_encoding: str


class ChunkIndex(NamedTuple):
    """A chunk's place in the file by the summary, and the size and places of its message indexes."""

    offset: int
    length: int
    index_length: int
    indexes: dict[int, int]  # channel -> file offset of its message index
    compression: str
    packed: int  # bytes, compressed
    plain: int  # bytes, uncompressed
    first: int  # log time of the first message, ns
    last: int

    @property
    def channels(self) -> frozenset[int]:
        """The channels that have messages in the file."""
        return frozenset(self.indexes)


class Statistics(NamedTuple):
    """The counts of a file."""

    messages: int
    attachments: int
    chunks: int
    counts: dict[int, int]  # channel -> messages


# struct letter of the length in front of text, bytes, bytes, map
LENGTH = {"s": "I", "b": "I", "d": "Q", "m": "I"}


def values(data: bytes, layout: str, at: int = 0) -> list[Any]:
    """Return the values from offset `at` on, then the end offset. Raises DamagedError if one does not fit.

    Letters of the layout: B, H, I, Q integers, s a text, b and d bytes, m a map from 2-byte keys to 8-byte values.
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
    """Read a Schema record's content."""
    return Schema(*values(data, "Hssb")[:-1])


def channel(data: bytes) -> Channel:
    """Read a Channel record's content."""
    return Channel(*values(data, "HHss")[:-1])


def chunk_index(data: bytes) -> ChunkIndex:
    """Read a ChunkIndex record's content."""
    first, last, offset, length, indexes, index_length, compression, packed, plain, _ = values(data, "QQQQmQsQQ")
    return ChunkIndex(offset, length, index_length, indexes, compression, packed, plain, first, last)


def message_index(data: bytes) -> tuple[int, NDArray[Any]]:
    """Read a MessageIndex record's content: (channel, (k, 2) uint64 log time and offset in the chunk)."""
    ident, entries, _ = values(data, "Hb")
    if len(entries) % 16:
        raise DamagedError(TOO_SHORT)
    return ident, np.frombuffer(entries, "<u8").reshape(-1, 2)


def attachment(data: bytes) -> tuple[str, bytes, int]:
    """Read an Attachment record's content: (name, bytes, crc of everything before the crc; 0 = none)."""
    _, _, name, _, content, crc, _ = values(data, "QQssdI")
    return name, content, crc


def statistics(data: bytes) -> Statistics:
    """Read a Statistics record's content."""
    messages, _, _, attachments, _, chunks, _, _, counts, _ = values(data, "QHIIIIQQm")
    return Statistics(messages, attachments, chunks, counts)
