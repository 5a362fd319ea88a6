"""Types of robots in .db3 files that carry no definitions (ROS 2 before Iron): bytes laid out by hand decide."""

from __future__ import annotations

import sqlite3
import struct
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from locfuse.formats.log.log import open_log
from locfuse.fusion.data import Ragged

NS = 1_700_000_000_000_000_000
HEADER = struct.pack("<iiI5sxxx", NS // 10**9, 0, 5, b"base\0")  # 20 bytes after the encapsulation


def database(path: Path, msgtype: str, body: bytes) -> Path:
    """Two messages as rosbag2 stores them."""
    with closing(sqlite3.connect(path)) as made:
        made.execute(
            "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT)"
        )
        made.execute(
            "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB)"
        )
        made.execute("INSERT INTO topics VALUES(1, '/a', ?, 'cdr')", (msgtype,))
        for i in range(2):
            data = b"\0\1\0\0" + body
            made.execute("INSERT INTO messages(topic_id, timestamp, data) VALUES(1, ?, ?)", (NS + i, data))
        made.commit()
    return path


TAG = (
    HEADER + struct.pack("<I", 1) + struct.pack("<I9sxxxii2f", 9, b"tag36h11\0", 7, 0, 0.0, 50.0)
    + struct.pack("<2d", 320.5, 240.5) + bytes(8 * 8) + bytes(9 * 8)
)  # fmt: skip
ARUCO = (
    HEADER + struct.pack("<Iq", 1, 23) + struct.pack("<I", 1) + bytes(4)
    + struct.pack("<7d", 0.1, 0.2, 1.5, 0, 0, 0, 1)
)  # fmt: skip
FIX = (
    HEADER + HEADER[:17] + struct.pack("<xHIHxx4I", 0, 0, 0, 0, 0, 0, 0) + struct.pack("<h3H", 2, 1, 0, 1)
    + struct.pack("<25d", 52.5, 13.25, *range(23)) + struct.pack("<9d", 0.25, 0, 0, 0, 0.5, 0, 0, 0, 1)
    + struct.pack("<B", 2)
)  # fmt: skip


@pytest.mark.parametrize(
    ("msgtype", "body", "expected"),
    [
        (
            "autoware_vehicle_msgs/msg/VelocityReport",
            HEADER + struct.pack("<3f", 1.5, 0.25, -0.5),
            {"longitudinal_velocity": 1.5, "heading_rate": -0.5},
        ),
        (
            "ackermann_msgs/msg/AckermannDrive",
            struct.pack("<5f", 0.25, 0.0, 2.0, 0.0, 0.0),
            {"speed": 2.0, "steering_angle": 0.25},
        ),
        ("apriltag_msgs/msg/AprilTagDetectionArray", TAG, {"detections.id": 7, "detections.centre.x": 320.5}),
        ("ros2_aruco_interfaces/msg/ArucoMarkers", ARUCO, {"marker_ids": 23, "poses.position.z": 1.5}),
        (
            "gps_msgs/msg/GPSFix",
            FIX,
            {"status.status": 2, "latitude": 52.5, "longitude": 13.25, "position_covariance_type": 2},
        ),
    ],
    ids=["velocity report", "ackermann drive", "apriltags", "aruco markers", "GPSFix"],
)
def test_its_fields_are_read_without_a_definition_in_the_file(
    msgtype: str, body: bytes, expected: dict[str, float], tmp_path: Path
) -> None:
    stream = open_log([database(tmp_path / "x.db3", msgtype, body)]).stream("/a")
    columns: Any = stream.columns(*expected)
    assert dict(stream.dropped) == {}
    for name, value in expected.items():
        column = columns[name]
        found = column.values if isinstance(column, Ragged) else np.asarray(column)
        assert found.tolist() == [value, value], name
