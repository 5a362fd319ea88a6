"""Parsing of the MCAP records that locfuse reads. Specification: https://mcap.dev/spec."""

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

    @property
    def channels(self) -> frozenset[int]:
        """The channels with messages in this chunk."""
        return frozenset(self.indexes)


class Statistics(NamedTuple):
    """The numbers of messages, attachments and chunks of a file."""

    messages: int
    attachments: int
    chunks: int
    counts: dict[int, int]  # channel -> messages


# struct letter of the length that precedes text, bytes, bytes, map
LENGTH = {"s": "I", "b": "I", "d": "Q", "m": "I"}


def values(data: bytes, layout: str, at: int = 0) -> list[Any]:
    """Parse values in the order of `layout` from offset `at` on; return them, then the offset of their end.

    Raises DamagedError if the data end too early.

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
    """Parse the content of an Attachment record: (name, bytes, CRC-32 of all before it; 0 = none)."""
    _, _, name, _, content, crc, _ = values(data, "QQssdI")
    return name, content, crc


def statistics(data: bytes) -> Statistics:
    """Parse the content of a Statistics record."""
    messages, _, _, attachments, _, chunks, _, _, counts, _ = values(data, "QHIIIIQQm")
    return Statistics(messages, attachments, chunks, counts)
