"""Parsers on damaged input: each starts from a small corpus (benchmarks/corpus) and may refuse in one line."""

import contextlib
import json
import math
import sqlite3
import struct
import time
import traceback
from collections.abc import Callable
from functools import cache
from pathlib import Path
from random import Random
from typing import Any

import numpy as np

from benchmarks.experiment import scratch
from benchmarks.field_paths import paths
from locfuse.cli.analysis.robot_tables import make_robot
from locfuse.formats.container import mcap_records, ros1_bag
from locfuse.formats.container.decompress import DamagedError
from locfuse.formats.container.mcap_records import scan
from locfuse.formats.container.rosbag2_sqlite import journal_of
from locfuse.formats.container.source import ChannelInfo
from locfuse.formats.logs import file_stream
from locfuse.formats.logs.files import log_files, make_decoder
from locfuse.formats.logs.log import open_log
from locfuse.formats.messages.schema import SchemaError, parse, signature
from locfuse.formats.robot import map_files, robot_toml
from locfuse.formats.robot.transforms import wheel_geometry
from locfuse.fusion.data import LocfuseError

CORPUS = Path(__file__).parent / "corpus"
SLOW, LONGEST = 5.0, 1 << 16  # s of CPU for one input of a parser, and its bytes
REASONS = (LocfuseError, SchemaError, DamagedError)

# --- replacements for right bytes and words

INTEGERS = (0, 1, 2, 0x7F, 0xFF, 0x7FFF, 2**31 - 1, 2**31, 2**32 - 1, 2**62, 2**63 - 1, 2**63, 2**64 - 1)
FLOATS = (math.nan, math.inf, -math.inf, 0.0, -0.0, 1e308, -1e308, 1e-310, 1e30, -1e30, 1e9, -1.0)
ACTING = (
    "\x1b]0;pwned\x07", "a\x1b[2Jb", "\u202e/gnp", "a\nb\r", "\x9b31m", "\x00", "\u2028", "<script>&", "|`*_$\\",
)  # fmt: skip
VALUES = (
    *map(str, FLOATS), *map(json.dumps, ACTING), "9223372036854775807", "true", '""', '"text"', "[]", "[nan]",
    "[1, 2, 3]", "[[1, 2], [3]]", "{}", "2020-01-01", "1e400", "'/x'", '"/tf"', '"/scan"', "0.1",
    '"odom>base_link"',
)  # fmt: skip
BINARY = tuple(struct.pack(f"<{c}", n % 256**s) for n in INTEGERS for s, c in ((2, "H"), (4, "I"), (8, "Q")))
WORDS = (  # of the languages that parsers read
    b"float64", b"string", b"[3]", b"[<=4]", b" x\n", b"=" * 80, b"\nMSG: a/A\n", b"a/A b\n", b"Header", b"module",
    b"struct", b"sequence<", b"null", b"1e999", b'"\\ud800"', b'"sec"', b'"array"', b"[" * 5000, b"<joint", b"../",
    b"<parent link='a'/>", b"<child link='a'/>", b"9" * 400, b"\n[lrf]\nx = 1\n", b"nan", b"x = ", b"id,",
    b"t,x,y\n", b"1e-99999999999999999999", b"op=\x02", b"conn=", b"\x80" * 11, b"\x1a\x02", b"\r\n",
    b"\xe2\x80\xae", *(bytes([c]) for c in b"[]{}<>,.;:=-_#'\"&%\n\r \0\xff"),
)  # fmt: skip


def damaged(
    rng: Random, data: bytes, words: tuple[bytes, ...] = BINARY, near: list[int] | None = None
) -> tuple[bytes, str]:
    """Return (changed bytes, name of the change); half of the changes are just after a place in `near`."""
    data = data or b"\0"
    at = rng.randrange(len(data))
    end = min(len(data), at + 1 + int(len(data) ** rng.random()))
    if near and rng.random() < 0.5:
        at = min(rng.choice(near) + rng.randrange(48), len(data) - 1)
    end = max(end, at + 1)
    word, piece = rng.choice(words), data[at:end]
    name, new, end = rng.choice(
        (
            ("flipped", bytes([data[at] ^ 1 << rng.randrange(8)]), at + 1),
            ("truncated", b"", len(data)),
            ("zeroed", bytes(len(piece)), end),
            ("garbled", rng.randbytes(len(piece)), end),
            ("cut out", b"", end),
            ("repeated", piece * (rng.choice((2, 30, 1000)) if len(piece) < 1000 else 2), end),
            ("a word instead", word, at + len(word)),
            ("a word between", word, at),
        )
    )
    return data[:at] + new + data[end:], name


# --- parsers


@cache
def corpus(name: str) -> tuple[bytes, ...]:
    return tuple(path.read_bytes() for path in sorted((CORPUS / name).iterdir()))


def written(name: str, data: bytes) -> Path:
    (scratch() / name).parent.mkdir(exist_ok=True)
    (scratch() / name).write_bytes(data)
    return scratch() / name


def definition(language: str, data: bytes) -> None:
    tree = parse("a/msg/A", language, data.decode("utf-8", "replace"), filler=language != "ros1msg")
    paths(tree), signature(tree)


@cache
def decoder(encoding: str, language: str, definition: bytes) -> Any:
    name = "a/msg/A" if encoding == "cdr" else "A"
    return make_decoder(ChannelInfo("/a", name, encoding, language, definition, 1))


