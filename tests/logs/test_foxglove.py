"""Foxglove's message types, as JSON, Protobuf and ROS 2 messages: closed forms decide."""

import base64
import json
import math
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from invented import Definition
from mcap.writer import Writer
from present import present
from wheel_bags import RATE, SPEED, custom, on_circle, stamps, turned

from locfuse.cli.analysis.choose import choose
from locfuse.cli.analysis.mounts import mount_of, transforms_of
from locfuse.cli.analysis.robot_tables import make_robot
from locfuse.formats.logs.log import Log, open_log
from locfuse.fusion.data import Array, Ragged
from locfuse.fusion.robot import WheelSettings
from locfuse.fusion.wheels.read import read_wheels

T = np.arange(0.0, 5.01, 0.1)
END = on_circle(RATE * T[-1])
NUMBER, TEXT, WHOLE = {"type": "number"}, {"type": "string"}, {"type": "integer"}
NUMBERS = {"type": "array", "items": NUMBER}
TIME = {"type": "object", "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}}}


def parts(of: str) -> dict[str, Any]:
    return {"type": "object", "properties": dict.fromkeys(of, NUMBER)}


POSE = {"type": "object", "properties": {"position": parts("xyz"), "orientation": parts("xyzw")}}
TRANSFORM = {
    "timestamp": TIME,
    "parent_frame_id": TEXT,
    "child_frame_id": TEXT,
    "translation": parts("xyz"),
    "rotation": parts("xyzw"),
}
SCHEMAS: dict[str, dict[str, Any]] = {
    "foxglove.LaserScan": {
        "timestamp": TIME,
        "frame_id": TEXT,
        "pose": POSE,
        "start_angle": NUMBER,
        "end_angle": NUMBER,
        "ranges": {"type": "array", "items": NUMBER},
        "intensities": {"type": "array", "items": NUMBER},
    },
    "foxglove.Odometry": {
        "timestamp": TIME,
        "frame_id": TEXT,
        "body_frame_id": TEXT,
        "pose": POSE,
        "linear_velocity": parts("xyz"),
        "angular_velocity": parts("xyz"),
        "pose_covariance": NUMBERS,
        "velocity_covariance": NUMBERS,
    },
    "foxglove.JointStates": {
        "timestamp": TIME,
        "joints": {
            "type": "array",
            "items": {
                "type": "object",
                "properties": {"name": TEXT, "position": NUMBER, "velocity": NUMBER, "effort": NUMBER},
            },
        },
    },
    "foxglove.PointCloud": {
        "timestamp": TIME,
        "frame_id": TEXT,
        "pose": POSE,
        "point_stride": WHOLE,
        "fields": {
            "type": "array",
            "items": {"type": "object", "properties": {"name": TEXT, "offset": WHOLE, "type": WHOLE}},
        },
        "data": {"type": "string", "contentEncoding": "base64"},
    },
    "foxglove.PoseInFrame": {"timestamp": TIME, "frame_id": TEXT, "pose": POSE},
    "foxglove.FrameTransform": TRANSFORM,
    "foxglove.FrameTransforms": {
        "transforms": {"type": "array", "items": {"type": "object", "properties": TRANSFORM}}
    },
}
Event = tuple[int, str, str, dict[str, Any]]


Written = Callable[[Path, list[Event]], Log]


@pytest.fixture(params=["json", "protobuf"])
def written(request: pytest.FixtureRequest) -> Written:
    """Messages of Foxglove's types in one encoding."""
    return partial(write, request.param)


def write(encoding: str, path: Path, events: list[Event]) -> Log:
    with path.open("wb") as file:
        writer: Any = Writer(file)
        writer.start()
        made = {kind: Definition(kind, SCHEMAS[kind]) for kind in {event[2] for event in events}}
        channels: dict[str, int] = {}
        for ns, topic, kind, values in sorted(events, key=lambda e: e[0]):
            if topic not in channels:
                text = json.dumps({"type": "object", "properties": SCHEMAS[kind]}).encode()
                language, schema = ("jsonschema", text) if encoding == "json" else ("protobuf", made[kind].schema)
                channels[topic] = writer.register_channel(
                    topic, encoding, writer.register_schema(kind, language, schema)
                )
            data = json.dumps(values).encode() if encoding == "json" else made[kind].message(values)
            writer.add_message(channels[topic], ns + 3_000_000, data, ns)
        writer.finish()
    return open_log([path])


def time(ns: int) -> dict[str, int]:
    return {"sec": ns // 10**9, "nsec": ns % 10**9}


def quaternion(theta: float) -> dict[str, float]:
    return {"x": 0.0, "y": 0.0, **turned(theta)}


def poses(topic: str, frame: str) -> list[Event]:
    found: list[Event] = []
    for ns, t in zip(stamps(T), T.tolist(), strict=True):
        x, y, theta = on_circle(RATE * t)
        pose = {"position": {"x": x, "y": y, "z": 0.0}, "orientation": quaternion(theta)}
        found.append((ns, topic, "foxglove.PoseInFrame", {"timestamp": time(ns), "frame_id": frame, "pose": pose}))
    return found


def edge(ns: int, parent: str, child: str, at: Sequence[float] | Array) -> dict[str, Any]:
    place = {"x": at[0], "y": at[1], "z": 0.2}
    return {
        "timestamp": time(ns),
        "parent_frame_id": parent,
        "child_frame_id": child,
        "translation": place,
        "rotation": quaternion(at[2]),
    }


def scan(ns: int, turn: float = 0.0) -> Event:
    pose = {"position": {"x": 0.0, "y": 0.0, "z": 0.0}, "orientation": quaternion(turn)}
    values = {
        "timestamp": time(ns),
        "frame_id": "laser",
        "pose": pose,
        "start_angle": -1.5,
        "end_angle": 1.5,
        "ranges": [2.0 + 0.05 * i if i % 7 else None for i in range(31)],
        "intensities": [],
    }
    return ns, "/scan", "foxglove.LaserScan", values


def end_of(log: Log, topic: str) -> Array:
    end: Array = read_wheels(log.stream(topic), WheelSettings()).wheels.pose[-1]
    return end


@pytest.mark.parametrize("single", [True, False], ids=["FrameTransform", "FrameTransforms"])
def test_transforms_of_foxglove_are_odometry_and_mounts(single: bool, written: Written, tmp_path: Path) -> None:
    events: list[Event] = []
    for ns, t in zip(stamps(T), T.tolist(), strict=True):
        both = [
            edge(ns, "odom", "base_link", on_circle(RATE * t)),
            edge(ns, "base_link", "laser", (0.2, 0.1, math.pi / 2)),
        ]
        if single:
            events += [(ns, f"/transforms/{k}", "foxglove.FrameTransform", one) for k, one in enumerate(both)]
        else:
            events.append((ns, "/transforms", "foxglove.FrameTransforms", {"transforms": both}))
        events.append(scan(ns))
    log = written(tmp_path / "x.mcap", events)
    choice = choose(log, make_robot({}))
    topic = "/transforms/0:odom:base_link" if single else "/transforms:odom:base_link"
    assert (choice.of("wheels"), choice.of("lrf")) == ((topic,), ("/scan:scan",))
    assert end_of(log, topic) == pytest.approx(END, abs=1e-9)
    assert log.stream(topic).t_ns.tolist() == stamps(T)
    mount = present(mount_of(transforms_of(log, ["laser"]), "laser"))
    assert (mount.x, mount.y, mount.yaw) == pytest.approx((0.2, 0.1, math.pi / 2), abs=1e-9)


def test_a_scan_of_foxglove_has_its_beams_evenly_between_its_ends(written: Written, tmp_path: Path) -> None:
    log = written(tmp_path / "x.mcap", [scan(stamps(T)[0], turn=0.5)])
    assert log.find("/scan:scan") is not None
    columns = log.stream("/scan:scan").columns("angle_min", "angle_increment", "time_increment", "ranges")
    ranges = columns["ranges"]
    assert isinstance(ranges, Ragged)
    assert np.asarray(columns["angle_min"]) == pytest.approx([-1.0])  # turned by its pose
    assert np.asarray(columns["angle_increment"]) == pytest.approx([0.1])
    assert np.asarray(columns["time_increment"]).tolist() == [0.0]
    assert np.isnan(ranges[0][::7]).all()
    assert ranges[0][1] == pytest.approx(2.05)


def test_poses_of_odometry_come_before_scans_and_those_in_the_map_after(written: Written, tmp_path: Path) -> None:
    scans = [scan(ns) for ns in stamps(T)]
    log = written(tmp_path / "x.mcap", [*poses("/pose", "odom"), *scans])
    assert choose(log, make_robot({})).of("wheels") == ("/pose",)
    assert end_of(log, "/pose") == pytest.approx(END, abs=1e-9)
    log = written(tmp_path / "y.mcap", [*poses("/pose", "map"), *scans])
    assert choose(log, make_robot({})).of("wheels") == ("/scan:scan",)


@pytest.mark.parametrize("speeds", [True, False], ids=["with speeds", "poses alone"])
def test_an_odometry_of_foxglove(speeds: bool, written: Written, tmp_path: Path) -> None:
    events: list[Event] = []
    for ns, _, _, values in poses("", "odom"):
        moving = {"linear_velocity": {"x": SPEED}, "angular_velocity": {"z": RATE}} if speeds else {}
        known = {"pose_covariance": [0.25 * (i == 7) for i in range(36)]}
        events.append(
            (ns, "/odom", "foxglove.Odometry", {**values, "body_frame_id": "base_link", **moving, **known})
        )
    log = written(tmp_path / "x.mcap", events)
    assert choose(log, make_robot({})).of("wheels") == ("/odom:odometry",)
    assert end_of(log, "/odom:odometry") == pytest.approx(END, abs=1e-9)
    columns = log.stream("/odom:odometry").columns("twist.twist.linear.x", "pose.covariance", "twist.covariance")
    speed, pose, twist = (np.asarray(column) for column in columns.values())
    assert speed == pytest.approx(np.full(len(T), SPEED if speeds else 0.0))
    assert (pose.shape, pose[0, 7], pose.sum(), twist.sum()) == ((len(T), 36), 0.25, 0.25 * len(T), 0.0)


def test_joints_of_foxglove_are_wheels(written: Written, tmp_path: Path) -> None:
    radius, track = 0.1, 0.5
    events: list[Event] = []
    for ns, t in zip(stamps(T), T.tolist(), strict=True):
        turns = [(SPEED + side * RATE * track / 2) * t / radius for side in (-1, 1)]
        joints = [
            {"name": name, "position": at, "velocity": 0.0, "effort": 0.0}
            for name, at in zip(("left_wheel", "right_wheel"), turns, strict=True)
        ]
        events.append((ns, "/joints", "foxglove.JointStates", {"timestamp": time(ns), "joints": joints}))
    log = written(tmp_path / "x.mcap", events)
    robot = make_robot({"wheels": {"radius": radius, "track": track}})
    assert choose(log, robot).of("wheels") == ("/joints:joints",)
    end = read_wheels(log.stream("/joints:joints"), robot.wheels).wheels.pose[-1]
    assert end == pytest.approx(END, abs=1e-6)


def test_a_cloud_of_foxglove_is_turned_and_moved_by_its_pose_and_sliced(written: Written, tmp_path: Path) -> None:
    beams = np.radians(np.arange(-170.0, 171.0, 10.0))
    level = np.column_stack((3.0 * np.cos(beams), 3.0 * np.sin(beams), np.full(len(beams), 0.05)))
    low = level * (1.0, 1.0, -20.0)  # the floor
    layout = np.dtype(
        {"names": ["i", *"xyz"], "formats": ["<i2", "<f4", "<f4", "<f8"], "offsets": [0, 2, 6, 10], "itemsize": 20}
    )
    packed = np.zeros(2 * len(beams), layout)
    for k, axis in enumerate("xyz"):
        packed[axis] = np.concatenate((level, low))[:, k]
    kinds = zip(("i", "x", "y", "z"), (0, 2, 6, 10), (4, 7, 7, 8), strict=True)
    values = {
        "timestamp": time(stamps(T)[0]),
        "frame_id": "lidar",
        "point_stride": 20,
        "pose": {"position": {"x": 0.0, "y": 0.0, "z": 0.01}, "orientation": quaternion(math.pi / 2)},
        "fields": [{"name": name, "offset": at, "type": kind} for name, at, kind in kinds],
        "data": base64.b64encode(packed.tobytes()).decode(),
    }
    log = written(
        tmp_path / "x.mcap", [(stamps(T)[0] + k, "/lidar", "foxglove.PointCloud", values) for k in range(5)]
    )
    choose(log, make_robot({"wheels": {"topic": "/lidar:scan"}}))
    columns = log.stream("/lidar:scan").columns("ranges", "angle_min", "angle_increment")
    ranges = columns["ranges"]
    assert isinstance(ranges, Ragged)
    seen = np.flatnonzero(np.isfinite(ranges[0]))
    angles = np.asarray(columns["angle_min"])[0] + np.asarray(columns["angle_increment"])[0] * seen
    turned_by = np.sort(np.angle(np.exp(1j * (beams + math.pi / 2))))
    assert angles == pytest.approx(turned_by, abs=math.radians(0.26))
    assert ranges[0][seen] == pytest.approx(np.full(len(seen), 3.0), abs=1e-5)


def test_the_same_types_as_ros_messages(tmp_path: Path) -> None:
    kind, text = (
        "foxglove_msgs/msg/LaserScan",
        (
            "builtin_interfaces/Time timestamp\nstring frame_id\ngeometry_msgs/Pose pose\nfloat64 start_angle\n"
            "float64 end_angle\nfloat64[] ranges\nfloat64[] intensities\n"
        ),
    )
    (ns, _, _, values) = scan(stamps(T)[0])
    row = {**values, "timestamp": {"sec": ns // 10**9, "nanosec": ns % 10**9}, "ranges": [2.0, 2.5, 3.0]}
    log = open_log([custom(tmp_path / "x.mcap", "/lidar", kind, text, T[:1], [row])])
    choice = choose(log, make_robot({}))
    assert choice.of("lrf") == ("/lidar:scan",)
    stream = log.stream("/lidar:scan")
    assert stream.t_ns.tolist() == [ns]
    assert stream.frame_id == "laser"
    columns = stream.columns("angle_increment", "ranges")
    assert np.asarray(columns["angle_increment"]) == pytest.approx([1.5])
