"""One walk over an MCAP file's outermost records: where its chunks lie, and what cannot be read.

Only record headers are touched, so it costs milliseconds per gigabyte and trusts nobody. The summary section
is the safety net: its chunk index says where to go on after a hole, its statistics what should have been there.
"""

from __future__ import annotations

import os
import zlib
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ..fusion.data import LocfuseError
from . import mcap_records as rec
from .decompress import CODECS, MAX_BYTES, DamagedError
from .losses import Losses
from .magic import describe

CUT_OFF = "the file ends without an end mark: the recording was cut off"
WINDOW = 1 << 18
SEARCH = 1 << 20
RUN_BYTES = 1 << 20  # loose messages are read in runs of about this size


class FileBytes:
    """Random access to a file with a read-ahead window: never more than asked for plus the window."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._file = path.open("rb")
        self.size = os.fstat(self._file.fileno()).st_size
        self._start = 0
        self._window = b""

    def read(self, at: int, n: int) -> bytes:
        """Return up to n bytes from `at` on (fewer at the end of the file)."""
        if n > WINDOW:
            return os.pread(self._file.fileno(), n, at)
        offset = at - self._start
        if not 0 <= offset <= len(self._window) - n:
            self._window = os.pread(self._file.fileno(), WINDOW, at)
            self._start, offset = at, 0
        return self._window[offset : offset + n]


@dataclass
class ChunkRef:
    """One chunk of the file."""

    offset: int  # of its record
    header: rec.ChunkHeader
    index: dict[int, tuple[int, int]] = field(default_factory=dict)  # channel -> (file offset, content length)
    available: int = 0  # compressed bytes present: less than header.length where the file is cut off
    counts: dict[int, int] | None = None  # channel -> messages, once known

    @property
    def start(self) -> int:
        """File offset of the compressed bytes."""
        return self.offset + rec.RECORD.size + self.header.start

    @property
    def span(self) -> tuple[int, int]:
        """Log times of its first and last message, ns."""
        return self.header.first, self.header.last

    @property
    def size(self) -> int:
        """Bytes to read: fewer than the header says where the file is cut off."""
        return self.available

    @property
    def cut_off(self) -> bool:
        """Whether the file ends inside this chunk."""
        return self.available < self.header.length


@dataclass
class LooseRun:
    """Consecutive messages outside any chunk."""

    offset: int
    size: int
    counts: dict[int, int] | None = field(default_factory=dict)
    span: tuple[int, int] = (0, 0)  # log times, ns
    cut_off: bool = False

    @property
    def start(self) -> int:
        """File offset of the bytes."""
        return self.offset


Part = ChunkRef | LooseRun


@dataclass
class Summary:
    """What the file's last section says, if it can be believed."""

    start: int = 0
    schemas: dict[int, rec.Schema] = field(default_factory=dict)
    channels: dict[int, rec.Channel] = field(default_factory=dict)
    chunks: list[rec.ChunkIndex] = field(default_factory=list)
    counts: dict[int, int] | None = None


@dataclass
class Survey:
    """What the walk found."""

    parts: list[Part] = field(default_factory=list)
    schemas: dict[int, rec.Schema] = field(default_factory=dict)
    channels: dict[int, rec.Channel] = field(default_factory=dict)
    attachments: list[tuple[int, int]] = field(default_factory=list)  # (content offset, length)
    expected: dict[int, int] | None = None  # channel -> messages, by the statistics


def read_summary(data: FileBytes) -> Summary | None:
    """Return the summary section if footer, checksum and records are whole, else None."""
    tail = rec.RECORD.size + rec.FOOTER_LENGTH + len(rec.MAGIC)
    foot = data.read(max(data.size - tail, 0), tail)
    if len(foot) < tail or foot[-len(rec.MAGIC) :] != rec.MAGIC or foot[0] != rec.FOOTER:
        return None
    start, _, crc = rec.Cursor(foot, rec.RECORD.size).integers("QQI")
    end = data.size - tail
    if not start or not len(rec.MAGIC) <= start <= end or end - start > MAX_BYTES:
        return None
    section = data.read(start, end - start)
    if crc and zlib.crc32(section + foot[: rec.RECORD.size + rec.FOOTER_LENGTH - 4]) != crc:
        return None
    try:
        return _parse_summary(section, start)
    except DamagedError:
        return None


