"""Small bags made for a test, written by the public mcap writer from messages serialised by rosbags."""

import os
import sqlite3
from collections.abc import Iterable, Iterator, Sequence
from contextlib import closing
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from rosbags.typesys import Stores, get_typestore

from locfuse.formats.container.mcap_source import McapSource
from locfuse.formats.logs.log import Log

STORE = get_typestore(Stores.ROS2_JAZZY)
S = 10**9
T0 = 1_700_000_000 * S


class Said(NamedTuple):
    """One message to record."""

    topic: str
    msgtype: str
    data: bytes
    log_time: int
    sequence: int = 0


def data_folder() -> Path:
    """The folder of real logs, or skip."""
    folder = os.environ.get("LOCFUSE_DATA")
    if not folder:
        pytest.skip("LOCFUSE_DATA is not set: no real logs to try")
    return Path(folder)


def real_logs(*ends: str) -> list[str]:
    """The real logs, relative to their folder: .mcap files, or those that end so; none where it is not set."""
    folder = os.environ.get("LOCFUSE_DATA")
    files = Path(folder).rglob("*") if folder else []
    return sorted(str(p.relative_to(folder)) for p in files if folder and p.suffix in (ends or (".mcap",)))


def real_log(name: str) -> Path:
    return data_folder() / name


def build(msgtype: str, store: Any = STORE, **values: Any) -> Any:
    """A message with zeros but for `values`: dicts make sub-messages, lists become arrays."""
    kind = store.types[msgtype]
    made = {}
    for name, desc in store.get_msgdef(msgtype).fields:
        made[name] = _value(desc, values.pop(name, None), store)
    assert not values, f"{msgtype} has no {list(values)}"
    return kind(**made)


def _value(desc: Any, given: Any, store: Any) -> Any:
    kind, detail = desc[0].name, desc[1]
    if kind == "NAME":
        return build(detail, store, **(given or {}))
    if kind == "BASE":
        return given if given is not None else ("" if detail[0] == "string" else 0)
    element, size = detail
    if element[0].name == "NAME":
        return [build(element[1], store, **one) for one in given or [{}] * (size if kind == "ARRAY" else 0)]
    if element[1][0] == "string":
        return list(given or [""] * (size if kind == "ARRAY" else 0))
    dtype = {"byte": "uint8", "octet": "uint8", "char": "uint8"}.get(element[1][0], element[1][0])
    return np.array(given if given is not None else [0] * (size if kind == "ARRAY" else 0), dtype)


def cdr(msgtype: str, little: bool = True, **values: Any) -> bytes:
    return bytes(STORE.serialize_cdr(build(msgtype, **values), msgtype, little_endian=little))


