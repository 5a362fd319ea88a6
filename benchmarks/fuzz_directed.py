"""Directed fuzzing: whole logs that are wrong on purpose, in one to three ways: benchmarks.fuzz --directed.

Random damage seldom builds a definition whose fields are of another kind, a name that acts on a terminal, a stamp
that is no time, or a text file of nonsense beside the log. Each case here takes a short drive, changes it in such
ways (DEEDS), and gives it to some command.
"""

from __future__ import annotations

import json
import math
import random
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
from mcap.records import Attachment, Channel, Schema
from mcap.writer import CompressionType
from rosbags.typesys import Stores, get_typestore

from benchmarks.fuzz_cases import Case, Workshop
from benchmarks.fuzz_damage import INTERESTING, NUMBERS, VALUES, span
from benchmarks.fuzz_logs import Spoken, contents, short_drive, written
from benchmarks.fuzz_parsers import TARGETS, mutated
from benchmarks.fuzz_sensors import DEEDS as OF_SENSORS

STORE = get_typestore(Stores.ROS2_JAZZY)
ACTING = (
    "\x1b]0;pwned\x07",
    "a\x1b[2Jb",
    "\u202e/gnp",
    "a\nb\r",
    "\x9b31m",
    "\x00",
    "\u2028",
    "<script>&",
    "|`*_$\\",
)
KINDS = (
    "string", "float64", "float64[]", "string[]", "float64[3]", "bool", "uint8[]", "int64", "uint64", "int8",
    "std_msgs/Header", "builtin_interfaces/Time", "std_msgs/Header[]", "wstring", "float32[<=2]", "byte",
)  # fmt: skip
FOREIGN = (
    "sensor_msgs/msg/Imu", "nav_msgs/msg/Odometry", "sensor_msgs/msg/NavSatFix", "sensor_msgs/msg/Range",
    "geometry_msgs/msg/TwistStamped", "tf2_msgs/msg/TFMessage", "std_msgs/msg/String", "sensor_msgs/msg/Image",
    "sensor_msgs/msg/CompressedImage", "sensor_msgs/msg/LaserScan", "geometry_msgs/msg/PoseWithCovarianceStamped",
    "sensor_msgs/msg/JointState", "sensor_msgs/msg/MagneticField", "geometry_msgs/msg/PointStamped",
)  # fmt: skip
SIZES = (0, 1, 2, 3, 62, 1000, 100_000)  # of an array: beams of a scan
SMALL_NUMBERS = [n for n in NUMBERS if not 1e38 < abs(n) < float("inf")]  # those that a float32 holds
ROLES = (
    "wheels.topic", "truth.topic", "lrf.topic", "compass.topic", "gyro.topic", "gps.topic", "camera.topic",
    "sonar.topic", "landmarks.file", "landmarks.map",
)  # fmt: skip
KEYS = (
    *ROLES, "wheels.radius", "wheels.track", "wheels.noise", "lrf.sigma_range", "lrf.map", "start.x", "lrf.x",
    "compass.sigma_deg", "start.sigma_xy", "wheels.time_offset", "lrf.time_offset", "truth.sigma_xy", "gyro.bias",
    "camera.model", "lrf.range_max", "lrf.yaw_deg", "wheels.joints", "truth.x", "compass.time_offset",
)  # fmt: skip
COMMANDS = (
    ("info",), ("info",), ("info", "--json"), ("info", "--check"), ("init",), ("run",), ("run",),
    ("run", "--smooth"), ("run", "--export", "mcap,log,kitti,tum,tum-cov,csv"), ("compare",),
    ("compare", "--json"), ("compare", "--smooth"), ("compare", "--all-subsets"), ("recover",),
    ("recover", "--json"), ("view",), ("calibrate",),
)  # fmt: skip
OPTIONS: tuple[tuple[str, ...], ...] = (
    ("--order", "recorded"), ("--order", "stamp"), ("--strict",), ("--hash",), ("-q",), ("--preset", "paper"),
    ("--from", "1"), ("--to", "1"), ("--from", "nan"), ("--to", "-1e300"), ("--from", "1e18"), ("--align", "se2"),
    ("--align", "origin"),
)  # fmt: skip
KNOWN_OPTIONS = {"recover": 0, "info": 5, "init": 5, "view": 5, "calibrate": 5}  # how many of OPTIONS it takes


