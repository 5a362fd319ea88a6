"""A ROS 1 bag as a source of message batches: chunk by chunk, finished or cut off.

Format 2.0: https://wiki.ros.org/Bags/Format/2.0.
"""

from __future__ import annotations

import re
import struct
from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from typing import NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from locfuse.formats.caps import FREE_RECORDS, MAX_CHUNK
from locfuse.fusion.data import Ints, LocfuseError

from .decompress import CODECS, DamagedError, decompress, decompress_prefix
from .file_bytes import FileBytes
from .losses import Losses
from .source import Batch, ChannelInfo, Messages

MAGIC = b"#ROSBAG V2.0\n"
MESSAGE, BAG_HEADER, INDEX, CHUNK, CHUNK_INFO, CONNECTION = range(2, 8)
WORD = struct.Struct("<I")
TIME = struct.Struct("<II")  # seconds, nanoseconds
HEAD_BYTES = 1 << 16  # record headers are read up to this size

Fields = dict[bytes, bytes]


class BagRecord(NamedTuple):
    """One record: its fields, and the place of its data."""

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


def read_entry(data: FileBytes, at: int) -> BagRecord:
    """Read the record at a file offset. Raises DamagedError if there is none."""
    word = data.read(at, WORD.size)
    n = WORD.unpack(word)[0] if len(word) == WORD.size else HEAD_BYTES
    header = data.read(at + WORD.size, min(n, HEAD_BYTES) + WORD.size)
    if n > HEAD_BYTES - WORD.size or len(header) < n + WORD.size:
        raise DamagedError("bytes that are no record")
    found = fields_of(header[:n])
    op = found.get(b"op", b"")
    if len(op) != 1:
        raise DamagedError("bytes that are no record")
    return BagRecord(at, op[0], found, at + 2 * WORD.size + n, int(WORD.unpack_from(header, n)[0]))


def fields_of(header: bytes) -> Fields:
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


def scan_chunk(data: NDArray[np.uint8], most: int) -> Scanned:
    """Read a chunk's decompressed bytes record by record. Raises DamagedError at more than `most` records."""
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


def _entry(buffer: memoryview, at: int) -> BagRecord:
    (n,) = WORD.unpack_from(buffer, at)
    (length,) = WORD.unpack_from(buffer, at + WORD.size + n)
    start = at + 2 * WORD.size + n
    if start + length > len(buffer):
        raise DamagedError("a record reaches beyond its chunk")
    found = fields_of(bytes(buffer[at + WORD.size : start - WORD.size]))
    return BagRecord(at, (found.get(b"op") or b"\x00")[0], found, start, length)


