"""A short healthy drive as raw messages, and ways to spoil it as real robots and drivers do."""

from collections.abc import Callable, Iterable, Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w
from pose_streams import reckoned

from locfuse.formats.container.mcap_write import log_writer
from locfuse.fusion.data import Array
from locfuse.sample_logs import scenario as load
from locfuse.sample_logs.simulate import EPOCH_NS, Simulation
from locfuse.sample_logs.table import RawMessage

Tables = dict[str, dict[str, Any]]
Change = Callable[["Drive"], None]
Edit = Callable[[RawMessage], RawMessage | None]
WHEELS, COMPASS, SCAN, TRUTH = "/joint_states", "/compass", "/scan", "/ground_truth/pose"
PICTURES = "/omni/image/compressed"
RADIUS, TRACK = 0.05, 0.6
MS, S = 10**6, 10**9
LEGS = (
    "{forward=1.6}, {turn_deg=80, speed=0.25}, {forward=1.0, speed=0.4}, {turn_deg=-130, speed=0.3},"
    "{forward=-0.6}, {turn_deg=60, speed=0.3}, {forward=1.2, speed=0.5}, {turn_deg=-100, speed=0.3},"
    "{forward=0.8, speed=0.4}"
)
SCENARIO = (
    f'path={{kind="legs", x=2.2, y=2.4, theta_deg=20.0, legs=[{LEGS}]}}',
    *("control.estimator=truth", "control.wait=0.5", "camera.rate=0.7", "camera.size=[240,240]"),
    *("camera.centre=[120.7,119.1]", "camera.focal=160", "camera.inner=31", "camera.outer=116"),
    *("wheels.rate=25", "wheels.noise=2e-4", "compass.rate=10", "lrf.rate=6", "truth.rate=10"),
)


@cache
def _simulated() -> tuple[tuple[RawMessage, ...], Tables]:
    simulation = Simulation(load.load("rounded_rectangle", SCENARIO), seed=5)
    messages: list[RawMessage] = []
    simulation.run(None, messages.append)
    return tuple(messages), simulation.robot_tables


class Drive:
    """Messages in the order of their arrival, and the robot.toml that comes with them: both may be changed."""

    def __init__(self, pictures: bool = False) -> None:
        messages, tables = _simulated()
        self.messages = list(messages)
        self.tables = {name: dict(table) for name, table in tables.items()}
        if not pictures:
            self.drop(PICTURES)
            del self.tables["camera"]

    def on(self, topic: str) -> list[RawMessage]:
        """The messages of one topic."""
        return [m for m in self.messages if m.topic == topic]

    def each(self, topic: str, edit: Edit) -> None:
        """Change every message of a topic; None takes it out."""
        edited = (edit(m) if m.topic == topic else m for m in self.messages)
        self.messages = [m for m in edited if m is not None]

    def field(self, topic: str, **values: Any) -> None:
        """Set a field of every message of a topic: to a value, or to what a function makes of the old one."""

        def edit(m: RawMessage) -> RawMessage:
            new = {k: v(m.fields[k]) if callable(v) else v for k, v in values.items()}
            return m._replace(fields={**m.fields, **new})

        self.each(topic, edit)

    def add(self, messages: Iterable[RawMessage]) -> None:
        """Add messages where they arrive."""
        self.messages = sorted((*self.messages, *messages), key=lambda m: m.log_ns)

    def drop(self, *topics: str) -> None:
        self.messages = [m for m in self.messages if m.topic not in topics]

    def record(self, path: Path) -> Path:
        """Write it as a log."""
        with log_writer(path) as log:
            log.attach("robot.toml", tomli_w.dumps(self.tables).encode())
            for m in self.messages:
                log.write(m.topic, m.msgtype, m.fields, m.log_ns, stamp_ns=m.stamp_ns, frame_id=m.frame_id)
        return path


def recorded(folder: Path, *changes: Change) -> Path:
    """The drive with these changes as a log in a folder."""
    drive = Drive()
    for change in changes:
        change(drive)
    return drive.record(folder / "log.mcap")


def seconds(m: RawMessage) -> float:
    """When a message was taken, s after the start."""
    return (m.stamp_ns - EPOCH_NS) / S


def angles(drive: Drive) -> Array:
    """Both wheels' angles, (n, 2)."""
    return np.array([m.fields["position"] for m in drive.on(WHEELS)])


def dead_reckoning(drive: Drive) -> Array:
    """What a driver would publish as its odometry: poses (n, 3), from 0."""
    rolled = np.diff(angles(drive), axis=0) * RADIUS
    return reckoned(np.column_stack((rolled.mean(axis=1), rolled @ [-1, 1] / TRACK)))


def odometry(drive: Drive, poses: Array, twist: Mapping[str, Array]) -> list[RawMessage]:
    """/odom beside every wheel reading."""
    found = []
    for i, m in enumerate(drive.on(WHEELS)):
        x, y, theta = poses[i].tolist()
        fields = {
            "child_frame_id": "base_link",
            "pose.pose.position.x": x,
            "pose.pose.position.y": y,
            "pose.pose.orientation.z": float(np.sin(theta / 2)),
            "pose.pose.orientation.w": float(np.cos(theta / 2)),
            **{f"twist.twist.{k}": float(v[i]) for k, v in twist.items()},
        }
        found.append(RawMessage("/odom", "nav_msgs/msg/Odometry", m.log_ns, m.stamp_ns, "odom", fields))
    return found


def speeds(drive: Drive) -> dict[str, Array]:
    """Forward speed and turning rate at every wheel reading."""
    t = np.array([seconds(m) for m in drive.on(WHEELS)])
    rate = np.gradient(angles(drive), t, axis=0) * RADIUS
    return {"linear.x": rate.mean(axis=1), "angular.z": (rate[:, 1] - rate[:, 0]) / TRACK}


def numbers(topic: str, kind: str, when: Iterable[RawMessage], values: Iterable[Any]) -> list[RawMessage]:
    """Bare numbers, recorded when these messages were."""
    msgtype = f"std_msgs/msg/{kind}"
    return [
        RawMessage(topic, msgtype, m.log_ns, m.log_ns, "", {"data": v}) for m, v in zip(when, values, strict=True)
    ]


def headings(drive: Drive) -> Array:
    """The true heading at every compass reading [rad]."""
    t, theta = truth_headings(drive)
    return np.interp([seconds(m) for m in drive.on(COMPASS)], t, theta)


def truth_headings(drive: Drive) -> tuple[Array, Array]:
    truth = drive.on(TRUTH)
    theta = [2 * np.arctan2(m.fields["pose.orientation.z"], m.fields["pose.orientation.w"]) for m in truth]
    return np.array([seconds(m) for m in truth]), np.unwrap(theta)