@dataclass(frozen=True)
class Draft:
    """A drive that is changed before it becomes a case."""

    spoken: tuple[Spoken, ...]
    robot: bytes
    beside: dict[str, bytes] = field(default_factory=dict)  # name -> content
    words: tuple[str, ...] = ()
    command: tuple[str, ...] = ("run",)
    name: str = "log"  # of the log file, without its ending

    def more(self, words: tuple[str, ...], files: Mapping[str, bytes] = {}) -> Draft:
        """Return the draft with more words of the command line, and more files beside the log."""
        return replace(self, words=(*self.words, *words), beside={**self.beside, **files})


Deed = Callable[[Random, Draft], Draft]


@dataclass
class DirectedShop(Workshop):
    """The drive that the cases start from."""

    first: tuple[str, ...] = ()  # one of these deeds is done first; (): any
    drive: Draft = field(default_factory=lambda: Draft((), b""))

    def learn(self, folder: Path) -> None:
        """Record the drive, and see that it is healthy."""
        spoken, attachments = contents(short_drive())
        self.drive = Draft(tuple(spoken), attachments[0].data)
        for command in ("run", "compare", "view"):  # loads every library before memory is limited
            healthy = Case("healthy", _recorded(self.drive, Random(0)), command=(command,))
            if wrong := self.judge(healthy, folder):
                raise SystemExit(wrong)

    def case(self, seed: int) -> Case:
        """Return the case that belongs to a seed."""
        rng = random.Random(f"directed {seed}")
        draft = replace(self.drive, command=rng.choice(COMMANDS))
        deeds = rng.sample(DEEDS, rng.choice((1, 1, 2, 3)))
        if self.first:
            deeds[0] = rng.choice([deed for deed in DEEDS if deed.__name__ in self.first])
        for deed in deeds:
            draft = deed(rng, draft)
        known = OPTIONS[: KNOWN_OPTIONS.get(draft.command[0])]
        if rng.random() < 0.3 and known:
            draft = draft.more(rng.choice(known))
        words = tuple(w for w in draft.words if w == "-q") if draft.command[0] == "recover" else draft.words
        title = f"{' '.join(draft.command)}: {', '.join(deed.__name__ for deed in deeds)}"
        log = _recorded(draft, Random(seed))
        return Case(title, log, beside=draft.beside, words=words, command=draft.command, name=draft.name)


def _recorded(draft: Draft, rng: Random) -> bytes:
    """Return the log as .mcap."""
    file = Attachment(0, 0, "robot.toml", "application/toml", draft.robot)
    compression = rng.choice(list(CompressionType))
    return written(list(draft.spoken), [file], chunk_size=4000, compression=compression)


# --- deeds -------------------------------------------------------------------------------------------------------


def _topics(case: Draft) -> list[str]:
    return sorted({one.channel.topic for one in case.spoken})


def _of(rng: Random, case: Draft) -> tuple[str, Schema]:
    topic = rng.choice(_topics(case))
    schema = next(one.schema for one in case.spoken if one.channel.topic == topic)
    assert schema is not None
    return topic, schema


def _each(case: Draft, topic: str, change: Callable[[Spoken], Spoken]) -> Draft:
    return replace(case, spoken=tuple(change(one) if one.channel.topic == topic else one for one in case.spoken))


def another_kind(rng: Random, case: Draft) -> Draft:
    """Let a field of a definition be of another kind than in the messages."""
    topic, schema = _of(rng, case)
    lines = schema.data.decode("utf-8", "replace").split("\n")  # an earlier deed may have damaged it
    own = [i for i, line in enumerate(lines) if len(line.split()) == 2 and "=" not in line and "MSG" not in line]
    if not own:
        return case
    i = rng.choice(own)
    lines[i] = f"{rng.choice(KINDS)} {lines[i].split()[1]}"
    new = replace(schema, data="\n".join(lines).encode())
    return _each(case, topic, lambda one: one._replace(schema=new))