def decoded(encoding: str, language: str, definition: bytes, *messages: bytes) -> None:
    """Decode messages field by field; the number of rows must equal that of good messages."""
    by, length = decoder(encoding, language, definition), np.array([len(m) for m in messages], np.int64)
    data = np.frombuffer(b"".join(messages), np.uint8)
    found = by.decode(data, np.cumsum(length) - length, length, tuple(paths(by.message)[:40]))
    assert {len(column) for column in found.columns.values()} <= {int(found.good.sum())}


def mcap_record(data: bytes) -> None:
    read = mcap_records
    indexes = (read.chunk_index, read.message_index)
    for kind in (read.schema, read.channel, read.attachment, read.statistics, *indexes):
        with contextlib.suppress(DamagedError):
            kind(data)
    scan(np.frombuffer(data, np.uint8), 5000)


def log_of(ending: str, data: bytes) -> None:
    log = open_log([written(f"log{ending}", data)])
    for topic in [topic for topic, info in log.topics.items() if info.problem is None]:
        with contextlib.suppress(LocfuseError):
            log.stream(topic).t_ns  # noqa: B018 - the property reads
    log.losses.lines()


def metadata(data: bytes) -> None:
    file = written("bag/metadata.yaml", data)
    written("bag/a.mcap", b"x")
    assert all(found.parent == file.parent for found in log_files(file.parent))


def journal(data: bytes) -> None:
    database = scratch() / "a.db3"
    if not database.exists():
        with contextlib.closing(sqlite3.connect(database)) as made:
            made.execute("CREATE TABLE messages(data)")
    written("a.db3-wal", data)
    journal_of(database)


FIELDS = {
    file_stream.RANGES: ("id", "range"),
    file_stream.POSE: ("pose.pose.position.x", "pose.pose.orientation.w", "pose.covariance"),
    file_stream.POINT: ("point.x", "point.y"),
    file_stream.DETECTIONS: ("id", "range", "bearing"),
}


def beside(ending: str, data: bytes) -> None:
    """Read a trajectory or detections from a text file; columns must have one length."""
    found = file_stream.read_file(str(written(f"beside{ending}", data)))
    columns = found.columns(*FIELDS[found.msgtype])
    assert found.t_ns.dtype == np.int64
    assert {len(column) for column in columns.values()} == {len(found.t_ns)}


JSON = b'{"a": 1, "b": [1, 2], "header": {"stamp": {"sec": 1, "nanosec": 2}}}'
ALL_KINDS = {
    name: (CORPUS / name / "all_kinds").read_bytes() for name in ("ros2msg", "jsonschema", "protobuf schema")
}
PARSERS: dict[str, Callable[[bytes], object]] = {  # by the name of their corpus
    "ros2msg": lambda data: definition("ros1msg" if len(data) % 2 else "ros2msg", data),
    "ros2idl": lambda data: definition("ros2idl", data),
    "jsonschema": lambda data: decoded("json", "jsonschema", data, JSON),
    "json": lambda data: decoded("json", "jsonschema", ALL_KINDS["jsonschema"], data, data[:9]),
    "protobuf schema": lambda data: decoded("protobuf", "protobuf", data, *corpus("protobuf")),
    "protobuf": lambda data: decoded("protobuf", "protobuf", ALL_KINDS["protobuf schema"], data, data[:9]),
    "cdr": lambda data: decoded("cdr", "ros2msg", ALL_KINDS["ros2msg"], data, data[:20]),
    "robot.toml": lambda data: make_robot(robot_toml.parse(data, "robot.toml")),
    "urdf": lambda data: wheel_geometry(data.decode("utf-8", "replace")),
    "metadata.yaml": metadata,
    "mcap record": mcap_record,
    "mcap": lambda data: log_of(".mcap", data),
    "bag record": lambda data: ros1_bag.scan_chunk(np.frombuffer(data, np.uint8), 5000),
    "bag": lambda data: log_of(".bag", data),
    "journal": journal,
    "tum": lambda data: beside(".tum", data),
    "csv": lambda data: beside(".csv", data),
    "landmarks": lambda data: map_files.read_landmarks(written("landmarks.csv", data)),
    "line_map": lambda data: map_files.decode_lines(data, "map"),
}


def mutated(name: str, rng: Random) -> bytes:
    """Return an input of a parser: a file of its corpus, changed in one to eight places."""
    data = rng.choice(corpus(name))
    for _ in range(rng.choice((1, 1, 2, 4, 8))):
        data = damaged(rng, data, WORDS if rng.random() < 0.8 else BINARY)[0][:LONGEST]
    return data


def wrong(parser: Callable[[bytes], object], data: bytes) -> str:
    """Return the problem of a parser's result for an input, "" if there is none."""
    begin = time.process_time()
    try:
        parser(data)
    except REASONS as refusal:
        if len(str(refusal).splitlines()) != 1:
            return f"a refusal of several lines: {refusal}"
    except Exception:
        return traceback.format_exc(limit=-4)
    took = time.process_time() - begin
    return f"{took:.1f} s of CPU" if took > SLOW else ""


def fuzz_parser(name: str, seed: int, seconds: float) -> tuple[int, dict[str, bytes]]:
    """Return the number of inputs given to a parser, and each kind of problem with its first input."""
    rng, end, n, found = Random(f"{name} {seed}"), time.process_time() + seconds, 0, dict[str, bytes]()
    while time.process_time() < end:
        data, n = mutated(name, rng), n + 1
        if problem := wrong(PARSERS[name], data):
            found.setdefault(problem.rstrip(), data)
    return n, found
