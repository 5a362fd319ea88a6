"""Motion as strangers record it: frames in /tf, twists, wheel speeds, steering; each gives its own path."""

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
from bags import Said
from commands import locfuse, refused, reported
from pose_streams import odometry_stream, pose_stream, reckoned
from wheel_bags import (
    GEOMETRY,
    RADIUS,
    RATE,
    SPEED,
    TRACK,
    angles,
    custom,
    frames,
    joint_states,
    log_of,
    messages,
    odometry,
    on_circle,
    pose_of,
    poses_in,
    stamps,
    twists,
)

from locfuse.formats.logs.log import open_log
from locfuse.fusion.data import Array, ArrayStream, LocfuseError
from locfuse.fusion.robot import WheelSettings
from locfuse.fusion.streams import MergedStream
from locfuse.fusion.wheels.read import read_wheels

DURATION = 20.0  # s
T = np.arange(0.0, DURATION + 0.01, 0.05)
CIRCLE = on_circle(RATE * T)


def tf(t: Array, poses: Array, parent: str = "odom", child: str = "base_link", more: Any = ()) -> list[Said]:
    return frames(parent, child, t, poses, more=more)


def numbers_of(stream: Any, *fields: str) -> dict[str, Array]:
    """Columns of a TransformStamped, by the part of the transform."""
    columns = stream.columns(*(f"transform.{field}" for field in fields))
    return {field: np.asarray(columns[f"transform.{field}"]) for field in fields}


def speeds(topic: str, factor: float = 1.0, **how: Any) -> list[Said]:
    return twists(T, topic, factor * SPEED, factor * RATE, "base_link", **how)


def final(log: Path, *words: Any) -> tuple[list[float], dict[str, Any]]:
    done = reported("run", log, "--no-advice", "--write", "csv,json", *words)
    last = (done.out / "trajectory.csv").read_text().splitlines()[-1].split(",")
    return [float(v) for v in last[1:4]], done.report


def test_an_odometry_that_only_tf_has_gives_what_the_same_odometry_topic_gives(tmp_path: Path) -> None:
    mount = ("base_link", "laser", (0.1, 0.0, 0.0))
    in_tf, _ = final(log_of(tmp_path / "tf.mcap", tf(T, CIRCLE, more=[mount])))
    topic, _ = final(log_of(tmp_path / "odom.mcap", odometry(T, CIRCLE)))
    assert in_tf == pytest.approx(topic, abs=1e-9)
    assert in_tf[:2] == pytest.approx(CIRCLE[-1, :2], abs=1e-6)
    info = locfuse("info", tmp_path / "tf.mcap").stdout
    assert "/tf:odom:base_link, the only odometry in /tf" in info
    assert 'topic = "/tf:odom:base_link"' in locfuse("init", tmp_path / "tf.mcap").stdout


def test_a_transform_that_two_publishers_send_counts_once(tmp_path: Path) -> None:
    once = tf(T, CIRCLE)
    copies = [m._replace(log_time=m.log_time + 70_000_000) for m in once]  # after the next one
    stream = open_log([log_of(tmp_path / "twice.mcap", [*once, *copies])]).stream("/tf:odom:base_link")
    assert (
        stream.t_ns.tolist()
        == open_log([log_of(tmp_path / "x.mcap", once)]).stream("/tf:odom:base_link").t_ns.tolist()
    )


def test_an_odometry_of_one_message_leaves_the_motion_to_tf(tmp_path: Path) -> None:
    one = odometry(T[:1], CIRCLE[:1])
    found, report = final(log_of(tmp_path / "both.mcap", [*tf(T, CIRCLE), *one]))
    assert found[:2] == pytest.approx(CIRCLE[-1, :2], abs=1e-6)
    words = "/odom has too few messages to give the motion (1)"
    assert f"wheels: {words}: not used" in json.dumps(report)
    assert words in refused("run", log_of(tmp_path / "one.mcap", one), "-o", tmp_path / "out")


