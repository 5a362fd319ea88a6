"""Every kind of bag is the same log: sqlite3, compressed files and messages, ROS 1, JSON."""

import base64
import json
import random
import sqlite3
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zstandard
from bags import LIGHT, STORE, T0, S, Said, build, contents, drive, real_log, rows, write
from invented import walks
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer as Ros2Writer
from rosbags.typesys import Stores, get_typestore

from benchmarks.field_paths import paths
from locfuse.formats.logs.files import make_decoder
from locfuse.formats.logs.log import open_log
from locfuse.fusion.data import LocfuseError

NOETIC = get_typestore(Stores.ROS1_NOETIC)


@pytest.fixture(scope="module")
def reference(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    return contents(open_log([write(tmp_path_factory.mktemp("ref") / "ref.mcap", drive())]))


def rosbag2(folder: Path, plugin: StoragePlugin, mode: CompressionMode | None = None) -> Path:
    """The drive as rosbags writes it."""
    writer = Ros2Writer(folder, version=9, storage_plugin=plugin)
    if mode is not None:
        writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        connections: dict[str, Any] = {}
        for m in drive():
            if m.topic not in connections:
                connections[m.topic] = writer.add_connection(m.topic, m.msgtype, typestore=STORE)
            writer.write(connections[m.topic], m.log_time, m.data)
    return folder


@pytest.mark.parametrize("plugin", list(StoragePlugin))
@pytest.mark.parametrize("mode", [None, CompressionMode.FILE, CompressionMode.MESSAGE, CompressionMode.STORAGE])
def test_rosbag2_folders_of_every_storage_and_compression(
    tmp_path: Path, reference: dict[str, Any], plugin: StoragePlugin, mode: CompressionMode | None
) -> None:
    if plugin is StoragePlugin.SQLITE3 and mode is CompressionMode.STORAGE:
        pytest.skip("sqlite3 storage has no compression of its own")
    folder = rosbag2(tmp_path / "bag", plugin, mode)
    log = open_log([folder])
    assert contents(log) == reference
    assert not log.losses
    assert sum(len(n) for n, _ in log.stream("/scan").blocks("ranges")) == 50
    (folder / "metadata.yaml").unlink()
    assert contents(open_log([folder])) == reference


def test_a_real_sqlite3_bag_without_definitions_is_its_mcap_twin() -> None:
    """The definitions of standard types are rosbags'; the MCAP carries its own."""
    db3, mcap = open_log([real_log("turtlebot4/db3")]), open_log([real_log("turtlebot4")])
    assert db3.topics.keys() == mcap.topics.keys()
    assert db3.time_span_ns == mcap.time_span_ns
    channels = {c.topic: c for source in mcap._sources for c in source.channels.values()}
    wants = {topic: tuple(paths(make_decoder(channels[topic]).message)) for topic in mcap.topics}
    for topic, fields in wants.items():
        one, other = (log.stream(topic) for log in (db3, mcap))
        np.testing.assert_array_equal(one.t_ns, other.t_ns)
        a, b = one.columns(*fields), other.columns(*fields)
        for name in fields:
            for x, y in zip(rows(a[name]), rows(b[name]), strict=True):
                np.testing.assert_array_equal(x, y)


def test_a_type_nobody_defines_is_refused_by_name(tmp_path: Path) -> None:
    folder = rosbag2(tmp_path / "bag", StoragePlugin.SQLITE3)
    file = next(folder.glob("*.db3"))
    with sqlite3.connect(file) as database:
        database.execute("DROP TABLE message_definitions")
        database.execute("UPDATE topics SET type = 'my_msgs/msg/Special' WHERE name = '/heading'")
    database.close()
    log = open_log([file])
    assert len(log.stream("/scan").t_ns) == 50
    with pytest.raises(LocfuseError, match="/heading cannot be read: its type is not described"):
        log.stream("/heading")


def zeroed(bad: bytearray, rng: random.Random) -> None:
    """Cut the file off, or overwrite 600 of its bytes with zeros."""
    if rng.random() < 0.5:
        del bad[rng.randrange(100, len(bad)) :]
    else:
        at = rng.randrange(len(bad))
        bad[at : at + 600] = bytes(600)


def garbled(bad: bytearray, rng: random.Random) -> None:
    for _ in range(3):
        bad[rng.randrange(13, len(bad))] = rng.randrange(256)


@pytest.mark.parametrize(("kind", "damage", "seed"), [("db3", zeroed, 0), ("bag", garbled, 3)])
def test_a_damaged_bag_gives_what_can_be_read_and_counts_the_rest_or_is_refused_in_one_line(
    tmp_path: Path, kind: str, damage: Any, seed: int
) -> None:
    file = tmp_path / "x.bag"
    if kind == "db3":
        file = next(rosbag2(tmp_path / "bag", StoragePlugin.SQLITE3).glob("*.db3"))
    content, rng, lossy = (file if kind == "db3" else ros1(file)).read_bytes(), random.Random(seed), 0
    for _ in range(60):
        damage(bad := bytearray(content), rng)
        file.write_bytes(bad)
        try:
            log = open_log([file])
            for name in (name for name, topic in log.topics.items() if topic.problem is None):
                assert (np.diff(log.stream(name).t_ns) >= 0).all()
                log.stream(name).columns()
            lossy += bool(log.losses)
        except LocfuseError as problem:
            refusal = str(problem)
            assert "\n" not in refusal
    assert lossy > 2 or kind == "bag"


def test_a_sqlite3_file_that_is_no_bag_is_one_line(tmp_path: Path) -> None:
    file = tmp_path / "x.db3"
    database = sqlite3.connect(file)
    database.execute("CREATE TABLE music (title TEXT)")
    database.close()
    with pytest.raises(LocfuseError, match="not a readable rosbag2 database: no such table"):
        open_log([file])


@pytest.mark.parametrize("cut", [0.3, 0.7, 0.95])
def test_a_cut_off_compressed_file_gives_its_beginning(tmp_path: Path, cut: float) -> None:
    said = drive(4000)
    plain = write(tmp_path / "x.mcap", said, chunk_size=3000)
    packed = zstandard.ZstdCompressor(level=1).compress(plain.read_bytes())
    file = tmp_path / "x.mcap.zstd"
    file.write_bytes(packed[: int(len(packed) * cut)])
    log = open_log([file])
    assert log.name == "x"
    assert "the compression is damaged or cut off" in log.losses.lines()[0]
    assert cut - 0.15 < len(log.stream("/joint_states").t_ns) / 4000 < 1


def test_a_bomb_of_a_compressed_file_stops_at_its_cap(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("locfuse.formats.container.decompress.MIN_CAP_BYTES", 1 << 20)
    file = tmp_path / "x.mcap.zstd"
    file.write_bytes(zstandard.ZstdCompressor().compress(bytes(64 << 20)))
    with pytest.raises(LocfuseError, match="unpacks to more than 1 MiB"):
        open_log([file])


def test_messages_that_do_not_unpack_are_dropped_and_counted(tmp_path: Path) -> None:
    pack = zstandard.ZstdCompressor().compress
    said = [m._replace(data=pack(m.data)[: -9 if i % 10 == 0 else None]) for i, m in enumerate(drive(40))]
    log = open_log([write(tmp_path / "x.mcap", said)])
    found = log.streams(LIGHT)
    n_bad = sum(sum(stream.dropped.values()) for stream in found.values())
    assert n_bad == len(range(0, len(said), 10))
    assert sum(len(stream.t_ns) for stream in found.values()) == len(said) - n_bad


# ROS 1


def ros1(path: Path, compression: Ros1Writer.CompressionFormat | None = None) -> Path:
    """The drive as a ROS 1 bag."""
    writer = Ros1Writer(path)
    if compression:
        writer.set_compression(compression)
    writer.chunk_threshold = 4000
    with writer:
        connections: dict[str, Any] = {}
        for m in drive():
            message: Any = STORE.deserialize_cdr(m.data, m.msgtype)
            if m.topic not in connections:
                connections[m.topic] = writer.add_connection(m.topic, m.msgtype, typestore=NOETIC)
            kind = m.msgtype
            fields = {name: getattr(message, name) for name, _ in NOETIC.get_msgdef(kind).fields}
            if "header" in fields:
                stamp = {"sec": message.header.stamp.sec, "nanosec": message.header.stamp.nanosec}
                head = {"seq": 7, "stamp": stamp, "frame_id": message.header.frame_id}
                fields["header"] = build("std_msgs/msg/Header", NOETIC, **head)
            raw = NOETIC.serialize_ros1(NOETIC.types[kind](**fields), kind)
            writer.write(connections[m.topic], m.log_time, raw)
    return path


@pytest.mark.parametrize("compression", [None, *Ros1Writer.CompressionFormat])
def test_a_ros1_bag_is_the_same_log(
    tmp_path: Path, reference: dict[str, Any], compression: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    walked = walks(monkeypatch)
    log = open_log([ros1(tmp_path / "x.bag", compression)])
    assert contents(log) == reference
    assert not log.losses
    assert log.time_span_ns == open_log([write(tmp_path / "x.mcap", drive())]).time_span_ns
    assert len(walked) < 0.1 * sum(topic.count for topic in log.topics.values())


def test_a_truncated_ros1_bag_gives_every_message_that_is_wholly_there(tmp_path: Path) -> None:
    content = ros1(tmp_path / "x.bag").read_bytes()
    whole = open_log([tmp_path / "x.bag"])
    stamps = {topic: stream.t_ns.tolist() for topic, stream in whole.streams(LIGHT).items()}
    path = tmp_path / "cut.bag"
    counts = []
    for cut in range(5000, len(content), len(content) // 25):
        path.write_bytes(content[:cut])
        log = open_log([path])
        n = 0
        for topic in log.topics:
            t_ns = log.stream(topic).t_ns.tolist()
            assert t_ns == stamps[topic][: len(t_ns)]
            n += len(t_ns)
        assert log.losses
        counts.append(n)
    assert counts == sorted(counts)
    assert counts[-1] == sum(map(len, stamps.values()))


def test_a_hole_in_a_ros1_bag_loses_what_lies_in_it_and_nothing_behind(tmp_path: Path) -> None:
    content = bytearray(ros1(tmp_path / "x.bag").read_bytes())
    at = len(content) // 3
    content[at : at + 500] = bytes(500)
    path = tmp_path / "hole.bag"
    path.write_bytes(content)
    log = open_log([path])
    stream = log.stream("/joint_states")
    assert log.losses or sum(stream.dropped.values())
    assert 120 < len(stream.t_ns) < 200
    assert stream.t_ns[-1] == T0 + 199 * S // 20


# JSON


@pytest.mark.parametrize("name", ["custom-camera-model", "example", "example_logs"])
def test_real_json_logs_read_like_by_the_json_module(name: str) -> None:
    from mcap.reader import make_reader

    path = real_log(f"bags/foxglove-json/{name}.mcap")
    log = open_log([path])
    said: dict[str, list[Said]] = {}
    with path.open("rb") as file:
        for schema, channel, m in make_reader(file).iter_messages():
            assert schema is not None
            said.setdefault(channel.topic, []).append(
                Said(channel.topic, schema.name, m.data, m.log_time, m.sequence)
            )
    for topic, messages in said.items():
        stream = log.stream(topic)
        unique = list({(m.log_time, m.data): m for m in messages}.values())
        assert len(stream.t_ns) == len(unique)
        channels = [c for source in log._sources for c in source.channels.values() if c.topic == topic]
        fields = [f for f in paths(make_decoder(channels[0]).message) if "." not in f and f != "timestamp"]
        columns = stream.columns(*fields)
        values = [json.loads(m.data) for m in unique]
        for field in fields:
            got = sorted(map(str, (np.asarray(x).tolist() for x in rows(columns[field]))))
            expected = sorted(map(str, (_plain(v[field], columns[field]) for v in values)))
            assert got == expected


def _plain(value: Any, column: Any) -> Any:
    if isinstance(column, list) and column and isinstance(column[0], bytes):
        return np.asarray(base64.b64decode(value)).tolist()
    if isinstance(value, list):
        return [float(x) for x in value]
    return float(value) if isinstance(value, int) else value
