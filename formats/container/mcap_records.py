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


class ChunkHeader(NamedTuple):
    """The header in front of a chunk's bytes."""

    uncompressed_size: int
    crc: int  # 0 = not checked by the writer
    compression: str
    start: int  # of the compressed bytes, from the content's start
    length: int  # of the compressed bytes
    first: int  # log time of the first message, ns
    last: int


class ChunkIndex(NamedTuple):
    """A chunk's place by the summary, and the bytes of message indexes after it."""

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
        """The channels with messages in the file."""
        return frozenset(self.indexes)


class AttachmentIndex(NamedTuple):
    """An attachment's place by the summary."""

    offset: int
    length: int


def opcode_and_length(head: bytes) -> tuple[int, int]:
    """Read the opcode and length of any record."""
    opcode, length = RECORD.unpack_from(head)
    return int(opcode), int(length)


class Cursor:
    """Reads values from the front of a record; raises DamagedError if a value does not fit."""

    def __init__(self, data: bytes, at: int = 0) -> None:
        self.data = data
        self.at = at

    def take(self, n: int) -> bytes:
        """Return the next n bytes."""
        end = self.at + n
        if end > len(self.data):
            raise DamagedError("a record is shorter than its content")
        piece = self.data[self.at : end]
        self.at = end
        return piece

    def integers(self, layout: str) -> tuple[int, ...]:
        """Return little-endian integers by struct letters."""
        return struct.unpack("<" + layout, self.take(struct.calcsize("<" + layout)))

    def integer(self, letter: str) -> int:
        """Return one little-endian integer by its struct letter."""
        return self.integers(letter)[0]

    def text(self) -> str:
        """Return a string with a 4-byte length."""
        return self.take(self.integer("I")).decode("utf-8", "replace")

    def map(self, value: str) -> dict[int, int]:
        """Return a map from 2-byte keys to integers of struct letter `value`."""
        entry = struct.Struct("<H" + value)
        data = self.take(self.integer("I"))
        if len(data) % entry.size:
            raise DamagedError("a record is shorter than its content")
        return dict(entry.iter_unpack(data))


def schema(data: bytes) -> Schema:
    """Read a Schema record's content."""
    c = Cursor(data)
    return Schema(c.integer("H"), c.text(), c.text(), c.take(c.integer("I")))


def channel(data: bytes) -> Channel:
    """Read a Channel record's content."""
    c = Cursor(data)
    ident, schema_id = c.integers("HH")
    return Channel(ident, schema_id, c.text(), c.text())


def chunk_header(data: bytes) -> ChunkHeader:
    """Read the header in a Chunk record's content."""
    c = Cursor(data)
    first, last, size, crc = c.integers("QQQI")
    compression = c.text()
    length = c.integer("Q")
    return ChunkHeader(size, crc, compression, c.at, length, first, last)


def chunk_index(data: bytes) -> ChunkIndex:
    """Read a ChunkIndex record's content."""
    c = Cursor(data)
    first, last, offset, length = c.integers("QQQQ")
    indexes = c.map("Q")
    index_length, compression = c.integer("Q"), c.text()
    packed, plain = c.integers("QQ")
    return ChunkIndex(offset, length, index_length, indexes, compression, packed, plain, first, last)


def attachment_index(data: bytes) -> AttachmentIndex:
    """Read the header in an AttachmentIndex record's content."""
    return AttachmentIndex(*Cursor(data).integers("QQ"))


def message_index(data: bytes) -> tuple[int, NDArray[Any]]:
    """Read a MessageIndex record's content: (channel, (k, 2) uint64 log time and offset in the chunk)."""
    c = Cursor(data)
    ident, n_bytes = c.integers("HI")
    entries = c.take(n_bytes)
    if n_bytes % 16:
        raise DamagedError("a record is shorter than its content")
    return ident, np.frombuffer(entries, "<u8").reshape(-1, 2)


def attachment(data: bytes) -> tuple[str, bytes, int]:
    """Read an Attachment record's content: (name, bytes, crc of everything before the crc; 0 = none)."""
    c = Cursor(data)
    c.integers("QQ")
    name = c.text()
    c.text()
    return name, c.take(c.integer("Q")), c.integer("I")


class Statistics(NamedTuple):
    """The counts of a file."""

    messages: int
    attachments: int
    chunks: int
    counts: dict[int, int]  # channel -> messages


def statistics(data: bytes) -> Statistics:
    """Read a Statistics record's content."""
    c = Cursor(data)
    messages, _, _, attachments, _, chunks, _, _ = c.integers("QHIIIIQQ")
    return Statistics(messages, attachments, chunks, c.map("Q"))
