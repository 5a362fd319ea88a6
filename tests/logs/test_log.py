"""A log is its messages in recording order, whatever the files look like that hold them."""

import hashlib
import os
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bags import (
    LIGHT,
    T0,
    S,
    Said,
    cdr,
    contents,
    definition,
    drive,
    header,
    real_log,
    real_logs,
    recorded,
    rows,
    shuffled,
    write,
)
from commands import reported
from mcap.writer import CompressionType, Writer

from locfuse import sample_logs
from locfuse.formats.container.file_bytes import FileBytes, Losses
from locfuse.formats.container.mcap_source import McapSource
from locfuse.formats.logs.files import files_of, identity_of, log_files
from locfuse.formats.logs.log import open_log
from locfuse.fusion.data import LocfuseError, Ragged, UsageError

JOINTS = "sensor_msgs/msg/JointState"


@pytest.fixture(scope="module")
def reference(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    return contents(open_log([write(tmp_path_factory.mktemp("ref") / "ref.mcap", drive())]))


@pytest.mark.parametrize("compression", list(CompressionType))
@pytest.mark.parametrize(("little", "order"), [(True, "as recorded"), (False, "shuffled")])
@pytest.mark.parametrize(
    "layout",
    [
        {},
        {"chunk_size": 3000},
        {"use_chunking": False},
        {"chunk_size": 3000, "enable_crcs": False},
        {"enable_data_crcs": True},
        {"use_statistics": False, "repeat_channels": False, "repeat_schemas": False},
    ],
)
def test_the_numbers_do_not_depend_on_how_the_messages_are_stored(
    tmp_path: Path, reference: dict[str, Any], compression: CompressionType, little: bool, order: str, layout: Any
) -> None:
    said = drive(little=little)
    path = write(
        tmp_path / "log.mcap", shuffled(said) if order == "shuffled" else said, compression=compression, **layout
    )
    log = open_log([path])
    assert contents(log) == reference
    assert not log.losses


def test_split_files_merge_by_topic_and_order_and_the_same_file_twice_is_one(
    tmp_path: Path, reference: dict[str, Any]
) -> None:
    said = drive()
    one = write(tmp_path / "log_1.mcap", said[:150])
    other = write(tmp_path / "log_0.mcap", said[150:])
    assert contents(open_log([one, other])) == reference
    assert contents(open_log([other, one])) == reference
    assert contents(open_log([tmp_path])) == reference
    path = write(tmp_path / "log.mcap", drive())
    shutil.copy(path, tmp_path / "copy.mcap")
    log = open_log([path, tmp_path / "copy.mcap"])
    assert contents(log) == reference
    assert log.stream("/scan").dropped == {"repeat": 50}


@pytest.mark.parametrize(
    "text",
    [
        "rosbag2_bagfile_information:\n  relative_file_paths:\n    - b_0.mcap\n    - 'a_0.mcap'\n  duration: 1\n",
        'relative_file_paths:\r\n- b_0.mcap\r\n- "a_0.mcap"\r\n',
    ],
)
def test_a_rosbag2_folder_is_the_files_its_metadata_lists(
    tmp_path: Path, reference: dict[str, Any], text: str
) -> None:
    said = drive()
    for name, some in (("a_0", said[:150]), ("b_0", said[150:]), ("unrelated", drive(3))):
        write(tmp_path / f"{name}.mcap", some)
    metadata = tmp_path / "metadata.yaml"
    metadata.write_text(text)
    log = open_log([tmp_path])
    assert contents(log) == contents(open_log([metadata])) == reference
    assert (log.name, len(log.paths)) == (tmp_path.name, 2)
    assert [file.name for file in log_files(tmp_path)] == ["b_0.mcap", "a_0.mcap"]


@pytest.mark.parametrize("rows_per_block", [1, 7, 256])
@pytest.mark.parametrize("order", ["as recorded", "shuffled"])
def test_blocks_give_every_row_exactly_once(tmp_path: Path, rows_per_block: int, order: str) -> None:
    said = list(shuffled(drive())) if order == "shuffled" else drive()
    stream = open_log([write(tmp_path / "log.mcap", said, chunk_size=4000)]).stream("/scan")
    whole = stream.columns("ranges")["ranges"]
    seen: list[int] = []
    for numbers, columns in stream.blocks("ranges", rows=rows_per_block):
        for number, row in zip(numbers.tolist(), rows(columns["ranges"]), strict=True):
            np.testing.assert_array_equal(row, whole[number])
        seen += numbers.tolist()
        assert 0 < len(numbers) <= rows_per_block
    assert sorted(seen) == list(range(len(stream.t_ns)))


def test_a_block_is_never_much_larger_than_its_bound(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("locfuse.formats.logs.stream.BLOCK_BYTES", 4096)
    stream = open_log([write(tmp_path / "log.mcap", drive(), chunk_size=2000)]).stream("/scan")
    sizes = [c["ranges"].values.nbytes for _, c in stream.blocks("ranges") if isinstance(c["ranges"], Ragged)]
    assert len(sizes) > 3
    assert max(sizes) < 3 * 4096


def test_messages_of_equal_time_are_ordered_by_sequence_by_content_and_without_numbers_by_stamp(
    tmp_path: Path,
) -> None:
    said = [Said("/n", "std_msgs/msg/Float64", cdr("std_msgs/msg/Float64", data=i), T0, i % 3) for i in range(30)]
    said += [
        Said("/joints", JOINTS, cdr(JOINTS, header=header(T0 + i), position=[i]), T0 + (i // 10 + 1) * S)
        for i in range(30)
    ]
    orders = []
    for seed in range(5):
        log = open_log([write(tmp_path / f"{seed}.mcap", shuffled(said, seed), chunk_size=200)])
        orders.append(np.asarray(log.stream("/n").columns("data")["data"]).tolist())
        assert rows(log.stream("/joints").columns("position")["position"]) == [[i] for i in range(30)]
    assert all(order == orders[0] for order in orders)
    assert [int(x) % 3 for x in orders[0]] == [0] * 10 + [1] * 10 + [2] * 10


def test_messages_of_two_publishers_that_send_the_same_are_one_stream(tmp_path: Path) -> None:
    """The copy of each is recorded after the next one."""
    one = [
        Said("/joints", JOINTS, cdr(JOINTS, header=header(T0 + i * S // 10), position=[i]), T0 + i * S // 10)
        for i in range(30)
    ]
    copies = [said._replace(log_time=said.log_time + S // 8) for said in one]
    stream = open_log([write(tmp_path / "log.mcap", [*one, *copies])]).stream("/joints")
    assert rows(stream.columns("position")["position"]) == [[i] for i in range(30)]
    assert stream.dropped == {"repeat": 30}
    assert stream.t_ns.tolist() == [said.log_time for said in one]


def test_a_message_recorded_twice_is_one_reading_and_one_at_two_times_is_two(tmp_path: Path) -> None:
    said = drive(20)
    log = open_log([write(tmp_path / "log.mcap", [*said, *said[:7]])])
    assert len(log.stream("/joint_states").t_ns) == 20
    assert log.stream("/joint_states").dropped == {"repeat": sum(m.topic == "/joint_states" for m in said[:7])}
    data = cdr("std_msgs/msg/Float64", data=1.0)
    said = [Said("/n", "std_msgs/msg/Float64", data, T0 + i) for i in range(3)]
    assert len(open_log([write(tmp_path / "log.mcap", said)]).stream("/n").t_ns) == 3


def test_garbage_messages_are_dropped_and_counted_and_the_others_keep_their_rows(tmp_path: Path) -> None:
    said = drive(40)
    bad = [m._replace(data=m.data[:-3]) if i % 10 == 4 else m for i, m in enumerate(said)]
    log = open_log([write(tmp_path / "log.mcap", bad, chunk_size=2000)])
    for topic, stream in log.streams(LIGHT).items():
        kept = [m for m, b in zip(said, bad, strict=True) if m.topic == topic and m is b]
        n_bad = sum(m.topic == topic for m in said) - len(kept)
        assert len(stream.t_ns) == len(kept)
        assert sum(stream.dropped.values()) == n_bad
        assert sum(len(numbers) for numbers, _ in stream.blocks()) == len(kept)


def test_fields_asked_for_later_fit_the_rows_asked_for_first(tmp_path: Path) -> None:
    log = open_log([write(tmp_path / "log.mcap", shuffled(drive()), chunk_size=3000)])
    stream = log.stream("/joint_states")
    t_ns = stream.t_ns
    np.testing.assert_array_equal(stream.columns("header.stamp")["header.stamp"], t_ns)
    position = stream.columns("position")["position"]
    assert [position[i][0] for i in range(5)] == pytest.approx([0.0, 0.1, 0.2, 0.3, 0.4])


def test_light_columns_of_all_topics_are_read_in_one_walk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    log = open_log([write(tmp_path / "log.mcap", drive(), chunk_size=3000)])
    from locfuse.formats.container.mcap_source import McapSource

    walks: list[Any] = []
    batches = McapSource.batches

    def counted(self: McapSource, wanted: Any) -> Any:
        walks.append(wanted)
        return batches(self, wanted)

    monkeypatch.setattr(McapSource, "batches", counted)
    streams = log.streams(LIGHT)
    for topic, stream in streams.items():
        assert len(stream.t_ns)
        assert stream.columns(*LIGHT[topic])
    assert len(walks) == 1


def test_topics_say_type_count_and_encoding_beside_attachments_and_hash(tmp_path: Path) -> None:
    log = open_log([write(tmp_path / "log.mcap", drive(20))])
    assert {name: (topic.msgtype, topic.count) for name, topic in log.topics.items()} == {
        "/heading": ("std_msgs/msg/Float64", 10),
        "/joint_states": (JOINTS, 20),
        "/scan": ("sensor_msgs/msg/LaserScan", 5),
    }
    assert log.time_span_ns == (T0 + 5_000_000, T0 + 19 * S // 20 + 5_000_000)
    path = write(tmp_path / "log.mcap", drive(5), attachments={"robot.toml": b"[wheels]\nradius = 0.1\n"})
    log = open_log([path])
    assert log.attachments == {"robot.toml": b"[wheels]\nradius = 0.1\n"}
    assert log.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()
    assert log.name == "log"


def test_an_empty_log_has_topics_without_rows(tmp_path: Path) -> None:
    path = tmp_path / "empty.mcap"
    with path.open("wb") as file:
        writer: Any = Writer(file)
        writer.start()
        schema = writer.register_schema(JOINTS, "ros2msg", definition(JOINTS))
        writer.register_channel("/joint_states", "cdr", schema)
        writer.finish()
    log = open_log([path])
    stream = log.stream("/joint_states")
    assert len(stream.t_ns) == 0
    assert len(stream.columns("position")["position"]) == 0
    assert list(stream.blocks("position")) == []
    assert log.time_span_ns is None


@pytest.mark.parametrize(
    ("topic", "fields", "says"),
    [
        ("/scam", (), "has no topic /scam; did you mean /scan"),
        ("/scan", ("rangez",), r"/scan \(sensor_msgs/msg/LaserScan\).*did you mean 'ranges'"),
        ("/imu", (), "it has /heading, /joint_states, /scan"),
    ],
)
def test_a_wrong_topic_field_or_order_is_a_line(
    tmp_path: Path, topic: str, fields: tuple[str, ...], says: str
) -> None:
    log = open_log([write(tmp_path / "log.mcap", drive(5))])
    with pytest.raises(LocfuseError, match=says):
        log.streams({topic: fields})
    with pytest.raises(LocfuseError, match=says):
        list(log.stream(topic).blocks(*fields))
    with pytest.raises(UsageError, match="auto, stamp, recorded"):
        log.stream("/scan", "sideways")


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"", r"empty \(0 bytes\)"),
        (b"SQLite format 3\x00" + b"\x00" * 100, "not a readable rosbag2 database"),
        (b"#ROSBAG V1.2\n", "ROS 1 bag of an old version"),
        (b"\xff\xd8\xff\xe0" + b"\x00" * 100, "JPEG"),
        (b"\x00" * 500, "zeros"),
        (b"hello, this is not a log\n", "text"),
        (b"PK\3\4" + b"x" * 100, "not an MCAP file"),
    ],
)
def test_a_file_that_is_no_log_is_named_in_one_line(tmp_path: Path, content: bytes, says: str) -> None:
    path = tmp_path / "x.mcap"
    path.write_bytes(content)
    with pytest.raises(LocfuseError, match=says) as raised:
        open_log([path])
    assert "\n" not in str(raised.value)


def test_paths_that_do_not_exist_and_folders_without_a_log(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="no such file"):
        open_log([tmp_path / "nothing.mcap"])
    with pytest.raises(LocfuseError, match=r"no log in this folder"):
        open_log([tmp_path])
    (tmp_path / "report.json").write_text("{}")
    with pytest.raises(LocfuseError, match="is a locfuse result"):
        open_log([tmp_path])


def test_two_types_on_one_topic_keep_the_busier_one_and_count_the_rest(tmp_path: Path) -> None:
    said = drive(40)
    other = Said("/joint_states", "std_msgs/msg/Float64", cdr("std_msgs/msg/Float64", data=1.0), T0)
    one = write(tmp_path / "one.mcap", said)
    two = write(tmp_path / "two.mcap", [other] * 3)
    stream = open_log([one, two]).stream("/joint_states")
    assert len(stream.t_ns) == 40
    assert stream.dropped == {"of std_msgs/msg/Float64": 3}


@pytest.mark.parametrize("name", [n for n in real_logs() if "truncated" not in n and "json" not in n] or ["none"])
def test_real_logs_have_the_topics_counts_and_times_the_public_reader_finds(name: str) -> None:
    path = real_log(name)
    log = open_log([path])
    for topic, messages in recorded(path).items():
        described = log.topics[topic]
        if described.problem or "_service_event" in topic:
            continue
        stream = log.stream(topic)
        assert len(stream.t_ns) == len(messages)
        assert described.count == len(messages) + stream.dropped.get("repeat", 0)
        assert (np.diff(stream.t_ns) >= 0).all()
    assert not log.losses


def test_what_a_log_forgot_is_read_again(tmp_path: Path) -> None:
    log = open_log([write(tmp_path / "shuffled.mcap", shuffled(drive()))])
    before = contents(log)
    log.forget()
    assert contents(log) == before


# --- what a log is known by, and how little of it is read for that


PICTURE = 900_000  # bytes


@pytest.fixture(scope="module")
def raw(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Uncompressed pictures in chunks of 1 MB with small messages between them: the shape of a raw-image bag."""
    path = tmp_path_factory.mktemp("raw") / "raw.mcap"
    with path.open("wb") as file:
        writer: Any = Writer(file, chunk_size=1 << 20, compression=CompressionType.NONE)
        writer.start()
        schema = writer.register_schema("a/msg/B", "ros2msg", b"uint8[] data")
        pictures, ticks = (writer.register_channel(topic, "cdr", schema) for topic in ("/raw", "/ticks"))
        for i in range(40):
            writer.add_message(pictures, 100 * i, os.urandom(PICTURE), 100 * i)
            for j in range(20):
                writer.add_message(ticks, 100 * i + j, b"\0" * 40, 100 * i + j)
        writer.finish()
    return path


def test_opening_a_log_of_raw_pictures_reads_a_hundredth_of_it(raw: Path) -> None:
    losses = Losses()
    data = FileBytes(raw, losses)
    source = McapSource(data)
    assert {c.topic: c.n for c in source.channels.values()} == {"/raw": 40, "/ticks": 800}
    assert not losses
    assert data.read_bytes <= 0.01 * data.size
    assert not data.all_read


def test_bytes_that_are_read_twice_count_once(raw: Path) -> None:
    data = FileBytes(raw, Losses())
    for at in (0, 1000, 0, 500_000):
        data.read(at, 300_000)
    assert data.read_bytes == 301_000 + 300_000
    data.feed(lambda piece: None)
    for at in range(0, data.size, 1_000_000):
        data.read(at, 1_000_000)
    assert data.all_read


def test_a_copy_has_the_identity_of_the_log_and_another_log_has_another(raw: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy.mcap"
    shutil.copy(raw, copy)
    known = identity_of(files_of([raw]))
    assert identity_of(files_of([copy])) == known
    assert known.size == raw.stat().st_size
    with copy.open("ab") as file:
        file.write(b"x")  # no end mark any more: known by its ends
    assert identity_of(files_of([copy])).digest != known.digest
    other = sample_logs.path("rounded_rectangle")
    assert identity_of(files_of([other])).digest != known.digest


def test_every_byte_is_hashed_where_all_were_read_or_the_user_asks() -> None:
    log = sample_logs.path("rounded_rectangle")
    words = ("compare", "rounded_rectangle", "--sensors", "odometry", "--no-advice", "--hash")
    source = reported(*words).report["input"]
    assert source["sha256"] == hashlib.sha256(log.read_bytes()).hexdigest()
    assert source["identity"] == identity_of(files_of([log])).digest
    assert source["size"] == log.stat().st_size
