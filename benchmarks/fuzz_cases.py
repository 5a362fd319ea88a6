"""Cases of benchmarks.fuzz: a seed decides how a log is damaged, or made wrong on purpose."""

from __future__ import annotations

import io
import json
import math
import re
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from random import Random
from typing import Any, NamedTuple

import cv2
import numpy as np
from mcap.reader import make_reader
from mcap.records import Channel, Message, Schema
from mcap.writer import CompressionType, Writer
from rosbags.typesys import Stores, get_typestore

from benchmarks import experiment
from benchmarks.fuzz_parsers import ACTING, FLOATS, INTEGERS, VALUES, WORDS, damaged, mutated
from benchmarks.real_logs import are_there, folder
from locfuse import sample_logs
from locfuse.fusion.data import Array
from locfuse.sample_logs.scenario import load
from locfuse.sample_logs.simulate import EPOCH_NS, Outcome, Simulation, on_truth, write_log

LARGEST = 2_000_000  # bytes of a real log: a case must stay fast


class Spoken(NamedTuple):
    """One message of a log, with schema and channel, so that it can be written again."""

    schema: Schema
    channel: Channel
    message: Message


@dataclass(frozen=True)
class Case:
    """A log, files beside it, and a command; `{here}` in a word is replaced by the folder."""

    title: str = ""
    log: bytes = b""
    suffix: str = ".mcap"
    healthy: str = ""  # undamaged log, whose trajectory must result if no damage is reported
    beside: Mapping[str, bytes] = field(default_factory=dict)  # name -> content
    words: tuple[str, ...] = ()
    command: tuple[str, ...] = ("run",)
    spoken: list[Spoken] = field(default_factory=list)  # what a directed case writes as its log
    robot: bytes = b""

    def more(self, words: tuple[str, ...], files: Mapping[str, bytes] = {}) -> Case:
        """Return the case with more words of the command line, and more files beside the log."""
        return replace(self, words=(*self.words, *words), beside={**self.beside, **files})

    def each(self, topic: str, change: Callable[[Spoken], Spoken]) -> Case:
        """Return the case with the messages of a topic changed."""
        return replace(self, spoken=[change(one) if one.channel.topic == topic else one for one in self.spoken])

    def write(self, folder: Path) -> list[str]:
        """Write everything into a new folder, and return the command line."""
        folder.mkdir(parents=True)
        log = folder / f"log{self.suffix}"
        for path, content in {log: self.log, **{folder / n: c for n, c in self.beside.items()}}.items():
            path.write_bytes(content)
        results = {
            "run": ["-o", f"{folder}/out", "--write", "all"],  # trajectory.csv is evaluated
            "compare": ["-o", f"{folder}/out"],
            "recover": ["-o", f"{folder}/fixed.mcap"],
            "view": ["--save", f"{folder}/drive.rrd"],
        }
        command, *options = self.command
        words = [word.replace("{here}", str(folder)) for word in self.words]
        return [command, str(log), *options, *results.get(command, []), *words]


def contents(data: bytes) -> list[Spoken]:
    return [Spoken(*one) for one in make_reader(io.BytesIO(data)).iter_messages(log_time_order=False)]  # type: ignore[arg-type]


def recorded(spoken: list[Spoken], robot: bytes, **options: Any) -> bytes:
    """Write messages unchanged by the public writer; equal channels and equal schemas are written once."""
    file, known = io.BytesIO(), dict[Any, int]()
    writer: Any = Writer(file, **options)
    writer.start(profile="ros2", library="locfuse fuzz")
    writer.add_attachment(0, 0, "robot.toml", "application/toml", robot)
    for schema, channel, message in spoken:
        key = schema.name, schema.encoding, schema.data
        if key not in known:
            known[key] = writer.register_schema(*key)
        topic = channel.topic, channel.message_encoding, known[key]
        if topic not in known:
            known[topic] = writer.register_channel(*topic)
        writer.add_message(known[topic], message.log_time, message.data, message.publish_time, message.sequence)
    writer.finish()
    return file.getvalue()


SHORT = (
    *("control.estimator=truth", "control.wait=0", "path.laps=0.045", "camera.enabled=false"),
    *("wheels.rate=25", "compass.rate=10", "lrf.rate=5", "lrf.beams=61", "truth.rate=10"),
)


class Short(NamedTuple):
    """A simulated drive of 2.4 s."""

    spoken: list[Spoken]
    robot: bytes  # robot.toml
    outcome: Outcome
    walls: Array  # (n, 4) x0, y0, x1, y1 [m]


