"""Bags as strangers record them: names, frames and doubles that no standard rules out; what is chosen of them."""

import math
import tracemalloc
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bags import Said
from commands import locfuse, refused
from present import present
from wheel_bags import (
    GEOMETRY,
    RADIUS,
    RATE,
    SPEED,
    TICKS,
    TRACK,
    angles,
    custom,
    frames,
    joint_states,
    log_of,
    messages,
    numbers,
    odometry,
    on_circle,
    pose_of,
    turned,
    twists,
)

import locfuse as locfuse_api
from locfuse.cli.analysis.choose import choose
from locfuse.cli.analysis.load import load
from locfuse.cli.analysis.mounts import mount_of, on_moving_parts, transforms_of
from locfuse.cli.analysis.robot_tables import make_robot
from locfuse.cli.analysis.settings import LogOptions
from locfuse.cli.analysis.topics import Choice
from locfuse.formats.logs.log import Log, open_log
from locfuse.fusion.data import Array, LocfuseError
from locfuse.fusion.robot import WheelSettings
from locfuse.fusion.wheels.calibrate import geometry_by_odometry
from locfuse.fusion.wheels.read import joint_names, read_wheels

T = np.arange(0.0, 5.01, 0.1)
CIRCLE = on_circle(RATE * T)
STANDING = np.zeros_like(CIRCLE)


def driven(topic: str, poses: Array = CIRCLE) -> list[Said]:
    return odometry(T, poses, topic)


def tf(parent: str, child: str, poses: Array = CIRCLE, topic: str = "/tf") -> list[Said]:
    return frames(parent, child, T[: len(poses)], poses, topic)


def speeds(topic: str, frame: str) -> list[Said]:
    return twists(T, topic, SPEED, RATE, frame)


def mount(parent: str, child: str) -> list[Said]:
    """One transform of /tf_static: 0.2 m ahead, 0.1 m left, turned by 90 degrees."""
    return tf(parent, child, np.array([[0.2, 0.1, math.pi / 2]]), "/tf_static")


def scans(topic: str, frame: str = "laser") -> list[Said]:
    data: dict[str, Any] = {"angle_min": -1.5, "angle_increment": 0.1, "range_max": 10.0}
    data["ranges"] = [2.0 + 0.05 * i for i in range(30)]
    return messages(topic, "sensor_msgs/msg/LaserScan", T, [data] * len(T), frame)


def opened(tmp_path: Path, *said: list[Said]) -> Log:
    return open_log([log_of(tmp_path / "x.mcap", *said)])


def chosen(log: Log, **tables: Any) -> Choice:
    return choose(log, make_robot(tables))


def end_of(log: Log) -> Array:
    """Where the motion of the chosen topic ends, (x, y, theta)."""
    reading = read_wheels(log.stream(chosen(log).topics["wheels"]), WheelSettings())
    end: Array = reading.wheels.pose[-1]
    return end


# ---- which of several ----


@pytest.mark.parametrize(
    ("wheels", "other"),
    [
        ("/husky_velocity_controller/odom", "/odometry/filtered"),
        ("/odom/unfiltered", "/odom"),
        ("/odom", "/zed/zed_node/odom"),
        ("/base_odometry/odom", "/robot_pose_ekf/odom_combined"),
        ("/odometry/wheels", "/odom"),
        ("/odom_enc", "/odom"),
        ("/odom", "/odom_rf2o"),
        ("/odometry/filtered", "/odometry/gps"),
    ],
)
def test_an_odometry_of_wheels_is_taken_before_one_made_of_more(wheels: str, other: str, tmp_path: Path) -> None:
    log = opened(tmp_path, driven(wheels), driven(other, STANDING))
    choice = chosen(log)
    assert choice.of("wheels") == (wheels,)
    (note,) = choice.notes
    assert (note.role, note.fixes) == ("wheels", (f"wheels.topic={wheels}",))
    assert note.words.startswith(f"{wheels} is used: {other} looks made of more")
    assert end_of(log) == pytest.approx(CIRCLE[-1], abs=1e-6)