def _parse_summary(section: bytes, start: int) -> Summary:
    summary = Summary(start)
    at = 0
    while at < len(section):
        cursor = rec.Cursor(section, at)
        opcode, length = cursor.integers("BQ")
        content = cursor.take(length)
        at = cursor.at
        if opcode == rec.SCHEMA:
            schema = rec.schema(content)
            summary.schemas[schema.id] = schema
        elif opcode == rec.CHANNEL:
            channel = rec.channel(content)
            summary.channels[channel.id] = channel
        elif opcode == rec.CHUNK_INDEX:
            summary.chunks.append(rec.chunk_index(content))
        elif opcode == rec.STATISTICS:
            summary.counts = rec.message_counts(content)
    return summary


def survey(data: FileBytes, losses: Losses) -> Survey:
    """Walk the data section from the first record to DataEnd, over whatever damage there is."""
    magic = data.read(0, len(rec.MAGIC))
    summary = read_summary(data)
    if magic != rec.MAGIC and summary is None:
        raise LocfuseError(f"{data.path}: not an MCAP file: it is {describe(data.read(0, 64))}")
    return _Walk(data, summary, losses).run()


def _opcode_and_length(head: bytes) -> tuple[int, int]:
    opcode, length = rec.RECORD.unpack_from(head)
    return int(opcode), int(length)