@cache
def short_drive() -> Short:
    path, scenario = experiment.scratch() / "short.mcap", load("rounded_rectangle", SHORT)
    outcome = write_log(scenario, 1, on_truth, path)
    data = path.read_bytes()
    robot = next(iter(make_reader(io.BytesIO(data)).iter_attachments())).data
    return Short(contents(data), robot, outcome, Simulation(scenario, 1).obstacles.segments)


@cache
def bases() -> dict[str, tuple[Case, float]]:
    """Return the logs to damage by name, with weights; also small real logs if their folder is set."""
    short, usual = short_drive(), {"compression": CompressionType.NONE, "chunk_size": 4000}
    kinds: tuple[tuple[str, float, bool, dict[str, Any]], ...] = (  # name, weight, has checksums, options
        ("zstd", 10, True, {"compression": CompressionType.ZSTD}),
        ("lz4", 5, True, {"compression": CompressionType.LZ4}),
        ("stored", 10, True, {}),
        ("rosbag2", 10, False, {"enable_crcs": False}),
        ("loose", 5, False, {"use_chunking": False}),
    )
    found = {}
    for name, weight, checked, how in kinds:
        log = recorded(short.spoken, short.robot, **usual | how)
        found[name] = Case(name, log, healthy=name if checked else ""), weight
    for name in sample_logs.names():
        found[name] = Case(name, sample_logs.path(name).read_bytes(), healthy=name), 0.3
    for path in sorted(folder().rglob("*")) if are_there() else []:
        if path.suffix in {".mcap", ".db3", ".bag"} and 0 < path.stat().st_size <= LARGEST:
            found[path.name] = Case(path.name, path.read_bytes(), path.suffix, words=WHEELS), 0.4
    return found


WHEELS = ("--set", "wheels.radius=0.033", "--set", "wheels.track=0.16")  # of a log that does not know them


def damaged_case(seed: int) -> Case:
    rng = Random(seed)
    cases, weights = zip(*bases().values(), strict=True)
    base: Case = rng.choices(cases, weights)[0]
    data, names, starts, at = base.log, [], [], 8  # of the records of an .mcap, behind its magic
    while base.suffix == ".mcap" and at + 17 < len(data):
        starts.append(at)
        at += 9 + int(struct.unpack_from("<Q", data, at + 1)[0])
    for _ in range(rng.choice((1, 1, 1, 2))):
        data, name = damaged(rng, data, near=starts)
        names.append(name)
    command = ("compare",) if rng.random() < 0.05 else ("run",)
    return replace(base, title=f"{base.title}: {', '.join(names)}", log=data, command=command)


# --- cases that are wrong on purpose: each function ("deed") changes one thing

STORE: Any = get_typestore(Stores.ROS2_JAZZY)
FOREIGN = (
    "sensor_msgs/msg/Imu", "sensor_msgs/msg/NavSatFix", "sensor_msgs/msg/Range", "sensor_msgs/msg/LaserScan",
    "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage", "sensor_msgs/msg/JointState",
    "sensor_msgs/msg/MagneticField", "geometry_msgs/msg/TwistStamped", "geometry_msgs/msg/PointStamped",
    "geometry_msgs/msg/PoseWithCovarianceStamped", "nav_msgs/msg/Odometry", "tf2_msgs/msg/TFMessage",
    "std_msgs/msg/String",
)  # fmt: skip
TOPICS = ("/extra", "/tf", "/tf_static", "/odom", "/robot_description", "/imu/data", "/scan")
COMMANDS = (
    "info", "info", "info --json", "info --check", "init", "run", "run", "run --smooth",
    "run --export mcap,log,kitti,tum,tum-cov,csv", "compare", "compare --json", "compare --smooth",
    "compare --all-subsets", "recover", "recover --json", "view", "calibrate",
)  # fmt: skip
OPTIONS = (
    "--order recorded", "--order stamp", "--strict", "--hash", "-q", "--preset paper", "--from 1", "--to 1",
    "--from nan", "--to -1e300", "--from 1e18", "--align se2", "--align origin",
)  # fmt: skip
KNOWN_OPTIONS = {"recover": 0, "info": 5, "init": 5, "view": 5, "calibrate": 5}  # how many of OPTIONS it takes


def directed_case(first: tuple[str, ...], seed: int) -> Case:
    """Return a short drive with one to three changes; the first is one of `first` if not empty."""
    rng = Random(f"directed {seed}")
    short = short_drive()
    case = Case(command=tuple(rng.choice(COMMANDS).split()), spoken=short.spoken, robot=short.robot)
    deeds = rng.sample(DEEDS, rng.choice((1, 1, 2, 3)))
    deeds[0] = rng.choice([deed for deed in DEEDS if deed.__name__ in first] or [deeds[0]])
    for deed in deeds:
        case = deed(rng, case)
    known = OPTIONS[: KNOWN_OPTIONS.get(case.command[0])]
    if rng.random() < 0.3 and known:
        case = case.more(tuple(rng.choice(known).split()))
    title = f"{' '.join(case.command)}: {', '.join(deed.__name__ for deed in deeds)}"
    log = recorded(case.spoken, case.robot, chunk_size=4000, compression=rng.choice(list(CompressionType)))
    return replace(case, title=title, log=log, words=() if case.command[0] == "recover" else case.words)


