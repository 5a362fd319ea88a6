"""Every parser by itself, in memory, on damaged input: python -m benchmarks.fuzz_parsers (an hour: --seconds 300).

Each parser starts from a small corpus (benchmarks/corpus), which is cut, spliced,
repeated and sprinkled with words of its own language. A parser may refuse in its own words; anything else that it
raises, an answer of the wrong kind, and an input that takes more than `SLOW` seconds of CPU are findings. They are
saved; exit 1.
"""

from __future__ import annotations

import atexit
import random
import resource
import struct
import tempfile
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from pathlib import Path

import click
import numpy as np

from benchmarks.field_paths import paths
from benchmarks.fuzz_damage import damaged
from locfuse.cli.analysis.robot_tables import make_robot
from locfuse.formats.container import mcap_records, ros1_bag
from locfuse.formats.container.decompress import DamagedError
from locfuse.formats.container.mcap_chunk import scan
from locfuse.formats.container.rosbag2_sqlite import journal_of
from locfuse.formats.container.source import ChannelInfo
from locfuse.formats.logs import file_stream
from locfuse.formats.logs.file_stream import read_file
from locfuse.formats.logs.files import log_files
from locfuse.formats.logs.log import open_log
from locfuse.formats.messages.decode import make_decoder
from locfuse.formats.messages.schema import SchemaError, parse, signature
from locfuse.formats.robot import landmark_map, line_map, robot_toml
from locfuse.formats.robot.urdf import wheel_geometry
from locfuse.fusion.data import LocfuseError

CORPUS = Path(__file__).parent / "corpus"
SLOW = 5.0  # s of CPU for one input of some kilobytes
LONGEST = 1 << 16  # bytes of an input
GIB = 1 << 30


@dataclass(frozen=True)
class Target:
    """A parser, its corpus, the words of its language, and how it may refuse."""

    parse: Callable[[bytes], object]
    corpus: tuple[bytes, ...]
    words: tuple[bytes, ...]
    refusals: tuple[type[Exception], ...]


def corpus(folder: str) -> tuple[bytes, ...]:
    return tuple(path.read_bytes() for path in sorted((CORPUS / folder).iterdir()))


def definition(language: str) -> Callable[[bytes], object]:
    """A message definition, and all that is asked of its tree."""

    def run(data: bytes) -> object:
        tree = parse("a/msg/A", language, data.decode("utf-8", "replace"), filler=language != "ros1msg")
        return signature(tree)

    return run


def jsonschema(data: bytes) -> object:
    return decoded(
        maker("A", "json", "jsonschema", data),
        b'{"a": 1, "b": [1, 2], "header": {"stamp": {"sec": 1, "nanosec": 2}}}',
    )


def decoded(decoder: object, *messages: bytes) -> object:
    """Decode messages by every field; the number of rows must be that of the good messages."""
    length = np.array([len(m) for m in messages], np.int64)
    data = np.frombuffer(b"".join(messages), np.uint8)
    fields = all_fields(decoder)
    found = decoder.decode(data, np.cumsum(length) - length, length, fields)  # type: ignore[attr-defined]
    for path, column in found.columns.items():
        assert len(column) == int(found.good.sum()), path
    return found


@lru_cache(2)
def all_fields(decoder: object) -> tuple[str, ...]:
    return tuple(paths(decoder.message)[:40])  # type: ignore[attr-defined]


def maker(type_name: str, encoding: str, language: str, definition: bytes) -> object:
    return make_decoder(ChannelInfo("/a", type_name, encoding, language, definition, 1))


# of the corpus: one definition with every kind of field, and one message by it
(PROTO_MESSAGE,) = corpus("protobuf")
SCAN = maker("a/msg/A", "cdr", "ros2msg", (CORPUS / "ros2msg" / "all_kinds").read_bytes())
FIX = maker("A", "json", "jsonschema", (CORPUS / "jsonschema" / "all_kinds").read_bytes())
PROTO = maker("A", "protobuf", "protobuf", (CORPUS / "protobuf schema" / "all_kinds").read_bytes())


def protobuf_schema(data: bytes) -> object:
    return decoded(maker("A", "protobuf", "protobuf", data), PROTO_MESSAGE)


def protobuf_message(data: bytes) -> object:
    return decoded(PROTO, data, data[:9])


def robot(data: bytes) -> object:
    return make_robot(robot_toml.parse(data, "robot.toml"))


@cache
def scratch() -> Path:
    """A folder in memory where it can be: a file for every input would cost more than reading it."""
    shm = Path("/dev/shm")
    folder = tempfile.TemporaryDirectory(dir=shm if shm.is_dir() else None)
    atexit.register(folder.cleanup)
    return Path(folder.name)


