"""The common interface of log files: channels, and batches of raw messages in one buffer.

A batch is about one chunk, so memory use is bounded; its messages are columns of offsets into the buffer, so that
decoding can gather a field of all messages at once.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import msgspec
import numpy as np
import zstandard
from numpy.typing import NDArray

from locfuse.formats.columns import Bytes, view
from locfuse.formats.inputs import FREE_RECORDS, MAX_CHUNK, MAX_MESSAGE
from locfuse.fusion.data import Ints

from .decompress import DamagedError, decompress, decompress_prefix
from .file_bytes import FileBytes


class ChannelInfo(NamedTuple):
    """One channel of one file. Channels with the same topic are one stream."""

    topic: str
    msgtype: str  # as written in the file
    encoding: str  # of the messages: cdr, json, ros1, protobuf
    schema_encoding: str  # ros2msg, ros2idl, ros1msg, jsonschema, protobuf
    schema: bytes
    n: int | None  # number of messages; None where the file does not store it


class Messages(NamedTuple):
    """The messages of one channel in one batch, in file order."""

    start: Ints  # (k,) offset of the first payload byte in the batch's buffer
    length: Ints  # (k,) number of payload bytes
    log_time: Ints  # (k,) ns
    sequence: Ints  # (k,)
    published: Ints  # (k,) publish times, ns; the log times if the file stores none

    def take(self, rows: NDArray[Any] | slice) -> Messages:
        """Return the messages of these rows: indices, a mask or a slice."""
        return Messages(*(column[rows] for column in self))


def by_channel(channel: Ints, everything: Messages) -> dict[int, Messages]:
    """Group messages by channel id (k,)."""
    return {int(ident): everything.take(channel == ident) for ident in np.unique(channel)}


class Batch(NamedTuple):
    """Messages that were read and decompressed together."""

    data: Bytes
    messages: dict[int, Messages]  # by channel id


class Source(ABC):
    """One file of a log; damaged parts are skipped and recorded as losses."""

    channels: Mapping[int, ChannelInfo]  # by id

    def __init__(self, data: FileBytes) -> None:
        self.path = data.path
        self.data = data

    @property
    def attachments(self) -> Mapping[str, bytes]:
        """Attachments by name."""
        return {}

    @property
    def checked(self) -> bool:
        """Whether the file has checksums that reveal a changed value."""
        return False

    @property
    @abstractmethod
    def time_span_ns(self) -> tuple[int, int] | None:
        """First and last log time [ns]; None without messages."""

    @abstractmethod
    def batches(self, wanted: Collection[int]) -> Iterator[Batch]:
        """Yield the messages of the wanted channels in file order, the same at every call."""


def message_type(name: str) -> str:
    """Return a ROS type name in the form "pkg/msg/Name"; "pkg/Name" and "pkg::msg::Name" are converted."""
    parts = name.replace("::", "/").split("/")
    return f"{parts[0]}/msg/{parts[1]}" if len(parts) == 2 else "/".join(parts)


# --- Messages compressed one by one (rosbag2 "message mode"). They are recognised by zstd's magic number at their
# beginning, so metadata.yaml is not needed, which is missing after a crash

ZSTD_WORD = 0xFD2FB528
MAX_PORTION_BYTES = 16 * 1024 * 1024  # bytes of unpacked messages per yielded portion


def unpack(data: Bytes, messages: Messages) -> Iterator[tuple[Bytes, Messages]]:
    """Decompress zstd messages; yield (buffer, messages) in portions of about MAX_PORTION_BYTES.

    A damaged message becomes empty. A batch without zstd messages is yielded unchanged.
    """
    words = view(data, "<u4", messages.start[messages.length >= 4])
    if not (words == ZSTD_WORD).any():
        yield data, messages
        return
    pieces: list[bytes] = []
    first, size = 0, 0
    for i, (at, n) in enumerate(zip(messages.start.tolist(), messages.length.tolist(), strict=True)):
        pieces.append(_unpacked_message(data[at : at + n].tobytes()))
        size += len(pieces[-1])
        if size >= MAX_PORTION_BYTES:
            yield _portion(pieces, messages.take(slice(first, i + 1)))
            pieces, first, size = [], i + 1, 0
    if pieces:
        yield _portion(pieces, messages.take(slice(first, None)))


def _unpacked_message(message: bytes) -> bytes:
    if int.from_bytes(message[:4], "little") != ZSTD_WORD:
        return message
    try:
        declared = zstandard.frame_content_size(message)  # -1: the frame declares none
        plain = zstandard.ZstdDecompressor().stream_reader(message, read_across_frames=True).read(MAX_MESSAGE + 1)
    except zstandard.ZstdError:
        return b""
    return plain if declared <= len(plain) <= MAX_MESSAGE else b""  # a cut-off frame gives less


def _portion(pieces: list[bytes], messages: Messages) -> tuple[Bytes, Messages]:
    ends = np.cumsum([len(piece) for piece in pieces], dtype=np.int64)
    length = np.diff(ends, prepend=0)
    return np.frombuffer(b"".join(pieces), np.uint8), messages._replace(start=ends - length, length=length)


# --- Files of chunks (MCAP, ROS 1 bag), read chunk by chunk with bounded memory

CUT_OFF = "the file is cut off inside a chunk"
NO_RECORD = "a chunk holds bytes that are no record"


class Part(msgspec.Struct):
    """A part of a file: one chunk, or consecutive messages outside chunks."""

    offset: int  # of the chunk record in the file
    start: int  # of the content in the file
    size: int  # bytes of content; in a cut-off file only those that are present
    compression: str = ""
    plain: int | None = None  # uncompressed bytes; None outside chunks
    cut_off: bool = False  # whether the file ends inside this part
    counts: dict[int, int] | None = None  # channel -> messages, once known
    span: tuple[int, int] = (0, 0)  # log times of its first and last message, ns


class Records(NamedTuple):
    """The messages and channel definitions of one part of a file."""

    messages: dict[int, Messages]
    definitions: list[Any]  # of channels; their type depends on the file format
    end: int  # offset of the first invalid record; without damage, the size of the part


def most_records(packed: int) -> int:
    """Return the largest accepted number of records in a chunk of `packed` compressed bytes.

    FREE_RECORDS are always accepted; each further record needs at least one compressed byte.
    """
    return FREE_RECORDS + packed


class ChunkedSource(Source):
    """A file of parts (chunks) that are read one after the other."""

    parts: Sequence[Part]  # in reading order

    @abstractmethod
    def search(self, part: Part, data: Bytes) -> Records:
        """Find the records in the uncompressed bytes of a part. Raises DamagedError."""

    def batches(self, wanted: Collection[int]) -> Iterator[Batch]:
        """Yield the messages of the wanted channels in file order."""
        for part in self.parts:
            if part.counts is not None and not part.counts.keys() & wanted:
                continue
            data, found = self.load(part)
            if messages := {ident: m for ident, m in found.messages.items() if ident in wanted}:
                yield Batch(data, messages)

    def load(self, part: Part) -> tuple[Bytes, Records]:
        """Return a part's uncompressed bytes and its records; record losses and message counts."""
        known = None if part.counts is None else sum(part.counts.values())
        try:
            data = np.frombuffer(self.unpacked(part), np.uint8)
            found = self.search(part, data)
        except DamagedError as problem:
            self.data.lose(str(problem), part.offset, part.size, known)
            data, found = np.empty(0, np.uint8), Records({}, [], 0)
        else:
            if found.end < len(data) or part.cut_off:
                reason = CUT_OFF if part.cut_off else NO_RECORD
                n = sum(len(m.start) for m in found.messages.values())
                missing = None if known is None else max(known - n, 0)
                self.data.lose(reason, part.offset, len(data) - found.end, missing)
        if part.counts is None:
            part.counts = {ident: len(m.start) for ident, m in found.messages.items()}
        return data, found

    def unpacked(self, part: Part) -> bytes:
        """Return the uncompressed bytes of a part. Raises DamagedError."""
        if part.size > MAX_CHUNK:
            raise DamagedError(f"a chunk is larger than {MAX_CHUNK >> 20} MiB")
        packed = self.data.read(part.start, part.size)
        if part.plain is None:
            return packed
        return (decompress_prefix if part.cut_off else decompress)(packed, part.compression, part.plain)

    def counted(self) -> Counter[int]:
        """Return channel -> number of messages in all parts."""
        total: Counter[int] = Counter()
        for part in self.parts:
            total.update(part.counts or {})
        return total