def test_mounts_come_from_tf_where_nothing_is_static(tmp_path: Path) -> None:
    scan = {"angle_min": -1.5, "angle_increment": 0.1, "range_max": 10.0, "ranges": [2.0] * 30}
    t = np.arange(0.1, DURATION, 0.5)
    scans = messages("/scan", "sensor_msgs/msg/LaserScan", t, [scan] * len(t), "laser")
    mount = ("base_link", "laser", (0.12, -0.03, 0.5))
    log = log_of(tmp_path / "x.mcap", tf(T, CIRCLE, more=[mount]), scans)
    found = json.loads(locfuse("info", log, "--json").stdout)["extrinsics"]["lrf"]
    assert [found["x"], found["y"], found["yaw_deg"]] == pytest.approx([0.12, -0.03, math.degrees(0.5)], abs=1e-5)
    assert found["by"] == "/tf"
    assert "# by /tf: where laser sits on the base" in locfuse("init", log).stdout


def test_frames_of_tf_are_chained_and_the_slower_one_is_interpolated(tmp_path: Path) -> None:
    """map -> odom drifts along x linearly, so that between its stamps the chain is known exactly."""
    slow = T[::10]
    drift = np.stack((0.1 * slow, np.zeros_like(slow), np.zeros_like(slow)), axis=-1)
    log = open_log([log_of(tmp_path / "x.mcap", tf(T, CIRCLE), tf(slow, drift, "map", "odom"))])
    stream = log.stream("/tf:map:base_link")
    columns = numbers_of(stream, "translation.x", "translation.y", "rotation.z")
    n = len(stream.t_ns)
    assert n == len(T)
    np.testing.assert_allclose(columns["translation.x"], CIRCLE[:n, 0] + 0.1 * T[:n], atol=1e-9)
    np.testing.assert_allclose(columns["translation.y"], CIRCLE[:n, 1], atol=1e-9)
    np.testing.assert_allclose(columns["rotation.z"], np.sin(RATE * T[:n] / 2), atol=1e-9)
    backward = numbers_of(log.stream("/tf:base_link:odom"), "translation.x")["translation.x"]
    c, s = np.cos(RATE * T), np.sin(RATE * T)
    np.testing.assert_allclose(backward, -(c * CIRCLE[:, 0] + s * CIRCLE[:, 1]), atol=1e-9)


def test_frames_that_loop_or_are_not_there_are_one_line(tmp_path: Path) -> None:
    log = log_of(tmp_path / "x.mcap", tf(T, CIRCLE), tf(T, CIRCLE, "base_link", "odom"))
    assert "frames form a loop: base_link -> odom -> base_link" in refused("run", log, "-o", tmp_path / "out")
    assert "  /tf: frames form a loop: base_link -> odom -> base_link\n" in locfuse("info", log).stdout
    log = log_of(tmp_path / "x.mcap", tf(T, CIRCLE))
    refusal = refused("run", log, "-o", tmp_path / "out", "--set", "wheels.topic=/tf:odom:base_footprint")
    assert "/tf has no frame base_footprint; it has base_link, odom" in refusal


def test_two_frames_of_tf_are_the_truth_where_they_are_named(tmp_path: Path) -> None:
    """The base in map, where a tracker says it, judges an odometry that is 10 % short."""
    short = np.concatenate((0.9 * CIRCLE[:, :2], CIRCLE[:, 2:]), axis=1)
    log = log_of(tmp_path / "x.mcap", odometry(T, short), tf(T, CIRCLE, "map", "base_link"))
    words = ("--no-advice", "--sensors", "odometry", "--set", "truth.topic=/tf:map:base_link")
    found = reported("compare", log, *words).rows["odometry"]
    expected = 0.1 * math.sqrt(float(np.square(CIRCLE[:, :2]).sum(axis=1).mean()))
    assert found["position_rmse_m"] == pytest.approx(expected, rel=1e-3)


