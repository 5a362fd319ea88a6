"""Types of robots in .db3 files that carry no definitions (ROS 2 before Iron): bytes laid out by hand decide."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bags import T0 as NS
from bags import database

from locfuse.formats.logs.log import open_log
from locfuse.fusion.data import Ragged


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
        Cdr().header().add("I", 1).text("tag36h11").add("iiff", 7, 0, 0, 50)
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
        Cdr().header().header().add("HIHIIII", *(0,) * 7).add("hHHH", 2, 1, 0, 1)
        .add("d" * 34, 52.5, 13.25, *range(23), 0.25, 0, 0, 0, 0.5, 0, 0, 0, 1).add("B", 2),
        {"status.status": 2, "latitude": 52.5, "longitude": 13.25, "position_covariance_type": 2},
    ),
    "isaac": (
        "isaac_ros_apriltag_interfaces/msg/AprilTagDetectionArray",
        Cdr().header().add("I", 1).text("tag36h11").add("i" + "d" * 15, 7, *range(15)).header()
        .pose(True),
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
        Cdr().header().add("II", 9, 1).text("robot").add("I", 1).add("bi", 0, 3).text("m").add("ddd", 1, 2, 3)
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
        Cdr().add("QQB", 5, 5, 1).add("f" * 7, 1.5, -2.5, 0, 1, 0, 0, 0).add("B", 3).add("f" * 15, *range(15))
        .add("Bb", 0, 100),
        {"position": 1.5, "q": 1.0, "velocity_frame": 3, "angular_velocity": 3.0},
    ),
    **{
        f"local position of PX4 {release}": (
            "px4_msgs/msg/VehicleLocalPosition",
            _reference(_to_heading().add("f" * len(headings) + "BB", *headings, 1, 1), tilt)
            .add(bottom, *[1] * len(bottom)),
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
        Cdr().add("iII", 5, 0, 0).add("f" * 13, 1, *(0,) * 12).add("bBfBf", 30, 1, 0, 0, 0.1)
        .add("f" * 12, 1.5, *(0,) * 11).add("h" * 4, 1, 2, 3, 4).add("f" * 24, *(0,) * 24),
        {"position": 1.5, "imu_state.quaternion": 1.0},
    ),
}  # fmt: skip


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