def metadata(data: bytes) -> object:
    folder = scratch() / "bag"
    folder.mkdir(exist_ok=True)
    (folder / "a.mcap").write_bytes(b"x")
    (folder / "metadata.yaml").write_bytes(data)
    files = log_files(folder)
    assert all(file.parent == folder for file in files)
    return files


def mcap_record(data: bytes) -> object:
    """The content of every kind of record."""
    for read in (
        mcap_records.schema, mcap_records.channel, mcap_records.chunk_header, mcap_records.chunk_index,
        mcap_records.message_index, mcap_records.attachment, mcap_records.statistics,
    ):  # fmt: skip
        try:
            read(data)
        except DamagedError:
            continue
    return scan(np.frombuffer(data, np.uint8), 5000)


def file_of(ending: str) -> Callable[[bytes], object]:
    """A whole file: opened, and every topic decoded."""

    def run(data: bytes) -> object:
        file = scratch() / f"log{ending}"
        file.write_bytes(data)
        log = open_log([file])
        for topic, info in log.topics.items():
            if info.problem is None:
                try:
                    log.stream(topic).t_ns  # noqa: B018 - the property reads
                except LocfuseError:
                    continue
        return log.losses.lines()

    return run


def bag_record(data: bytes) -> object:
    return ros1_bag.scan_chunk(np.frombuffer(data, np.uint8), 5000)


def journal(data: bytes) -> object:
    file = scratch() / "log.db3"
    file.write_bytes(data)
    Path(f"{file}-wal").write_bytes(data)
    return journal_of(file)


def beside_the_log(ending: str) -> Callable[[bytes], object]:
    """A trajectory or detections in a text file: whole times, and columns of one length."""

    def run(data: bytes) -> object:
        file = scratch() / f"beside{ending}"
        file.write_bytes(data)
        found = read_file(str(file))
        columns = found.columns(*FIELDS_BESIDE[found.msgtype])
        assert found.t_ns.dtype == np.int64
        assert {len(column) for column in columns.values()} == {len(found.t_ns)}
        return columns

    return run


FIELDS_BESIDE = {
    file_stream.RANGES: ("id", "range"),
    file_stream.POSE: ("pose.pose.position.x", "pose.pose.orientation.w", "pose.covariance"),
    file_stream.POINT: ("point.x", "point.y"),
    file_stream.DETECTIONS: ("id", "range", "bearing"),
}


def landmarks(data: bytes) -> object:
    file = scratch() / "landmarks.csv"
    file.write_bytes(data)
    return landmark_map.read(file)


ROS_WORDS = (
    b"float64", b"string", b"[]", b"[3]", b"[<=4]", b" x\n", b"=" * 80, b"\nMSG: a/A\n", b"a/A b\n", b"#",
    b"Header",
)  # fmt: skip
IDL_WORDS = (b"module", b"struct", b"{", b"};", b"sequence<", b">", b"long")
JSON_WORDS = (
    b"[", b"]", b"{", b"}", b"null", b"NaN", b"1e999", b'"\\ud800"', b"-1", b'"sec"', b'"type"', b'"array"', b",",
)  # fmt: skip
TOML_WORDS = (b"[", b"]", b"=", b".", b"'", b'"', b"{", b"}", b"nan", b"9" * 400, b"\n")
XML_WORDS = (b"<joint", b"<parent link='a'/>", b"<child link='a'/>", b"&", b"<", b">", b"nan", b"1e999")
YAML_WORDS = (b"- ", b"\n", b":", b"../", b"'", b"\0", b" ")
BYTES = (b"\0", b"\xff", b"\xff\xff\xff\xff", b"\0\0\0\0\0\0\0\x80", struct.pack("<I", 1 << 30))
CSV_WORDS = (
    b",", b"\n", b"\r", b"\r\n", b'"', b" ", b"nan", b"1e400", b"-", b"_", b"0" * 5000, b"t,x,y\n", b"id,", b"#",
    b"\xe2\x80\xae", b"1e-99999999999999999999",
)  # fmt: skip
OURS, DAMAGED = (LocfuseError,), (DamagedError,)


def urdf(data: bytes) -> object:
    return wheel_geometry(data.decode("utf-8", "replace"))


def wall_map(data: bytes) -> object:
    return line_map.decode(data, "map")


def fix_message(data: bytes) -> object:
    return decoded(FIX, data, data[:9])


def scan_message(data: bytes) -> object:
    return decoded(SCAN, data, data[:20])