def header(t_ns: int, frame: str = "") -> dict[str, Any]:
    return {"stamp": {"sec": t_ns // S, "nanosec": t_ns % S}, "frame_id": frame}


@cache
def definition(msgtype: str) -> bytes:
    return STORE.generate_msgdef(msgtype, ros_version=2)[0].encode()


def write(
    path: Path,
    said: Iterable[Said],
    *,
    compression: CompressionType = CompressionType.NONE,
    attachments: dict[str, bytes] | None = None,
    encoding: str = "cdr",
    **options: Any,
) -> Path:
    """Write messages in the given order."""
    with path.open("wb") as file:
        writer: Any = Writer(file, compression=compression, **options)
        writer.start()
        channels: dict[str, int] = {}
        for m in said:
            if m.topic not in channels:
                schema = writer.register_schema(m.msgtype, "ros2msg", definition(m.msgtype))
                channels[m.topic] = writer.register_channel(m.topic, encoding, schema)
            writer.add_message(channels[m.topic], m.log_time, m.data, m.log_time, m.sequence)
        for name, data in (attachments or {}).items():
            writer.add_attachment(T0, T0, name, "text/plain", data)
        writer.finish()
    return path


def drive(n: int = 200, *, little: bool = True) -> list[Said]:
    """Wheels at 20 Hz, scans at 5 Hz and a header-less heading at 10 Hz; stamps 5 ms before recording."""
    said = []
    rng = np.random.default_rng(1)
    for i in range(n):
        t = T0 + i * S // 20
        wheels = cdr(
            "sensor_msgs/msg/JointState",
            little,
            header=header(t),
            name=["left", "right"],
            position=[0.1 * i, 0.11 * i],
        )
        said.append(Said("/joint_states", "sensor_msgs/msg/JointState", wheels, t + 5_000_000, i))
        if i % 2 == 0:
            heading = cdr("std_msgs/msg/Float64", little, data=0.01 * i)
            said.append(Said("/heading", "std_msgs/msg/Float64", heading, t + 6_000_000, i))
        if i % 4 == 0:
            ranges = rng.uniform(0.5, 8, 90).astype(np.float32)
            scan = cdr(
                "sensor_msgs/msg/LaserScan",
                little,
                header=header(t, "laser"),
                angle_min=-1.5,
                angle_increment=0.03,
                range_max=30.0,
                ranges=ranges,
            )
            said.append(Said("/scan", "sensor_msgs/msg/LaserScan", scan, t + 5_500_000, i))
    return said


LIGHT = {
    "/joint_states": ("name", "position", "header.stamp"),
    "/heading": ("data",),
    "/scan": ("ranges", "angle_min"),
}


def recorded(path: Path) -> dict[str, list[tuple[Any, Any]]]:
    """(schema, message) by topic in recording order, by the public reader; messages recorded twice count once."""
    found: dict[str, list[tuple[Any, Any]]] = {}
    with path.open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages(log_time_order=False):
            found.setdefault(channel.topic, []).append((schema, message))
    return {topic: _once(messages) for topic, messages in found.items()}


def _once(messages: list[tuple[Any, Any]]) -> list[tuple[Any, Any]]:
    unique = {(m.log_time, m.data): (schema, m) for schema, m in reversed(messages)}
    return sorted(unique.values(), key=lambda entry: (entry[1].log_time, entry[1].sequence))


def rows(column: Any) -> list[Any]:
    """A column as one Python value per row."""
    return [column[i] for i in range(len(column))]


def shuffled(said: Sequence[Said], seed: int = 0) -> Iterator[Said]:
    for i in np.random.default_rng(seed).permutation(len(said)).tolist():
        yield said[i]


def contents(log: Log) -> dict[str, Any]:
    """Everything the light fields of a log say, as plain values."""
    found: dict[str, Any] = {}
    for topic, stream in log.streams(LIGHT).items():
        found[topic] = (stream.msgtype, stream.t_ns.tolist(), stream.frame_id)
        for name, column in stream.columns(*LIGHT[topic]).items():
            found[f"{topic}.{name}"] = [np.asarray(row).tolist() for row in rows(column)]
    return found


def database(path: Path, topic: str, msgtype: str, messages: Sequence[bytes]) -> Path:
    """A .db3 without definitions, as rosbag2 wrote it before ROS 2 Iron; a message each tenth of a second."""
    with closing(sqlite3.connect(path)) as made:
        made.executescript(
            "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT);"
            "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB)"
        )
        made.execute("INSERT INTO topics VALUES(1, ?, ?, 'cdr')", (topic, msgtype))
        stored = [(T0 + i * S // 10, data) for i, data in enumerate(messages)]
        made.executemany("INSERT INTO messages(topic_id, timestamp, data) VALUES(1, ?, ?)", stored)
        made.commit()
    return path


def delivered(source: McapSource, *topics: str) -> Iterator[tuple[str, int, int, bytes]]:
    """Yield (topic, log time, sequence, bytes) of every message of these topics, else of all."""
    wanted = {ident for ident, channel in source.channels.items() if channel.topic in topics or not topics}
    for batch in source.batches(wanted):
        for ident, m in batch.messages.items():
            for i in range(len(m.start)):
                data = batch.data[m.start[i] : m.start[i] + m.length[i]].tobytes()
                yield source.channels[ident].topic, int(m.log_time[i]), int(m.sequence[i]), data
