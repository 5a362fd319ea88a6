"""The logs we write, read by others: rosbags, mcap-ros2-support, `rerun mcap check`, and mcap's own CRCs."""

import io
import math
import subprocess
import sys
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bags import T0, cdr, header
from mcap.exceptions import McapError
from mcap.reader import NonSeekingReader, make_reader
from mcap_ros2.decoder import DecoderFactory
from numpy.typing import NDArray
from present import present
from zstandard import ZstdError

from locfuse.formats.container.mcap_write import add_messages, log_writer, open_writer
from locfuse.formats.results.mcap_export import PoseSeries, stamp_columns
from locfuse.fusion.data import LocfuseError

EPOCH = 1_700_000_000_000_000_000
STAMP = EPOCH + 123_456_789
# message type -> fields by dotted path, one of every type that the simulator and the exports write
MESSAGES: dict[str, dict[str, Any]] = {
    "sensor_msgs/msg/JointState": {"name": ("left", "right"), "position": np.array([1.5, -2.5]), "effort": []},
    "sensor_msgs/msg/MagneticField": {"magnetic_field.x": 1.25e-5, "magnetic_field_covariance": np.arange(9.0)},
    "sensor_msgs/msg/LaserScan": {"angle_min": -1.5, "range_max": 80.0, "ranges": np.array([1.0, math.inf, 3.0])},
    "sensor_msgs/msg/CompressedImage": {"format": "jpeg", "data": b"\xff\xd8\x00\xd9"},
    "geometry_msgs/msg/PoseStamped": {"pose.position.x": 1.0, "pose.orientation.w": 0.5},
    "sensor_msgs/msg/Range": {"radiation_type": 0, "range": math.inf, "max_range": 4.0},
    "sensor_msgs/msg/NavSatFix": {"latitude": 21.038, "position_covariance": np.eye(3).ravel()},
    "std_msgs/msg/String": {"data": '{"event": "begin", "what": "Ütä"}'},
    "std_msgs/msg/Bool": {"data": True},
    "std_msgs/msg/Int32": {"data": -7},
    "tf2_msgs/msg/TFMessage": {
        "transforms": [{"header": {"frame_id": "base_link"}, "transform": {"rotation": {"w": 1.0}}}]
    },
}


def topic(msgtype: str) -> str:
    return "/" + msgtype.rsplit("/", 1)[1].lower()


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("log") / "all_types.mcap"
    with log_writer(path) as writer:
        writer.attach("robot.toml", b"[wheels]\nradius = 0.05\n")
        for i in range(3):
            for msgtype, fields in MESSAGES.items():
                latched = msgtype.endswith("TFMessage")
                ns = EPOCH + i
                writer.write(topic(msgtype), msgtype, fields, ns, stamp_ns=STAMP, frame_id="f", latched=latched)
    return path


def same(read: Any, written: Any) -> bool:
    if isinstance(written, list) and written and isinstance(written[0], dict):
        return len(read) == 1 and read[0].header.frame_id == "base_link" and read[0].transform.rotation.w == 1.0
    if isinstance(written, bytes):
        return bytes(read) == written
    if isinstance(written, str | bool):
        return bool(read == written)
    if isinstance(written, tuple):
        return tuple(read) == written
    return bool(np.array_equal(np.asarray(read, float), np.asarray(written, float)))


def check(msgtype: str, message: Any) -> None:
    for path, value in MESSAGES[msgtype].items():
        assert same(attrgetter(path)(message), value), f"{msgtype}.{path}"
    if hasattr(message, "header"):
        assert message.header.frame_id == "f"
        assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == STAMP


def decoded(log: Path, *topics: str) -> list[tuple[str, Any, int]]:
    """Return (type, message, log time) as mcap-ros2-support reads them by the schemas in the file."""
    with log.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        messages = reader.iter_decoded_messages(topics or None)
        return [(schema.name, message, raw.log_time) for schema, _, raw, message in messages if schema]


