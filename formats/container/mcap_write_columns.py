"""Writing MCAP from columns: a chunk of many messages at a time, without a Python call for each.

Format: https://mcap.dev/spec. Records but for messages are those of the `mcap` library.
"""

from __future__ import annotations

import struct
import zlib
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import IO, Any, NamedTuple

import numpy as np
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from numpy.typing import NDArray

from locfuse.fusion.data import Ints

from .mcap_records import MAGIC

RECORD = 9  # bytes of opcode and length
HEAD = [("op", "u1"), ("length", "<u8"), ("channel", "<u2"), ("sequence", "<u4"), ("log", "<u8"), ("pub", "<u8")]
HEAD_BYTES = np.dtype(HEAD).itemsize
COMPRESSION = "zstd"


class Block(NamedTuple):
    """Messages of one channel."""

    channel: int
    log_time: Ints  # (n,) ns
    sequence: Ints  # (n,)
    payload: NDArray[np.uint8] | Sequence[memoryview]  # (n, size), or of any lengths
    publish_time: Ints | None = None  # (n,) ns; None: the log times


class ColumnWriter:
    """Writes an MCAP into an open file: definitions, then chunks, then `finish`."""

    def __init__(self, file: IO[bytes], profile: str = "ros2") -> None:
        self._file = file
        self._at = 0
        self._crc = 0
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        self._chunks: list[ChunkIndex] = []
        self._attachments: list[AttachmentIndex] = []
        self._counts: Counter[int] = Counter()
        self._times: list[int] = []
        self._notes: list[MetadataIndex] = []
        self._put(MAGIC)
        self._record(Header(profile, "locfuse"))

    def schema(self, name: str, encoding: str, data: bytes) -> int:
        """Write a schema and return its number."""
        self._schemas.append(Schema(id=len(self._schemas) + 1, name=name, encoding=encoding, data=data))
        self._record(self._schemas[-1])
        return self._schemas[-1].id

    def channel(self, topic: str, encoding: str, schema: int, metadata: Mapping[str, str]) -> int:
        """Write a channel and return its number."""
        number = len(self._channels) + 1
        self._channels.append(Channel(number, topic, encoding, dict(metadata), schema))
        self._record(self._channels[-1])
        return number

    def attach(self, name: str, data: bytes, media_type: str, time_ns: int) -> None:
        """Write an attachment, such as robot.toml."""
        at = self._at
        self._record(Attachment(time_ns, time_ns, name, media_type, data))
        length = self._at - at
        self._attachments.append(AttachmentIndex(at, length, time_ns, time_ns, len(data), name, media_type))

    def metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write a metadata record: words about the file by key."""
        at = self._at
        self._record(Metadata(name=name, metadata=dict(values)))
        self._notes.append(MetadataIndex(length=self._at - at, name=name, offset=at))

    def chunk(self, blocks: Sequence[Block]) -> None:
        """Write messages as one chunk with an index for each of its channels."""
        blocks = [block for block in blocks if len(block.log_time)]
        if not blocks:
            return
        packed = [_records(block) for block in blocks]
        first = np.cumsum([0, *(len(data) for data, _ in packed)]).tolist()
        plain = b"".join(data for data, _ in packed)
        entries: dict[int, list[NDArray[np.uint64]]] = {}
        for block, (_, offsets), start in zip(blocks, packed, first, strict=False):
            pair = np.stack((block.log_time, offsets + start), axis=1).astype("<u8")
            entries.setdefault(block.channel, []).append(pair)
            self._counts[block.channel] += len(pair)
        self._write_chunk(plain, {channel: np.concatenate(pairs) for channel, pairs in entries.items()})

    def _write_chunk(self, plain: bytes, entries: Mapping[int, NDArray[np.uint64]]) -> None:
        times = np.concatenate([pairs[:, 0] for pairs in entries.values()])
        begin, end = int(times.min()), int(times.max())
        self._times += [begin, end]
        data = zstandard.compress(plain)
        name = COMPRESSION.encode()
        head = struct.pack("<QQQII", begin, end, len(plain), zlib.crc32(plain), len(name)) + name
        body = head + struct.pack("<Q", len(data))
        at = self._at
        self._put(struct.pack("<BQ", Opcode.CHUNK, len(body) + len(data)) + body + data)
        size, offsets = self._at - at, {}
        for channel, pairs in sorted(entries.items()):
            offsets[channel] = self._at
            content = pairs[np.argsort(pairs[:, 0], kind="stable")].tobytes()
            self._put(
                struct.pack("<BQHI", Opcode.MESSAGE_INDEX, 6 + len(content), channel, len(content)) + content
            )
        self._chunks.append(
            ChunkIndex(
                chunk_length=size,
                chunk_start_offset=at,
                compression=COMPRESSION,
                compressed_size=len(data),
                message_end_time=end,
                message_index_length=self._at - at - size,
                message_index_offsets=offsets,
                message_start_time=begin,
                uncompressed_size=len(plain),
            )
        )

    def finish(self) -> None:
        """Write the summary and the file's end."""
        self._record(DataEnd(self._crc))
        groups: list[tuple[Opcode, list[Any]]] = [
            (Opcode.SCHEMA, self._schemas),
            (Opcode.CHANNEL, self._channels),
            (Opcode.STATISTICS, [self._statistics()]),
            (Opcode.CHUNK_INDEX, self._chunks),
            (Opcode.ATTACHMENT_INDEX, self._attachments),
            (Opcode.METADATA_INDEX, self._notes),
        ]
        start, offsets = self._at, []
        summary: Any = RecordBuilder()  # Any: its `end` is untyped
        for opcode, records in groups:
            if not records:
                continue
            begin = summary.count
            for record in records:
                record.write(summary)
            offsets.append(
                SummaryOffset(group_opcode=opcode, group_start=start + begin, group_length=summary.count - begin)
            )
        offset_start = start + summary.count
        for offset in offsets:
            offset.write(summary)
        data: bytes = summary.end()
        self._put(data)
        begin_of_footer = struct.pack("<BQQQ", Opcode.FOOTER, 20, start, offset_start)
        self._record(Footer(start, offset_start, zlib.crc32(begin_of_footer, zlib.crc32(data))))
        self._put(MAGIC)

    def _statistics(self) -> Statistics:
        return Statistics(
            attachment_count=len(self._attachments),
            channel_count=len(self._channels),
            channel_message_counts=dict(sorted(self._counts.items())),
            chunk_count=len(self._chunks),
            message_count=self._counts.total(),
            message_end_time=max(self._times, default=0),
            message_start_time=min(self._times, default=0),
            metadata_count=len(self._notes),
            schema_count=len(self._schemas),
        )

    def _record(self, record: Any) -> None:
        builder: Any = RecordBuilder()
        record.write(builder)
        self._put(builder.end())

    def _put(self, data: bytes) -> None:
        self._file.write(data)
        self._at += len(data)
        self._crc = zlib.crc32(data, self._crc)


def _records(block: Block) -> tuple[bytes, Ints]:
    """Return the Message records of a block, and where each begins (n,)."""
    n = len(block.log_time)
    lengths = np.fromiter(map(len, block.payload), np.int64, n)
    head = np.empty(n, HEAD)
    head["op"], head["channel"], head["length"] = Opcode.MESSAGE, block.channel, HEAD_BYTES - RECORD + lengths
    published = block.log_time if block.publish_time is None else block.publish_time
    head["sequence"], head["log"], head["pub"] = block.sequence, block.log_time, published
    offsets: Ints = np.concatenate(([0], np.cumsum(HEAD_BYTES + lengths)[:-1]))
    heads = head.view(np.uint8).reshape(n, -1)
    if isinstance(block.payload, np.ndarray):
        return np.hstack((heads, block.payload)).tobytes(), offsets
    return b"".join(part for pair in zip(map(bytes, heads), block.payload, strict=True) for part in pair), offsets
