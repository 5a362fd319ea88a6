"""Writing ROS 2 logs as MCAP: message by message, or from columns without a Python call for each message.

Chunks are packed by zstd and have checksums. Format: https://mcap.dev/spec. Records but for messages are those of
the `mcap` library.
"""

from __future__ import annotations

import contextlib
import os
import struct
import zlib
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import IO, Any, NamedTuple, Self

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
from mcap.writer import CompressionType, Writer
from numpy.typing import NDArray
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_typestore

from locfuse.formats.whole_files import claim, temporary_for
from locfuse.fusion.data import Ints, LocfuseError

from .mcap_records import MAGIC

RECORD_HEAD_BYTES = 9  # bytes of opcode and length
HEAD = [("op", "u1"), ("length", "<u8"), ("channel", "<u2"), ("sequence", "<u4"), ("log", "<u8"), ("pub", "<u8")]
HEAD_BYTES = np.dtype(HEAD).itemsize
COMPRESSION = "zstd"


class MessageBlock(NamedTuple):
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

    def chunk(self, blocks: Sequence[MessageBlock]) -> None:
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


def _records(block: MessageBlock) -> tuple[bytes, Ints]:
    """Return the Message records of a block, and where each begins (n,)."""
    n = len(block.log_time)
    lengths = np.fromiter(map(len, block.payload), np.int64, n)
    head = np.empty(n, HEAD)
    head["op"], head["channel"] = Opcode.MESSAGE, block.channel
    head["length"] = HEAD_BYTES - RECORD_HEAD_BYTES + lengths
    published = block.log_time if block.publish_time is None else block.publish_time
    head["sequence"], head["log"], head["pub"] = block.sequence, block.log_time, published
    offsets: Ints = np.concatenate(([0], np.cumsum(HEAD_BYTES + lengths)[:-1]))
    heads = head.view(np.uint8).reshape(n, -1)
    if isinstance(block.payload, np.ndarray):
        return np.hstack((heads, block.payload)).tobytes(), offsets
    return b"".join(part for pair in zip(map(bytes, heads), block.payload, strict=True) for part in pair), offsets


# --- Standard ROS 2 messages as CDR, with their ros2msg schemas

# A late subscriber of a latched topic still gets it when the bag is played: rosbag2 reads this per channel.
LATCHED = """\
- history: 1
  depth: 1
  reliability: 1
  durability: 1
  deadline: {sec: 9223372036, nsec: 854775807}
  lifespan: {sec: 9223372036, nsec: 854775807}
  liveliness: 1
  liveliness_lease_duration: {sec: 9223372036, nsec: 854775807}
  avoid_ros_namespace_conventions: false
"""

CHUNK_BYTES = 512 * 1024  # bytes before compression: a reader of one topic skips little


