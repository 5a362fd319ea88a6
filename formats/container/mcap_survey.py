"""Survey of an MCAP file: its chunks, channels, attachments and damaged parts, without reading messages.

Only record headers are read, which takes milliseconds per gigabyte. After damage, the chunk index of the summary
section locates the next chunk; its statistics give the number of messages that are missing.
"""

from __future__ import annotations

import zlib
from bisect import bisect_left
from collections import Counter
from contextlib import suppress

import msgspec
import numpy as np
from msgspec import field
from msgspec.structs import replace

from locfuse.formats.inputs import MAX_CHUNK
from locfuse.fusion.data import Ints, LocfuseError

from . import mcap_records as rec
from .decompress import CODECS, DamagedError
from .file_bytes import FileBytes
from .source import Part


class ChunkRef(Part):
    """A chunk of an MCAP file, with its message indexes."""

    crc: int = 0  # of the uncompressed bytes; 0 = none
    index: dict[int, tuple[int, int]] = field(default_factory=dict)  # channel -> (file offset, content length)
    promised: bool = False  # whether all fields are from the file's summary; crc is then unknown

    @property
    def place(self) -> tuple[int, int]:
        """File offsets: start of the chunk, end of its message indexes."""
        return self.offset, max(at + length for at, length in self.index.values())


CHUNK_HEAD = rec.RECORD.size + 64  # bytes that hold a chunk's header


def chunk_at(offset: int, data: FileBytes) -> ChunkRef:
    """Parse the header of the chunk record at a file offset. Raises DamagedError if there is no chunk."""
    head = data.read(offset, CHUNK_HEAD)
    opcode, length, *_ = rec.values(head, "BQ")
    first, last, plain, crc, compression, size, front = rec.values(head, "QQQIsQ", rec.RECORD.size)
    if opcode != rec.CHUNK or front + size != rec.RECORD.size + length:
        raise DamagedError("a chunk header that contradicts itself")
    return ChunkRef(offset, offset + front, size, compression, plain, span=(first, last), crc=crc)


def sort_by_time(parts: list[Part]) -> None:
    """Sort the parts by last log time, if any part ends before an earlier part in the file begins.

    MCAP chunks may be in any order. Parts that only overlap in time stay in file order.
    """
    latest = 0
    for first, last in (part.span for part in parts):
        if last < latest:
            parts.sort(key=lambda part: part.span[1])
            return
        latest = max(latest, first)


class Survey(msgspec.Struct):
    """The result of a survey."""

    parts: list[Part] = []
    schemas: dict[int, rec.Schema] = {}
    channels: dict[int, rec.Channel] = {}
    attachments: list[tuple[int, int]] = []  # (content offset, length)
    expected: dict[int, int] | None = None  # channel -> number of messages in the Statistics record

    def define(self, opcode: int, content: bytes) -> None:
        """Add a Schema or Channel record; the first definition counts (the summary's, if there is one)."""
        if opcode == rec.SCHEMA:
            schema = rec.schema(content)
            self.schemas.setdefault(schema.id, schema)
        elif opcode == rec.CHANNEL:
            channel = rec.channel(content)
            self.channels.setdefault(channel.id, channel)


# --- The summary section at the end: used only if footer, checksum and records are valid


class FileSummary(Survey):
    """The content of a file's summary section."""

    start: int = 0  # file offset of the section
    chunks: dict[int, rec.ChunkIndex] = {}  # by file offset
    statistics: rec.Statistics | None = None


TAIL_BYTES = rec.RECORD.size + rec.FOOTER_LENGTH + len(rec.MAGIC)  # bytes of footer and magic


def _footer(data: FileBytes) -> tuple[int, int, bytes] | None:
    """Return the summary's offset, its CRC-32, and the footer bytes that the CRC covers; None without a footer."""
    foot = data.read(max(data.size - TAIL_BYTES, 0), TAIL_BYTES)
    if len(foot) < TAIL_BYTES or foot[-len(rec.MAGIC) :] != rec.MAGIC or foot[0] != rec.FOOTER:
        return None
    start, _, crc, at = rec.values(foot, "QQI", rec.RECORD.size)
    return start, crc, foot[: at - 4]