def test_a_commanded_twist_is_the_last_resort_and_no_figure_of_it_means_anything(tmp_path: Path) -> None:
    log = log_of(tmp_path / "x.mcap", speeds("/cmd_vel"))
    done = locfuse("run", log, "-o", tmp_path / "out")
    assert done.exit_code == 3
    assert "void: wheels: /cmd_vel holds commanded speeds" in done.stderr
    assert locfuse("info", log, "--check", "--no-advice").exit_code == 3
    pose, report = final(log, "--set", "wheels.topic=/cmd_vel")
    assert pose[:2] == pytest.approx(CIRCLE[-1, :2], abs=1e-9)
    assert not report["validity"]
    measured = log_of(tmp_path / "measured.mcap", speeds("/cmd_vel", 2.0), speeds("/base/speed"))
    pose, report = final(measured)
    assert pose[:2] == pytest.approx(CIRCLE[-1, :2], abs=1e-9)
    assert "commanded" not in json.dumps(report)


@pytest.mark.parametrize("topic", ["/cmd_vel", "/base/speed"])
@pytest.mark.parametrize(("field", "absurd"), [("linear.x", 1e300), ("angular.z", -1e308), ("linear.x", -2e6)])
def test_a_speed_that_no_body_has_is_left_out_and_counted(topic: str, field: str, absurd: float) -> None:
    """The circle goes on as if the message had not come; what is faster than wheels.max_speed goes too."""
    data = {"linear.x": np.full(len(T), SPEED), "angular.z": np.full(len(T), RATE)}
    data[field] = data[field].copy()
    data[field][[7, 30]] = absurd
    stream = ArrayStream(topic, "geometry_msgs/msg/Twist", np.array(stamps(T)), data)
    reading = read_wheels(stream, WheelSettings())
    assert reading.dropped == {"spike": 2}
    np.testing.assert_allclose(reading.wheels.pose[-1], CIRCLE[-1], atol=1e-9)
    assert read_wheels(stream, WheelSettings(max_speed=2.0 * SPEED)).dropped == {"spike": 2}
    with pytest.raises(
        LocfuseError, match=r"100% of the readings are faster than wheels.max_speed=0.2 m/s.*below 0.4"
    ):
        read_wheels(stream, WheelSettings(max_speed=0.5 * SPEED))


def test_an_odometry_of_another_scale_is_corrected_by_two_factors() -> None:
    """Poses whose distances are 1.1 times as long and whose turns are 0.9 times as far."""
    t_ns, wrong = np.rint(T * 1e9).astype(np.int64), reckoned(np.diff(T)[:, None] * [1.1 * SPEED, 0.9 * RATE])
    scales = WheelSettings(scale=1.0 / 1.1, turn_scale=1.0 / 0.9)
    for stream in (pose_stream("/odom", t_ns, wrong), odometry_stream(t_ns, wrong)):
        assert read_wheels(stream, scales).wheels.pose[-1] == pytest.approx(CIRCLE[-1], abs=1e-3)


def test_an_odometry_that_turns_to_one_side_is_corrected_by_the_ratio_of_two_wheels() -> None:
    """They turn 0.1 rad per metre too far to the left: of two wheels 0.3 m apart, the left one is 3 % larger."""
    t_ns, wrong = np.rint(T * 1e9).astype(np.int64), reckoned(np.diff(T)[:, None] * [SPEED, RATE + 0.1 * SPEED])
    for settings in (WheelSettings(ratio=0.985 / 1.015), WheelSettings(ratio=0.97 / 1.03, track=0.6)):
        found = read_wheels(odometry_stream(t_ns, wrong), settings).wheels
        assert found.pose[-1] == pytest.approx(CIRCLE[-1], abs=1e-3)
    with pytest.raises(LocfuseError, match="must be positive"):
        read_wheels(odometry_stream(t_ns, wrong), WheelSettings(ratio=0.0))