def time_message(ns: int) -> dict[str, int]:
    """Return the fields of a builtin_interfaces/Time."""
    return {"sec": ns // 1_000_000_000, "nanosec": ns % 1_000_000_000}


def nested(fields: Mapping[str, Any]) -> dict[str, Any]:
    """Return {"a.b": 1} as {"a": {"b": 1}}."""
    tree: dict[str, Any] = {}
    for path, value in fields.items():
        *parents, leaf = path.split(".")
        node = tree
        for name in parents:
            node = node.setdefault(name, {})
        node[leaf] = value
    return tree


class StandardMessages:
    """Builds and serialises messages of the standard ROS 2 types from plain values."""

    def __init__(self) -> None:
        self._store = get_typestore(Stores.ROS2_HUMBLE)

    def schema(self, msgtype: str) -> str:
        """Return the ros2msg text of a type with all the types it uses."""
        if msgtype not in self._store.fielddefs:
            raise LocfuseError(f"{msgtype} is not a standard ROS 2 message type: it cannot be written")
        return self._store.generate_msgdef(msgtype, ros_version=2)[0]

    def has_header(self, msgtype: str) -> bool:
        """Say whether the type starts with a std_msgs/Header."""
        fields = self._store.fielddefs[msgtype][1]
        return bool(fields) and fields[0][1] == (Nodetype.NAME, "std_msgs/msg/Header")

    def cdr(self, msgtype: str, values: Mapping[str, Any]) -> bytes:
        """Return the message as CDR bytes; what `values` (nested) leaves out is zero or empty."""
        return bytes(self._store.serialize_cdr(self._build(msgtype, values), msgtype))

    def _build(self, msgtype: str, values: Mapping[str, Any]) -> Any:
        fields = self._store.fielddefs[msgtype][1]
        unknown = set(values) - {name for name, _ in fields}
        if unknown:
            raise ValueError(f"{msgtype} has no field {', '.join(sorted(unknown))}")
        return self._store.types[msgtype](**{name: self._value(kind, values.get(name)) for name, kind in fields})

    def _value(self, kind: Any, value: Any) -> Any:
        node, inner = kind
        if node == Nodetype.NAME:
            return self._build(inner, value or {})
        if node == Nodetype.BASE:
            return _default(inner[0]) if value is None else value
        element, length = inner  # an array or a sequence
        if element[0] == Nodetype.NAME:
            return [self._build(element[1], v) for v in (() if value is None else value)]
        base = element[1][0]
        if base == "string":
            return [] if value is None else list(value)
        if isinstance(value, bytes | bytearray | memoryview):
            return np.frombuffer(value, np.uint8)
        return np.zeros(length, base) if value is None else np.asarray(value, base)


def _default(base: str) -> str | int | float:
    if base == "string":
        return ""
    return 0.0 if base.startswith("float") else 0


class LogWriter:
    """A ROS 2 log that appears whole or not at all: written beside `path`, renamed onto it when closed.

    As a context manager it closes on success and leaves nothing behind when an exception passes through.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self._part = temporary_for(self.path)
        self._messages = StandardMessages()
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, tuple[int, str]] = {}  # topic -> channel id, message type
        self._sequence: dict[str, int] = {}
        self._file = self._open()
        self._writer: Any = Writer(  # Any: its `finish` is untyped
            self._file, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD, enable_data_crcs=True
        )
        self._writer.start(profile="ros2", library="locfuse")

    def attach(self, name: str, data: bytes, media_type: str = "application/toml", log_ns: int = 0) -> None:
        """Add an attachment, such as robot.toml."""
        self._writer.add_attachment(
            create_time=log_ns, log_time=log_ns, name=name, media_type=media_type, data=data
        )

    def write(
        self,
        topic: str,
        msgtype: str,
        fields: Mapping[str, Any],
        log_ns: int,
        *,
        stamp_ns: int | None = None,
        frame_id: str = "",
        latched: bool = False,
    ) -> None:
        """Append one message: values by dotted field path; `stamp_ns` (default log_ns) fills its header."""
        channel = self._channel(topic, msgtype, latched)
        values = nested(fields)
        if self._messages.has_header(msgtype):
            stamp = time_message(log_ns if stamp_ns is None else stamp_ns)
            values["header"] = {"stamp": stamp, "frame_id": frame_id}
        self._sequence[topic] += 1
        self._writer.add_message(
            channel_id=channel,
            log_time=log_ns,
            publish_time=log_ns,
            sequence=self._sequence[topic],
            data=self._messages.cdr(msgtype, values),
        )

    def _channel(self, topic: str, msgtype: str, latched: bool) -> int:
        if topic in self._channels:
            known, existing = self._channels[topic]
            if existing != msgtype:
                raise ValueError(f"{topic} holds {existing}, not {msgtype}")
            return known
        if msgtype not in self._schemas:
            text = self._messages.schema(msgtype).encode()
            self._schemas[msgtype] = self._writer.register_schema(msgtype, "ros2msg", text)
        metadata = {"offered_qos_profiles": LATCHED if latched else ""}
        channel: int = self._writer.register_channel(topic, "cdr", self._schemas[msgtype], metadata)
        self._channels[topic] = channel, msgtype
        self._sequence[topic] = 0
        return channel

    def _open(self) -> IO[bytes]:
        try:
            claim(self._part)
            return self._part.open("wb")
        except OSError as error:
            folder = self.path.parent
            raise LocfuseError(f"{self.path} cannot be written: {folder}: {error.strerror}") from error

    def close(self) -> None:
        """Finish the file and give it its name; if that fails, nothing is left behind."""
        try:
            self._writer.finish()
            self._file.flush()
            os.fsync(self._file.fileno())
            self._file.close()
            self._part.replace(self.path)
        except BaseException:
            self.abort()
            raise

    def abort(self) -> None:
        """Throw away what was written; a file of that name, if there was one, stays as it is."""
        with contextlib.suppress(OSError):  # closing flushes: on a full disk that fails once more
            self._file.close()
        self._part.unlink(missing_ok=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None:
            self.close()
        else:
            self.abort()