def summary_section(data: FileBytes) -> bytes | None:
    """Return the bytes of the summary section; None if it is missing or its checksum is wrong."""
    foot = _footer(data)
    end = data.size - TAIL_BYTES
    if foot is None or not len(rec.MAGIC) <= foot[0] <= end or end - foot[0] > MAX_CHUNK:
        return None
    start, crc, footer = foot
    section = data.read(start, end - start)
    return None if crc and zlib.crc32(section + footer) != crc else section


def read_summary(data: FileBytes) -> FileSummary | None:
    """Return the parsed summary section; None without a valid one."""
    section = summary_section(data)
    if section is None:
        return None
    summary = FileSummary(start=data.size - TAIL_BYTES - len(section))
    at = 0
    try:
        while at < len(section):
            opcode, length, start = rec.values(section, "BQ", at)
            at = start + length
            content = section[start:at]
            if at > len(section):
                return None
            summary.define(opcode, content)
            if opcode == rec.CHUNK_INDEX:
                chunk = rec.chunk_index(content)
                summary.chunks[chunk.offset] = chunk
            elif opcode == rec.STATISTICS:
                summary.statistics = rec.statistics(content)
                summary.expected = summary.statistics.counts
            elif opcode == rec.ATTACHMENT_INDEX:
                offset, length, _ = rec.values(content, "QQ")
                summary.attachments.append((offset + rec.RECORD.size, length - rec.RECORD.size))
    except DamagedError:
        return None
    return summary


# --- A survey from the summary alone, for a remote file

CHUNK_FRONT = 8 + 8 + 8 + 4 + 4 + 8  # bytes before a chunk's content, without the compression's name
INDEX_FRONT = 2 + 4  # bytes of a message index before its entries
ENTRY_BYTES = 16  # bytes


def promised(data: FileBytes) -> Survey | None:
    """Return the survey by the file's summary section alone, without reading chunks.

    None unless the chunks, counts and definitions of the summary agree. If they agree, no needed record lies
    between chunks.
    """
    summary = read_summary(data)
    if summary is None or summary.statistics is None:
        return None
    parts: list[Part] = []
    total: Counter[int] = Counter()
    end = 0
    for _, entry in sorted(summary.chunks.items()):
        chunk = _promised_chunk(entry)
        if chunk is None or chunk.offset < end:
            return None
        end = chunk.start + chunk.size
        parts.append(chunk)
        total.update(chunk.counts or {})
    statistics = summary.statistics
    agrees = (
        total == Counter(statistics.counts)
        and total.total() == statistics.messages
        and len(parts) == statistics.chunks
        and len(summary.attachments) == statistics.attachments
        and total.keys() <= summary.channels.keys()
        and all(summary.channels[ident].schema_id in {0, *summary.schemas} for ident in total)
        and end <= summary.start
        and all(length > 0 for _, length in summary.attachments)
    )
    if not agrees:
        return None
    sort_by_time(parts)
    summary.parts = parts
    summary.attachments.sort()
    return summary


def _promised_chunk(entry: rec.ChunkIndex) -> ChunkRef | None:
    """Return the chunk of a ChunkIndex record, with the message indexes that follow it without a gap.

    None if the record contradicts itself, or if the chunk is too large to be read at once.
    """
    front = CHUNK_FRONT + len(entry.compression.encode())
    begin = entry.offset + entry.length
    order = sorted((at, ident) for ident, at in entry.indexes.items())
    if entry.length != rec.RECORD.size + front + entry.packed or not order or order[0][0] != begin:
        return None
    if not entry.compression and entry.packed > LARGE_CHUNK_BYTES:
        return None
    indexes, counts = {}, {}
    for (at, ident), end in zip(order, [*(at for at, _ in order[1:]), begin + entry.index_length], strict=True):
        length = end - at - rec.RECORD.size
        if length < INDEX_FRONT or (length - INDEX_FRONT) % ENTRY_BYTES:
            return None
        indexes[ident], counts[ident] = (at + rec.RECORD.size, length), (length - INDEX_FRONT) // ENTRY_BYTES
    start, span = begin - entry.packed, (entry.first, entry.last)
    chunk = ChunkRef(entry.offset, start, entry.packed, entry.compression, entry.plain, counts=counts, span=span)
    chunk.index, chunk.promised = indexes, True
    return chunk


