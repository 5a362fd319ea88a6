"""Kinds of messages that few robots publish, as the usual ones: a circle in closed form decides."""

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
from locfuse.formats.logs.log import open_log
from locfuse.fusion.data import LocfuseError
from locfuse.fusion.robot import WheelSettings
from locfuse.fusion.sensors.gps import Gps, GpsSettings
from locfuse.fusion.wheels.motion import Wheels
from locfuse.fusion.wheels.read import read_wheels

Array = NDArray[np.float64]
SPEED, RATE = 0.4, 0.2  # m/s, rad/s: a circle of 2 m radius
T = np.arange(0.0, 5.01, 0.1)
POSES = np.stack((2.0 * np.sin(RATE * T), 2.0 * (1.0 - np.cos(RATE * T)), RATE * T), axis=-1)
RADIUS, TRACK = 0.1, 0.5
LINE = "=" * 80
DRIVERS = (
    f"{LINE}\nMSG: {{0}}/DriveFeedback\nfloat32 current\nfloat32 measured_velocity\nfloat32 measured_travel\n"
    "bool driver_fault\n"
)


@pytest.mark.parametrize(
    ("package", "array"), [("jackal_msgs", "DriveFeedback[2]"), ("clearpath_platform_msgs", "DriveFeedback[]")]
)
def test_the_motors_of_a_jackal_are_its_wheels(package: str, array: str, tmp_path: Path) -> None:
    kind = f"{package}/msg/Feedback"
    text = f"std_msgs/Header header\n{package}/{array} drivers\nfloat32 pcb_temperature\n" + DRIVERS.format(
        package
    )
    sides = [(SPEED + side * RATE * TRACK / 2) * T / RADIUS for side in (-1, 1)]
    rows: list[dict[str, Any]] = [
        {"drivers": [{"measured_travel": left, "measured_velocity": 1.0}, {"measured_travel": right}]}
        for left, right in zip(*(side.tolist() for side in sides), strict=True)
    ]
    log = open_log([custom(tmp_path / "x.mcap", "/feedback", kind, text, T, rows)])
    robot = make_robot({"wheels": {"radius": RADIUS, "track": TRACK}})
    assert choose(log, robot).of("wheels") == ("/feedback:joints",)
    stream = log.stream("/feedback:joints")
    assert stream.columns("name")["name"][0] == ("left_wheel", "right_wheel")
    end = read_wheels(stream, robot.wheels).wheels.pose[-1]
    assert end == pytest.approx(POSES[-1], abs=1e-4)  # angles of single precision


def test_a_feedback_of_four_motors_is_none_of_two_wheels(tmp_path: Path) -> None:
    kind = "clearpath_platform_msgs/msg/Feedback"
    text = "std_msgs/Header header\nclearpath_platform_msgs/DriveFeedback[] drivers\n"
    rows = [{"drivers": [{"measured_travel": t}] * 4} for t in T.tolist()]
    log = open_log([
        custom(tmp_path / "x.mcap", "/feedback", kind, text + DRIVERS.format("clearpath_platform_msgs"), T, rows)
    ])  # fmt: skip
    assert log.find("/feedback:joints") is not None
    stream = log.stream("/feedback:joints")
    with pytest.raises(LocfuseError, match="named like the left wheel"):
        read_wheels(stream, WheelSettings(radius=RADIUS, track=TRACK))


def test_the_pose_that_a_legged_robot_says_is_an_odometry(tmp_path: Path) -> None:
    text = (
        "unitree_go/IMUState imu_state\nfloat32[3] position\nfloat32[3] velocity\nfloat32 yaw_speed\n"
        f"{LINE}\nMSG: unitree_go/IMUState\nfloat32[4] quaternion\nfloat32[3] gyroscope\n"
    )
    rows = [
        {
            "imu_state": {"quaternion": [math.cos(h / 2), 0.0, 0.0, math.sin(h / 2)], "gyroscope": [0.0] * 3},
            "position": [x, y, 0.3],
            "velocity": [0.0] * 3,
        }
        for x, y, h in POSES.tolist()
    ]
    log = open_log(
        [custom(tmp_path / "x.mcap", "/sportmodestate", "unitree_go/msg/SportModeState", text, T, rows)]
    )
    assert choose(log, make_robot({})).of("wheels") == ("/sportmodestate:odometry",)
    end = read_wheels(log.stream("/sportmodestate:odometry"), WheelSettings()).wheels.pose[-1]
    assert end == pytest.approx(POSES[-1], abs=1e-5)  # numbers of single precision


def test_fixes_of_gpsd_are_fixes(tmp_path: Path) -> None:
    text = (
        "std_msgs/Header header\ngps_msgs/GPSStatus status\nfloat64 latitude\nfloat64 longitude\n"
        "float64[9] position_covariance\nuint8 position_covariance_type\n"
        f"{LINE}\nMSG: gps_msgs/GPSStatus\nint16 status\n"
    )
    covariance = [0.04, 0.0, 0.0, 0.0, 0.09, 0.0, 0.0, 0.0, 1.0]
    rows = [
        {
            "status": {"status": -1 if i == 3 else 18},
            "latitude": 52.0 + 1e-6 * i,
            "longitude": 9.0,
            "position_covariance": covariance,
            "position_covariance_type": 2,
        }
        for i in range(len(T))
    ]
    log = open_log([custom(tmp_path / "x.mcap", "/gpsfix", "gps_msgs/msg/GPSFix", text, T, rows)])
    stream = log.stream("/gpsfix")
    zero = np.zeros(2)
    still = Wheels.from_wheels(np.array([0.0, 10.0]), zero, zero, 0.5, 1e-4)
    m = Gps().measure(stream, GpsSettings(sigma=1.0), still, int(stream.t_ns[0]))
    assert (len(m.z), m.dropped) == (len(T) - 1, {"no_fix": 1})
    assert m.z[-1, 1] == pytest.approx(1e-6 * (len(T) - 1) * 111267.0, rel=1e-4)  # a degree at 52 deg north
    assert m.R_unit[0].tolist() == [[0.04, 0.0], [0.0, 0.09]]