def test_an_odometry_in_ned_is_mirrored_by_a_negative_scale_of_its_turns() -> None:
    """Poses with y to the right and headings clockwise, of a body 0.2 m ahead on the same circle."""
    x, y, theta = (CIRCLE + 0.2 * np.column_stack((np.cos(CIRCLE[:, 2]), np.sin(CIRCLE[:, 2]), 0.0 * T))).T
    ned = pose_stream("/odom", np.rint(T * 1e9).astype(np.int64), np.column_stack((x, -y, -theta)))
    found = read_wheels(ned, WheelSettings(turn_scale=-1.0, x=0.2))
    np.testing.assert_allclose(found.wheels.pose[:, :2], CIRCLE[:, :2], atol=1e-6)
    with pytest.raises(LocfuseError, match="turn_scale must be at least"):
        read_wheels(ned, WheelSettings(turn_scale=0.0))


def test_wheel_angles_have_a_radius_and_no_scale(tmp_path: Path) -> None:
    log = log_of(tmp_path / "x.mcap", joint_states(*angles()))
    words = refused("run", log, *GEOMETRY, "--set", "wheels.turn_scale=1.1")
    assert "wheels.turn_scale: only for an odometry, and /joint_states is none" in words


@pytest.mark.parametrize("child", ["camera_link", "somewhere"])
def test_an_odometry_of_a_camera_is_that_of_the_base_if_the_log_knows_its_mount(
    child: str, tmp_path: Path
) -> None:
    """A camera 0.2 m ahead and 0.1 m to the left, turned by 0.5 rad; without a mount it counts as base."""
    x, y, theta = CIRCLE.T
    c, s = np.cos(theta), np.sin(theta)
    camera = np.column_stack((x + 0.2 * c - 0.1 * s, y + 0.2 * s + 0.1 * c, theta + 0.5))
    static = frames("base_link", "camera_link", T[:1], np.array([[0.2, 0.1, 0.5]]), "/tf_static")
    pose, _ = final(log_of(tmp_path / "x.mcap", odometry(T, camera, child=child), static))
    dx, dy = camera[-1, :2] - camera[0, :2]
    own = [dx * math.cos(0.5) + dy * math.sin(0.5), dy * math.cos(0.5) - dx * math.sin(0.5)]
    assert pose[:2] == pytest.approx(CIRCLE[-1, :2] if child == "camera_link" else own, abs=1e-6)


def test_a_body_ahead_of_the_axle_is_not_turned_although_it_moves_aside_in_turns() -> None:
    """Half of the way is straight, and all turns are to the left: on average the body moves aside by 7 degrees."""
    turn = np.where(np.arange(400) % 100 < 50, 0.0, 0.0125)
    base = reckoned(np.column_stack((np.full(400, 0.01), turn)))
    ahead = base + 0.2 * np.column_stack((np.cos(base[:, 2]), np.sin(base[:, 2]), 0.0 * base[:, 2]))
    t_ns = (np.arange(401) * 50_000_000).astype(np.int64)
    odom = odometry_stream(t_ns, ahead, np.full(401, 0.2), np.append(turn, 0.0) / 0.05)
    assert read_wheels(odom, WheelSettings()).notes == ()
    np.testing.assert_allclose(read_wheels(odom, WheelSettings(x=0.2)).wheels.pose, base, atol=1e-6)


@pytest.mark.parametrize("hangs", [False, True])
def test_an_odometry_that_hangs_or_is_zero_for_a_while_loses_no_way(hangs: bool) -> None:
    """On a circle 4 m from the origin: the poses from 8 s to 10 s are the one before, or zeros."""
    poses = CIRCLE + np.array([4.0, 4.0, 0.0])
    bad = (T > 8.0) & (T < 10.0)
    poses[bad] = poses[np.searchsorted(T, 8.0)] if hangs else 0.0
    reading = read_wheels(pose_stream("/odom", np.rint(T * 1e9).astype(np.int64), poses), WheelSettings())
    assert reading.wheels.pose[-1] == pytest.approx(CIRCLE[-1], abs=1e-6)
    assert reading.wheels.heading(np.array(9.0)) == pytest.approx(RATE * 9.0, abs=0.02)
    assert float(np.diff(reading.wheels.t).max()) == pytest.approx(2.0, abs=0.06)
    assert reading.dropped == ({} if hangs else {"zeros": bad.sum()})
    assert any("its 39 equal readings" in note for note in reading.notes) == hangs


