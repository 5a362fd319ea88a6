"""Decompression gives what was packed, its true beginning, or one reason; held to the libraries that packed it."""

from __future__ import annotations

import bz2
import random
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import lz4.frame
import numpy as np
import pytest
import zstandard
from bags import T0 as NS, database

from locfuse.formats.container import decompress as unpacking, source
from locfuse.formats.container.decompress import DamagedError, decompress, decompress_prefix, unpack_file
from locfuse.formats.container.file_bytes import FileBytes, Losses
from locfuse.formats.container.source import Messages, unpack
from locfuse.formats.inputs import MAX_CHUNK
from locfuse.formats.logs.log import open_log
from locfuse.fusion.data import LocfuseError, Ragged

NOISE = random.Random(1).randbytes(300_000)  # several blocks of every codec
PACK: dict[str, Callable[[bytes], bytes]] = {
    "zstd": zstandard.compress,
    "lz4": lambda data: lz4.frame.compress(data, content_checksum=True),
    "bz2": bz2.compress,
    "": lambda data: data,
}
NO_SIZE = zstandard.ZstdCompressor(write_content_size=False)


@pytest.mark.parametrize("codec", PACK)
@pytest.mark.parametrize("plain", [b"", b"a", bytes(100_000), NOISE], ids=["nothing", "a byte", "zeros", "noise"])
def test_what_was_packed_comes_out(codec: str, plain: bytes) -> None:
    assert decompress(PACK[codec](plain), codec, len(plain)) == plain
    assert decompress_prefix(PACK[codec](plain), codec, len(plain)) == plain


def test_two_frames_and_a_frame_that_does_not_say_its_size_are_read() -> None:
    assert decompress(zstandard.compress(b"a") + zstandard.compress(b"b"), "zstd", 2) == b"ab"
    assert decompress(NO_SIZE.compress(NOISE), "zstd", len(NOISE)) == NOISE


REFUSED = [
    *((PACK[codec](b"abc"), codec, 3 + off, "size is not the declared one") for codec in PACK for off in (-1, 1)),
    *((b"no frame at all", codec, 9, f"does not decompress \\({codec}\\)") for codec in ("zstd", "lz4", "bz2")),
    (zstandard.compress(b"a"), "zstd", MAX_CHUNK + 1, "more than 256 MiB"),
    (b"a", "brotli\x1b[2J" + "x" * 90, 1, r"unknown compression 'brotli\\x1b"),
]


@pytest.mark.parametrize(("data", "codec", "size", "says"), REFUSED)
def test_what_is_not_as_it_was_packed_is_refused_with_its_reason(
    data: bytes, codec: str, size: int, says: str
) -> None:
    with pytest.raises(DamagedError, match=says):
        decompress(data, codec, size)
    if "unknown" in says:
        with pytest.raises(DamagedError, match=says):
            decompress_prefix(data, codec, size)


@pytest.mark.parametrize("codec", ["zstd", "lz4"])
def test_of_a_cut_off_stream_the_true_beginning_is_kept(codec: str) -> None:
    packed = PACK[codec](NOISE)
    for share in (0.0, 0.01, 0.5, 0.9, 1.0):
        found = decompress_prefix(packed[: int(share * len(packed))], codec, len(NOISE))
        assert NOISE.startswith(found)
        assert len(found) >= int(share * len(packed)) - (1 << 18)  # but for the last block
    assert decompress_prefix(packed[:-9] + b"\xff" * 9, codec, len(NOISE))[:1000] == NOISE[:1000]
    assert decompress_prefix(b"no frame at all", codec, 100) == b""
    assert decompress_prefix(packed, codec, 70_000) == NOISE[:70_000]


def messages(*contents: bytes) -> tuple[np.ndarray, Messages]:
    length = np.array([len(one) for one in contents], np.int64)
    times = np.arange(len(contents), dtype=np.int64)
    found = Messages(np.cumsum(length) - length, length, times, times, times)
    return np.frombuffer(b"".join(contents), np.uint8), found


def unpacked(*contents: bytes) -> list[list[tuple[int, bytes]]]:
    return [
        [
            (int(t), data[a : a + n].tobytes())
            for t, a, n in zip(found.log_time, found.start, found.length, strict=True)
        ]
        for data, found in unpack(*messages(*contents))
    ]