def _value(store: Any, name: str, rng: Random) -> Any:
    fields = store.get_msgdef(name).fields
    return store.types[name](**{key: _part(store, desc, rng) for key, desc in fields})


def _part(store: Any, desc: Any, rng: Random) -> Any:
    kind, detail = desc[0].name, desc[1]
    if kind == "NAME":
        return _value(store, detail, rng)
    if kind == "BASE":
        return _text(rng) if detail[0] in {"string", "wstring"} else _number(rng, detail[0])
    element, size = detail
    count = size if kind == "ARRAY" else rng.choice((0, 1, 2, 3, 9, 61))
    if element[0].name == "NAME":
        return [_value(store, element[1], rng) for _ in range(count)]
    if element[1][0] in {"string", "wstring"}:
        return [_text(rng) for _ in range(count)]
    dtype = {"byte": "uint8", "octet": "uint8", "char": "uint8"}.get(element[1][0], element[1][0])
    return np.array([_number(rng, element[1][0]) for _ in range(count)]).astype(dtype)


def _number(rng: Random, base: str) -> Any:
    if base == "bool":
        return rng.random() < 0.5
    if base.startswith("float"):
        value = rng.choice(NUMBERS) if rng.random() < 0.1 else rng.gauss(0.0, 2.0)
        return float("inf") if base == "float32" and math.isfinite(value) and abs(value) > 1e38 else value
    bits = int("".join(c for c in base if c.isdigit()) or 8)
    value = rng.choice(INTERESTING) if rng.random() < 0.1 else rng.randrange(3)
    value %= 2**bits
    return value - 2**bits if base.startswith("int") and value >= 2 ** (bits - 1) else value


def _text(rng: Random) -> str:
    return rng.choice(
        (*ACTING, "base_link", "odom", "laser", "left_wheel_joint", "right_wheel_joint", "", "x" * 300)
    )


def acting_names(rng: Random, case: Draft) -> Draft:
    """Let a name of the log act on what shows it: topic, type, language, encoding, the log's own."""
    topic, schema = _of(rng, case)
    odd = rng.choice(ACTING)
    deed = rng.randrange(5)
    if deed == 4:
        return replace(case, name=f"l{odd}g".replace("/", "").replace("\0", ""))

    def change(one: Spoken) -> Spoken:
        channel = replace(one.channel, topic=one.channel.topic + odd) if deed == 0 else one.channel
        channel = replace(channel, message_encoding=odd) if deed == 1 else channel
        other = (schema, schema, replace(schema, name=schema.name + odd), replace(schema, encoding=odd))[deed]
        return Spoken(other, channel, one.message)

    return _each(case, topic, change)


def acting_values(rng: Random, case: Draft) -> Draft:
    """Let texts in messages act: frames, joints, descriptions."""
    topic, schema = _of(rng, case)
    return _typed(rng, case, topic, schema, _odd_texts)


def odd_numbers(rng: Random, case: Draft) -> Draft:
    """Let numbers in messages be NaN, infinite, huge, or of another sign."""
    topic, schema = _of(rng, case)
    return _typed(rng, case, topic, schema, _odd_numbers)


def _typed(rng: Random, case: Draft, topic: str, schema: Schema, edit: Callable[[Random, Any], None]) -> Draft:
    """Change messages by their fields, every one or a few of a topic."""
    share, seed = rng.choice((1.0, 0.1)), rng.random()

    def change(one: Spoken) -> Spoken:
        if Random(f"{seed} {one.message.log_time}").random() > share:
            return one
        try:
            message = STORE.deserialize_cdr(one.message.data, schema.name)
            edit(Random(seed), message)
            data = bytes(STORE.serialize_cdr(message, schema.name))
        except Exception:  # another deed has changed the definition
            return one
        return one._replace(message=replace(one.message, data=data))

    return _each(case, topic, change)