def a_topic(rng: Random, case: Case) -> tuple[str, Schema]:
    one = rng.choice(case.spoken)
    return one.channel.topic, one.schema


def odd_values(rng: Random, case: Case) -> Case:
    """Make numbers in messages NaN, infinite, huge or absurd, put code into texts, change array lengths."""
    (topic, schema), share, seed = a_topic(rng, case), rng.choice((1.0, 0.1)), rng.random()

    def change(one: Spoken) -> Spoken:
        if Random(f"{seed} {one.message.log_time}").random() > share:
            return one
        try:
            message = STORE.deserialize_cdr(one.message.data, schema.name)
            make_odd(Random(seed), message)
            data = bytes(STORE.serialize_cdr(message, schema.name))
        except Exception:  # another function has changed the definition, or a field cannot store the value
            return one
        return one._replace(message=replace(one.message, data=data))

    return case.each(topic, change)


def make_odd(rng: Random, message: Any) -> None:
    for key in rng.sample(names := [key for key in vars(message) if key[0] != "_"], min(2, len(names))):
        value, odd = getattr(message, key), rng.choice([x for x in FLOATS if not 1e38 < abs(x) < math.inf])
        if hasattr(value, "__dataclass_fields__"):
            make_odd(rng, value)
        elif isinstance(value, np.ndarray) and value.size:
            array = np.resize(value, rng.choice((0, 1, 2, 62, 1000, 100_000, value.size, value.size)))
            array[rng.randrange(value.size) :] = odd if value.dtype.kind == "f" else rng.choice(INTEGERS[:5])
            setattr(message, key, array)
        elif isinstance(value, list) and value:
            value[rng.randrange(len(value))] = rng.choice(ACTING)
        else:
            other = {str: rng.choice(ACTING), float: odd, int: rng.choice((0, -1, 2**31 - 1, 2**32 - 1))}
            setattr(message, key, other.get(type(value), value))


def foreign_topics(rng: Random, case: Case) -> Case:
    name, topic = rng.choice(FOREIGN), rng.choice(TOPICS)
    schema = Schema(0, STORE.generate_msgdef(name, ros_version=2)[0].encode(), "ros2msg", name)
    data = bytes(STORE.serialize_cdr(filled(rng, STORE, name), name))
    if name == "std_msgs/msg/String":
        text = mutated("urdf", rng).decode("utf-8", "replace")
        data = bytes(STORE.serialize_cdr(STORE.types[name](data=text), name))
    some = [o.message for o in case.spoken[:: rng.choice((1, 5, 40))]]
    extra = [replace(m, data=data[:4] + m.data[4:12] + data[12:]) for m in some]
    more = [Spoken(schema, Channel(0, topic, "cdr", {}, 0), message) for message in extra]
    mixed = replace(case, spoken=more)
    for _ in range(rng.randrange(4)):
        mixed = odd_values(rng, mixed)
    return replace(case, spoken=[*case.spoken, *mixed.spoken])


def filled(rng: Random, store: Any, name: str) -> Any:

    def value(kind: Any) -> Any:
        what, detail = kind[0].name, kind[1]
        if what == "NAME":
            return filled(rng, store, detail)
        if what == "BASE":
            number = rng.gauss(0.0, 2.0) if detail[0].startswith("float") else rng.randrange(2)
            return rng.choice(("base_link", "odom", "laser")) if "string" in detail[0] else number
        element, size = detail
        values = [value(element) for _ in range(size if what == "ARRAY" else rng.choice((0, 1, 2, 9, 61)))]
        dtype = {"byte": "uint8", "octet": "uint8", "char": "uint8"}.get(element[1][0], element[1][0])
        return values if element[0].name == "NAME" or "string" in dtype else np.array(values, dtype)

    return store.types[name](**{key: value(kind) for key, kind in store.get_msgdef(name).fields})


def sprinkled(rng: Random, text: str) -> bytes:
    share = rng.choice((0.0, 0.0, 0.01, 0.5))
    odd = re.sub(r"[-+.\d]+", lambda m: rng.choice(VALUES) if rng.random() < share else m[0], text)
    data = odd.encode("utf-8", "replace")
    return damaged(rng, data, WORDS)[0] if rng.random() < 0.15 else data