TARGETS: dict[str, Target] = {
    "ros2msg": Target(definition("ros2msg"), corpus("ros2msg"), ROS_WORDS, (SchemaError,)),
    "ros1msg": Target(definition("ros1msg"), corpus("ros2msg"), ROS_WORDS, (SchemaError,)),
    "ros2idl": Target(definition("ros2idl"), corpus("ros2idl"), IDL_WORDS, (SchemaError,)),
    "jsonschema": Target(jsonschema, corpus("jsonschema"), JSON_WORDS, (SchemaError,)),
    "json": Target(fix_message, corpus("json"), JSON_WORDS, ()),
    "protobuf schema": Target(protobuf_schema, corpus("protobuf schema"), BYTES, (SchemaError,)),
    "protobuf": Target(protobuf_message, corpus("protobuf"), (*BYTES, b"\x80" * 11, b"\x1a\x02"), ()),
    "cdr": Target(scan_message, corpus("cdr"), BYTES, ()),
    "robot.toml": Target(robot, corpus("robot.toml"), TOML_WORDS, OURS),
    "urdf": Target(urdf, corpus("urdf"), XML_WORDS, ()),
    "metadata.yaml": Target(metadata, corpus("metadata.yaml"), YAML_WORDS, OURS),
    "mcap record": Target(
        mcap_record, tuple(corpus("mcap")[0][at:] for at in (8, 25, 80)), BYTES, (DamagedError,)
    ),
    "mcap": Target(file_of(".mcap"), corpus("mcap"), BYTES, OURS),
    "bag record": Target(
        bag_record, corpus("bag record"), (*BYTES, b"op=\x02", b"conn=", b"time="), (DamagedError,)
    ),
    "bag": Target(file_of(".bag"), corpus("bag"), (*BYTES, b"op=\x05"), OURS),
    "journal": Target(journal, corpus("journal"), BYTES, ()),
    "tum": Target(beside_the_log(".tum"), corpus("tum"), CSV_WORDS, OURS),
    "csv": Target(beside_the_log(".csv"), corpus("csv"), CSV_WORDS, OURS),
    "landmarks": Target(landmarks, corpus("landmarks"), CSV_WORDS, OURS),
    "line map": Target(wall_map, corpus("line_map"), JSON_WORDS, OURS),
}


def mutated(target: Target, rng: random.Random) -> bytes:
    """Return an input: a corpus file, changed in one to eight places."""
    data = rng.choice(target.corpus)
    for _ in range(rng.choice((1, 1, 2, 4, 8))):
        data = damaged(rng, data or b"\0", target.words, target.corpus)[0][:LONGEST]
    return data


def wrong(target: Target, data: bytes) -> str | None:
    """Return what is wrong with what a parser makes of an input, None for nothing."""
    begin = time.process_time()
    try:
        target.parse(data)
    except target.refusals as refusal:
        if len(str(refusal).splitlines()) != 1:
            return f"a refusal of several lines: {refusal}"
    except Exception:
        return traceback.format_exc(limit=-4)
    took = time.process_time() - begin
    return f"{took:.1f} s of CPU" if took > SLOW else None


def findings(name: str, seed: int, seconds: float) -> Iterator[tuple[int, bytes, str]]:
    """Yield (number, input, what is wrong) for the inputs of so many seconds of CPU."""
    rng, target = random.Random(f"{name} {seed}"), TARGETS[name]
    end, n = time.process_time() + seconds, 0
    while time.process_time() < end:
        data = mutated(target, rng)
        if (problem := wrong(target, data)) is not None:
            yield n, data, problem
        n += 1
    yield n, b"", ""


def fuzz(name: str, seed: int, seconds: float, save: Path | None) -> tuple[int, list[str]]:
    """Return how many inputs a parser was given, and what was wrong, each kind once."""
    problems: dict[str, str] = {}
    n = 0
    for n, data, problem in findings(name, seed, seconds):
        place = problem.rstrip().rpartition("\n")[0] or problem  # where it was raised: one finding
        if problem and place not in problems:
            problems[place] = problem
            if save is not None:
                save.mkdir(parents=True, exist_ok=True)
                (save / f"{name.replace(' ', '_')}-{seed}-{n}").write_bytes(data)
    return n, list(problems.values())


@click.command()
@click.option("--seconds", default=4.0, show_default=True, help="CPU for each parser.")
@click.option("--seed", default=1, show_default=True)
@click.option("--only", type=click.Choice(list(TARGETS)), help="One parser.")
@click.option("--save", type=click.Path(path_type=Path), default=Path("findings"), show_default=True)
def main(seconds: float, seed: int, only: str | None, save: Path) -> None:
    """Give every parser damaged input for some seconds each."""
    resource.setrlimit(resource.RLIMIT_AS, (4 * GIB, 4 * GIB))
    names: Sequence[str] = [only] if only else list(TARGETS)
    bad = 0
    for name in names:
        n, problems = fuzz(name, seed, seconds, save)
        bad += len(problems)
        click.echo(f"{name:14} {n:8} inputs, {n / seconds:8.0f} a second, {len(problems)} findings")
        for problem in problems[:5]:
            click.echo(problem)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    click.echo(f"peak {peak:.0f} MiB")
    raise SystemExit(1 if bad else 0)


if __name__ == "__main__":
    main()