def _odd_texts(rng: Random, message: Any) -> None:
    for key, value in vars(message).items():
        if isinstance(value, str):
            setattr(message, key, rng.choice(ACTING))
        elif isinstance(value, list) and value and isinstance(value[0], str):
            value[rng.randrange(len(value))] = rng.choice(ACTING)
        elif hasattr(value, "__dataclass_fields__"):
            _odd_texts(rng, value)


def _odd_numbers(rng: Random, message: Any) -> None:
    names = [key for key in vars(message) if not key.startswith("__")]
    for key in rng.sample(names, min(2, len(names))):
        value = getattr(message, key)
        if isinstance(value, float):
            setattr(message, key, rng.choice(SMALL_NUMBERS))
        elif isinstance(value, int) and key in {"sec", "nanosec"}:
            setattr(message, key, rng.choice((0, -1, 2**31 - 1, -(2**31))) if key == "sec" else 2**32 - 1)
        elif isinstance(value, np.ndarray) and value.size and value.dtype.kind == "f":
            array = value.copy()
            array[rng.randrange(value.size) :] = rng.choice(SMALL_NUMBERS)
            setattr(message, key, rng.choice((array, np.resize(value, rng.choice(SIZES)))))
        elif hasattr(value, "__dataclass_fields__"):
            _odd_numbers(rng, value)


def huge_counts(rng: Random, case: Draft) -> Draft:
    """Let lengths of arrays and texts in a message be huge."""
    topic, _ = _of(rng, case)
    words = rng.sample(range(1, 20), 2)
    count = rng.choice((2**32 - 1, 2**31, 2**30, 2**20, 70_000))

    def change(one: Spoken) -> Spoken:
        data = bytearray(one.message.data)
        for word in words:
            if 4 + 4 * word + 4 <= len(data):
                struct.pack_into("<I", data, 4 + 4 * word, count)
        return one._replace(message=replace(one.message, data=bytes(data)))

    return _each(case, topic, change)


