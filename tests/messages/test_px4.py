"""PX4's messages in north, east, down are read as those of ROS in east, north, up: a circle in closed form."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from wheel_bags import custom

from locfuse.cli.analysis.choose import choose
from locfuse.cli.analysis.robot_tables import make_robot
from locfuse.formats.logs.log import Log, open_log
from locfuse.fusion.data import LocfuseError
from locfuse.fusion.robot import WheelSettings
from locfuse.fusion.sensors.gyro import GyroSettings, up_rate
from locfuse.fusion.wheels.read import read_wheels

Array = NDArray[np.float64]
SPEED, RATE = 0.4, 0.2  # m/s, rad/s counter-clockwise seen from above: a circle of 2 m radius
T = np.arange(0.0, 5.01, 0.1)
EAST, NORTH, YAW = 2.0 * np.sin(RATE * T), 2.0 * (1.0 - np.cos(RATE * T)), RATE * T  # from east, ENU
HEADING = math.pi / 2 - YAW  # from north, clockwise
VEHICLE = """uint64 timestamp
uint8 pose_frame
float32[3] position
float32[4] q
uint8 velocity_frame
float32[3] velocity
float32[3] angular_velocity
"""
LOCAL = "uint64 timestamp\nfloat32 x\nfloat32 y\nfloat32 vx\nfloat32 vy\nfloat32 heading\n"
SENSOR = "uint64 timestamp\nfloat32[3] gyro_rad\nfloat32[3] accelerometer_m_s2\n"


def log_with(folder: Path, kind: str, text: str, rows: list[dict[str, Any]], topic: str) -> Log:
    return open_log([custom(folder / f"{kind}.mcap", topic, f"px4_msgs/msg/{kind}", text, T, rows)])


@pytest.mark.parametrize("body", [False, True], ids=["speeds in the world", "speeds of the body"])
def test_the_odometry_of_a_vehicle(body: bool, tmp_path: Path) -> None:
    rows = [
        {
            "timestamp": round(1e6 * t),
            "position": [n, e, 0.0],
            "q": [math.cos(h / 2), 0.0, 0.0, math.sin(h / 2)],
            "velocity_frame": 3 if body else 1,
            "velocity": [SPEED, 0.0, 0.0] if body else [SPEED * math.cos(h), SPEED * math.sin(h), 0.0],
            "angular_velocity": [0.0, 0.0, -RATE],
        }
        for t, n, e, h in zip(T.tolist(), NORTH.tolist(), EAST.tolist(), HEADING.tolist(), strict=True)
    ]
    log = log_with(tmp_path, "VehicleOdometry", VEHICLE, rows, "/fmu/out/vehicle_odometry")
    choice = choose(log, make_robot({}))
    assert choice.of("wheels") == ("/fmu/out/vehicle_odometry:odometry",)
    stream = log.stream(choice.topics["wheels"])
    end = read_wheels(stream, WheelSettings()).wheels.pose[-1]
    assert end == pytest.approx([EAST[-1], NORTH[-1], YAW[-1]], abs=1e-5)
    speed = stream.columns("twist.twist.linear.x", "twist.twist.angular.z")
    np.testing.assert_allclose(np.asarray(speed["twist.twist.linear.x"]), SPEED, atol=1e-6)
    np.testing.assert_allclose(np.asarray(speed["twist.twist.angular.z"]), RATE, atol=1e-6)


def test_the_local_position_of_a_vehicle(tmp_path: Path) -> None:
    rows = [
        {"x": n, "y": e, "heading": h, "vx": SPEED * math.cos(h), "vy": SPEED * math.sin(h)}
        for n, e, h in zip(NORTH.tolist(), EAST.tolist(), HEADING.tolist(), strict=True)
    ]
    log = log_with(tmp_path, "VehicleLocalPosition", LOCAL, rows, "/fmu/out/vehicle_local_position")
    stream = log.stream(choose(log, make_robot({})).topics["wheels"])
    end = read_wheels(stream, WheelSettings()).wheels.pose[-1]
    assert end == pytest.approx([EAST[-1], NORTH[-1], YAW[-1]], abs=1e-5)
    np.testing.assert_allclose(
        np.asarray(stream.columns("twist.twist.linear.x")["twist.twist.linear.x"]), SPEED, atol=1e-6
    )


def test_its_sensors_turn_and_weigh_as_an_imu_does(tmp_path: Path) -> None:
    rows = [{"gyro_rad": [0.01, 0.02, -RATE], "accelerometer_m_s2": [0.1, 0.2, -9.81]}] * len(T)
    log = log_with(tmp_path, "SensorCombined", SENSOR, rows, "/fmu/out/sensor_combined")
    assert log.find("/fmu/out/sensor_combined:imu") is not None
    stream = log.stream("/fmu/out/sensor_combined:imu")
    axes = [f"{part}.{axis}" for part in ("angular_velocity", "linear_acceleration") for axis in "xyz"]
    columns: Any = stream.columns(*axes, "angular_velocity_covariance", "orientation_covariance")
    found = [float(np.asarray(columns[name])[0]) for name in axes]
    assert found == pytest.approx([0.01, -0.02, RATE, 0.1, -0.2, 9.81], abs=1e-5)
    assert np.asarray(columns["orientation_covariance"])[0, 0] == -1.0  # it has none
    rate = up_rate(columns, GyroSettings(), stream.topic)
    np.testing.assert_allclose(rate, RATE, atol=1e-6)


def test_a_definition_that_lies_is_refused_in_one_line(tmp_path: Path) -> None:
    text = VEHICLE.replace("float32[3] position", "string position")
    log = log_with(tmp_path, "VehicleOdometry", text, [{"position": "here"}] * len(T), "/odom")
    with pytest.raises(LocfuseError, match="position is a text by its definition; accepted: 3 numbers"):
        read_wheels(log.stream(choose(log, make_robot({})).topics["wheels"]), WheelSettings())