class _Walk:
    def __init__(self, data: FileBytes, summary: Summary | None, losses: Losses) -> None:
        self.data = data
        self.summary = summary
        self.losses = losses
        self.found = Survey()
        if summary is not None:
            self.found = Survey(schemas=summary.schemas, channels=summary.channels, expected=summary.counts)
        self.starts = sorted(chunk.offset for chunk in summary.chunks) if summary else []

    def run(self) -> Survey:
        at: int | None = len(rec.MAGIC)
        while at is not None and at < self.data.size:
            at = self._step(at)
        if at is not None:
            self.losses.add(
                str(self.data.path), "the file ends without an end mark: the recording was cut off", 0, 0
            )
        return self.found

    def _step(self, at: int) -> int | None:
        """Handle the record at `at`; return the next one's offset, or None at the end of the data section."""
        head = self.data.read(at, rec.RECORD.size)
        if len(head) < rec.RECORD.size:
            return self._lost(at, "the file is cut off inside a record")
        opcode, length = _opcode_and_length(head)
        if opcode in (rec.DATA_END, rec.FOOTER):
            return None
        end = at + rec.RECORD.size + length
        known = 0 < opcode < rec.DATA_END or opcode >= rec.PRIVATE
        try:
            if not known:
                raise DamagedError("bytes that are no record")
            if end > self.data.size and opcode != rec.CHUNK:
                raise DamagedError("a record reaches beyond the end of the file")
            handler = self.HANDLERS.get(opcode)
            if handler is not None:
                handler(self, at, length)
        except DamagedError as problem:
            self._distrust_index()
            return self._lost(at, str(problem))
        return min(end, self.data.size)

    def _distrust_index(self) -> None:
        """Damage behind a chunk may have taken some of its message indexes: read the chunk itself."""
        if self.found.parts and isinstance(chunk := self.found.parts[-1], ChunkRef):
            chunk.index.clear()
            chunk.counts = None

    def _content(self, at: int, length: int) -> bytes:
        if length > MAX_BYTES:
            raise DamagedError(f"a record claims more than {MAX_BYTES >> 20} MiB")
        return self.data.read(at + rec.RECORD.size, length)

    def _schema(self, at: int, length: int) -> None:
        schema = rec.schema(self._content(at, length))
        self.found.schemas.setdefault(schema.id, schema)

    def _channel(self, at: int, length: int) -> None:
        channel = rec.channel(self._content(at, length))
        self.found.channels.setdefault(channel.id, channel)

    def _message(self, at: int, length: int) -> None:
        if length < rec.MESSAGE_HEADER:
            raise DamagedError("a message is shorter than its header")
        ident, _, time = rec.Cursor(self.data.read(at + rec.RECORD.size, 14)).integers("HIQ")
        run = self.found.parts[-1] if self.found.parts else None
        size = rec.RECORD.size + length
        if not isinstance(run, LooseRun) or run.offset + run.size != at or run.size + size > RUN_BYTES:
            run = LooseRun(at, 0, span=(time, time))
            self.found.parts.append(run)
        run.size += size
        run.span = min(run.span[0], time), max(run.span[1], time)
        assert run.counts is not None
        run.counts[ident] = run.counts.get(ident, 0) + 1

    def _chunk(self, at: int, length: int) -> None:
        header = rec.chunk_header(self.data.read(at + rec.RECORD.size, min(length, 64)))
        if header.start + header.length != length:
            raise DamagedError("a chunk header that contradicts itself")
        start = at + rec.RECORD.size + header.start
        available = min(header.length, max(self.data.size - start, 0))
        if available < header.length and self._next_start(at + 1) is not None:
            raise DamagedError("a chunk reaches beyond the end of the file")
        self.found.parts.append(ChunkRef(at, header, available=available))

    def _message_index(self, at: int, length: int) -> None:
        chunk = self.found.parts[-1] if self.found.parts else None
        if isinstance(chunk, ChunkRef):
            ident, n_bytes = rec.Cursor(self.data.read(at + rec.RECORD.size, 6)).integers("HI")
            if n_bytes != length - 6 or n_bytes % 16:
                raise DamagedError("a message index that contradicts itself")
            chunk.index[ident] = (at + rec.RECORD.size, length)
            if not chunk.cut_off:
                chunk.counts = (chunk.counts or {}) | {ident: n_bytes // 16}

    def _attachment(self, at: int, length: int) -> None:
        self.found.attachments.append((at + rec.RECORD.size, length))

    HANDLERS = {  # noqa: RUF012
        rec.SCHEMA: _schema,
        rec.CHANNEL: _channel,
        rec.MESSAGE: _message,
        rec.CHUNK: _chunk,
        rec.MESSAGE_INDEX: _message_index,
        rec.ATTACHMENT: _attachment,
    }

    def _lost(self, at: int, reason: str) -> int:
        """Count the bytes up to the next chunk (or the end) as lost and go on there."""
        onward = self._next_start(at + 1)
        if onward is None:
            onward = self.summary.start if self.summary and self.summary.start > at else self.data.size
        self.losses.add(str(self.data.path), reason, at, onward - at)
        return onward

    def _next_start(self, at: int) -> int | None:
        """Return where to go on: by the chunk index, else at the next bytes that look like a chunk."""
        for start in self.starts:
            if start >= at:
                return start
        return None if self.starts else self._search(at)

    def _search(self, at: int) -> int | None:
        chunked = any(isinstance(part, ChunkRef) for part in self.found.parts)
        check = self._is_chunk if chunked else self._starts_records
        while at + rec.RECORD.size <= self.data.size:
            window = np.frombuffer(self.data.read(at, SEARCH), np.uint8)
            n = len(window) - rec.RECORD.size + 1
            wanted = (window[:n] == rec.CHUNK) | ((window[:n] == rec.MESSAGE) & (not chunked))
            wanted &= (window[5 : n + 5] == 0) & (window[6 : n + 6] == 0)  # shorter than 4 GiB
            for i in np.flatnonzero(wanted).tolist():
                if check(at + i):
                    return at + int(i)
            at += max(n, 1)
        return None

    def _is_chunk(self, at: int) -> bool:
        head = self.data.read(at, rec.RECORD.size + 64)
        if len(head) < rec.RECORD.size + 40 or head[0] != rec.CHUNK:
            return False
        length = _opcode_and_length(head)[1]
        try:
            header = rec.chunk_header(head[rec.RECORD.size :])
        except DamagedError:
            return False
        fits = at + rec.RECORD.size + length <= self.data.size
        return fits and header.compression in CODECS and header.start + header.length == length

    def _starts_records(self, at: int) -> bool:
        """Tell whether a chunk or three plausible records in a row begin here."""
        if self._is_chunk(at):
            return True
        for _ in range(3):
            head = self.data.read(at, rec.RECORD.size + 2)
            if len(head) < rec.RECORD.size + 2:
                return False
            opcode, length = _opcode_and_length(head)
            if opcode == rec.MESSAGE and rec.Cursor(head, rec.RECORD.size).integer("H") not in self.found.channels:
                return False
            if not 0 < opcode <= rec.DATA_END or at + rec.RECORD.size + length > self.data.size:
                return False
            if opcode == rec.DATA_END:
                return True
            at += rec.RECORD.size + length
        return True
