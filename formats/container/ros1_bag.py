"""Reading a ROS 1 bag chunk by chunk, also one that was cut off.

Format 2.0: https://wiki.ros.org/Bags/Format/2.0.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable
from contextlib import suppress
from typing import NamedTuple

import numpy as np

from locfuse.formats.columns import Bytes
from locfuse.fusion.data import LocfuseError

from .decompress import DamagedError
from .file_bytes import FileBytes
from .source import ChannelInfo, ChunkedSource, Messages, Part, Records, by_channel, most_records

MAGIC = b"#ROSBAG V2.0\n"
MESSAGE, BAG_HEADER, INDEX, CHUNK, CHUNK_INFO, CONNECTION = range(2, 8)
UINT32 = struct.Struct("<I")
TIME = struct.Struct("<II")  # seconds, nanoseconds
HEAD_BYTES = 1 << 16  # record headers are read up to this size

Fields = dict[bytes, bytes]


class BagRecord(NamedTuple):
    """A record of a bag: its header fields, and the offset and length of its data."""

    at: int
    op: int
    fields: Fields
    start: int
    length: int

    @property
    def end(self) -> int:
        """The offset of the next record."""
        return self.start + self.length

    def numbers(self, name: bytes, layout: struct.Struct = UINT32) -> tuple[int, ...]:
        """Return the integers in a header field. Raises DamagedError if the field is missing."""
        value = self.fields.get(name, b"")
        if len(value) != layout.size:
            raise DamagedError("a record without its fields")
        return layout.unpack(value)

    @property
    def connection(self) -> int:
        """The connection id in the header."""
        return self.numbers(b"conn")[0]

    def time_ns(self, name: bytes) -> int:
        """Return a time field of the header, ns."""
        seconds, nanoseconds = self.numbers(name, TIME)
        return seconds * 10**9 + nanoseconds


def read_entry(read: Callable[[int, int], bytes | memoryview], at: int) -> BagRecord:
    """Read the record at an offset; `read` takes (offset, number of bytes).

    Raises DamagedError if there is no record.
    """
    word = read(at, UINT32.size)
    n = UINT32.unpack(word)[0] if len(word) == UINT32.size else HEAD_BYTES
    header = read(at + UINT32.size, min(n, HEAD_BYTES) + UINT32.size)
    if n > HEAD_BYTES - UINT32.size or len(header) < n + UINT32.size:
        raise DamagedError("bytes that are no record")
    found = fields_of(bytes(header[:n]))
    op = found.get(b"op", b"")
    if len(op) != 1:
        raise DamagedError("bytes that are no record")
    return BagRecord(at, op[0], found, at + 2 * UINT32.size + n, int(UINT32.unpack_from(header, n)[0]))


def fields_of(header: bytes) -> Fields:
    """Parse the name=value fields of a record header."""
    found: Fields = {}
    at = 0
    while at < len(header):
        if at + 4 > len(header):
            raise DamagedError("a record header that contradicts itself")
        (n,) = UINT32.unpack_from(header, at)
        name, equals, value = header[at + 4 : at + 4 + n].partition(b"=")
        at += 4 + n
        if at > len(header) or not equals:
            raise DamagedError("a record header that contradicts itself")
        found[name] = value
    return found


Connection = tuple[int, Fields, bytes]  # id, fields, data


def scan_chunk(data: Bytes, most: int) -> Records:
    """Read the records of a chunk; the definitions in the result are of type Connection.

    Raises DamagedError at more than `most` records.
    """
    buffer = data.data
    connections: dict[int, Connection] = {}
    rows: list[tuple[int, int, int, int]] = []
    at = count = 0
    while at < len(buffer):
        count += 1
        if count > most:
            raise DamagedError(f"a chunk unpacks to more than {most} records, the cap for its size")
        try:
            entry = read_entry(lambda start, n: buffer[start : start + n], at)
            if entry.end > len(buffer):
                break
            if entry.op == MESSAGE:
                rows.append((entry.connection, entry.time_ns(b"time"), entry.start, entry.length))
            elif entry.op == CONNECTION:
                content = bytes(buffer[entry.start : entry.end])
                connections[entry.connection] = entry.connection, entry.fields, content
            else:
                break
        except DamagedError:
            break
        at = entry.end
    connection, time_ns, start, length = np.array(rows, np.int64).reshape(-1, 4).T
    everything = Messages(start, length, time_ns, np.zeros(len(start), np.int64), time_ns)
    return Records(by_channel(connection, everything), list(connections.values()), at)


# --- The bag file

CUT_OFF = "the bag was not closed: the recording was cut off"
WINDOW_BYTES = 1 << 20
CHUNK_FIELD = re.compile(rb"[\x0f\x10]\0\0\0compression=(?:none|bz2|lz4)")  # a field in the header of every chunk
MAX_FIELD_OFFSET = 64  # bytes from the chunk record's start to this field


class BagSource(ChunkedSource):
    """One .bag file."""

    time_span_ns: tuple[int, int] | None = None

    def __init__(self, data: FileBytes) -> None:
        super().__init__(data)
        self.parts: list[Part] = []
        self._connections: dict[int, tuple[Fields, bytes]] = {}
        self._survey()
        self._complete_counts()
        self.channels = self._channels()

    def search(self, part: Part, data: Bytes) -> Records:
        """Find the records in the uncompressed bytes of a part."""
        return scan_chunk(data, most_records(part.size))

    def _survey(self) -> None:
        """Read the top-level records: chunks with their indexes, connections, and the time span."""
        at = len(MAGIC)
        closed = False
        while at < self.data.size:
            try:
                entry = read_entry(self.data.read, at)
                if entry.end > self.data.size and entry.op != CHUNK:
                    raise DamagedError("a record reaches beyond the end of the file")
                self._add_record(entry)
                closed |= entry.op == CHUNK_INFO
                at = min(entry.end, self.data.size)
            except DamagedError as problem:
                following = self._next_chunk(at + 1)
                self.data.lose(str(problem), at, following - at)
                at = following
                if self.parts:
                    self.parts[-1].counts = None  # a part of the chunk's index may be lost
        if not closed:
            self.data.lose(CUT_OFF, 0, 0)

    def _add_record(self, entry: BagRecord) -> None:
        last = self.parts[-1] if self.parts else Part(0, 0, 0, plain=0)
        if entry.op == BAG_HEADER:
            if entry.fields.get(b"encryptor"):
                raise LocfuseError(f"{self.path}: the bag is encrypted")
        elif entry.op == CHUNK:
            name = entry.fields.get(b"compression", b"").decode("utf-8", "replace")
            available = min(entry.length, self.data.size - entry.start)
            plain = entry.numbers(b"size")[0] or None  # 0 if the recorder crashed inside the chunk
            part = Part(entry.at, entry.start, available, "" if name == "none" else name, plain)
            part.cut_off = available < entry.length
            if part.size:
                self.parts.append(part)
        elif entry.op == INDEX:
            last.counts = (last.counts or {}) | {entry.connection: entry.numbers(b"count")[0]}
        elif entry.op == CONNECTION:
            data = self.data.read(entry.start, entry.length)
            self._connections.setdefault(entry.connection, (entry.fields, data))
        elif entry.op == MESSAGE:
            # messages outside chunks occur after a crash, which leaves the header of the last chunk incomplete
            if last.plain is None and last.start + last.size == entry.at and last.size < WINDOW_BYTES:
                last.size = entry.end - last.start
            else:
                self.parts.append(Part(entry.at, entry.at, entry.end - entry.at))
        elif entry.op == CHUNK_INFO:  # only a closed bag has these
            self._extend_span(entry.time_ns(b"start_time"), entry.time_ns(b"end_time"))

    def _extend_span(self, first: int, last: int) -> None:
        if self.time_span_ns is not None:
            first, last = min(first, self.time_span_ns[0]), max(last, self.time_span_ns[1])
        self.time_span_ns = first, last

    def _next_chunk(self, at: int) -> int:
        """Return the offset of the next chunk at or after `at`, or the size of the file."""
        while at < self.data.size:
            window = self.data.read(at, WINDOW_BYTES)
            for field in CHUNK_FIELD.finditer(window):
                for i in range(max(field.start() - MAX_FIELD_OFFSET, 0), field.start() - 3):
                    end = i + UINT32.size + int(UINT32.unpack_from(window, i)[0])  # of a header that begins here
                    if field.end() <= end <= i + 2 * MAX_FIELD_OFFSET:
                        with suppress(DamagedError):
                            entry = read_entry(self.data.read, at + i)
                            if entry.op == CHUNK and entry.end <= self.data.size:
                                return entry.at
            at += WINDOW_BYTES - 2 * MAX_FIELD_OFFSET if len(window) == WINDOW_BYTES else len(window)
        return self.data.size

    def _complete_counts(self) -> None:
        """Get missing connections and message counts from the content of the parts."""
        for part in self.parts:
            if part.counts is not None and part.counts.keys() <= self._connections.keys() and self.time_span_ns:
                continue
            part.counts = None
            _, found = self.load(part)
            inside = {ident: (head, data) for ident, head, data in found.definitions}
            self._connections = {**inside, **self._connections}
            for messages in found.messages.values():
                self._extend_span(int(messages.log_time.min()), int(messages.log_time.max()))

    def _channels(self) -> dict[int, ChannelInfo]:
        counts = self.counted()
        found = {}
        for ident, (head, data) in self._connections.items():
            try:
                described = fields_of(data)
            except DamagedError:
                continue
            topic = head.get(b"topic", described.get(b"topic", b"")).decode("utf-8", "replace")
            msgtype = described.get(b"type", b"").decode("utf-8", "replace")
            text = described.get(b"message_definition", b"")
            found[ident] = ChannelInfo(topic, msgtype, "ros1", "ros1msg", text, counts[ident])
        return found
