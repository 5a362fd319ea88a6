"""Kinds of messages that few robots publish, as the usual ones: a circle in closed form decides."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bags import Said, cdr, header, write
from commands import locfuse, reported
from wheel_bags import RATE, SPEED, custom, odometry, on_circle, stamps, turned

from locfuse.cli.analysis.choose import choose
from locfuse.cli.analysis.robot_tables import make_robot
from locfuse.formats.logs.log import Log, open_log
from locfuse.fusion.data import Array, LocfuseError
from locfuse.fusion.robot import WheelSettings
from locfuse.fusion.sensors.gps import Gps, GpsSettings
from locfuse.fusion.sensors.gyro import GyroSettings, up_rate
from locfuse.fusion.wheels.motion import Wheels
from locfuse.fusion.wheels.read import read_wheels

T = np.arange(0.0, 5.01, 0.1)
POSES = on_circle(RATE * T)
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
    log = open_log(
        [custom(tmp_path / "x.mcap", "/feedback", kind, text + DRIVERS.format("clearpath_platform_msgs"), T, rows)]
    )
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


# --- a nav_msgs/Path as poses over time: its last message, each pose at its own stamp


PATH = "nav_msgs/msg/Path"
PATH_T = np.arange(0.0, 10.01, 0.1)
PATH_POSES = on_circle(RATE * PATH_T)


def path(times: Array, poses: Array, at: int, planned: bool = False) -> Said:
    """A message on /slam/path that holds poses (n, 3) [m, rad]; of a plan all have its own stamp."""
    own = [at] * len(times) if planned else stamps(times)
    held = [
        {"header": header(ns, "map"), "pose": {"position": {"x": x, "y": y}, "orientation": turned(theta)}}
        for ns, (x, y, theta) in zip(own, poses.tolist(), strict=True)
    ]
    return Said("/slam/path", PATH, cdr(PATH, header=header(at, "map"), poses=held), at)


def growing() -> list[Said]:
    """A way that is drawn again every second, wrong until the last message corrects it all."""
    wrong = PATH_POSES + np.array([0.3, -0.1, 0.05])
    at = stamps(PATH_T)
    early = [path(PATH_T[:i:5], wrong[:i:5], at[i]) for i in range(10, 101, 10)]
    return [*early, path(PATH_T[::5], PATH_POSES[::5], at[-1] + 1)]


def test_the_last_message_says_the_whole_way_at_the_stamps_of_its_poses(tmp_path: Path) -> None:
    log = open_log([write(tmp_path / "x.mcap", growing())])
    stream = log.stream("/slam/path:poses")
    assert stream.msgtype == "geometry_msgs/msg/PoseStamped"
    assert stream.frame_id == "map"
    assert stream.t_ns.tolist() == stamps(PATH_T[::5])
    x, w = (np.asarray(c) for c in stream.columns("pose.position.x", "pose.orientation.w").values())
    assert x == pytest.approx(PATH_POSES[::5, 0])
    assert w == pytest.approx(np.cos(PATH_POSES[::5, 2] / 2))


def test_a_path_is_judged_as_an_estimate_and_judges_as_truth(tmp_path: Path) -> None:
    log = write(tmp_path / "x.mcap", sorted([*odometry(PATH_T, PATH_POSES), *growing()], key=lambda m: m.log_time))
    named = ("--set", "truth.topic=/slam/path", "--estimate", "slam=/slam/path")
    rows = reported("compare", log, *named, "--no-advice").rows
    assert rows["slam"]["position_rmse_m"] == pytest.approx(0.0, abs=1e-9)
    assert rows["odometry"]["position_rmse_m"] == pytest.approx(0.0, abs=1e-3)
    assert rows["odometry"]["heading_rmse_deg"] == pytest.approx(0.0, abs=math.degrees(1e-3))


@pytest.mark.parametrize("n", [0, 1, 20], ids=["empty", "one pose", "all of one time"])
def test_a_plan_is_no_way_that_was_driven(n: int, tmp_path: Path) -> None:
    at = stamps(PATH_T)
    plans = [path(PATH_T[:n], PATH_POSES[:n], at[i], planned=True) for i in (0, 50)]
    log = open_log([write(tmp_path / "x.mcap", plans)])
    with pytest.raises(LocfuseError, match=f"/slam/path: the {n} poses of its last message have no times"):
        _ = log.stream("/slam/path:poses").t_ns
    done = locfuse("info", tmp_path / "x.mcap", "--set", "pose.topic=/slam/path:poses")
    assert (done.exit_code, done.stderr) == (0, "")
    assert f"not readable: /slam/path:poses: /slam/path: the {n} poses" in done.stdout


# --- pX4's messages in north, east, down are read as those of ROS in east, north, up: a circle in closed form


EAST, NORTH, YAW = POSES.T  # from east, ENU
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


@pytest.mark.parametrize("kind", ["speeds in the world", "speeds of the body", "local position"])
def test_the_odometry_of_a_vehicle(kind: str, tmp_path: Path) -> None:
    numbers = zip(T.tolist(), NORTH.tolist(), EAST.tolist(), HEADING.tolist(), strict=True)
    if kind == "local position":
        rows: list[dict[str, Any]] = [
            {"x": n, "y": e, "heading": h, "vx": SPEED * math.cos(h), "vy": SPEED * math.sin(h)}
            for _, n, e, h in numbers
        ]
        log = log_with(tmp_path, "VehicleLocalPosition", LOCAL, rows, "/vehicle")
    else:
        body = kind == "speeds of the body"
        rows = [
            {
                "timestamp": round(1e6 * t),
                "position": [n, e, 0.0],
                "q": [math.cos(h / 2), 0.0, 0.0, math.sin(h / 2)],
                "velocity_frame": 3 if body else 1,
                "velocity": [SPEED, 0.0, 0.0] if body else [SPEED * math.cos(h), SPEED * math.sin(h), 0.0],
                "angular_velocity": [0.0, 0.0, -RATE],
            }
            for t, n, e, h in numbers
        ]
        log = log_with(tmp_path, "VehicleOdometry", VEHICLE, rows, "/vehicle")
    choice = choose(log, make_robot({}))
    assert choice.of("wheels") == ("/vehicle:odometry",)
    stream = log.stream("/vehicle:odometry")
    end = read_wheels(stream, WheelSettings()).wheels.pose[-1]
    assert end == pytest.approx([EAST[-1], NORTH[-1], YAW[-1]], abs=1e-5)
    speed = stream.columns("twist.twist.linear.x", "twist.twist.angular.z")
    np.testing.assert_allclose(np.asarray(speed["twist.twist.linear.x"]), SPEED, atol=1e-6)
    if kind != "local position":
        np.testing.assert_allclose(np.asarray(speed["twist.twist.angular.z"]), RATE, atol=1e-6)


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