def confirm(data: FileBytes, chunk: ChunkRef) -> None:
    """Compare a chunk from the summary with its own header in the file, and take over the CRC of the header.

    Only a chunk that is `promised` (all fields from the summary) is compared. Raises DamagedError if they differ.
    """
    if chunk.promised:
        own = None
        with suppress(DamagedError):
            own = chunk_at(chunk.offset, data)
        if own is None or replace(own, index=chunk.index, counts=chunk.counts, crc=0, promised=True) != chunk:
            raise DamagedError("a chunk is not what the summary says")
        chunk.crc, chunk.promised = own.crc, False


# --- The kind of a file by its first bytes, for error messages

SIGNATURES = (
    (b"\x89MCAP0\r\n", "an MCAP file"),
    (b"SQLite format 3\x00", "a sqlite3 database (a rosbag2 .db3 is one)"),
    (b"#ROSBAG V2.0", "a ROS 1 bag"),
    (b"#ROSBAG", "a ROS 1 bag of an old version"),
    (b"\x28\xb5\x2f\xfd", "zstd-compressed data"),
    (b"\x04\x22\x4d\x18", "lz4-compressed data"),
    (b"\x1f\x8b", "gzip-compressed data"),
    (b"BZh", "bzip2-compressed data"),
    (b"PK\x03\x04", "a zip archive"),
    (b"\xff\xd8\xff", "a JPEG image"),
    (b"\x89PNG", "a PNG image"),
    (b"%PDF", "a PDF document"),
    (b"RRF", "a Rerun recording"),
    (b"rosbag2_bagfile_information", "a rosbag2 metadata.yaml"),
    (b"{", "JSON text"),
)


def describe(head: bytes) -> str:
    """Return the kind of a file from its first 64 or more bytes, as text."""
    if not head:
        return "empty (0 bytes)"
    for signature, words in SIGNATURES:
        if head.startswith(signature):
            return words
    if not head.strip(b"\x00"):
        return "filled with zeros"
    try:
        text = head[:60].decode()
    except UnicodeDecodeError:
        return "of an unknown kind"
    return "a text file" if text.isprintable() or "\n" in text else "of an unknown kind"


# --- The survey, record by record

SEARCH_BYTES = 1 << 20  # searched at once for the next readable record after damage
RUN_BYTES = 1 << 20  # size of the blocks in which messages outside chunks are read; a larger message is read alone
LARGE_CHUNK_BYTES = 32 * 1024 * 1024
CUT_OFF = "the file ends without an end mark: the recording was cut off"
NO_SUMMARY = "the summary is damaged: messages may be missing, their number is unknown"


def survey(data: FileBytes) -> Survey:
    """Survey the data section from the first record to DataEnd; damaged parts are recorded as losses."""
    magic = data.read(0, len(rec.MAGIC))
    summary = read_summary(data)
    if magic != rec.MAGIC and summary is None:
        raise LocfuseError(f"{data.path}: not an MCAP file: it is {describe(data.read(0, 64))}")
    return _SurveyWalk(data, summary).run()