@pytest.mark.parametrize(
    ("used", "other"),
    [
        ("/scan_front", "/scan_back"),
        ("/f_scan", "/b_scan"),
        ("/scan", "/scan_filtered"),
        ("/base_scan", "/tilt_scan"),
    ],
)
def test_of_several_lasers_the_likeliest_is_used_and_said(used: str, other: str, tmp_path: Path) -> None:
    choice = chosen(opened(tmp_path, driven("/odom"), scans(used), scans(other)))
    assert choice.of("lrf") == (used,)
    (note,) = choice.notes
    assert (note.role, note.fixes) == ("lrf", (f"lrf.topic={used}",))
    assert note.words.endswith(f"{used} is used")


def test_of_two_robots_the_laser_of_the_one_that_is_named_is_taken(tmp_path: Path) -> None:
    said = [m for r in ("robot1", "robot2") for m in (*driven(f"/{r}/odom"), *scans(f"/{r}/scan"))]
    log = opened(tmp_path, said)
    with pytest.raises(LocfuseError, match="2 topics that fit: /robot1/odom, /robot2/odom"):
        chosen(log)
    for robot in ("robot1", "robot2"):
        choice = chosen(log, wheels={"topic": f"/{robot}/odom"})
        assert choice.of("lrf") == (f"/{robot}/scan",)
        assert "pose" not in choice.absent  # the odometry of the other robot is not offered


def test_init_writes_the_laser_that_is_used_and_calls_it_a_guess(tmp_path: Path) -> None:
    log = log_of(tmp_path / "x.mcap", driven("/odom"), scans("/rear_scan"), scans("/front_scan"))
    done = locfuse("init", log)
    assert "guessed: lrf.topic=/front_scan" in done.stderr
    assert done.stdout.count('topic = "/front_scan"') == 1


# ---- wheels ----


@pytest.mark.parametrize(
    ("joints", "pair"),
    [
        ("l_wheel_joint r_wheel_joint torso_lift_joint", "l_wheel_joint r_wheel_joint"),
        ("fl_wheel_joint fr_wheel_joint rl_wheel_joint rr_wheel_joint", "rl_wheel_joint rr_wheel_joint"),
        (
            "front_left_wheel front_right_wheel rear_left_wheel rear_right_wheel",
            "rear_left_wheel rear_right_wheel",
        ),
        (
            "left_wheel_joint right_wheel_joint wheel_drop_left_joint wheel_drop_right_joint",
            "left_wheel_joint right_wheel_joint",
        ),
        (
            "left_front_steer_wheel right_front_steer_wheel left_back_wheel right_back_wheel",
            "left_back_wheel right_back_wheel",
        ),
    ],
)
def test_wheels_are_known_by_names_that_robots_give_them(joints: str, pair: str) -> None:
    assert joint_names([tuple(joints.split())], "/joint_states", WheelSettings()) == tuple(pair.split())


@pytest.mark.parametrize(
    "joints",
    ["l_elbow r_elbow", "front_left_hip_x front_right_hip_x", "fl_caster_l_wheel_joint fl_caster_r_wheel_joint"],
)
def test_arms_and_casters_are_no_wheels(joints: str) -> None:
    with pytest.raises(LocfuseError, match="no joint is named like the left wheel"):
        joint_names([tuple(joints.split())], "/joint_states", WheelSettings())


def test_where_nobody_knows_the_size_of_the_wheels_the_laser_says_how_the_robot_moved(tmp_path: Path) -> None:
    t, angle = angles(5.0)
    log = opened(tmp_path, joint_states(t, angle), scans("/scan"))
    choice = chosen(log)
    assert choice.of("wheels") == ("/scan",)
    words = "/scan is used, since wheel angles are in /joint_states but radius and track are unknown"
    assert choice.notes[0].words == words
    assert chosen(log, wheels={"radius": 0.05}).of("wheels") == ("/joint_states",)
    assert chosen(log, wheels={"radius": 0.05, "track": 0.3}).of("wheels") == ("/joint_states",)


@pytest.mark.parametrize("parent", ["odom_combined", "robot1/odom", "wheel_odom", "/odometry"])
def test_an_odometry_frame_in_tf_is_known_by_any_usual_name(parent: str, tmp_path: Path) -> None:
    log = opened(tmp_path, tf(parent, "base_footprint"), tf("map", parent, STANDING))
    assert end_of(log) == pytest.approx(CIRCLE[-1], abs=1e-6)


