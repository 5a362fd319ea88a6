"""Wheel readings of a known drive, as each kind of message publishes them."""

import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from bags import T0, S, Said, build, cdr, header, write
from mcap.writer import Writer
from numpy.typing import NDArray
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from locfuse.cli.analysis.choose import choose
from locfuse.cli.analysis.robot_tables import make_robot
from locfuse.cli.analysis.topics import Choice
from locfuse.formats.logs.log import open_log
from locfuse.fusion.data import Array

RADIUS, TRACK, TICKS = 0.05, 0.3, 1000.0
SPEED, RATE = 0.4, 0.2  # m/s, rad/s: a circle of 2 m radius
GEOMETRY = ("--set", f"wheels.radius={RADIUS}", "--set", f"wheels.track={TRACK}")
ODOMETRY = "nav_msgs/msg/Odometry"
CREATE = "irobot_create_msgs/msg/WheelTicks"
CREATE_TEXT = "std_msgs/Header header\nint32 ticks_left\nint32 ticks_right\n"
TURTLE = "turtlebot3_msgs/msg/SensorState"
TURTLE_TEXT = """std_msgs/Header header
uint8 bumper
float32 cliff
float32 sonar
float32 illumination
uint8 led
uint8 button
bool torque
int32 left_encoder
int32 right_encoder
float32 battery
"""


def angles(duration: float = 20.0, rate: float = 50.0) -> tuple[Array, Array]:
    """Times (n,) and true wheel angles (n, 2): stand, accelerate, curve, stop, back up, turn on the spot."""
    t = np.arange(0.0, duration, 1.0 / rate)
    knots = np.array([0, 1, 2, 7, 8, 9, 12, 13, 14, 18, 19]) * duration / 20.0
    left = np.interp(t, knots, [0, 0, 6, 6, 0, -5, -5, 0, 3, 3, 0])
    right = np.interp(t, knots, [0, 0, 6, 8, 0, -5, -5, 0, -3, -3, 0])
    angle = np.stack((np.cumsum(left), np.cumsum(right)), axis=-1) / rate
    return t, angle


def on_circle(turn: Array | float, radius: float = 2.0) -> Array:
    """Poses (n, 3) along a circle from the origin, in closed form, by how far the robot has turned [rad]."""
    return np.stack((radius * np.sin(turn), radius * (1.0 - np.cos(turn)), turn), axis=-1)


def pose_of(angle: NDArray[np.floating[Any]], radius: float = RADIUS, track: float = TRACK) -> Array:
    """Final pose of dead reckoning along arcs, the plainest way: (x, y, theta)."""
    x = y = theta = 0.0
    for d_left, d_right in np.diff(angle, axis=0) * radius:
        ds, turn = (d_left + d_right) / 2, (d_right - d_left) / track
        chord = ds * (np.sin(turn / 2) / (turn / 2) if turn else 1.0)
        x, y, theta = x + chord * np.cos(theta + turn / 2), y + chord * np.sin(theta + turn / 2), theta + turn
    return np.array([x, y, theta])


def stamps(t: Array) -> list[int]:
    return [T0 + round(s * S) for s in t.tolist()]


def joint_states(t: Array, angle: Array, names: tuple[str, str] = ("left_wheel", "right_wheel")) -> list[Said]:
    return [
        Said(
            "/joint_states",
            "sensor_msgs/msg/JointState",
            cdr("sensor_msgs/msg/JointState", header=header(ns), name=list(names), position=row),
            ns + 1_000_000,
        )
        for ns, row in zip(stamps(t), angle.tolist(), strict=True)
    ]


def turned(theta: float) -> dict[str, float]:
    """A heading [rad] as the two numbers of a quaternion that it has."""
    return {"z": math.sin(theta / 2), "w": math.cos(theta / 2)}


def messages(topic: str, kind: str, t: Array, rows: Iterable[Any], frame: str | None = None) -> list[Said]:
    """Messages of one type with these fields at times t (n,), stamped in a frame where one is given."""
    stamped: list[dict[str, Any]] = [{} if frame is None else {"header": header(ns, frame)} for ns in stamps(t)]
    return [
        Said(topic, kind, cdr(kind, **head, **row), ns)
        for ns, head, row in zip(stamps(t), stamped, rows, strict=True)
    ]