def _take(
    entry: BagRecord,
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


# --- Bags as sources of message batches, finished or cut off

CUT_OFF = "the bag was not closed: the recording was cut off"
WINDOW_BYTES = 1 << 20
HINT = re.compile(rb"[\x0f\x10]\0\0\0compression=(?:none|bz2|lz4)")  # a field of every chunk's header,
BEFORE = range(4, 64)  # so many bytes behind the record's start


class BagPart(msgspec.Struct):
    """A chunk, or messages outside any chunk after a crash."""

    at: int
    start: int
    length: int
    compression: str = ""
    size: int = 0  # unpacked
    cut_off: bool = False
    counts: dict[int, int] | None = None  # connection -> messages, by the index behind the chunk


class BagSource:
    """One .bag file."""

    attachments: Mapping[str, bytes] = {}

    def __init__(self, data: FileBytes, losses: Losses) -> None:
        self.path = data.path
        self.losses = losses
        self.data = data
        self._parts: list[BagPart] = []
        self._connections: dict[int, tuple[Fields, bytes]] = {}
        self._span: tuple[int, int] | None = None
        self._survey()
        self._discover()
        self.channels = self._channels()

    @property
    def time_span_ns(self) -> tuple[int, int] | None:
        """First and last time, None without messages."""
        return self._span

    def published(self, data: NDArray[np.uint8], messages: Messages) -> Ints:
        """Return the log times: the file keeps no others."""
        return messages.log_time

    def batches(self, wanted: Collection[int]) -> Iterator[Batch]:
        """Yield the messages of the wanted connections in file order."""
        for part in self._parts:
            if part.counts is not None and not part.counts.keys() & wanted:
                continue
            data, found = self._load(part)
            messages = {
                ident: _messages(found).take(found.connection == ident)
                for ident in np.unique(found.connection).tolist()
                if ident in wanted
            }
            if messages:
                yield Batch(data, messages)

    def _survey(self) -> None:
        """Read the outermost records: chunks and their indexes, connections, and the time span."""
        at = len(MAGIC)
        closed = False
        while at < self.data.size:
            try:
                entry = read_entry(self.data, at)
                if entry.end > self.data.size and entry.op != CHUNK:
                    raise DamagedError("a record reaches beyond the end of the file")
                closed = self._take(entry) or closed
            except DamagedError as problem:
                at = self._lost(at, str(problem))
            else:
                at = min(entry.end, self.data.size)
        if not closed:
            self.losses.add(str(self.path), CUT_OFF, 0, 0)

    def _take(self, entry: BagRecord) -> bool:
        """Add one record; return whether it belongs to the index at the end of a bag."""
        if entry.op == BAG_HEADER:
            if entry.fields.get(b"encryptor"):
                raise LocfuseError(f"{self.path}: the bag is encrypted")
        elif entry.op == CHUNK:
            self._take_chunk(entry)
        elif entry.op == INDEX and self._parts:
            chunk = self._parts[-1]
            chunk.counts = (chunk.counts or {}) | {entry.number(b"conn"): entry.number(b"count")}
        elif entry.op == CONNECTION:
            data = self.data.read(entry.start, entry.length)
            self._connections.setdefault(entry.number(b"conn"), (entry.fields, data))
        elif entry.op == MESSAGE:
            self._take_loose(entry)
        elif entry.op == CHUNK_INFO:
            self._widen(entry.time_ns(b"start_time"), entry.time_ns(b"end_time"))
            return True
        return False

    def _take_chunk(self, entry: BagRecord) -> None:
        name = entry.fields.get(b"compression", b"").decode("utf-8", "replace")
        available = min(entry.length, self.data.size - entry.start)
        part = BagPart(entry.at, entry.start, available, "" if name == "none" else name, entry.number(b"size"))
        part.cut_off = available < entry.length
        if part.length:
            self._parts.append(part)

    def _take_loose(self, entry: BagRecord) -> None:
        """Collect messages outside a chunk whose header was never completed, after a crash."""
        before = self._parts[-1] if self._parts else None
        if (
            before
            and not before.size
            and before.start + before.length == entry.at
            and before.length < WINDOW_BYTES
        ):
            before.length = entry.end - before.start
        else:
            self._parts.append(BagPart(entry.at, entry.at, entry.end - entry.at))

    def _widen(self, first: int, last: int) -> None:
        if self._span is not None:
            first, last = min(first, self._span[0]), max(last, self._span[1])
        self._span = first, last

    def _lost(self, at: int, reason: str) -> int:
        """Count the bytes up to the next chunk (or the end) as lost and continue there."""
        onward = self._next_chunk(at + 1)
        self.losses.add(str(self.path), reason, at, onward - at)
        if self._parts:
            self._parts[-1].counts = None  # the damage may have taken a part of its index
        return onward

    def _next_chunk(self, at: int) -> int:
        while at < self.data.size:
            window = self.data.read(at, WINDOW_BYTES)
            for hint in HINT.finditer(window):
                starts = (hint.start() - back for back in BEFORE if back <= hint.start())
                headed = (at + i for i in starts if _heads(window, i, hint.end()))
                if (start := next(filter(self._is_chunk, headed), None)) is not None:
                    return start
            at += WINDOW_BYTES - 2 * BEFORE.stop if len(window) == WINDOW_BYTES else len(window)
        return self.data.size

    def _is_chunk(self, at: int) -> bool:
        try:
            entry = read_entry(self.data, at)
        except DamagedError:
            return False
        return entry.op == CHUNK and entry.end <= self.data.size

    def _load(self, part: BagPart) -> tuple[NDArray[np.uint8], Scanned]:
        """Read one part; damage is counted and left out."""
        try:
            data = np.frombuffer(self._bytes(part), np.uint8)
            found = scan_chunk(data, FREE_RECORDS + part.length)
        except DamagedError as problem:
            known = None if part.counts is None else sum(part.counts.values())
            self.losses.add(str(self.path), str(problem), part.at, part.length, known)
            data = np.empty(0, np.uint8)
            found = scan_chunk(data, 0)
        if found.end < len(data):
            reason = (
                "the file is cut off inside a chunk" if part.cut_off else "a chunk holds bytes that are no record"
            )
            self.losses.add(str(self.path), reason, part.at, len(data) - found.end)
        return data, found

    def _bytes(self, part: BagPart) -> bytes:
        if part.length > MAX_CHUNK:
            raise DamagedError(f"a chunk is larger than {MAX_CHUNK >> 20} MiB")
        if part.compression not in CODECS:
            raise DamagedError(f"unknown compression {part.compression[:16]!r}")
        packed = self.data.read(part.start, part.length)
        if part.size == 0:
            return packed
        unpack = decompress_prefix if part.cut_off else decompress
        return unpack(packed, part.compression, part.size)

    def _discover(self) -> None:
        """Read the parts whose connections and message counts are only known from their content."""
        for part in self._parts:
            if part.counts is not None and part.counts.keys() <= self._connections.keys() and self._span:
                continue
            _, found = self._load(part)
            part.counts = dict(Counter(found.connection.tolist()))
            self._connections = {**found.connections, **self._connections}
            if len(found.time_ns):
                self._widen(int(found.time_ns.min()), int(found.time_ns.max()))

    def _channels(self) -> dict[int, ChannelInfo]:
        counts: Counter[int] = Counter()
        for part in self._parts:
            counts.update(part.counts or {})
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


def _heads(window: bytes, start: int, end: int) -> bool:
    """Return whether the header of a record here reaches `end` and is as short as a chunk's."""
    length = int(WORD.unpack_from(window, start)[0])
    return end <= start + WORD.size + length <= start + 2 * BEFORE.stop


def _messages(found: Scanned) -> Messages:
    return Messages(found.start, found.length, found.time_ns, np.zeros(len(found.start), np.int64))
