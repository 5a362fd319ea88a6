"""Logs built to do harm: the sample log with one thing changed, or bytes laid by hand."""

import json
import sqlite3
import struct
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import zstandard
from mcap.reader import make_reader
from mcap.writer import Writer

from locfuse import sample_logs

DIVIDER = "=" * 80 + "\nMSG: "
MAGIC = b"\x89MCAP0\r\n"
START = MAGIC + struct.pack("<BQII", 1, 8, 0, 0)
T0 = 1_700_000_000 * 10**9


class Put(NamedTuple):
    """One message with everything that describes it."""

    msgtype: str
    language: str
    definition: bytes
    topic: str
    encoding: str
    log_time: int
    data: bytes


Change = Callable[[Put], Put]


@cache
def sample() -> tuple[tuple[Put, ...], bytes]:
    """The messages of the sample log in order of recording, and its robot.toml."""
    with sample_logs.path("rounded_rectangle").open("rb") as file:
        reader = make_reader(file)
        robot = next(iter(reader.iter_attachments())).data
        found = [
            Put(s.name, s.encoding, s.data, c.topic, c.message_encoding, m.log_time, m.data)
            for s, c, m in reader.iter_messages()
            if s is not None
        ]
    return tuple(found), robot


def write(
    path: Path,
    change: Change = lambda put: put,
    *,
    robot: bytes | None = None,
    extra: Sequence[Put] = (),
    seconds: float = 3.0,
    keep: Callable[[Put], bool] = lambda put: True,
) -> Path:
    """Write the first seconds of the sample log, every message changed, and some more."""
    messages, own = sample()
    chosen = [m for m in messages if m.log_time - messages[0].log_time <= seconds * 1e9 and keep(m)]
    with path.open("wb") as file:
        writer: Any = Writer(file)
        writer.start("ros2")
        writer.add_attachment(0, 0, "robot.toml", "application/toml", own if robot is None else robot)
        schemas: dict[Any, int] = {}
        channels: dict[Any, int] = {}
        for put in [*map(change, chosen), *extra]:
            if put[:3] not in schemas:
                schemas[put[:3]] = writer.register_schema(*put[:3])
            key = (put.topic, put.encoding, schemas[put[:3]])
            if key not in channels:
                channels[key] = writer.register_channel(*key)
            writer.add_message(channels[key], put.log_time, put.data, put.log_time)
        writer.finish()
    return path


def lies(topic: str, old: bytes, new: bytes) -> Change:
    """A definition that says something else than the messages hold."""

    def change(put: Put) -> Put:
        return put._replace(definition=put.definition.replace(old, new)) if put.topic == topic else put

    return change


def chunk(plain: bytes, compression: str = "zstd") -> bytes:
    """A Chunk record of any bytes."""
    packed = zstandard.compress(plain) if compression else plain
    name = compression.encode()
    head = struct.pack("<QQQII", 1, 1, len(plain), 0, len(name)) + name + struct.pack("<Q", len(packed))
    return struct.pack("<BQ", 6, len(head) + len(packed)) + head + packed


FIX = {
    "type": "object",
    "properties": {
        "timestamp": {"type": "object", "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}}},
        "frame_id": {"type": "string"},
        "latitude": {"type": "number"},
        "longitude": {"type": "number"},
        "position_covariance": {"type": "array", "items": {"type": "number"}},
        "position_covariance_type": {"type": "integer"},
    },
}


def fix(i: int, schema: Any = None, **changed: Any) -> Put:
    """A foxglove.LocationFix in JSON, some of its values changed."""
    t = sample()[0][0].log_time + i * 10**8
    value = {
        "timestamp": {"sec": t // 10**9, "nsec": t % 10**9},
        "frame_id": "gps",
        "latitude": 48.0 + 1e-6 * i,
        "longitude": 11.0,
        "position_covariance": [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        "position_covariance_type": 2,
        **changed,
    }
    text = json.dumps(FIX if schema is None else schema).encode()
    return Put("foxglove.LocationFix", "jsonschema", text, "/fix", "json", t, json.dumps(value).encode())


def crashed_recording(folder: Path, messages: int = 600, commit_every: int = 50) -> Path:
    """A .db3 whose recorder committed now and then and lost its power: half of it lies in the journal."""
    live = folder / "live.db3"
    database = sqlite3.connect(live)
    database.execute("PRAGMA journal_mode=wal")
    database.executescript(
        "CREATE TABLE topics(id INTEGER PRIMARY KEY,name TEXT,type TEXT,serialization_format TEXT,"
        "offered_qos_profiles TEXT);"
        "CREATE TABLE messages(id INTEGER PRIMARY KEY,topic_id INTEGER,timestamp INTEGER,data BLOB);"
    )
    rows = sample()[0][:messages]
    idents = {key: i for i, key in enumerate(sorted({(put.topic, put.msgtype) for put in rows}))}
    database.executemany(
        "INSERT INTO topics VALUES(?,?,?,'cdr','')", [(i, topic, kind) for (topic, kind), i in idents.items()]
    )
    for k in range(0, messages, commit_every):
        values = [(idents[p.topic, p.msgtype], p.log_time, p.data) for p in rows[k : k + commit_every]]
        database.executemany("INSERT INTO messages(topic_id,timestamp,data) VALUES(?,?,?)", values)
        database.commit()
        if k == messages // 2:
            database.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    crash = folder / "crash"
    crash.mkdir()
    for ending in ("", "-wal"):
        (crash / f"bag.db3{ending}").write_bytes(Path(f"{live}{ending}").read_bytes())
    database.close()
    return crash / "bag.db3"