def test_fixes_and_an_imu_alone_are_refused_in_a_line_that_says_what_is_missing(tmp_path: Path) -> None:
    imu, fix = (
        messages(topic, f"sensor_msgs/msg/{kind}", T, [{}] * len(T), "base_link")
        for topic, kind in (("/imu", "Imu"), ("/fix", "NavSatFix"))
    )
    with pytest.raises(LocfuseError) as refused:
        chosen(opened(tmp_path, imu, fix))
    words = str(refused.value)
    assert "has no wheels, no odometry (nor one in /tf), no laser, no poses and no speeds" in words
    assert "/fix and /imu can only correct a motion" in words
    with pytest.raises(LocfuseError, match=r"no speeds\. It has /number"):
        chosen(opened(tmp_path, numbers("/number", "Float64", T, T.tolist())))


@pytest.mark.parametrize("kind", ["Int32", "Int64", "Float32"])
def test_both_wheels_in_one_array_are_left_and_right(kind: str, tmp_path: Path) -> None:
    t, angle = angles(20.0)
    whole = kind != "Float32"
    rows = np.round(angle * TICKS / (2.0 * math.pi)).astype(int).tolist() if whole else angle.tolist()
    log = opened(tmp_path, numbers("/wheel_ticks", f"{kind}MultiArray", t, rows))
    sized: dict[str, Any] = {"radius": RADIUS, "track": TRACK}
    sized |= {"ticks_per_revolution": TICKS} if whole else {}
    choice = chosen(log, wheels=sized)
    assert choice.of("wheels") == ("/wheel_ticks",)
    end = read_wheels(log.stream("/wheel_ticks"), WheelSettings(**sized)).wheels.pose[-1]
    assert end == pytest.approx(pose_of(angle), abs=5e-3)


def test_of_an_array_of_four_nobody_guesses_which_are_the_wheels(tmp_path: Path) -> None:
    t, angle = angles(20.0)
    rows = np.column_stack((angle, angle))[:, [0, 2, 1, 3]]  # front left, rear left, front right, rear right
    log = opened(tmp_path, numbers("/encoders", "Float64MultiArray", t, rows.tolist()))
    sized: dict[str, Any] = {"radius": RADIUS, "track": TRACK}
    with pytest.raises(LocfuseError, match=r"holds 4 numbers; .* --set wheels\.left=0 --set wheels\.right=3"):
        read_wheels(log.stream("/encoders"), WheelSettings(**sized))
    named = WheelSettings(**sized, left="1", right="3")
    assert read_wheels(log.stream("/encoders"), named).wheels.pose[-1] == pytest.approx(pose_of(angle), abs=1e-6)


def test_what_is_not_read_is_named_with_what_to_record_instead(tmp_path: Path) -> None:
    kind, text = "livox_ros_driver2/msg/CustomMsg", "std_msgs/Header header\nuint32 point_num\n"
    file = custom(tmp_path / "x.mcap", "/livox/lidar", kind, text, T, [{}] * len(T))
    with pytest.raises(LocfuseError) as refused:
        chosen(open_log([file]))
    assert "/livox/lidar (livox_ros_driver2/CustomMsg) holds points in Livox' own format" in str(refused.value)
    both = open_log([file, log_of(tmp_path / "odom.mcap", driven("/odom"))])
    assert "record PointCloud2 instead" in chosen(both).absent["lrf"]


# ---- where sensors sit ----


@pytest.mark.parametrize(
    "said",
    [
        [*tf("robot1/odom", "robot1/base_link"), *mount("robot1/base_link", "laser")],
        [*tf("odom", "chassis"), *mount("chassis", "laser")],
        [*tf("/odom_combined", "/base"), *mount("/base", "/laser")],
        [*tf("wheel_odom", "my_robot_body"), *mount("my_robot_body", "laser")],
        [*tf("map", "ego_vehicle"), *mount("ego_vehicle", "laser")],
    ],
    ids=["a robot's name before it", "another name", "slashes of ROS 1", "a name of its own", "moved in the map"],
)
def test_a_mount_is_found_on_any_frame_that_is_the_body(said: Sequence[Said], tmp_path: Path) -> None:
    found = present(mount_of(transforms_of(opened(tmp_path, list(said)), ["laser"]), "laser"))
    assert [found.x, found.y, found.yaw] == pytest.approx([0.2, 0.1, math.pi / 2], abs=1e-9)