def test_a_command_lasts_until_the_next_one_and_a_second_at_most() -> None:
    t = np.array([0.0, 0.5, 4.0, 4.2])
    data = {"linear.x": np.array([1.0, 2.0, 3.0, 0.0]), "angular.z": np.array([0.0, 0.0, 0.0, 0.0])}
    stream = ArrayStream("/cmd_vel", "geometry_msgs/msg/Twist", np.array(stamps(t)), data)
    wheels = read_wheels(stream, WheelSettings()).wheels
    at = np.interp([0.5, 1.5, 3.9, 4.0, 4.2], wheels.t, wheels.pose[:, 0])
    np.testing.assert_allclose(at, [0.5, 2.5, 2.5, 2.5, 3.1], atol=1e-9)  # 0.5 s of 1, 1 s of 2, 0.2 s of 3 m/s


KOBUKI_TEXT = (
    "std_msgs/Header header\nuint16 time_stamp\nuint8 bumper\nuint8 wheel_drop\nuint8 cliff\n"
    "uint16 left_encoder\nuint16 right_encoder\nint8 left_pwm\nint8 right_pwm\nuint8 buttons\nuint8 charger\n"
    "uint8 battery\nuint16[] bottom\nuint8[] current\nuint8 over_current\nuint16 digital_input\n"
    "uint16[] analog_input\n"
)


def test_a_turtlebot_2_is_recognised_and_its_counters_of_16_bits_roll_over(tmp_path: Path) -> None:
    t, angle = angles(60.0)
    counts = np.round(angle * 2578.33 / (2 * math.pi)).astype(int) + 60_000
    rows = [{"left_encoder": a % 2**16, "right_encoder": b % 2**16} for a, b in counts.tolist()]
    kind = "kobuki_msgs/msg/SensorState"
    log = custom(tmp_path / "x.mcap", "/mobile_base/sensors/core", kind, KOBUKI_TEXT, t, rows)
    done = locfuse("init", log, "-o", tmp_path / "robot.toml")
    assert "this robot is a turtlebot2 (messages of kobuki_msgs)" in done.stderr
    pose, _ = final(log, "--robot", str(tmp_path / "robot.toml"))
    assert pose[:2] == pytest.approx(pose_of(counts * 2 * math.pi / 2578.33, 0.035, 0.23)[:2], abs=1e-6)


ACKERMANN = "ackermann_msgs/msg/AckermannDrive"
SIDES = [(SPEED + side * RATE * TRACK / 2) / RADIUS for side in (-1, 1)]  # rad/s of the left and the right wheel
TURTLE_POSES = [{"x": x + 5.5, "y": y + 5.5, "theta": math.remainder(a, math.tau)} for x, y, a in CIRCLE.tolist()]


def package(kind: str, topic: str, fields: str, rows: list[Any]) -> Callable[[Path], Path]:
    """What writes a log of messages of single precision: the same row at all times T, or one row a time."""
    names, head = fields.split(), "" if kind in {"turtlesim/msg/Pose", ACKERMANN} else "std_msgs/Header header\n"
    text = head + "".join(f"float32 {name}\n" for name in names)
    said = rows if isinstance(rows[0], dict) else [dict(zip(names, rows, strict=True))] * len(T)
    return lambda path: custom(path, topic, kind, text, T, said)


def wheel_speeds(path: Path) -> Path:
    """Joint states without angles, or with angles that are no numbers."""
    empty: tuple[dict[str, Any], ...] = ({}, {"position": [math.nan, math.nan]})
    rows = ({"name": ["left_wheel", "right_wheel"], "velocity": SIDES, **empty[i % 2]} for i in range(len(T)))
    return log_of(path, messages("/joint_states", "sensor_msgs/msg/JointState", T, rows, "base_link"))