class _SurveyWalk:
    def __init__(self, data: FileBytes, summary: FileSummary | None) -> None:
        self.data = data
        self.summary = summary
        known = summary or FileSummary()
        self.promised = known.chunks
        self.found = Survey([], known.schemas, known.channels, [], known.expected)
        self.chunked = False
        self._starts = sorted(self.promised)
        self._window = range(0)  # file offsets of the bytes searched last for a readable record
        self._places: Ints = np.empty(0, np.int64)  # possible record starts in the window, file offsets
        self._chunks_only = False  # whether `_places` has chunks only
        self.index_end = 0  # end of the last chunk's message indexes, from the summary

    def run(self) -> Survey:
        here = len(rec.MAGIC)
        at: int | None = here
        while at is not None and at < self.data.size:
            here, at = at, self._step(at)
        if at is not None:
            self.data.lose(CUT_OFF, 0, 0)
        elif self.summary is None and ((foot := _footer(self.data)) is None or foot[0] != 0):
            self.data.lose(NO_SUMMARY, here, self.data.size - here)
        for part in self.found.parts:
            entry = self.promised.get(part.offset)
            if isinstance(part, ChunkRef) and (entry is None or entry.indexes.keys() != part.index.keys()):
                part.counts = None  # not confirmed by the summary: the chunk is read to count its messages
        # no checksum covers the times in a chunk's header: they are used only if equal to the summary's
        times = sorted((entry.first, entry.last) for entry in self.promised.values())
        if sorted(part.span for part in self.found.parts) == times:
            sort_by_time(self.found.parts)
        return self.found

    def _step(self, at: int) -> int | None:
        """Process the record at `at`; return the next record's offset, None at the end of the data section."""
        head = self.data.read(at, rec.RECORD.size)
        if len(head) < rec.RECORD.size:
            return self._skip_damage(at, "the file is cut off inside a record")
        opcode, length = rec.RECORD.unpack_from(head)
        end: int = at + rec.RECORD.size + length
        if self._is_end(end, opcode, length):
            if opcode == rec.DATA_END:
                self._check_data_crc(at)
            return None
        try:
            if not (0 < opcode < rec.DATA_END or opcode >= rec.PRIVATE) or opcode == rec.FOOTER:
                raise DamagedError("bytes that are no record")
            if opcode != rec.CHUNK and at in self.promised:
                raise DamagedError("no chunk where the index promises one")
            if opcode != rec.MESSAGE_INDEX and at < self.index_end:
                raise DamagedError("no message index where the chunk index promises one")
            if end > self.data.size and opcode != rec.CHUNK:
                raise DamagedError("a record reaches beyond the end of the file")
            return min(self._add(opcode, at, end), self.data.size)
        except DamagedError as problem:
            if self.found.parts and isinstance(chunk := self.found.parts[-1], ChunkRef):
                chunk.index.clear()  # damage behind the chunk may have destroyed message indexes
                chunk.counts = None
            return self._skip_damage(at, str(problem))

    def _add(self, opcode: int, at: int, end: int) -> int:
        """Add the record from `at` to `end` to the result; return the offset from which to read on."""
        start = at + rec.RECORD.size
        if opcode == rec.MESSAGE:
            return self._unchunked(at, end)
        if opcode == rec.CHUNK:
            return self._chunk(at, end)
        if opcode in {rec.SCHEMA, rec.CHANNEL}:
            if end - start > MAX_CHUNK:
                raise DamagedError(f"a record claims more than {MAX_CHUNK >> 20} MiB")
            self.found.define(opcode, self.data.read(start, end - start))
        elif opcode == rec.ATTACHMENT:
            self.found.attachments.append((start, end - start))
        elif opcode == rec.MESSAGE_INDEX and self.found.parts and isinstance(self.found.parts[-1], ChunkRef):
            chunk = self.found.parts[-1]
            ident, n_bytes, _ = rec.values(self.data.read(start, 6), "HI")
            if n_bytes != end - start - 6 or n_bytes % 16:
                raise DamagedError("a message index that contradicts itself")
            chunk.index[ident] = (start, end - start)
            if not chunk.cut_off:
                chunk.counts = (chunk.counts or {}) | {ident: n_bytes // 16}
        return end

    def _is_end(self, end: int, opcode: int, length: int) -> bool:
        """Return whether the record that ends at `end` is a DataEnd or Footer at a plausible offset.

        At any other offset such a record comes from a flipped bit.
        """
        if opcode == rec.FOOTER:
            return end + len(rec.MAGIC) == self.data.size
        if opcode != rec.DATA_END or length != 4:
            return False
        if self.summary and self.summary.start:
            return end == self.summary.start
        return end >= self.data.size or 0 < self.data.read(end, 1)[0] <= rec.DATA_END

    def _check_data_crc(self, at: int) -> None:
        """Check the data section's CRC-32, if it has one and some messages are outside chunks."""
        value = self.data.read(at + rec.RECORD.size, 4)
        crc = int.from_bytes(value, "little") if len(value) == 4 else 0  # the file may be cut off inside it
        unchunked = any(not isinstance(part, ChunkRef) for part in self.found.parts)
        if crc and unchunked and self.data.crc32(0, at) != crc:
            self.data.lose("the file fails its checksum: values may be wrong", 0, 0)

    def _unchunked(self, at: int, end: int) -> int:
        """Add consecutive messages outside chunks as a part; return their end offset."""
        n_bytes = max(end - at, RUN_BYTES)
        if n_bytes > MAX_CHUNK:
            self.data.lose(f"a message is larger than {MAX_CHUNK >> 20} MiB", at, n_bytes, 1)
            return at + n_bytes
        data = np.frombuffer(self.data.read(at, n_bytes), np.uint8)
        found = rec.scan(data)
        if not found.messages:
            raise DamagedError("bytes that are no record")
        for opcode, start, size in found.definitions:
            self.found.define(opcode, data[start : start + size].tobytes())
        counts = {ident: len(messages.start) for ident, messages in found.messages.items()}
        times = np.concatenate([messages.log_time for messages in found.messages.values()])
        span = int(times.min()), int(times.max())
        self.found.parts.append(Part(at, at, found.end, counts=counts, span=span))
        return at + found.end

    def _chunk(self, at: int, end: int) -> int:
        """Add a chunk; return the offset from which to read on."""
        chunk = chunk_at(at, self.data)
        declared, chunk.size = chunk.size, min(chunk.size, max(self.data.size - chunk.start, 0))
        chunk.cut_off = chunk.size < declared
        if chunk.cut_off and self._next_readable(at + 1) is not None:
            raise DamagedError("a chunk reaches beyond the end of the file")
        if not chunk.compression and declared > LARGE_CHUNK_BYTES:  # read its messages like unchunked ones
            if chunk.cut_off or not chunk.crc or self.data.crc32(chunk.start, end) == chunk.crc:
                return chunk.start
            self.data.lose("a chunk fails its checksum", chunk.start, chunk.size)
            return end
        self.chunked = True
        if at in self.promised:
            self.index_end = end + self.promised[at].index_length
        self.found.parts.append(chunk)
        return end

    def _next_readable(self, at: int) -> int | None:
        """Return the offset of the next chunk at or after `at`, in an unchunked file of the next message.

        It is found by the chunk index, or else by a search of the bytes. None if there is none.
        """
        if self._starts:
            i = bisect_left(self._starts, at)
            return self._starts[i] if i < len(self._starts) else None
        end = self.summary.start if self.summary else self.data.size
        while at + rec.RECORD.size <= end:
            if at not in self._window or self.chunked != self._chunks_only:
                window = np.frombuffer(self.data.read(at, SEARCH_BYTES), np.uint8)
                n = len(window) - rec.RECORD.size + 1
                wanted = (window[:n] == rec.CHUNK) | ((window[:n] == rec.MESSAGE) & (not self.chunked))
                wanted &= np.ndarray((n,), "<u4", window, 5, (1,)) == 0  # upper half of the length: below 4 GiB
                self._window, self._chunks_only = range(at, at + n), self.chunked
                self._places = np.flatnonzero(wanted) + at
            for i in range(int(np.searchsorted(self._places, at)), len(self._places)):
                place = int(self._places[i])
                if self._is_chunk(place) or (not self.chunked and self._are_records(place)):
                    return place
            at = self._window.stop
        return None

    def _is_chunk(self, at: int) -> bool:
        try:
            chunk = chunk_at(at, self.data)
        except DamagedError:
            return False
        return chunk.start + chunk.size <= self.data.size and chunk.compression in CODECS

    def _are_records(self, at: int) -> bool:
        """Return whether three plausible records in a row begin here, with messages of known channels only."""
        for _ in range(3):
            head = self.data.read(at, rec.RECORD.size + 2)
            if len(head) < rec.RECORD.size + 2:
                return False
            opcode, length = rec.RECORD.unpack_from(head)
            if (
                opcode == rec.MESSAGE
                and int.from_bytes(head[rec.RECORD.size :], "little") not in self.found.channels
            ):
                return False
            if not 0 < opcode <= rec.DATA_END or at + rec.RECORD.size + length > self.data.size:
                return False
            if opcode == rec.DATA_END:
                return True
            at += rec.RECORD.size + length
        return True

    def _skip_damage(self, at: int, reason: str) -> int:
        """Record the bytes up to the next readable record as lost; return its offset."""
        following = self._next_readable(at + 1)
        if following is None:
            following = self.summary.start if self.summary and self.summary.start > at else self.data.size
        self.data.lose(reason, at, following - at)
        return following
