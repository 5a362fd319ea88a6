"""A short simulated drive with every sensor of the registry: streams by role, and the robot that carries them.

It stands still at first and turns through the heading pi.
"""

from __future__ import annotations

from functools import cache
from typing import Any, cast

import numpy as np

from locfuse.cli.pipeline.load import make_robot
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
IMU = "sensor_msgs/msg/Imu"


@cache
def streams() -> tuple[dict[str, Stream], dict[str, dict[str, Any]]]:
    """Streams by role, and the tables of robot.toml."""
    topics, tables, _ = in_memory(load("extras", SCENARIO), 5)
    found: dict[str, Stream] = {r: topics[t["topic"]] for r, t in tables.items() if "topic" in t}
    for role in ("sonar", "gps"):  # robot.toml need not name them
        found[role] = merged([s for s in topics.values() if s.msgtype in REGISTRY[role].reads])
    found["gyro"] = imu(found["truth"])
    return found, tables


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