def test_a_frame_beside_the_body_is_not_taken_for_it(tmp_path: Path) -> None:
    """A pan unit that carries a camera is no body, however rigid the two are."""
    log = opened(tmp_path, tf("odom", "base_link"), mount("pan_link", "laser"))
    assert mount_of(transforms_of(log, ["laser"]), "laser") is None


def test_a_laser_that_moves_on_the_robot_is_left_out_with_what_moves(tmp_path: Path) -> None:
    """The odometry still runs; where somebody says where the laser stood, it is used."""
    swing = np.stack((np.zeros_like(T), np.zeros_like(T), 0.3 * np.sin(T)), axis=-1)
    moving = tf("odom", "base_link"), tf("base_link", "pan_link", swing), mount("pan_link", "laser")
    log = log_of(tmp_path / "x.mcap", driven("/odom"), *moving, scans("/scan"))
    info = locfuse("info", log)
    assert "laser moves on the robot (pan_link in base_link by /tf)" in " ".join(info.stdout.split())
    assert "base's origin is assumed" not in info.stdout
    refusal = refused("run", log, "-o", tmp_path / "out", "--no-advice", "--sensors", "lrf")
    assert "laser moves on the robot" in refusal
    placed = transforms_of(open_log([log]), ["laser"])
    assert mount_of(placed, "laser") is None
    assert on_moving_parts(placed, {"lrf": [open_log([log]).stream("/scan")]}, {"lrf": {"x": 0.2}}) == {}


# ---- estimates that look like odometry ----


def test_an_odometry_in_the_map_is_an_estimate_that_comes_after_what_the_wheels_said(tmp_path: Path) -> None:
    """A particle filter or a localisation publishes Odometry too; its frame says that it knows the room."""
    estimate = odometry(T, STANDING, "/pf/pose/odom", "map")
    for topic, wheels in (("/odom", driven("/odom")), ("/twist", speeds("/twist", "base_link"))):
        choice = chosen(opened(tmp_path, wheels, estimate))
        assert choice.of("wheels") == (topic,)
        assert "/pf/pose/odom looks made of more than the wheels" in choice.notes[0].words


def test_speeds_along_the_axes_of_odom_are_not_speeds_ahead(tmp_path: Path) -> None:
    log = opened(tmp_path, speeds("/odometry/twist", "odom"), speeds("/body_twist", "body"))
    assert chosen(log).of("wheels") == ("/body_twist",)


def options(*sets: str) -> LogOptions:
    return LogOptions(sets=sets, quiet=True)


def test_scans_that_say_how_the_robot_moved_say_nothing_of_where_their_laser_sits(tmp_path: Path) -> None:
    """Moved and matched by one mount, they fit any: what a filter found there would be made of noise."""
    log = log_of(tmp_path / "x.mcap", scans("/scan"))
    lrf = load([log], options()).robot.settings("lrf")
    assert lrf.sigmas(observable=True) == (0.0, 0.0, 0.0)
    told = load([log], options("lrf.sigma_x=0.02")).robot.settings("lrf")
    assert told.sigmas(observable=True) == (0.02, 0.0, 0.0)


# ---- inertial sensors ----


def imus(topic: str, oriented: bool = True) -> list[Said]:
    known: dict[str, Any] = {"orientation_covariance": [0.0 if oriented else -1.0, *[0.0] * 8]}
    known["angular_velocity"] = {"z": RATE}
    rows = ({"orientation": turned(RATE * t) if oriented else {}, **known} for t in T.tolist())
    return messages(topic, "sensor_msgs/msg/Imu", T, rows, "imu")