def placed(poses: Array, place: str = "position", heading: str = "orientation") -> list[dict[str, Any]]:
    """Poses (n, 3) as fields of a message."""
    return [{place: {"x": x, "y": y}, heading: turned(theta)} for x, y, theta in poses.tolist()]


def odometry(t: Array, poses: Array, topic: str = "/odom", frame: str = "odom", child: str = "") -> list[Said]:
    """Poses (n, 3) at times t (n,) as an odometry says them, of a frame in another one."""
    rows = ({"child_frame_id": child, "pose": {"pose": pose}} for pose in placed(poses))
    return messages(topic, ODOMETRY, t, rows, frame)


def poses_in(frame: str, t: Array, poses: Array, topic: str) -> list[Said]:
    """Poses (n, 3) at times t (n,), given in a frame."""
    return messages(topic, "geometry_msgs/msg/PoseStamped", t, ({"pose": pose} for pose in placed(poses)), frame)


def twists(t: Array, topic: str, x: float, turn: Any, frame: str | None = None, wrap: int = 1) -> list[Said]:
    """Speeds [m/s] and turning rates (n,) [rad/s]: bare, else stamped in a frame; `wrap` 2: with a covariance."""
    rows: Any = [{"linear": {"x": x}, "angular": {"z": z}} for z in np.broadcast_to(turn, t.shape).tolist()]
    kind = "TwistWithCovariance" if wrap == 2 else "Twist"
    if frame is not None:
        kind = f"{kind}Stamped"
        for _ in range(wrap):
            rows = [{"twist": row} for row in rows]
    return messages(topic, f"geometry_msgs/msg/{kind}", t, rows, frame)


def frames(parent: str, child: str, t: Array, poses: Array, topic: str = "/tf", more: Any = ()) -> list[Said]:
    """One frame in another, and `more` (parent, child, pose) that never move in every message."""
    still = [(a, b, *placed(np.array([pose]), "translation", "rotation")) for a, b, pose in more]
    rows = (
        {
            "transforms": [
                {"header": header(ns, a), "child_frame_id": b, "transform": found}
                for a, b, found in ((parent, child, moving), *still)
            ]
        }
        for ns, moving in zip(stamps(t), placed(poses, "translation", "rotation"), strict=True)
    )
    return messages(topic, "tf2_msgs/msg/TFMessage", t, rows)


def numbers(topic: str, kind: str, t: Array, values: Any) -> list[Said]:
    """A topic of std_msgs numbers, dated by their recording alone."""
    return messages(topic, f"std_msgs/msg/{kind}", t, ({"data": value} for value in values))


def custom(path: Path, topic: str, msgtype: str, text: str, t: Array, rows: list[dict[str, Any]]) -> Path:
    """A log of a type that no standard store knows, as its driver's package would define it."""
    store = get_typestore(Stores.ROS2_JAZZY)
    store.register(get_types_from_msg(text, msgtype))
    with path.open("wb") as file:
        writer: Any = Writer(file)
        writer.start()
        schema = writer.register_schema(
            msgtype, "ros2msg", store.generate_msgdef(msgtype, ros_version=2)[0].encode()
        )
        channel = writer.register_channel(topic, "cdr", schema)
        for ns, row in zip(stamps(t), rows, strict=True):
            head = {"header": header(ns)} if "header" in text else {}
            message = build(msgtype, store, **{**head, **row})
            writer.add_message(channel, ns, bytes(store.serialize_cdr(message, msgtype)), ns, 0)
        writer.finish()
    return path


def log_of(path: Path, *said: list[Said]) -> Path:
    return write(path, sorted((m for part in said for m in part), key=lambda m: m.log_time))


def chosen(folder: Path, *said: list[Said], **tables: Any) -> Choice:
    """What is taken of a log of these messages under tables of robot.toml."""
    return choose(open_log([log_of(folder / "x.mcap", *said)]), make_robot(tables))