def odd_stamps(rng: Random, case: Draft) -> Draft:
    """Let stamps and recording times be absurd, equal, or backwards."""
    topic, _ = _of(rng, case)
    deed, value = rng.randrange(5), rng.choice(INTERESTING)
    first = case.spoken[0].message

    def change(one: Spoken) -> Spoken:
        data, log_time = bytearray(one.message.data), one.message.log_time
        if deed == 0 and len(data) >= 12:
            struct.pack_into("<iI", data, 4, rng.choice((0, -1, 2**31 - 1)), value % 2**32)
        elif deed == 1:
            log_time = value % 2**64
        elif deed == 2 and len(data) >= 12:
            data[4:12] = first.data[4:12]
            log_time = first.log_time
        elif deed == 3:
            log_time = 2 * first.log_time + 10**10 - log_time
        elif deed == 4 and len(data) >= 12:
            struct.pack_into("<I", data, 8, int.from_bytes(data[8:12], "little") // 10**8 * 10**8)
        return one._replace(message=replace(one.message, data=bytes(data), log_time=log_time % 2**64))

    return _each(case, topic, change)


def other_order(rng: Random, case: Draft) -> Draft:
    """Drop, repeat, reverse or shuffle messages."""
    where = span(rng, len(case.spoken))
    piece = case.spoken[where]
    shuffled = tuple(rng.sample(piece, len(piece)))
    changed = rng.choice(((), piece * 2, piece[::-1], shuffled))
    return replace(case, spoken=case.spoken[: where.start] + changed + case.spoken[where.stop :])


def foreign_topics(rng: Random, case: Draft) -> Draft:
    """Add topics of types that the product reads, full of odd values."""
    name = rng.choice(FOREIGN)
    topic = rng.choice(("/extra", "/tf", "/tf_static", "/odom", "/robot_description", "/imu/data", "/scan"))
    schema = Schema(0, STORE.generate_msgdef(name, ros_version=2)[0].encode(), "ros2msg", name)
    channel = Channel(0, topic, "cdr", {}, 0)
    extra = []
    for one in case.spoken[:: rng.choice((1, 5, 40))]:
        if name == "std_msgs/msg/String":
            text = mutated(TARGETS["urdf"], rng).decode("utf-8", "replace")
            data = bytes(STORE.serialize_cdr(STORE.types[name](data=text), name))
        else:
            try:
                data = bytes(STORE.serialize_cdr(_value(STORE, name, rng), name))
            except Exception:  # a value that its field cannot hold
                continue
            data = data[:4] + one.message.data[4:12] + data[12:]
        extra.append(Spoken(schema, channel, replace(one.message, data=data)))
    return replace(case, spoken=(*case.spoken, *extra))


def odd_definition(rng: Random, case: Draft) -> Draft:
    """Let a definition be nonsense."""
    topic, schema = _of(rng, case)
    language = rng.choice(("ros2msg", "ros2msg", "ros2idl"))
    new = replace(schema, data=mutated(TARGETS[language], rng), encoding=language)
    return _each(case, topic, lambda one: one._replace(schema=new))


def odd_robot(rng: Random, case: Draft) -> Draft:
    """Give a robot.toml of nonsense, in the log or beside it, or names in it that act."""
    data = mutated(TARGETS["robot.toml"], rng)
    if rng.random() < 0.4:
        name = json.dumps(rng.choice(ACTING))
        key = rng.choice(("lrf.topic", "compass.frame", "wheels.joints", "truth.topic", f"{name}.x", name))
        data = rng.choice((case.robot, b"")) + f"\n{key} = {name}\n".encode()
    if rng.random() < 0.5:
        return replace(case, robot=data)
    return case.more(("--robot", "{here}/robot.toml"), {"robot.toml": data})


def odd_set(rng: Random, case: Draft) -> Draft:
    """Set a key to an odd value."""
    values = (*VALUES, *map(json.dumps, ACTING), '"/tf"', '"/scan"', '"/extra"', '"odom>base_link"', "0.1", "3")
    return case.more(("--set", f"{rng.choice(KEYS)}={rng.choice(values)}"))


def files_beside(rng: Random, case: Draft) -> Draft:
    """Give text files of nonsense: truth, landmarks, detections, a map, a baseline, an estimate."""
    csv, tum, places = (mutated(TARGETS[name], rng) for name in ("csv", "tum", "landmarks"))
    landmarks = ("--set", "landmarks.file={here}/d.csv", "--set", "landmarks.map={here}/m.csv")
    ways: list[tuple[tuple[str, ...], dict[str, bytes]]] = [
        (("--truth", "{here}/t.csv"), {"t.csv": csv}),
        (("--truth", "{here}/t.tum"), {"t.tum": tum}),
        (landmarks, {"d.csv": csv, "m.csv": places}),
    ]
    if case.command[0] == "run":
        ways.append((("--map", "{here}/map.json"), {"map.json": mutated(TARGETS["line map"], rng)}))
    if case.command[0] == "compare":
        empty = b'{"configurations": {"all": []}, "input": []}'
        report = rng.choice((b"[" * 9999, b"{}", b"[]", b"null", empty, csv))
        ways.append((("--baseline", "{here}/b.json"), {"b.json": report}))
        ways.append((("--estimate", "mine={here}/t.csv"), {"t.csv": csv}))
        ways.append((("--estimate", f"{rng.choice(ACTING[:-3])}=/ground_truth"), {}))
    return case.more(*rng.choice(ways))


DEEDS: list[Deed] = [
    another_kind, another_kind, acting_names, acting_values, odd_numbers, odd_numbers, huge_counts, odd_stamps,
    odd_stamps, other_order, foreign_topics, foreign_topics, odd_definition, odd_robot, odd_set,
    files_beside, files_beside, *OF_SENSORS,
]  # fmt: skip
