"""A ROS 1 bag as a source of message batches: chunk by chunk, finished or cut off."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Collection, Iterator, Mapping

import msgspec
import numpy as np
from numpy.typing import NDArray

from locfuse.formats.caps import FREE_RECORDS, MAX_CHUNK
from locfuse.fusion.data import Ints, LocfuseError

from . import ros1_records as rec
from .decompress import CODECS, DamagedError, decompress, decompress_prefix
from .file_bytes import FileBytes
from .losses import Losses
from .source import Batch, ChannelInfo, Messages

CUT_OFF = "the bag was not closed: the recording was cut off"
WINDOW_BYTES = 1 << 20
HINT = re.compile(rb"[\x0f\x10]\0\0\0compression=(?:none|bz2|lz4)")  # a field of every chunk's header,
BEFORE = range(4, 64)  # so many bytes behind the record's start


class Part(msgspec.Struct):
    """A chunk, or messages that a crash left outside one."""

    at: int
    start: int
    length: int
    compression: str = ""
    size: int = 0  # unpacked
    cut_off: bool = False
    counts: dict[int, int] | None = None  # connection -> messages, as the index behind the chunk says


class BagSource:
    """One .bag file."""

    attachments: Mapping[str, bytes] = {}

    def __init__(self, data: FileBytes, losses: Losses) -> None:
        self.path = data.path
        self.losses = losses
        self.data = data
        self._parts: list[Part] = []
        self._connections: dict[int, tuple[rec.Fields, bytes]] = {}
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
        """Walk the outermost records: chunks and their indexes, connections, the span of time."""
        at = len(rec.MAGIC)
        closed = False
        while at < self.data.size:
            try:
                entry = rec.read_entry(self.data, at)
                if entry.end > self.data.size and entry.op != rec.CHUNK:
                    raise DamagedError("a record reaches beyond the end of the file")
                closed = self._take(entry) or closed
            except DamagedError as problem:
                at = self._lost(at, str(problem))
            else:
                at = min(entry.end, self.data.size)
        if not closed:
            self.losses.add(str(self.path), CUT_OFF, 0, 0)

    def _take(self, entry: rec.Entry) -> bool:
        """Note one record; tell whether it is of the index that closes a bag."""
        if entry.op == rec.BAG_HEADER:
            if entry.fields.get(b"encryptor"):
                raise LocfuseError(f"{self.path}: the bag is encrypted")
        elif entry.op == rec.CHUNK:
            self._take_chunk(entry)
        elif entry.op == rec.INDEX and self._parts:
            chunk = self._parts[-1]
            chunk.counts = (chunk.counts or {}) | {entry.number(b"conn"): entry.number(b"count")}
        elif entry.op == rec.CONNECTION:
            data = self.data.read(entry.start, entry.length)
            self._connections.setdefault(entry.number(b"conn"), (entry.fields, data))
        elif entry.op == rec.MESSAGE:
            self._take_loose(entry)
        elif entry.op == rec.CHUNK_INFO:
            self._widen(entry.time_ns(b"start_time"), entry.time_ns(b"end_time"))
            return True
        return False

    def _take_chunk(self, entry: rec.Entry) -> None:
        name = entry.fields.get(b"compression", b"").decode("utf-8", "replace")
        available = min(entry.length, self.data.size - entry.start)
        part = Part(entry.at, entry.start, available, "" if name == "none" else name, entry.number(b"size"))
        part.cut_off = available < entry.length
        if part.length:
            self._parts.append(part)

    def _take_loose(self, entry: rec.Entry) -> None:
        """Collect messages that a crash left outside a chunk, whose header was never completed."""
        before = self._parts[-1] if self._parts else None
        if (
            before
            and not before.size
            and before.start + before.length == entry.at
            and before.length < WINDOW_BYTES
        ):
            before.length = entry.end - before.start
        else:
            self._parts.append(Part(entry.at, entry.at, entry.end - entry.at))

    def _widen(self, first: int, last: int) -> None:
        if self._span is not None:
            first, last = min(first, self._span[0]), max(last, self._span[1])
        self._span = first, last

    def _lost(self, at: int, reason: str) -> int:
        """Count the bytes up to the next chunk (or the end) as lost and go on there."""
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
            entry = rec.read_entry(self.data, at)
        except DamagedError:
            return False
        return entry.op == rec.CHUNK and entry.end <= self.data.size

    def _load(self, part: Part) -> tuple[NDArray[np.uint8], rec.Scanned]:
        """Read one part; what is damaged is counted and left out."""
        try:
            data = np.frombuffer(self._bytes(part), np.uint8)
            found = rec.scan(data, FREE_RECORDS + part.length)
        except DamagedError as problem:
            known = None if part.counts is None else sum(part.counts.values())
            self.losses.add(str(self.path), str(problem), part.at, part.length, known)
            data = np.empty(0, np.uint8)
            found = rec.scan(data, 0)
        if found.end < len(data):
            reason = (
                "the file is cut off inside a chunk" if part.cut_off else "a chunk holds bytes that are no record"
            )
            self.losses.add(str(self.path), reason, part.at, len(data) - found.end)
        return data, found

    def _bytes(self, part: Part) -> bytes:
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
        """Read the parts that alone can tell which connections and how many messages they hold."""
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
                said = rec.fields(data)
            except DamagedError:
                continue
            topic = head.get(b"topic", said.get(b"topic", b"")).decode("utf-8", "replace")
            msgtype = said.get(b"type", b"").decode("utf-8", "replace")
            text = said.get(b"message_definition", b"")
            found[ident] = ChannelInfo(topic, msgtype, "ros1", "ros1msg", text, counts[ident])
        return found


def _heads(window: bytes, start: int, end: int) -> bool:
    """Tell whether a record that starts here has a header that reaches `end` and is as short as a chunk's."""
    length = int(rec.WORD.unpack_from(window, start)[0])
    return end <= start + rec.WORD.size + length <= start + 2 * BEFORE.stop


def _messages(found: rec.Scanned) -> Messages:
    return Messages(found.start, found.length, found.time_ns, np.zeros(len(found.start), np.int64))