@pytest.mark.parametrize(
    ("used", "other"), [("/imu/data", "/camera/imu"), ("/imu1/imu", "/gripper/imu"), ("/z_imu/data", "/livox/imu")]
)
def test_of_imus_the_one_on_the_body_is_read_by_compass_and_gyro(used: str, other: str, tmp_path: Path) -> None:
    choice = chosen(opened(tmp_path, driven("/odom"), imus(used), imus(other)))
    assert (choice.of("compass"), choice.of("gyro")) == ((used,), (used,))
    choice = chosen(opened(tmp_path, driven("/odom"), imus(used, oriented=False), imus(other, oriented=False)))
    assert choice.of("gyro") == (used,)


def test_a_heading_that_is_a_bare_number_comes_after_an_orientation(tmp_path: Path) -> None:
    """Nothing says its unit, its zero or its sense; where no IMU has an orientation it is read."""
    heading = numbers("/compass_hdg", "Float64", T, np.degrees(RATE * T).tolist())
    choice = chosen(opened(tmp_path, driven("/odom"), imus("/imu/data"), heading))
    assert choice.of("compass") == ("/imu/data",)
    choice = chosen(opened(tmp_path, driven("/odom"), imus("/imu/data", oriented=False), heading))
    assert (choice.of("compass"), choice.of("gyro")) == (("/compass_hdg",), ("/imu/data",))


def counters_and_odometry(path: Path, t: Array) -> tuple[Any, Any]:
    """Both wheels by turns fast and slow, on a circle of 0.05 * 7.5 / 0.5 = 0.75 m: closed form."""
    rolled = 0.5 * t - 2.5 * (np.cos(0.2 * t) - 1.0)
    turn = 0.05 * 3.0 / 0.3 * rolled
    both = np.stack((6.0 * rolled, 9.0 * rolled), axis=-1)
    log = opened(path, joint_states(t, both), odometry(t, on_circle(turn, 0.75)))
    return log.stream("/joint_states"), log.stream("/odom")


def test_the_size_of_the_wheels_is_what_an_odometry_of_arcs_was_made_with(tmp_path: Path) -> None:
    """Along an arc the wheels roll further than the robot comes ahead: by the chord they were 0.5 % too small."""
    found = present(
        geometry_by_odometry(*counters_and_odometry(tmp_path, np.arange(0.0, 40.0, 0.1)), WheelSettings())
    )
    assert (found.radius, found.track) == pytest.approx((0.05, 0.3), rel=1e-4)


def test_a_clock_that_jumps_by_years_does_not_make_a_window_of_every_half_second(tmp_path: Path) -> None:
    """12 years of windows took 6 GiB."""
    streams = counters_and_odometry(tmp_path, np.append(np.arange(0.0, 40.0, 0.1), 4e8))
    tracemalloc.start()
    geometry_by_odometry(*streams, WheelSettings())
    assert tracemalloc.get_traced_memory()[1] < 50e6
    tracemalloc.stop()


def test_speeds_of_a_receiver_of_satellites_are_no_motion_of_the_body(tmp_path: Path) -> None:
    """They are given along east and north, and never turn."""
    fixes = speeds("/ublox/fix_velocity", "gps")
    assert chosen(opened(tmp_path, fixes, driven("/slam/odom"))).topics["wheels"] == "/slam/odom"
    with pytest.raises(LocfuseError, match="the robot's motion is unknown"):
        chosen(opened(tmp_path, fixes))


def test_wheels_whose_messages_are_all_malformed_are_called_so(tmp_path: Path) -> None:
    t, angle = angles(2.0)
    said = [one._replace(data=one.data[:9]) for one in joint_states(t, angle)]
    refusal = refused("run", log_of(tmp_path / "x.mcap", said), *GEOMETRY, "-o", tmp_path / "o")
    assert f"wheels: none of {len(t)} messages on /joint_states can be read: {len(t)} shorter" in refusal


# ---- cars: a motor controller, commands of speed and steering, and which of several commands counts ----

VESC_KIND = "vesc_msgs/msg/VescStateStamped"
VESC_STATE = f"{'=' * 80}\nMSG: vesc_msgs/VescState\nfloat64 speed\n"
VESC_TEXT = f"std_msgs/Header header\nvesc_msgs/VescState state\n{VESC_STATE}"
ERPM, WHEELBASE, GAIN, OFFSET = 4614.0, 0.33, -1.2135, 0.5304  # of an F1TENTH car
CAR = {"wheels.erpm_per_mps": ERPM, "wheels.wheelbase": WHEELBASE}
ACKERMANN = "ackermann_msgs/msg/AckermannDrive"
ACKERMANN_FIELDS = ("steering_angle", "steering_angle_velocity", "speed", "acceleration", "jerk")
ACKERMANN_TEXT = "".join(f"float32 {name}\n" for name in ACKERMANN_FIELDS)


