"""Logs to damage: a short simulated drive in several layouts, the sample logs, and real ones."""

from __future__ import annotations

import io
import os
import struct
import tempfile
from pathlib import Path
from typing import Any, NamedTuple

from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.records import Attachment, Channel, Chunk, Message, Schema
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer

from benchmarks.make_log import main as make_log
from locfuse import sample_logs

SHORT = (
    *("--minutes", "0.04", "--encoder-hz", "25", "--compass-hz", "10", "--scan-hz", "5", "--beams", "61"),
    *("--chunk-size", "4000"),
)
LARGEST = 2_000_000  # bytes of a real log: a case must stay fast
FILES = (".mcap", ".db3", ".bag")


class Spoken(NamedTuple):
    """One message with what it takes to write it again."""

    schema: Schema | None
    channel: Channel
    message: Message


class Base(NamedTuple):
    """A healthy log."""

    name: str
    suffix: str
    data: bytes
    checked: bool  # every chunk has a checksum
    weight: float
    real: bool = False


def contents(data: bytes) -> tuple[list[Spoken], list[Attachment]]:
    """Return the messages and attachments of an .mcap in file order, by the public reader."""
    reader = make_reader(io.BytesIO(data))
    spoken = [Spoken(*entry) for entry in reader.iter_messages(log_time_order=False)]
    return spoken, list(reader.iter_attachments())


def written(spoken: list[Spoken], attachments: list[Attachment], **options: Any) -> bytes:
    """Write messages as they are given, by the public writer; channels and schemas by their content."""
    file = io.BytesIO()
    writer: Any = Writer(file, **options)
    writer.start(profile="ros2", library="locfuse fuzz")
    for a in attachments:
        writer.add_attachment(a.create_time, a.log_time, a.name, a.media_type, a.data)
    known: dict[Any, int] = {}
    for schema, channel, message in spoken:
        if schema is not None and _key(schema) not in known:
            known[_key(schema)] = writer.register_schema(schema.name, schema.encoding, schema.data)
        number = known[_key(schema)] if schema is not None else 0
        key = (channel.topic, channel.message_encoding, number)
        if key not in known:
            known[key] = writer.register_channel(channel.topic, channel.message_encoding, number)
        writer.add_message(known[key], message.log_time, message.data, message.publish_time, message.sequence)
    writer.finish()
    return file.getvalue()


def _key(schema: Schema) -> tuple[str, str, bytes]:
    return schema.name, schema.encoding, schema.data


def has_checksums(data: bytes) -> bool:
    """Whether all messages of a healthy .mcap lie in chunks with a checksum."""
    found = list(StreamReader(io.BytesIO(data), emit_chunks=True).records)
    chunks = [r for r in found if isinstance(r, Chunk)]
    return (
        bool(chunks) and all(c.uncompressed_crc for c in chunks) and not any(isinstance(r, Message) for r in found)
    )


def short_drive() -> bytes:
    """Return a drive of 2.4 s in chunks with checksums."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "short.mcap"
        make_log([str(path), *SHORT], standalone_mode=False)
        return path.read_bytes()


def bases() -> list[Base]:
    """Return everything there is to damage; real logs where LOCFUSE_DATA names their folder."""
    zstd = short_drive()
    spoken, attachments = contents(zstd)
    none, lz4 = CompressionType.NONE, CompressionType.LZ4
    layouts: dict[str, tuple[Any, ...]] = {
        "rosbag2": ({"compression": none, "chunk_size": 4000, "enable_crcs": False}, 10),
        "lz4": ({"compression": lz4, "chunk_size": 4000}, 5),
        "stored": ({"compression": none, "chunk_size": 4000}, 10),
        "loose": ({"compression": none, "use_chunking": False}, 5),
    }
    made = [Base("zstd", ".mcap", zstd, True, 10)]
    for name, (options, weight) in layouts.items():
        data = written(spoken, attachments, **options)
        made.append(Base(name, ".mcap", data, has_checksums(data), weight))
    for name in sample_logs.names():
        data = sample_logs.path(name).read_bytes()
        made.append(Base(name, ".mcap", data, has_checksums(data), 0.3))
    return made + real()


def real() -> list[Base]:
    """Return the small ones of the real logs."""
    folder = os.environ.get("LOCFUSE_DATA")
    paths = sorted(p for p in Path(folder).rglob("*") if p.suffix in FILES) if folder else []
    return [_real(p) for p in paths if 0 < p.stat().st_size <= LARGEST]


def _real(path: Path) -> Base:
    data = path.read_bytes()
    try:
        checked = path.suffix == ".mcap" and has_checksums(data)
    except (McapError, struct.error):  # damaged already
        checked = False
    return Base(path.name, path.suffix, data, checked, 0.4, real=True)
