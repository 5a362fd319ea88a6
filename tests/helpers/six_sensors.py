"""A short simulated drive with every sensor of the registry: streams by role, and the robot that carries them.

It stands still at first and turns through the heading pi.
"""

from functools import cache
from typing import Any, cast

import numpy as np
from pose_streams import pose_columns

from benchmarks.golden_cases import EVERY, PLACES
from locfuse.cli.analysis.robot_tables import make_robot
from locfuse.fusion.data import Array, ArrayStream, Drive, Stream
from locfuse.fusion.measure import measure
from locfuse.fusion.robot import Robot
from locfuse.fusion.sensors.registry import REGISTRY
from locfuse.fusion.streams import merged
from locfuse.sample_logs.scenario import load
from locfuse.sample_logs.simulate import in_memory

SCENARIO = (*EVERY, "camera.rate=2")
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
    tables["landmarks"] = {"map": {str(key): list(place) for key, place in PLACES.items()}, "x": 0.1, "y": -0.05}
    found["ranges"] = ranges(found["truth"])
    tables["ranges"] = {**tables["landmarks"]}
    return found, tables


def ranges(truth: Stream) -> Stream:
    """Ranges from (0.1, -0.05) m on the robot to the landmarks, 7 cm too long: one at every second true pose."""
    seen = detections(truth)
    columns = cast("dict[str, Any]", seen.columns("id", "range"))
    data = {"id": columns["id"][::2], "range": columns["range"][::2] + 0.07}
    return ArrayStream("/uwb", "locfuse/msg/Ranges", seen.t_ns[::2], data)


def true_poses(truth: Stream) -> tuple[Array, Array, Array]:
    """The true x, y and unwrapped headings, (n,) each."""
    names = ("position.x", "position.y", "orientation.z", "orientation.w")
    x, y, z, w = cast("dict[str, Array]", truth.columns(*(f"pose.{name}" for name in names))).values()
    return x, y, np.unwrap(2.0 * np.arctan2(z, w))


def detections(truth: Stream) -> Stream:
    """Range and bearing to four landmarks at the true poses, two of them at every third stamp."""
    rows = []
    for i, (x, y, theta) in list(enumerate(zip(*true_poses(truth), strict=True)))[::3]:
        eye_x = x + 0.1 * np.cos(theta) + 0.05 * np.sin(theta)
        eye_y = y + 0.1 * np.sin(theta) - 0.05 * np.cos(theta)
        for key in sorted(PLACES)[(i // 3) % 2 :: 2]:
            dx, dy = PLACES[key][0] - eye_x, PLACES[key][1] - eye_y
            rows.append((int(truth.t_ns[i]), key, np.hypot(dx, dy), np.arctan2(dy, dx) - theta))
    t_ns, ids, ranges, bearings = (np.array(column) for column in zip(*rows, strict=True))
    data: dict[str, Any] = {"id": ids.astype(np.int64), "range": ranges, "bearing": bearings}
    return ArrayStream("detections.csv", "locfuse/msg/Detections", t_ns.astype(np.int64), data)


def poses(truth: Stream) -> Stream:
    """The true poses in a frame of their own, turned by 0.7 rad: every fourth, with a covariance."""
    x, y, theta = (column[::4] for column in true_poses(truth))
    n, c, s = len(x), np.cos(0.7), np.sin(0.7)
    data = pose_columns(np.column_stack((c * x - s * y + 3.0, s * x + c * y - 2.0, theta + 0.7)), "pose.pose")
    P = np.diag([4e-4, 1e-4, 0.0, 0.0, 0.0, 1e-4])
    P[0, 1] = P[1, 0] = 5e-5
    data["pose.covariance"] = np.tile(P.reshape(36), (n, 1)) * (1.0 + np.arange(n) % 2)[:, None]
    return ArrayStream("/other/pose", "geometry_msgs/msg/PoseWithCovarianceStamped", truth.t_ns[::4], data)


def speeds(truth: Stream) -> Stream:
    """What speeds the true poses have, between neighbours."""
    x, y, theta = true_poses(truth)
    vx, vy, rate = (np.gradient(column, truth.t_ns * 1e-9) for column in (x, y, theta))
    data = {"twist.linear.x": np.cos(theta) * vx + np.sin(theta) * vy, "twist.angular.z": rate}
    return ArrayStream("/flow/twist", "geometry_msgs/msg/TwistStamped", truth.t_ns, data)


def imu(truth: Stream) -> Stream:
    """What a gyro with a bias of 0.01 rad/s says of the true turning."""
    theta = true_poses(truth)[2]
    zero = np.zeros(len(theta))
    rate = np.gradient(theta, truth.t_ns * 1e-9) + 0.01
    data: dict[str, Any] = {
        f"angular_velocity.{axis}": v for axis, v in zip("xyz", (zero, zero, rate), strict=True)
    }
    data["angular_velocity_covariance"] = np.zeros((len(theta), 9))
    return ArrayStream("/imu", IMU, truth.t_ns, data)


@cache
def drive() -> tuple[Drive, Robot]:
    """The drive, measured."""
    found, tables = streams()
    robot = make_robot(tables)
    return measure({role: found[role] for role in ("wheels", "truth", *REGISTRY)}, robot), robot
