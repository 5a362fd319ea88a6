"""A short simulated drive with every sensor of the registry: streams by role, and the robot that carries them.

It stands still at first and turns through the heading pi.
"""

from __future__ import annotations

from functools import cache
from typing import Any, cast

import numpy as np

from locfuse.cli.analysis.robot_tables import make_robot
from locfuse.fusion.data import ArrayStream, Drive, Stream
from locfuse.fusion.measure import measure
from locfuse.fusion.robot import Robot
from locfuse.fusion.sensors.registry import REGISTRY
from locfuse.fusion.streams import merged
from locfuse.sample_logs.load import load
from locfuse.sample_logs.record import in_memory

LEGS = (
    "{turn_deg=80, speed=0.25}, {forward=0.8, speed=0.4}, {turn_deg=60, speed=0.3}, {forward=0.4},"
    "{turn_deg=-70, speed=0.3}"
)
SCENARIO = (
    f'path={{kind="legs", x=2.2, y=2.4, theta_deg=120.0, legs=[{LEGS}]}}',
    *("control.estimator=truth", "control.wait=1.5", "camera.enabled=true", "camera.rate=2", "compass.rate=10"),
    *("camera.size=[240,240]", "camera.centre=[120.7,119.1]", "camera.focal=160", "camera.inner=31"),
    "camera.outer=116",
)
LANDMARKS = {6: (0.5, 0.7), 7: (4.5, 1.0), 11: (4.0, 4.2), 20: (0.8, 3.9)}
IMU = "sensor_msgs/msg/Imu"


@cache
def streams() -> tuple[dict[str, Stream], dict[str, dict[str, Any]]]:
    """Streams by role, and the tables of robot.toml."""
    topics, tables, _ = in_memory(load("extras", SCENARIO), 5)
    found: dict[str, Stream] = {r: topics[t["topic"]] for r, t in tables.items() if "topic" in t}
    for role in ("sonar", "gps"):  # robot.toml need not name them
        found[role] = merged([s for s in topics.values() if s.msgtype in REGISTRY[role].reads])
    found["gyro"] = imu(found["truth"])
    found["pose"] = poses(found["truth"])
    found["twist"] = speeds(found["truth"])
    found["landmarks"] = detections(found["truth"])
    tables["landmarks"] = {
        "map": {str(key): list(place) for key, place in LANDMARKS.items()},
        "x": 0.1,
        "y": -0.05,
    }
    found["ranges"] = ranges(found["truth"])
    tables["ranges"] = {**tables["landmarks"]}
    return found, tables


def ranges(truth: Stream) -> Stream:
    """Ranges from (0.1, -0.05) m on the robot to the landmarks, 7 cm too long: one at every second true pose."""
    seen = detections(truth)
    columns = cast("dict[str, Any]", seen.columns("id", "range"))
    data = {"id": columns["id"][::2], "range": columns["range"][::2] + 0.07}
    return ArrayStream("/uwb", "locfuse/msg/Ranges", seen.t_ns[::2], data)


def detections(truth: Stream) -> Stream:
    """Range and bearing to four landmarks at the true poses, two of them at every third stamp."""
    columns = cast("dict[str, Any]", truth.columns("pose.position.x", "pose.position.y"))
    turn = cast("dict[str, Any]", truth.columns("pose.orientation.z", "pose.orientation.w"))
    theta = 2.0 * np.arctan2(turn["pose.orientation.z"], turn["pose.orientation.w"])
    rows = []
    for i in range(0, len(theta), 3):
        c, s = np.cos(theta[i]), np.sin(theta[i])
        x = columns["pose.position.x"][i] + c * 0.1 + s * 0.05
        y = columns["pose.position.y"][i] + s * 0.1 - c * 0.05
        for key in sorted(LANDMARKS)[(i // 3) % 2 :: 2]:
            dx, dy = LANDMARKS[key][0] - x, LANDMARKS[key][1] - y
            rows.append((int(truth.t_ns[i]), key, np.hypot(dx, dy), np.arctan2(dy, dx) - theta[i]))
    t_ns, ids, ranges, bearings = (np.array(column) for column in zip(*rows, strict=True))
    data: dict[str, Any] = {"id": ids.astype(np.int64), "range": ranges, "bearing": bearings}
    return ArrayStream("detections.csv", "locfuse/msg/Detections", t_ns.astype(np.int64), data)


def poses(truth: Stream) -> Stream:
    """The true poses in a frame of their own, turned by 0.7 rad: every fourth, with a covariance."""
    fields = ("position.x", "position.y", "orientation.x", "orientation.y", "orientation.z", "orientation.w")
    columns = cast("dict[str, Any]", truth.columns(*(f"pose.{field}" for field in fields)))
    x, y, _, _, z, w = (column[::4] for column in columns.values())
    c, s, half = np.cos(0.7), np.sin(0.7), np.arctan2(z, w) + 0.35
    data = {"x": c * x - s * y + 3.0, "y": s * x + c * y - 2.0}
    turned = {"x": 0.0 * half, "y": 0.0 * half, "z": np.sin(half), "w": np.cos(half)}
    P = np.diag([4e-4, 1e-4, 0.0, 0.0, 0.0, 1e-4])
    P[0, 1] = P[1, 0] = 5e-5
    fields_of = {f"pose.pose.position.{axis}": column for axis, column in data.items()}
    fields_of |= {f"pose.pose.orientation.{axis}": column for axis, column in turned.items()}
    fields_of["pose.covariance"] = (
        np.tile(P.reshape(36), (len(half), 1)) * (1.0 + np.arange(len(half)) % 2)[:, None]
    )
    return ArrayStream("/other/pose", "geometry_msgs/msg/PoseWithCovarianceStamped", truth.t_ns[::4], fields_of)


def speeds(truth: Stream) -> Stream:
    """What speeds the true poses have, between neighbours."""
    columns = cast("dict[str, Any]", truth.columns("pose.position.x", "pose.position.y"))
    turn = cast("dict[str, Any]", truth.columns("pose.orientation.z", "pose.orientation.w"))
    theta = np.unwrap(2.0 * np.arctan2(turn["pose.orientation.z"], turn["pose.orientation.w"]))
    t = truth.t_ns * 1e-9
    vx, vy = (np.gradient(columns[f"pose.position.{axis}"], t) for axis in "xy")
    forward = np.cos(theta) * vx + np.sin(theta) * vy
    data = {"twist.linear.x": forward, "twist.angular.z": np.gradient(theta, t)}
    return ArrayStream("/flow/twist", "geometry_msgs/msg/TwistStamped", truth.t_ns, data)


def imu(truth: Stream) -> Stream:
    """What a gyro with a bias of 0.01 rad/s says of the true turning."""
    columns = cast("dict[str, Any]", truth.columns("pose.orientation.z", "pose.orientation.w"))
    theta = np.unwrap(2.0 * np.arctan2(columns["pose.orientation.z"], columns["pose.orientation.w"]))
    n, zero = len(theta), np.zeros(len(theta))
    rate = np.gradient(theta, truth.t_ns * 1e-9) + 0.01
    data = {"x": zero, "y": zero, "z": rate}
    fields = {f"angular_velocity.{axis}": values for axis, values in data.items()}
    return ArrayStream("/imu", IMU, truth.t_ns, {**fields, "angular_velocity_covariance": np.zeros((n, 9))})


@cache
def drive() -> tuple[Drive, Robot]:
    """The drive, measured."""
    found, tables = streams()
    robot = make_robot(tables)
    return measure({role: found[role] for role in ("wheels", "truth", *REGISTRY)}, robot), robot