ESTIMATED = "{} holds poses that another program estimated"
GOALS = ("/slam/pose", "/move_base_simple/goal")
LOGS: dict[str, tuple[Callable[[Path], Path], tuple[str, ...], str, float]] = {  # log, words, what is said, m
    "TwistStamped": (lambda p: log_of(p, speeds("/v")), (), "", 1e-9),
    "TwistWithCovarianceStamped": (lambda p: log_of(p, speeds("/v", wrap=2)), (), "", 1e-9),
    "wheel speeds": (wheel_speeds, GEOMETRY, "it gives speeds and no angles: they are integrated", 1e-9),
    "poses": (
        lambda p: log_of(p, *(poses_in("map", T, CIRCLE, topic) for topic in GOALS)),
        (),
        ESTIMATED.format("/slam/pose"),
        1e-9,
    ),
    "frames": (
        lambda p: log_of(p, tf(T, CIRCLE, parent="world", child="turtle1")),
        (),
        ESTIMATED.format("/tf:world:turtle1"),
        1e-9,
    ),
    "odometry in the map": (
        lambda p: log_of(p, odometry(T, CIRCLE, "/carla/odometry", "world")),
        (),
        ESTIMATED.format("/carla/odometry"),
        1e-9,
    ),
    "duckietown": (
        package("duckietown_msgs/msg/Twist2DStamped", "/duck/cmd", "v omega", [SPEED, RATE]),
        ("--set", "wheels.topic=/duck/cmd"),
        "",
        1e-3,
    ),
    "autoware": (
        package(
            "autoware_vehicle_msgs/msg/VelocityReport",
            "/vehicle/status/velocity_status",
            "longitudinal_velocity lateral_velocity heading_rate",
            [SPEED, 0.0, RATE],
        ),
        (),
        "",
        1e-3,
    ),
    "turtlesim": (
        package("turtlesim/msg/Pose", "/turtle1/pose", "x y theta linear_velocity angular_velocity", TURTLE_POSES),
        (),
        "",
        1e-3,
    ),
    "create": (
        package("irobot_create_msgs/msg/WheelVels", "/wheel_vels", "velocity_left velocity_right", SIDES),
        GEOMETRY,
        "",
        1e-3,
    ),
    "ackermann": (
        package(
            ACKERMANN,
            "/drive",
            "steering_angle steering_angle_velocity speed acceleration jerk",
            [math.atan(RATE * 0.33 / SPEED), 0.0, SPEED, 0.0, 0.0],
        ),
        ("--set", "wheels.wheelbase=0.33"),
        "",
        1e-3,
    ),
}


@pytest.mark.parametrize("kind", LOGS)
def test_messages_of_every_kind_drive_their_circle(kind: str, tmp_path: Path) -> None:
    write, words, said, off = LOGS[kind]
    log = write(tmp_path / "x.mcap")
    if kind == "ackermann":
        assert "fill in wheels.wheelbase" in locfuse("init", log).stderr
    pose, report = final(log, *words)
    assert pose[:2] == pytest.approx(CIRCLE[-1, :2], abs=off)
    assert said in json.dumps(report)


def test_ticks_of_a_duckiebot_come_one_wheel_a_topic() -> None:
    t, angle = angles()
    ticks = np.round(angle * 135 / (2 * math.pi))
    kind = "duckietown_msgs/msg/WheelEncoderStamped"
    ns = np.array(stamps(t))
    sides = (
        ArrayStream(f"/bot/{side}_wheel_encoder_node/tick", kind, ns, {"data": counted})
        for side, counted in zip(("left", "right"), ticks.T, strict=True)
    )
    known = WheelSettings(radius=RADIUS, track=TRACK, ticks_per_revolution=135)
    pose = read_wheels(MergedStream(tuple(sides)), known).wheels.pose[-1]
    np.testing.assert_allclose(pose, pose_of(ticks * 2 * math.pi / 135), atol=1e-9)


