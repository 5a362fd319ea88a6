"""Writing ROS 2 logs as MCAP with the `mcap` library: zstd chunks with checksums."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

import numpy as np
from mcap.writer import CompressionType, Writer
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_typestore

from locfuse.formats.columns import Bytes, nested
from locfuse.formats.whole_files import whole_file
from locfuse.fusion.data import Ints, LocfuseError

CHUNK_BYTES = 512 * 1024  # bytes before compression; small, so that reading one topic is fast


def add_messages(
    writer: Any,
    channel: int,
    log_time: Ints,
    sequence: Ints,
    payload: Bytes | Sequence[memoryview],
    published: Ints | None = None,
) -> None:
    """Add messages of one channel to an `mcap` writer.

    Their log times are (n,) [ns], sequence numbers (n,), and `payload` has the bytes of each message. `published`
    (n,) [ns] are the publish times; None: the log times.
    """
    publish_time = log_time if published is None else published
    columns = (log_time.tolist(), payload, publish_time.tolist(), sequence.tolist())
    for logged, data, sent, number in zip(*columns, strict=True):
        writer.add_message(channel, logged, bytes(data), sent, number)


def open_writer(file: IO[bytes], profile: str = "ros2") -> Any:
    """Return a started `mcap` writer for an open file (Any: its methods are not typed)."""
    writer: Any = Writer(file, CHUNK_BYTES, CompressionType.ZSTD, enable_data_crcs=True)
    writer.start(profile=profile, library="locfuse")
    return writer


# --- Standard ROS 2 messages as CDR, with their ros2msg schemas

# QoS of a latched topic: rosbag2 reads it per channel, so that late subscribers get the message when it is played.
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


class StandardMessages:
    """Builds and serialises messages of the standard ROS 2 types from plain values."""

    def __init__(self) -> None:
        self._store = get_typestore(Stores.ROS2_HUMBLE)

    def schema(self, msgtype: str) -> str:
        """Return the ros2msg text of a type and of all types that it uses."""
        if msgtype not in self._store.fielddefs:
            raise LocfuseError(f"{msgtype} is not a standard ROS 2 message type: it cannot be written")
        return self._store.generate_msgdef(msgtype, ros_version=2)[0]

    def has_header(self, msgtype: str) -> bool:
        """Return whether the type starts with a std_msgs/Header."""
        fields = self._store.fielddefs[msgtype][1]
        return bool(fields) and fields[0][1] == (Nodetype.NAME, "std_msgs/msg/Header")

    def cdr(self, msgtype: str, values: Mapping[str, Any]) -> bytes:
        """Return the message as CDR bytes; fields missing in `values` (nested) are zero or empty."""
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
            zero = "" if inner[0] == "string" else 0.0 if inner[0].startswith("float") else 0
            return zero if value is None else value
        element, length = inner  # an array or a sequence
        if element[0] == Nodetype.NAME:
            return [self._build(element[1], v) for v in (() if value is None else value)]
        base = element[1][0]
        if base == "string":
            return [] if value is None else list(value)
        if isinstance(value, bytes | bytearray | memoryview):
            return np.frombuffer(value, np.uint8)
        return np.zeros(length, base) if value is None else np.asarray(value, base)


@contextmanager
def log_writer(path: str | Path) -> Iterator[LogWriter]:
    """Context manager: a LogWriter; the log appears at `path` only if the block ends without an error."""
    with whole_file(Path(path)) as temporary, temporary.open("wb") as file:
        log = LogWriter(file)
        yield log
        log.finish()


class LogWriter:
    """Writer of a ROS 2 log to an open file."""

    def __init__(self, file: IO[bytes]) -> None:
        self._messages = StandardMessages()
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, tuple[int, str]] = {}  # topic -> channel id, message type
        self._sequence: dict[str, int] = {}
        self.writer = open_writer(file)

    def attach(self, name: str, data: bytes) -> None:
        """Add a TOML file, such as robot.toml, as an attachment."""
        self.writer.add_attachment(0, 0, name, "application/toml", data)

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
        """Append a message; `fields` maps dotted field paths to values.

        `stamp_ns` is the stamp of its header; None: the log time.
        """
        channel = self.channel(topic, msgtype, latched)
        values = nested(fields)
        if self._messages.has_header(msgtype):
            sec, nanosec = divmod(log_ns if stamp_ns is None else stamp_ns, 1_000_000_000)
            values["header"] = {"stamp": {"sec": sec, "nanosec": nanosec}, "frame_id": frame_id}
        self._sequence[topic] += 1
        data = self._messages.cdr(msgtype, values)
        self.writer.add_message(channel, log_ns, data, publish_time=log_ns, sequence=self._sequence[topic])

    def channel(self, topic: str, msgtype: str, latched: bool = False) -> int:
        """Return the id of a topic's channel; register it if it is new."""
        if topic in self._channels:
            known, existing = self._channels[topic]
            if existing != msgtype:
                raise ValueError(f"{topic} holds {existing}, not {msgtype}")
            return known
        if msgtype not in self._schemas:
            text = self._messages.schema(msgtype).encode()
            self._schemas[msgtype] = self.writer.register_schema(msgtype, "ros2msg", text)
        metadata = {"offered_qos_profiles": LATCHED if latched else ""}
        channel: int = self.writer.register_channel(topic, "cdr", self._schemas[msgtype], metadata)
        self._channels[topic] = channel, msgtype
        self._sequence[topic] = 0
        return channel

    def finish(self) -> None:
        """Write the summary at the end of the file."""
        self.writer.finish()