def with_map(rng: Random, case: Case, text: str, suffix: str, files: Mapping[str, bytes] = {}) -> Case:
    command = case.command if case.command[0] in {"run", "compare"} else ("run",)
    words = ("--map", f"{{here}}/map{suffix}", *rng.choice(((), ("--set", "start.sigma_xy=5"))))
    return replace(case, command=command).more(words, {**files, f"map{suffix}": sprinkled(rng, text)})


def map_pictures(rng: Random, case: Case) -> Case:
    """Add a map as a picture: of the room, of noise, of the largest size, of other pixel depths, or damaged."""
    noise, side = np.random.default_rng(rng.randrange(2**32)), rng.choice((1, 2, 33, 200, 200, 200, 2000, 8200))
    grey = np.full((side, min(side, 2**26 // side)), 254, np.uint8)
    for x0, y0, x1, y1 in ((short_drive().walls + 0.5) / 0.05).round().astype(int).tolist():
        cv2.line(grey, (x0, side - 1 - y0), (x1, side - 1 - y1), 0)
    if side <= 2000:
        grey[noise.random(grey.shape) < rng.choice((0.0, 0.0, 1e-4, 0.1, 1.0))] = rng.choice((0, 127, 205, 255))
    picture = rng.choice((grey, grey.astype(np.uint16) * 257, np.dstack([grey] * 3) if side <= 200 else grey))
    content = cv2.imencode(".png", picture)[1].tobytes()
    if rng.random() < 0.5:
        content = b"P5\n%d %d\n%d\n" % (*grey.shape[::-1], rng.choice((255, 255, 1, 0))) + grey.tobytes()
    content = damaged(rng, content)[0] if rng.random() < 0.2 else content
    keys = "image: m.png\nresolution: 0.05\norigin: [-0.5, -0.5, 0]\nnegate: 0\noccupied_thresh: 0.65\n"
    extra = rng.choice(
        ("", "", "free_thresh: 0.196\n", "a: &a [*a]\n", "b: !!python/name:os.system\n", "[" * 3000)
    )
    return with_map(rng, case, keys.replace("m.png", rng.choice(IMAGES)) + extra, ".yaml", {"m.png": content})


IMAGES = (*["m.png"] * 12, "/dev/zero", "map.yaml", ".", "../x", "nothing.png")


def line_maps(rng: Random, case: Case) -> Case:
    count = rng.choice((1, 0, 0, 64, 1000, 10_000))
    ends = (
        short_drive().walls.tolist()
        if not count
        else [[rng.uniform(-20, 20) for _ in range(4)] for _ in range(count)]
    )
    rest = {"hits": 5, "covariance": [[1e-4, 0.0], [0.0, 1e-5]]}
    lines = [{"id": i, "from": four[:2], "to": four[2:], **rest} for i, four in enumerate(ends)]
    return with_map(rng, case, json.dumps({"format": "locfuse line map", "version": 1, "lines": lines}), ".json")


def detection_files(rng: Random, case: Case) -> Case:
    """Add detections.csv with many lines and ids, some of which are odd, with or without a map of landmarks."""
    noise, count = np.random.default_rng(rng.randrange(2**32)), rng.choice((10, 100, 1000, 5000, 20_000))
    known = max(rng.choice((1, 5, count // 200, count // 20, count)), 1)
    places, which = noise.uniform((-1.0, -1.0), (9.0, 7.0), (known, 2)), noise.integers(0, known, count)
    t = np.sort(noise.uniform(0.0, 2.4, count)).round(rng.choice((1, 9)))
    outcome = short_drive().outcome
    x, y, theta = (np.interp(t, outcome.truth_t, column) for column in outcome.truth.T)
    dx, dy = places[which].T - (x, y)
    stamps = EPOCH_NS * 1e-9 + t
    table = np.column_stack((stamps, which, np.hypot(dx, dy), np.arctan2(dy, dx) - theta)).tolist()
    text = "t,id,range,bearing\n" + "".join(f"{t:.9f},{i:g},{r:.6f},{b:.6f}\n" for t, i, r, b in table)
    near = "id,x,y\n" + "".join(f"{i},{a},{b}\n" for i, (a, b) in enumerate(places.tolist()))
    given = case.more(("--set", "landmarks.file={here}/d.csv"), {"d.csv": sprinkled(rng, text)})
    with_places = given.more(("--set", "landmarks.map={here}/m.csv"), {"m.csv": sprinkled(rng, near)})
    return rng.choice((given, with_places))


DEEDS = (odd_values, odd_values, foreign_topics, foreign_topics, map_pictures, line_maps, detection_files)