def test_mcap_ros2_support_and_rerun_read_back_every_type_by_the_schemas_in_the_file(log: Path) -> None:
    seen = decoded(log)
    assert len(seen) == 3 * len(MESSAGES)
    assert {ns for _, _, ns in seen} == {EPOCH, EPOCH + 1, EPOCH + 2}
    for msgtype, message, _ in seen:
        check(msgtype, message)
    rerun = Path(sys.executable).parent / "rerun"
    done = subprocess.run([rerun, "mcap", "check", log], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    rows = [line for line in done.stdout.splitlines() if "/" in line and line.startswith("ok")]
    assert len(rows) == len(MESSAGES)


def test_the_file_is_what_rosbag2_writes(log: Path) -> None:
    with log.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        assert reader.get_header().profile == "ros2"
        summary = present(reader.get_summary())
        assert {s.encoding for s in summary.schemas.values()} == {"ros2msg"}
        assert {c.message_encoding for c in summary.channels.values()} == {"cdr"}
        assert {c.compression for c in summary.chunk_indexes} == {"zstd"}
        attachments = [(a.name, a.data, a.log_time, a.media_type) for a in reader.iter_attachments()]
        sequences = [m.sequence for _, c, m in reader.iter_messages() if c.topic == "/string"]
    latched = [c.topic for c in summary.channels.values() if "durability: 1" in c.metadata["offered_qos_profiles"]]
    assert attachments == [("robot.toml", b"[wheels]\nradius = 0.05\n", 0, "application/toml")]
    assert latched == ["/tfmessage"]
    assert sequences == [1, 2, 3]


def test_a_flipped_bit_anywhere_in_the_data_is_found_by_its_crc(log: Path, tmp_path: Path) -> None:
    raw = bytearray(log.read_bytes())
    with log.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    chunk = summary.chunk_indexes[0]
    ends = chunk.chunk_start_offset + 60, chunk.chunk_start_offset + chunk.chunk_length - 60
    damaged = tmp_path / "damaged.mcap"
    for offset in range(*ends, 97):
        raw[offset] ^= 0x10
        damaged.write_bytes(raw)
        raw[offset] ^= 0x10
        with damaged.open("rb") as file, pytest.raises((McapError, ValueError, ZstdError)):
            list(NonSeekingReader(file, validate_crcs=True).iter_messages())


def test_what_is_left_out_is_zero_or_empty(log: Path) -> None:
    scan = decoded(log, "/laserscan")[0][1]
    assert scan.scan_time == 0.0
    assert len(scan.intensities) == 0


def test_a_folder_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(LocfuseError, match=r"cannot write .*nowhere/log\.mcap: No such file"):
        log_writer(tmp_path / "nowhere" / "log.mcap").__enter__()


def test_what_is_not_a_standard_message_is_refused(tmp_path: Path) -> None:
    with log_writer(tmp_path / "log.mcap") as writer:
        with pytest.raises(LocfuseError, match="my_msgs/msg/Thing is not a standard ROS 2 message type"):
            writer.write("/t", "my_msgs/msg/Thing", {}, EPOCH)
        with pytest.raises(ValueError, match="has no field dat"):
            writer.write("/s", "std_msgs/msg/String", {"dat": "x"}, EPOCH)
        with pytest.raises(ValueError, match=r"/s holds std_msgs/msg/String, not std_msgs/msg/Bool"):
            writer.write("/s", "std_msgs/msg/Bool", {"data": True}, EPOCH)


# --- logs written from columns, read back by the public mcap reader and by rosbags


def test_blocks_of_equal_and_of_any_lengths_are_read_back() -> None:
    payloads, times = np.arange(6, dtype=np.uint8).reshape(2, 3), np.array([T0 + 30, T0 + 10])
    file = io.BytesIO()
    writer = open_writer(file)
    a, b = (writer.register_channel(topic, "cdr", 0, {}) for topic in ("/a", "/b"))
    add_messages(writer, a, times, np.array([7, 8]), payloads)
    add_messages(writer, b, times, np.array([1, 2]), [memoryview(b""), memoryview(b"three")], times + 5)
    add_messages(writer, b, times[:0], times[:0], [])
    writer.finish()
    found = make_reader(io.BytesIO(file.getvalue()), validate_crcs=True).iter_messages(log_time_order=False)
    assert [(c.topic, m.log_time, m.publish_time, m.sequence, m.data) for _, c, m in found] == [
        ("/a", T0 + 30, T0 + 30, 7, b"\x00\x01\x02"),
        ("/a", T0 + 10, T0 + 10, 8, b"\x03\x04\x05"),
        ("/b", T0 + 30, T0 + 35, 1, b""),
        ("/b", T0 + 10, T0 + 15, 2, b"three"),
    ]


# --- many messages of one type


def test_columns_are_laid_over_the_bytes_of_one_message() -> None:
    """Numbers of every size and place, an array of numbers, and all that is constant; against rosbags."""
    constant = {"header.frame_id": "laser", "ranges": np.zeros(3, np.float32), "angle_min": -1.5}
    n = 5
    t = T0 + 1_999_999_999 * np.arange(n)
    columns = {
        **stamp_columns("header.stamp", t),
        "ranges": np.arange(3.0 * n).reshape(n, 3),
        "scan_time": np.linspace(0.0, 1.0, n),
    }

    def messages(msgtype: str, constant: dict[str, Any], columns: dict[str, Any]) -> NDArray[np.uint8]:
        def rows_of(rows: slice) -> dict[str, Any]:
            return {path: values[rows] for path, values in columns.items()}

        stamped = t[: len(next(iter(columns.values())))]
        return PoseSeries(msgtype, stamped, constant, rows_of).messages(slice(None))

    found = messages("sensor_msgs/msg/LaserScan", constant, columns)
    for i in range(n):
        expected = cdr(
            "sensor_msgs/msg/LaserScan",
            header=header(int(t[i]), "laser"),
            angle_min=-1.5,
            ranges=columns["ranges"][i].astype(np.float32),
            scan_time=columns["scan_time"][i],
        )
        assert found[i].tobytes() == expected
    whole = messages("std_msgs/msg/Int16", {}, {"data": np.array([3, -4])})
    assert [row.tobytes() for row in whole] == [cdr("std_msgs/msg/Int16", data=v) for v in (3, -4)]
