"""The records of a ROS 1 bag (format 2.0). Format: https://wiki.ros.org/Bags/Format/2.0."""

from __future__ import annotations

import struct
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from locfuse.fusion.data import Ints

from .decompress import DamagedError
from .file_bytes import FileBytes

MAGIC = b"#ROSBAG V2.0\n"
MESSAGE, BAG_HEADER, INDEX, CHUNK, CHUNK_INFO, CONNECTION = range(2, 8)
WORD = struct.Struct("<I")
TIME = struct.Struct("<II")  # seconds, nanoseconds
HEAD_BYTES = 1 << 16  # record headers are read up to this size

Fields = dict[bytes, bytes]


class Entry(NamedTuple):
    """One record: its fields, and where its data lies."""

    at: int
    op: int
    fields: Fields
    start: int
    length: int

    @property
    def end(self) -> int:
        """Where the next record begins."""
        return self.start + self.length

    def number(self, name: bytes) -> int:
        """Return a 4-byte field."""
        value = self.fields.get(name, b"")
        if len(value) != WORD.size:
            raise DamagedError("a record without its fields")
        return int(WORD.unpack(value)[0])

    def time_ns(self, name: bytes) -> int:
        """Return a time field in nanoseconds."""
        value = self.fields.get(name, b"")
        if len(value) != TIME.size:
            raise DamagedError("a record without its fields")
        seconds, nanoseconds = TIME.unpack(value)
        return int(seconds) * 10**9 + int(nanoseconds)


def read_entry(data: FileBytes, at: int) -> Entry:
    """Read the record at a file offset. Raises DamagedError for what is none."""
    word = data.read(at, WORD.size)
    n = WORD.unpack(word)[0] if len(word) == WORD.size else HEAD_BYTES
    header = data.read(at + WORD.size, min(n, HEAD_BYTES) + WORD.size)
    if n > HEAD_BYTES - WORD.size or len(header) < n + WORD.size:
        raise DamagedError("bytes that are no record")
    found = fields(header[:n])
    op = found.get(b"op", b"")
    if len(op) != 1:
        raise DamagedError("bytes that are no record")
    return Entry(at, op[0], found, at + 2 * WORD.size + n, int(WORD.unpack_from(header, n)[0]))


def fields(header: bytes) -> Fields:
    """Read the name=value fields of a record header."""
    found: Fields = {}
    at = 0
    while at < len(header):
        if at + 4 > len(header):
            raise DamagedError("a record header that contradicts itself")
        (n,) = WORD.unpack_from(header, at)
        name, equals, value = header[at + 4 : at + 4 + n].partition(b"=")
        at += 4 + n
        if at > len(header) or not equals:
            raise DamagedError("a record header that contradicts itself")
        found[name] = value
    return found


class Scanned(NamedTuple):
    """The records inside a chunk."""

    connections: dict[int, tuple[Fields, bytes]]  # id -> (fields, data)
    connection: Ints  # (k,) of every message
    time_ns: Ints  # (k,)
    start: Ints  # (k,) payload in the chunk
    length: Ints  # (k,)
    end: int  # where the records stop making sense


def scan(data: NDArray[np.uint8], most: int) -> Scanned:
    """Walk a chunk's decompressed bytes record by record. Raises DamagedError at more than `most` records."""
    buffer = data.data
    connections: dict[int, tuple[Fields, bytes]] = {}
    rows: list[tuple[int, int, int, int]] = []
    at = count = 0
    while at < len(buffer):
        count += 1
        if count > most:
            raise DamagedError(f"a chunk unpacks to more than {most} records, the cap for its size")
        try:
            entry = _entry(buffer, at)
            _take(entry, buffer, rows, connections)
        except (struct.error, DamagedError):
            break
        at = entry.end
    connection, time_ns, start, length = np.array(rows, np.int64).reshape(-1, 4).T
    return Scanned(connections, connection, time_ns, start, length, at)


def _entry(buffer: memoryview, at: int) -> Entry:
    (n,) = WORD.unpack_from(buffer, at)
    (length,) = WORD.unpack_from(buffer, at + WORD.size + n)
    start = at + 2 * WORD.size + n
    if start + length > len(buffer):
        raise DamagedError("a record reaches beyond its chunk")
    found = fields(bytes(buffer[at + WORD.size : start - WORD.size]))
    return Entry(at, (found.get(b"op") or b"\x00")[0], found, start, length)


def _take(
    entry: Entry,
    buffer: memoryview,
    rows: list[tuple[int, int, int, int]],
    connections: dict[int, tuple[Fields, bytes]],
) -> None:
    if entry.op == MESSAGE:
        rows.append((entry.number(b"conn"), entry.time_ns(b"time"), entry.start, entry.length))
    elif entry.op == CONNECTION:
        connections[entry.number(b"conn")] = entry.fields, bytes(buffer[entry.start : entry.end])
    else:
        raise DamagedError("bytes that are no record")