@pytest.mark.parametrize("backward", [1.0, -1.0])
@pytest.mark.parametrize("steering", ["angle", "rate", "heading"])
def test_a_steering_turns_by_its_tangent_over_the_wheelbase_or_is_a_turning_rate_or_a_heading(
    steering: Literal["angle", "rate", "heading"], backward: float
) -> None:
    """A heading may begin anywhere and wraps at pi; a circle is the same driven ahead or, mirrored, back."""
    held = {
        "angle": np.full(len(T), math.atan(backward * RATE * 0.33 / SPEED)),
        "rate": np.full(len(T), RATE),
        "heading": np.angle(np.exp(1j * (RATE * T + 2.0))),
    }[steering]
    data = {"drive.speed": np.full(len(T), backward * SPEED), "drive.steering_angle": held}
    stream = ArrayStream("/drive", "ackermann_msgs/msg/AckermannDriveStamped", np.array(stamps(T)), data)
    pose = read_wheels(stream, WheelSettings(steering=steering, wheelbase=0.33)).wheels.pose[-1]
    np.testing.assert_allclose(pose, CIRCLE[-1] * (backward, backward, 1.0), atol=1e-9)
    if steering == "angle":
        with pytest.raises(LocfuseError, match=r"--set wheels\.wheelbase"):
            read_wheels(stream, WheelSettings())


def test_an_odometry_that_stands_while_a_twist_or_fixes_move_is_refused_in_words(tmp_path: Path) -> None:
    still, out = odometry(T, np.zeros_like(CIRCLE)), tmp_path / "out"
    rows = ({"latitude": 48.0 + 1e-5 * i, "longitude": 11.0} for i in range(len(T[::10])))
    fixes = messages("/fix", "sensor_msgs/msg/NavSatFix", T[::10], rows, "gps")
    by_fixes = locfuse("run", log_of(tmp_path / "x.mcap", still, fixes), "-o", out)
    assert by_fixes.exit_code == 3
    assert "/odom never moves, but the fixes of /fix lie up to" in by_fixes.stderr
    log = log_of(tmp_path / "x.mcap", still, speeds("/wheel_velocity"))
    done = locfuse("run", log, "-o", out)
    assert done.exit_code == 3
    assert "/odom never moves, but /wheel_velocity moves 8.0 m" in done.stderr
    assert "--set wheels.topic=/wheel_velocity" in done.stderr
    pose, _ = final(log, "--set", "wheels.topic=/wheel_velocity")
    assert pose[:2] == pytest.approx(CIRCLE[-1, :2], abs=1e-9)
    assert locfuse("run", log_of(tmp_path / "alone.mcap", still), "-o", tmp_path / "out2").exit_code == 0


@pytest.mark.parametrize(("mirrored", "signs"), [("right", (1, -1)), ("left", (-1, 1)), ("both", (-1, -1))])
def test_mirrored_wheels_hide_no_radius_and_track(mirrored: str, signs: tuple[int, int], tmp_path: Path) -> None:
    t, angle = angles(40.0)
    poses = np.array([pose_of(angle[: i + 1]) for i in range(0, len(t), 5)])
    log = log_of(tmp_path / "x.mcap", joint_states(t, angle * signs), odometry(t[::5], poses))
    known = json.loads(locfuse("info", log, "--json").stdout)["findings"]
    (found,) = (f for f in known if f["code"] == "geometry")
    fixes = dict(fix.split("=") for fix in found["fixes"])
    assert fixes["wheels.mirrored"] == mirrored
    assert [float(fixes[f"wheels.{k}"]) for k in ("radius", "track")] == pytest.approx([RADIUS, TRACK], rel=0.02)


def test_an_odometry_that_is_named_as_a_pose_leaves_the_other_one_to_the_wheels(tmp_path: Path) -> None:
    log = log_of(tmp_path / "x.mcap", odometry(T, CIRCLE), odometry(T, CIRCLE, "/vo/odom"))
    assert "2 topics that fit: /odom, /vo/odom" in " ".join(locfuse("run", log).stderr.split())
    pose, _ = final(log, "--set", "pose.topic=/vo/odom", "--sensors", "pose", "--no-advice")
    assert pose[:2] == pytest.approx(CIRCLE[-1, :2], abs=0.05)
    alone = locfuse("run", log_of(tmp_path / "one.mcap", odometry(T, CIRCLE)), "--set", "pose.topic=/odom")
    assert "/odom is read as wheels already" in " ".join(alone.stderr.split())