def test_messages_that_were_packed_one_by_one_come_out_in_portions(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(source, "MAX_PORTION_BYTES", 250)
    plain = [bytes([i]) * 100 for i in range(7)]
    found = unpacked(*map(zstandard.compress, plain))
    assert [entry for portion in found for entry in portion] == list(enumerate(plain))
    assert [len(portion) for portion in found] == [3, 3, 1]


def test_a_message_that_does_not_unpack_or_is_too_long_comes_out_empty(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(source, "MAX_MESSAGE", 1000)
    packed = zstandard.compress(NOISE[:900])
    bad = (packed[:9] + b"\xff" * 90, zstandard.compress(bytes(1001)), packed[:-1], packed[:500])
    found = unpacked(b"plain", packed, *bad)
    assert found == [[(0, b"plain"), (1, NOISE[:900]), *((i, b"") for i in (2, 3, 4, 5))]]


def plain(file: Path, losses: Losses) -> bytes:
    unpack_file(unpacked_file := FileBytes(file, losses))  # its bytes go with it
    return unpacked_file.where.read_bytes()


SKIPPED = b"\x50\x2a\x4d\x18\x05\0\0\0abcde"  # a frame that says nothing
WHOLE = {
    "says its size": zstandard.compress(NOISE),
    "does not say its size": NO_SIZE.compress(NOISE),
    "has a checksum": zstandard.ZstdCompressor(write_checksum=True, write_content_size=False).compress(NOISE),
    "repeats": NO_SIZE.compress(bytes(300_000)),
    "two frames": NO_SIZE.compress(NOISE) + SKIPPED + zstandard.compress(NOISE[:70_000]),
}


@pytest.mark.parametrize("kind", WHOLE)
def test_wherever_a_file_is_cut_off_that_is_noticed(tmp_path: Path, kind: str) -> None:
    file, packed = tmp_path / "a.mcap.zstd", WHOLE[kind]
    file.write_bytes(packed)
    losses = Losses()
    whole = plain(file, losses)
    assert whole == zstandard.ZstdDecompressor().stream_reader(packed, read_across_frames=True).read()
    assert not losses
    for missing in (1, 2, 3, 5, 1000, len(packed) // 2):
        if len(packed) - missing < 20 or (kind == "two frames" and missing > 80_000):
            continue
        file.write_bytes(packed[:-missing])
        beginning = plain(file, losses := Losses())
        assert losses.bytes == (len(whole) - len(beginning) if kind == "says its size" else 0)
        assert losses, missing
        assert whole.startswith(beginning)


def test_a_file_that_is_damaged_from_the_beginning_says_so(tmp_path: Path) -> None:
    file = tmp_path / "a.mcap.zstd"
    file.write_bytes(b"\x28\xb5\x2f\xfd" + b"\xff" * 40)
    with pytest.raises(LocfuseError, match="damaged from the beginning"):
        unpack_file(FileBytes(file, Losses()))


def test_a_full_scratch_disk_is_one_line_and_leaves_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    file = tmp_path / "a.mcap.zstd"
    file.write_bytes(zstandard.compress(NOISE))

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(unpacking, "_unpack", full)
    with pytest.raises(LocfuseError, match=r"cannot be unpacked to .*: No space left on device"):
        unpack_file(FileBytes(file, Losses()))
    assert [path.name for path in tmp_path.iterdir()] == ["a.mcap.zstd"]


# --- types that are known without a definition


class Cdr:
    """Numbers laid out by hand: each at a multiple of its own size (OMG CDR, version 1)."""

    def __init__(self) -> None:
        self.body = b""

    def add(self, kinds: str, *values: float) -> Cdr:
        for kind, value in zip(kinds, values, strict=True):
            size = struct.calcsize(kind)
            self.body += bytes(-len(self.body) % size) + struct.pack(f"<{kind}", value)
        return self

    def text(self, words: str) -> Cdr:
        self.add("I", len(words) + 1)
        self.body += words.encode() + b"\0"
        return self

    def header(self) -> Cdr:
        return self.add("iI", NS // 10**9, 0).text("base")

    def pose(self, covariance: bool = False) -> Cdr:
        rest = (0,) * 36 if covariance else ()
        return self.add("d" * (7 + len(rest)), 0.1, 0.2, 1.5, 0, 0, 0, 1, *rest)


def hypothesis(made: Cdr) -> Cdr:
    return made.add("I", 1).text("tag_7").add("d", 0.9).pose(covariance=True)


def _to_heading() -> Cdr:
    made = Cdr().add("QQBBBB", 5, 5, 1, 1, 1, 1).add("fff", 1.5, -2.5, 0).add("ffBfB", 0, 0, 1, 0, 1)
    return made.add("ffff", 0.25, 0.5, 0, 0).add("ffBfB", 0, 0, 1, 0, 1).add("ffff", 0, 0, 9, 0.75)


def _reference(made: Cdr, tilt: str) -> Cdr:
    return made.add(tilt, *[0.5] * len(tilt)).add("BBQddf", 1, 1, 5, 47.0, 8.0, 400.0)


LAID_OUT: dict[str, tuple[str, Cdr, dict[str, float]]] = {
    "velocity report": (
        "autoware_vehicle_msgs/msg/VelocityReport",
        Cdr().header().add("fff", 1.5, 0.25, -0.5),
        {"longitudinal_velocity": 1.5, "heading_rate": -0.5},
    ),
    "ackermann drive": (
        "ackermann_msgs/msg/AckermannDrive",
        Cdr().add("fffff", 0.25, 0, 2, 0, 0),
        {"speed": 2.0, "steering_angle": 0.25},
    ),
    "apriltags": (
        "apriltag_msgs/msg/AprilTagDetectionArray",
        Cdr()
        .header()
        .add("I", 1)
        .text("tag36h11")
        .add("iiff", 7, 0, 0, 50)
        .add("d" * 19, 320.5, 240.5, *(0,) * 17),
        {"detections.id": 7, "detections.centre.x": 320.5},
    ),
    "aruco markers": (
        "ros2_aruco_interfaces/msg/ArucoMarkers",
        Cdr().header().add("IqI", 1, 23, 1).pose(),
        {"marker_ids": 23, "poses.position.z": 1.5},
    ),
    "GPSFix": (
        "gps_msgs/msg/GPSFix",
        Cdr()
        .header()
        .header()
        .add("HIHIIII", *(0,) * 7)
        .add("hHHH", 2, 1, 0, 1)
        .add("d" * 34, 52.5, 13.25, *range(23), 0.25, 0, 0, 0, 0.5, 0, 0, 0, 1)
        .add("B", 2),
        {"status.status": 2, "latitude": 52.5, "longitude": 13.25, "position_covariance_type": 2},
    ),
    "isaac": (
        "isaac_ros_apriltag_interfaces/msg/AprilTagDetectionArray",
        Cdr().header().add("I", 1).text("tag36h11").add("i" + "d" * 15, 7, *range(15)).header().pose(True),
        {"detections.id": 7, "detections.pose.pose.pose.position.z": 1.5},
    ),
    "aruco_opencv": (
        "aruco_opencv_msgs/msg/ArucoDetection",
        Cdr().header().add("IH", 1, 7).pose().add("I", 0),
        {"markers.marker_id": 7, "markers.pose.position.z": 1.5},
    ),
    "aruco": (
        "aruco_msgs/msg/MarkerArray",
        Cdr().header().add("I", 1).header().add("I", 7).pose(True).add("d", 1.0),
        {"markers.id": 7, "markers.pose.pose.position.z": 1.5},
    ),
    "aruco with corners": (
        "aruco_msgs/msg/MarkerArray",
        Cdr().header().add("I", 1).header().add("II", 7, 1).add("d" * 6, *range(6)).pose(True).add("d", 1.0),
        {"markers.id": 7, "markers.pose.pose.position.z": 1.5},
    ),
    "detections in the picture": (
        "vision_msgs/msg/Detection2DArray",
        hypothesis(Cdr().header().add("I", 1).header()).add("ddddd", 320.5, 240.0, 0.0, 8.0, 8.0).text("7"),
        {"detections.bbox.center.position.x|detections.bbox.center.x": 320.5},
    ),
    "detections in space": (
        "vision_msgs/msg/Detection3DArray",
        hypothesis(Cdr().header().add("I", 1).header()).pose().add("ddd", 0.1, 0.1, 0.1).text(""),
        {"detections.bbox.center.position.z": 1.5},
    ),
    "bodies": (
        "mocap4r2_msgs/msg/RigidBodies",
        Cdr()
        .header()
        .add("II", 9, 1)
        .text("robot")
        .add("I", 1)
        .add("bi", 0, 3)
        .text("m")
        .add("ddd", 1, 2, 3)
        .pose(),
        {"rigidbodies.pose.position.y": 0.2},
    ),
    "model states": (
        "gazebo_msgs/msg/ModelStates",
        Cdr().add("I", 1).text("robot").add("I", 1).pose().add("I", 1).add("d" * 6, *range(6)),
        {"pose.position.y": 0.2},
    ),
    "vehicle odometry": (
        "px4_msgs/msg/VehicleOdometry",
        Cdr()
        .add("QQB", 5, 5, 1)
        .add("f" * 7, 1.5, -2.5, 0, 1, 0, 0, 0)
        .add("B", 3)
        .add("f" * 15, *range(15))
        .add("Bb", 0, 100),
        {"position": 1.5, "q": 1.0, "velocity_frame": 3, "angular_velocity": 3.0},
    ),
    **{
        f"local position of PX4 {release}": (
            "px4_msgs/msg/VehicleLocalPosition",
            _reference(_to_heading().add("f" * len(headings) + "BB", *headings, 1, 1), tilt).add(
                bottom, *[1] * len(bottom)
            ),
            {"x": 1.5, "y": -2.5, "vx": 0.25, "vy": 0.5, "heading": 0.75},
        )
        for release, headings, tilt, bottom in (
            ("1.14", (0.1, 0.2), "", "fBBffffBffff"),
            ("1.15", (0.1, 0.2, 0.3), "f", "BfffBBffffBffff"),
            ("1.16", (0.1, 0.2, 0.3), "f", "BfffBBffffBfffff"),
        )
    },
    "sensors of a vehicle": (
        "px4_msgs/msg/SensorCombined",
        Cdr().add("Q", 5).add("fffI", 0.5, 0, 0, 4000).add("ifffI", 0, 9.5, 0, 0, 4000).add("BBBB", 0, 0, 1, 1),
        {"gyro_rad": 0.5, "accelerometer_m_s2": 9.5},
    ),
    "a legged robot": (
        "unitree_go/msg/SportModeState",
        Cdr()
        .add("iII", 5, 0, 0)
        .add("f" * 13, 1, *(0,) * 12)
        .add("bBfBf", 30, 1, 0, 0, 0.1)
        .add("f" * 12, 1.5, *(0,) * 11)
        .add("h" * 4, 1, 2, 3, 4)
        .add("f" * 24, *(0,) * 24),
        {"position": 1.5, "imu_state.quaternion": 1.0},
    ),
}


@pytest.mark.parametrize("which", LAID_OUT)
def test_messages_of_robots_are_read_without_a_definition(which: str, tmp_path: Path) -> None:
    """Two messages each; of arrays the first value."""
    msgtype, made, expected = LAID_OUT[which]
    stream = open_log([database(tmp_path / "x.db3", "/a", msgtype, [b"\0\1\0\0" + made.body] * 2)]).stream("/a")
    columns: Any = stream.columns(*expected)
    for name, value in expected.items():
        column = columns[name]
        numbers = column.values if isinstance(column, Ragged) else np.asarray(column)
        assert numbers.reshape(2, -1)[:, 0] == pytest.approx([value] * 2), name
    assert dict(stream.dropped) == {}


def test_a_message_of_another_release_is_not_read_as_what_it_is_not(tmp_path: Path) -> None:
    """VehicleOdometry of PX4 1.13 has covariances where that of 1.14 has variances."""
    made = Cdr().add("QQB", 5, 5, 1).add("f" * 32, *range(32)).add("B", 1).add("f" * 27, *range(27))
    path = database(tmp_path / "x.db3", "/a", "px4_msgs/msg/VehicleOdometry", [b"\0\1\0\0" + made.body])
    assert "not described" in str(open_log([path]).topics["/a"].problem)
