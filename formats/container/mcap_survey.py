"""One walk over an MCAP file's outermost records: where its chunks lie, and what cannot be read.

Only record headers are touched, so it costs milliseconds per gigabyte and trusts nobody. The summary section
is the safety net: its chunk index says where to go on after a hole, its statistics what should have been there.
"""

from __future__ import annotations

import numpy as np

from locfuse.formats.caps import MAX_CHUNK
from locfuse.fusion.data import LocfuseError

from . import mcap_records as rec
from .decompress import DamagedError
from .file_bytes import FileBytes
from .losses import Losses
from .mcap_chunk import scan
from .mcap_parts import ChunkRef, LooseRun, Survey, put_in_order
from .mcap_resync import CHUNK_HEAD, Resync
from .mcap_summary import Summary, lost_summary, read_summary
from .signatures import describe

RUN_BYTES = 1 << 20  # loose messages are read in runs of at most this size, if they are not larger themselves
LARGE_CHUNK_BYTES = 32 * 1024 * 1024
CUT_OFF = "the file ends without an end mark: the recording was cut off"
NO_SUMMARY = "the summary is damaged: messages may be missing that nobody counts"


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
        self.name = str(data.path)
        self.summary = summary
        self.losses = losses
        self.found = Survey()
        if summary is not None:
            self.found = Survey(schemas=summary.schemas, channels=summary.channels, expected=summary.counts)
        self.resync = Resync(data, summary)
        self.chunked = False
        self.index_end = 0  # where the message indexes of the last chunk end, as the summary says

    def run(self) -> Survey:
        here = len(rec.MAGIC)
        at: int | None = here
        while at is not None and at < self.data.size:
            here, at = at, self._step(at)
        if at is not None:
            self.losses.add(self.name, CUT_OFF, 0, 0)
        elif self.summary is None and lost_summary(self.data):
            self.losses.add(self.name, NO_SUMMARY, here, self.data.size - here)
        self._distrust_unconfirmed()
        self._put_in_order()
        return self.found

    def _put_in_order(self) -> None:
        """Put chunks in the order of their times.

        Times in a chunk's header are covered by no checksum, so they count only where the summary says the same.
        """
        spans = [part.span for part in self.found.parts]
        promised = self.summary.chunks.values() if self.summary else ()
        if sorted(spans) == sorted((entry.first, entry.last) for entry in promised):
            put_in_order(self.found.parts)

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
            if (handler := self.HANDLERS.get(opcode)) is not None:
                end = handler(self, at, length) or end
        except DamagedError as problem:
            self._distrust_index()
            return self._lost(at, str(problem))
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
        value = self.data.read(at + rec.RECORD.size, 4)
        whole = opcode == rec.DATA_END and len(value) == 4  # a file may be cut within the checksum itself
        if whole and any(isinstance(part, LooseRun) for part in self.found.parts):
            crc = rec.Cursor(value).integer("I")
            if crc and self.data.crc32(0, at) != crc:
                self.losses.add(self.name, "the file fails its checksum: values may be wrong", 0, 0)

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

    def _content(self, at: int, length: int) -> bytes:
        if length > MAX_CHUNK:
            raise DamagedError(f"a record claims more than {MAX_CHUNK >> 20} MiB")
        return self.data.read(at + rec.RECORD.size, length)

    def _schema(self, at: int, length: int) -> None:
        self.found.define(rec.SCHEMA, self._content(at, length))

    def _channel(self, at: int, length: int) -> None:
        self.found.define(rec.CHANNEL, self._content(at, length))

    def _loose(self, at: int, length: int) -> int:
        """Take messages outside any chunk, as many as lie in a row; return where they end."""
        n_bytes = max(rec.RECORD.size + length, RUN_BYTES)
        if n_bytes > MAX_CHUNK:
            self.losses.add(self.name, f"a message is larger than {MAX_CHUNK >> 20} MiB", at, n_bytes, 1)
            return at + n_bytes
        data = np.frombuffer(self.data.read(at, n_bytes), np.uint8)
        found = scan(data)
        if not found.messages:
            raise DamagedError("bytes that are no record")
        for opcode, start, size in found.definitions:
            self.found.define(opcode, data[start : start + size].tobytes())
        counts = {ident: len(messages.start) for ident, messages in found.messages.items()}
        times = np.concatenate([messages.log_time for messages in found.messages.values()])
        self.found.parts.append(LooseRun(at, found.end, counts, (int(times.min()), int(times.max()))))
        return at + found.end

    def _chunk(self, at: int, length: int) -> int | None:
        header = rec.chunk_header(self.data.read(at, CHUNK_HEAD)[rec.RECORD.size :])
        if header.start + header.length != length:
            raise DamagedError("a chunk header that contradicts itself")
        start = at + rec.RECORD.size + header.start
        available = min(header.length, max(self.data.size - start, 0))
        if available < header.length and self._onward(at + 1) is not None:
            raise DamagedError("a chunk reaches beyond the end of the file")
        if not header.compression and header.length > LARGE_CHUNK_BYTES:
            return self._opened(header, start, available)
        self.chunked = True
        if self.summary and at in self.summary.chunks:
            self.index_end = at + rec.RECORD.size + length + self.summary.chunks[at].index_length
        self.found.parts.append(ChunkRef(at, header, available=available))
        return None

    def _opened(self, header: rec.ChunkHeader, start: int, available: int) -> int:
        """Walk into an uncompressed chunk too large to hold: its messages are as good as loose ones."""
        whole = available == header.length
        if whole and header.crc and self.data.crc32(start, start + available) != header.crc:
            self.losses.add(self.name, "a chunk fails its checksum", start, available)
            return start + available
        return start

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
        rec.MESSAGE: _loose,
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
        self.losses.add(self.name, reason, at, onward - at)
        return onward
