"""One walk over an MCAP file's outermost records: where its chunks lie, and what cannot be read.

Only record headers are touched, so it costs milliseconds per gigabyte and trusts nobody. The summary section
is the safety net: its chunk index says where to go on after a hole, its statistics what should have been there.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from ..fusion.data import LocfuseError
from . import mcap_records as rec
from .decompress import MAX_BYTES, DamagedError
from .file_bytes import FileBytes
from .losses import Losses
from .magic import describe
from .mcap_resync import CHUNK_HEAD, Resync
from .mcap_summary import Summary, read_summary

RUN_BYTES = 1 << 20  # loose messages are read in runs of about this size
CUT_OFF = "the file ends without an end mark: the recording was cut off"


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
    last: tuple[int, int] = (0, 0)  # channel and bytes of the last message
    cut_off: bool = False

    @property
    def start(self) -> int:
        """File offset of the bytes."""
        return self.offset


Part = ChunkRef | LooseRun


@dataclass
class Survey:
    """What the walk found."""

    parts: list[Part] = field(default_factory=list)
    schemas: dict[int, rec.Schema] = field(default_factory=dict)
    channels: dict[int, rec.Channel] = field(default_factory=dict)
    attachments: list[tuple[int, int]] = field(default_factory=list)  # (content offset, length)
    expected: dict[int, int] | None = None  # channel -> messages, by the statistics


def survey(data: FileBytes, losses: Losses) -> Survey:
    """Walk the data section from the first record to DataEnd, over whatever damage there is."""
    magic = data.read(0, len(rec.MAGIC))
    summary = read_summary(data)
    if magic != rec.MAGIC and summary is None:
        raise LocfuseError(f"{data.path}: not an MCAP file: it is {describe(data.read(0, 64))}")
    return _Walk(data, summary, losses).run()


class _Walk:
    def __init__(self, data: FileBytes, summary: Summary | None, losses: Losses) -> None:
        self.data = data
        self.summary = summary
        self.losses = losses
        self.found = Survey()
        if summary is not None:
            self.found = Survey(schemas=summary.schemas, channels=summary.channels, expected=summary.counts)
        self.resync = Resync(data, summary)
        self.chunked = False
        self.index_end = 0  # where the message indexes of the last chunk end, as the summary says

    def run(self) -> Survey:
        at: int | None = len(rec.MAGIC)
        while at is not None and at < self.data.size:
            at = self._step(at)
        if at is not None:
            self.losses.add(str(self.data.path), CUT_OFF, 0, 0)
        self._distrust_unconfirmed()
        return self.found

    def _step(self, at: int) -> int | None:
        """Handle the record at `at`; return the next one's offset, or None at the end of the data section."""
        head = self.data.read(at, rec.RECORD.size)
        if len(head) < rec.RECORD.size:
            return self._lost(at, "the file is cut off inside a record")
        opcode, length = rec.opcode_and_length(head)
        if self._is_end(at, opcode, length):
            self._check_data_crc(at, opcode)
            return None
        end = at + rec.RECORD.size + length
        try:
            if not (0 < opcode < rec.DATA_END or opcode >= rec.PRIVATE) or opcode == rec.FOOTER:
                raise DamagedError("bytes that are no record")
            if opcode != rec.CHUNK and self.summary and at in self.summary.chunks:
                raise DamagedError("no chunk where the index promises one")
            if opcode != rec.MESSAGE_INDEX and at < self.index_end:
                raise DamagedError("no message index where the chunk index promises one")
            if end > self.data.size and opcode != rec.CHUNK:
                raise DamagedError("a record reaches beyond the end of the file")
            handler = self.HANDLERS.get(opcode)
            if handler is not None:
                handler(self, at, length)
        except DamagedError as problem:
            self._distrust_index()
            return self._lost(self._reach_of_damage(at, opcode), str(problem))
        return min(end, self.data.size)

    def _is_end(self, at: int, opcode: int, length: int) -> bool:
        """Tell a real end of the data section from a flipped bit that looks like one."""
        if opcode == rec.FOOTER:
            return at + rec.RECORD.size + length + len(rec.MAGIC) == self.data.size
        if opcode != rec.DATA_END or length != 4:
            return False
        end = at + rec.RECORD.size + length
        if self.summary and self.summary.start:
            return end == self.summary.start
        return 0 < self.data.read(end, 1)[:1][0] <= rec.DATA_END if end < self.data.size else True

    def _check_data_crc(self, at: int, opcode: int) -> None:
        """Check what no chunk's checksum covers, where the writer gave a checksum of everything."""
        if opcode == rec.DATA_END and any(isinstance(part, LooseRun) for part in self.found.parts):
            crc = rec.Cursor(self.data.read(at + rec.RECORD.size, 4)).integer("I")
            if crc and self.data.crc32(at) != crc:
                self.losses.add(str(self.data.path), "the file fails its checksum: values may be wrong", 0, 0)

    def _distrust_unconfirmed(self) -> None:
        """Skip chunks only by indexes that the summary confirms; the others are read to know their channels."""
        promised = self.summary.chunks if self.summary else {}
        for part in self.found.parts:
            if isinstance(part, ChunkRef):
                entry = promised.get(part.offset)
                if entry is None or entry.channels != part.index.keys():
                    part.counts = None

    def _distrust_index(self) -> None:
        """Damage behind a chunk may have taken some of its message indexes: read the chunk itself."""
        if self.found.parts and isinstance(chunk := self.found.parts[-1], ChunkRef):
            chunk.index.clear()
            chunk.counts = None

    def _reach_of_damage(self, at: int, opcode: int) -> int:
        """Bytes that are no record are a hole: it began in the loose message before them."""
        run = self.found.parts[-1] if self.found.parts else None
        if not isinstance(run, LooseRun) or run.start + run.size != at or 0 < opcode <= rec.DATA_END:
            return at
        ident, size = run.last
        assert run.counts is not None
        run.size -= size
        run.counts[ident] -= 1
        return at - size

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
        run.last = ident, size
        run.span = min(run.span[0], time), max(run.span[1], time)
        assert run.counts is not None
        run.counts[ident] = run.counts.get(ident, 0) + 1

    def _chunk(self, at: int, length: int) -> None:
        header = rec.chunk_header(self.data.read(at, CHUNK_HEAD)[rec.RECORD.size :])
        if header.start + header.length != length:
            raise DamagedError("a chunk header that contradicts itself")
        start = at + rec.RECORD.size + header.start
        available = min(header.length, max(self.data.size - start, 0))
        if available < header.length and self._onward(at + 1) is not None:
            raise DamagedError("a chunk reaches beyond the end of the file")
        self.chunked = True
        if self.summary and at in self.summary.chunks:
            self.index_end = at + rec.RECORD.size + length + self.summary.chunks[at].index_length
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

    def _onward(self, at: int) -> int | None:
        return self.resync.next(at, self.chunked, self.found.channels.keys())

    def _lost(self, at: int, reason: str) -> int:
        """Count the bytes up to the next chunk (or the end) as lost and go on there."""
        onward = self._onward(at + 1)
        if onward is None:
            onward = self.summary.start if self.summary and self.summary.start > at else self.data.size
        self.losses.add(str(self.data.path), reason, at, onward - at)
        return onward