def end_of_run(logs: Sequence[Path], sets: Mapping[str, Any]) -> tuple[Array, str]:
    """Where the run of a log in several files ends, and its notes."""
    done = locfuse_api.load(list(logs), sets=sets).run("odometry", advice=False)
    return done.filtered.pose[-1], " ".join(done.notes)


def motor(path: Path) -> Path:
    """A motor controller that measures the speed of the circle."""
    rows = [{"state": {"speed": ERPM * SPEED}}] * len(T)
    return custom(path / "vesc.mcap", "/sensors/core", VESC_KIND, VESC_TEXT, T, rows)


def commanded(path: Path, topic: str, speed: float, angle: float = math.atan(RATE * WHEELBASE / SPEED)) -> Path:
    rows = [{"steering_angle": angle, "speed": speed}] * len(T)
    return custom(path / f"{topic.strip('/')}.mcap", topic, ACKERMANN, ACKERMANN_TEXT, T, rows)


def test_a_motor_and_the_steering_beside_it_are_a_motion(tmp_path: Path) -> None:
    """The speed is the measured one; commands say where to, at half the speed that came out."""
    logs = motor(tmp_path), commanded(tmp_path, "/drive", SPEED / 2)
    pose, notes = end_of_run(logs, CAR)
    assert pose == pytest.approx(CIRCLE[-1], abs=1e-5)
    assert "erpm" not in notes
    _, notes = end_of_run(logs, {"wheels.wheelbase": WHEELBASE})
    assert "--set wheels.erpm_per_mps=<erpm> (speed_to_erpm_gain of vesc.yaml)" in notes
    with pytest.raises(LocfuseError, match="no topic says how the car was steered"):
        end_of_run(logs[:1], {**CAR, "wheels.topic": "/sensors/core"})


def test_the_position_of_a_servo_says_how_a_car_was_steered(tmp_path: Path) -> None:
    rows = [{"data": GAIN * math.atan(RATE * WHEELBASE / SPEED) + OFFSET}] * len(T)
    name = "/commands/servo/position"
    servo = custom(tmp_path / "servo.mcap", name, "std_msgs/msg/Float64", "float64 data\n", T, rows)
    logs = motor(tmp_path), servo
    pose, _ = end_of_run(logs, {**CAR, "wheels.servo_gain": GAIN, "wheels.servo_offset": OFFSET})
    assert pose == pytest.approx(CIRCLE[-1], abs=1e-5)
    with pytest.raises(LocfuseError, match=r'sets={"wheels\.servo_gain": <gain>'):
        end_of_run(logs, CAR)


@pytest.mark.parametrize(("used", "other"), [("/ackermann_cmd", "/drive"), ("/drive", "/teleop")])
def test_of_commands_the_one_that_the_base_obeys_is_taken_and_said(used: str, other: str, tmp_path: Path) -> None:
    logs = commanded(tmp_path, used, SPEED), commanded(tmp_path, other, 2 * SPEED, 0.0)
    pose, notes = end_of_run(logs, {"wheels.wheelbase": WHEELBASE})
    assert pose == pytest.approx(CIRCLE[-1], abs=1e-5)
    assert f"of several commands ({other} beside it) the base obeys it" in notes


def test_commands_of_two_robots_are_not_guessed_at(tmp_path: Path) -> None:
    how: Any = (ACKERMANN, ACKERMANN_TEXT, T, [{"speed": SPEED}] * len(T))
    logs = [custom(tmp_path / f"{n}.mcap", f"/robot{n}/cmd_vel", *how) for n in (1, 2)]
    with pytest.raises(LocfuseError, match="2 topics that fit: /robot1/cmd_vel, /robot2/cmd_vel"):
        end_of_run(logs, {"wheels.wheelbase": WHEELBASE})
