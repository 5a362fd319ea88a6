"""Which motion of a log is the robot's: by the share of a scan that lies on one a second before, else by kind."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from bags import Said, real_log
from commands import locfuse, ok, reported
from laser_room import ROOM, circle, ranges_of, scan_stream, scans_of
from present import present
from wheel_bags import (
    chosen,
    joint_states,
    log_of,
    messages,
    odometry,
    on_circle,
    poses_in,
    stamps,
    turned,
    twists,
)

from locfuse.cli.analysis.choose import choose
from locfuse.cli.analysis.load import load
from locfuse.cli.analysis.robot_tables import make_robot
from locfuse.cli.analysis.settings import LogOptions
from locfuse.formats.logs.log import open_log
from locfuse.fusion import se2
from locfuse.fusion.data import Array, LocfuseError
from locfuse.fusion.robot import WheelSettings
from locfuse.fusion.sensors.lrf import LrfSettings, laser_of
from locfuse.fusion.wheels.motion import Wheels, distances_explained, turns_explained
from locfuse.fusion.wheels.odometry import pose_and_speed, travelled, unlike_a_robot
from locfuse.fusion.wheels.read import WheelReading, read_wheels
from locfuse.fusion.wheels.scan_agreement import ScanPairs, scan_pairs

T, TRUTH = circle()


# ---- the share itself ----


def pairs_of(poses: Array, motion: WheelReading) -> ScanPairs:
    rng = np.random.default_rng(1)
    ranges = np.stack([ranges_of(pose, ROOM, rng) for pose in poses])
    return present(scan_pairs(scan_stream(stamps(T), ranges), laser_of(LrfSettings()), [motion]))


def moved_by(poses: Array) -> WheelReading:
    twist = se2.log(se2.between(poses[:-1], poses[1:]))
    return WheelReading(Wheels.from_twists(T, twist, 0.3, 0.0), stamps(T[:1])[0], {}, ())


def test_points_agree_with_the_true_motion_and_with_matching_and_not_with_standing() -> None:
    true = moved_by(TRUTH)
    pairs = pairs_of(TRUTH, true)
    assert pairs.of(true) > 0.74
    assert pairs.matched() > 0.74
    assert pairs.still < pairs.of(true) - 0.3


def test_a_motion_twice_as_far_agrees_less_and_a_late_clock_and_a_turned_laser_do_not_matter() -> None:
    true = moved_by(TRUTH)
    pairs = pairs_of(TRUTH, true)
    twice = moved_by(TRUTH * (2.0, 2.0, 1.0))
    assert pairs.of(twice) < pairs.of(true) - 0.1
    late = true._replace(epoch_ns=true.epoch_ns + 300_000_000)
    assert pairs.of(late) > pairs.of(true) - 0.1
    turned_laser = pairs_of(se2.compose(TRUTH, np.broadcast_to([0.0, 0.0, np.pi], TRUTH.shape)), true)
    assert turned_laser.of(true) > 0.74


def test_a_wrong_position_of_the_laser_does_not_speak_against_the_motion() -> None:
    true, rng = moved_by(TRUTH), np.random.default_rng(1)
    scans = scan_stream(stamps(T), np.stack([ranges_of(pose, ROOM, rng) for pose in TRUTH]))
    pairs = present(scan_pairs(scans, laser_of(LrfSettings(x=-0.2, y=0.3)), [true]))
    assert pairs.of(true) > 0.74
    assert pairs.of(moved_by(TRUTH * (2.0, 2.0, 1.0))) < pairs.of(true) - 0.1


@pytest.mark.parametrize("late_s", [-25.0, 37.0])
def test_a_clock_that_is_far_off_does_not_speak_against_the_motion(late_s: float) -> None:
    t, rng = np.arange(0.0, 60.0, 0.2), np.random.default_rng(4)
    turns = np.repeat(rng.normal(0.0, 0.6, len(t) // 10), 10)[1:]
    poses = se2.chain(0.2 * np.stack((0.05 + 0.0 * turns, 0.0 * turns, turns), axis=-1))
    twist = se2.log(se2.between(poses[:-1], poses[1:]))
    true = WheelReading(Wheels.from_twists(t, twist, 0.3, 0.0), stamps(t[:1])[0], {}, ())
    scans = scan_stream(stamps(t), np.stack([ranges_of(pose, ROOM, rng) for pose in poses]))
    pairs = present(scan_pairs(scans, laser_of(LrfSettings()), [true]))
    late = true._replace(epoch_ns=true.epoch_ns + round(late_s * 1e9))
    assert pairs.of(late) > pairs.of(true) - 0.15
    assert pairs.share(pairs._by(late, np.zeros(5))) < pairs.of(true) - 0.3


def test_a_laser_upside_down_sees_the_mirror_image_and_does_not_speak_against_the_motion(tmp_path: Path) -> None:
    """A beam to the left is told as one to the right. An odometry that turns wrongly is much rarer."""
    true, mirrored = moved_by(TRUTH), TRUTH * (1.0, -1.0, -1.0)
    rng = np.random.default_rng(1)
    ranges = np.stack([ranges_of(pose, ROOM, rng)[::-1] for pose in TRUTH])
    scans = scan_stream(stamps(T), ranges)
    pairs = present(scan_pairs(scans, laser_of(LrfSettings()), [true]))
    assert pairs.of(true) > 0.74
    assert pairs.of(moved_by(TRUTH * (2.0, 2.0, 1.0))) < pairs.of(true) - 0.1
    choice = chosen(tmp_path, odometry(T, mirrored), scans_of(T, TRUTH))
    assert choice.of("wheels") == ("/odom",)


# ---- which topic is taken ----


def test_an_odometry_that_agrees_with_the_laser_is_kept_and_the_share_is_said(tmp_path: Path) -> None:
    choice = chosen(tmp_path, odometry(T, TRUTH), scans_of(T, TRUTH))
    assert choice.of("wheels") == ("/odom",)
    assert "% of a scan's points agree with it" in choice.why["wheels"]
    assert choice.notes == []


def test_an_odometry_that_is_another_motion_gives_way_to_the_scans_with_its_numbers(tmp_path: Path) -> None:
    other = np.stack((0.9 * T, 0.0 * T, -0.4 * T), axis=-1)
    choice = chosen(tmp_path, odometry(T, other), scans_of(T, TRUTH))
    assert choice.of("wheels") == ("/scan",)
    (note,) = choice.notes
    assert note.words.startswith("/scan is used: /odom is not how the robot moved: by it")
    assert "by matching the scans" in note.words
    assert note.fixes == ("wheels.topic=/scan",)
    assert chosen(tmp_path, odometry(T, other), scans_of(T, TRUTH), wheels={"topic": "/odom"}).of("wheels") == (
        "/odom",
    )


def test_an_odometry_in_cm_is_named_and_its_scale_brings_it_back(tmp_path: Path) -> None:
    said = odometry(T, TRUTH * (100.0, 100.0, 1.0)), scans_of(T, TRUTH)
    (note,) = chosen(tmp_path, *said).notes
    assert "/odom, in cm as it seems (--set wheels.scale=0.01), is not how the robot moved" in note.words
    assert chosen(tmp_path, *said, wheels={"scale": 0.01}).of("wheels") == ("/odom",)


def test_of_two_odometries_that_look_alike_the_one_that_agrees_with_the_laser_is_taken(tmp_path: Path) -> None:
    wrong = odometry(T, TRUTH * (-1.0, 2.5, 1.0), "/odom2")
    choice = chosen(tmp_path, odometry(T, TRUTH, "/odom1"), wrong, scans_of(T, TRUTH))
    assert choice.of("wheels") == ("/odom1",)


@pytest.mark.parametrize("half", [0, 1], ids=["it never moves", "it ends half-way"])
def test_an_odometry_that_stands_while_the_laser_moves_gives_way(half: int, tmp_path: Path) -> None:
    still = odometry(T, np.zeros_like(TRUTH)) if not half else odometry(T[:20], TRUTH[:20])
    choice = chosen(tmp_path, still, scans_of(T, TRUTH))
    assert choice.of("wheels") == ("/scan",)
    assert "/odom" in choice.notes[0].words


def test_a_robot_at_rest_a_frozen_laser_and_a_short_log_leave_the_odometry(tmp_path: Path) -> None:
    still = np.zeros_like(TRUTH)
    choice = chosen(tmp_path, odometry(T, still), scans_of(T, still))
    assert choice.of("wheels") == ("/odom",)
    frozen = scans_of(T[:1], TRUTH[:1])[0]
    scans = [frozen._replace(log_time=ns) for ns in stamps(T)]
    assert chosen(tmp_path, odometry(T, TRUTH), scans).of("wheels") == ("/odom",)
    t, truth = circle(5.0)
    choice = chosen(tmp_path, odometry(t, truth), scans_of(t, truth))
    assert choice.of("wheels") == ("/odom",)


def test_a_twist_never_comes_before_scans_and_what_it_is_worth_is_said(tmp_path: Path) -> None:
    """The one is what was asked for, the other in the frame of the room; neither says so in any field."""
    said = twists(T, "/controller_output_linear", 0.8, 0.0), twists(T, "/speed", 0.6, -0.2)
    choice = chosen(tmp_path, *said, scans_of(T, TRUTH))
    assert choice.of("wheels") == ("/scan",)
    assert "/controller_output_linear" in choice.notes[0].words
    assert "/speed" in choice.notes[0].words
    assert chosen(tmp_path, twists(T, "/speed", 0.6, -0.2)).of("wheels") == ("/speed",)


def test_a_laser_that_freezes_for_some_time_does_not_judge_a_motion_there() -> None:
    true, rng = moved_by(TRUTH), np.random.default_rng(1)
    ranges = np.stack([ranges_of(pose, ROOM, rng) for pose in TRUTH])
    a, b = len(T) // 4, 3 * len(T) // 4
    ranges[a:b] = ranges[a]
    pairs = present(scan_pairs(scan_stream(stamps(T), ranges), laser_of(LrfSettings()), [true]))
    for rows in (pairs.first, pairs.later):
        assert not ((rows > a) & (rows < b)).any()
    assert len(pairs.points) == len(pairs.surface) == len(pairs.first)


# ---- what is no motion of the robot ----


@pytest.mark.parametrize(
    ("topic", "frame", "words"),
    [
        ("/mavros/setpoint_position/local", "map", "holds poses that were asked for"),
        ("/arm_controller/target", "map", "holds poses that were asked for"),
        ("/aruco_single/pose", "camera_color_frame", "of something that a camera sees"),
    ],
)
def test_poses_not_the_robots_void_every_figure(topic: str, frame: str, words: str, tmp_path: Path) -> None:
    log = log_of(tmp_path / "x.mcap", poses_in(frame, T, TRUTH, topic))
    done = reported("compare", log, code=3)
    assert words in done.stderr
    assert done.report["headline"].startswith("No verdict on this log: wheels:")
    assert done.report["validity"][0]["void"]
    info = locfuse("info", log, "--check", "--no-advice")
    assert info.exit_code == 3
    assert "truth.topic" not in info.stdout
    assert "locfuse compare" not in info.stdout
    robot = tmp_path / "robot.toml"
    asked = locfuse("init", log, "-o", robot)
    assert words in asked.stderr
    assert "next:" not in asked.stderr
    again = locfuse("compare", log, "--robot", robot, "-o", tmp_path / "again")
    assert again.exit_code == 3
    assert words in again.stderr


def test_where_no_sensor_is_beside_the_odometry_init_does_not_name_tune(tmp_path: Path) -> None:
    robot = tmp_path / "robot.toml"
    log = log_of(tmp_path / "x.mcap", odometry(T, TRUTH))
    done = locfuse("init", log, "-o", robot)
    assert f"next: locfuse compare {log} --robot {robot}" in done.stderr
    assert "locfuse tune" not in robot.read_text()
    assert locfuse("compare", log, "--robot", robot, "-o", tmp_path / "out").exit_code == 0


def test_wheels_within_their_noise_do_not_lose_to_scan_matching() -> None:
    report = reported("compare", "rounded_rectangle", "--sensors", "odometry", "--no-advice").report
    assert "by matching the scans" not in json.dumps(report)


def test_poses_of_the_robot_are_taken_before_a_marker_and_a_setpoint(tmp_path: Path) -> None:
    said = [
        poses_in(f, T, TRUTH, t)
        for f, t in (("camera_link", "/marker/pose"), ("map", "/setpoint"), ("map", "/slam/pose"))
    ]
    assert chosen(tmp_path, *said).of("wheels") == ("/slam/pose",)


@pytest.mark.parametrize("place", ["rounded", "heading 0", "at 0"])
def test_poses_that_are_useless_beside_their_speeds_are_not_used(place: str) -> None:
    t, speeds = np.arange(0.0, 40.0, 0.1), np.array([0.2, 0.3])
    turn = speeds[1] * t
    path = speeds[0] / speeds[1] * np.stack((np.sin(turn), 1.0 - np.cos(turn)), axis=-1)
    values = np.column_stack((path, turn, *np.broadcast_to(speeds, (len(t), 2)).T))
    values[:, :2] = np.round(values[:, :2], 1) if place == "rounded" else values[:, :2] * (place != "at 0")
    values[:, 2] *= place != "heading 0"
    motion = travelled(t, values, True, None)
    assert np.abs(motion.twist - [0.02, 0.0, 0.03]).max() < 1e-3
    assert any("used" in note for note in motion.notes)
    exact = travelled(t, np.column_stack((path, turn, 0.0 * values[:, 3:])), True, None)
    assert exact.notes == ()


def test_what_no_robot_drives_is_no_motion_and_a_mecanum_or_a_fast_car_is_one() -> None:
    t = np.arange(0.0, 20.0, 0.1)
    steps = np.stack((0.03 * np.ones(199), np.full(199, 1.0), np.zeros(199)), axis=-1)
    none = np.zeros(199, dtype=bool)
    assert unlike_a_robot(t, steps, none) == "it moves sideways at 10 m/s: its heading is not that of the body"
    assert not unlike_a_robot(t, steps * (1.0, 0.1, 1.0), none)
    t = np.arange(0.0, 20.0, 0.1)
    fast = np.tile((2.5, 0.0, 0.0), (199, 1))  # 25 m/s, evenly
    assert not unlike_a_robot(t, fast, np.zeros(199, dtype=bool))
    jumps = np.arange(199) % 10 == 0
    words = unlike_a_robot(t, np.where(jumps[:, None], fast, 0.0), jumps)
    assert words == "10% of its steps are jumps at more than 10 m/s"


# ---- real bags ----


@pytest.mark.parametrize(
    ("bag", "topic"),
    [
        ("strangers/controller_twist.bag", "/scan"),
        ("strangers/pimouse.bag", "/odom"),
        ("strangers/odometry_in_tf.bag", "/tf:odom:base_footprint"),
        ("turtlebot4/tb4_mcap.mcap", "/odom"),
        ("halls/edmonton.mcap", "/odom"),
        ("fr079/fr079.mcap", "/odom"),
        ("aces/aces.mcap", "/odom"),
    ],
)
def test_no_healthy_odometry_is_lost_and_no_controller_is_taken(bag: str, topic: str) -> None:
    assert choose(open_log([real_log(bag)]), make_robot({})).of("wheels") == (topic,)


@pytest.mark.parametrize("bag", ["setpoints.bag", "marker_in_camera.bag", "sideways.bag"])
def test_bags_of_strangers_without_a_motion_of_the_robot_are_refused(bag: str, tmp_path: Path) -> None:
    done = locfuse("compare", real_log(f"strangers/{bag}"), "-o", tmp_path / "out", "--write", "json")
    assert done.exit_code == 3
    assert done.stderr.startswith("void: wheels: /")


def test_the_scans_of_a_robot_whose_controller_was_recorded_give_its_path() -> None:
    log = real_log("strangers/controller_twist.bag")
    lrf = reported("run", log, "--sensors", "lrf", "--align", "origin", "--no-advice").rows["lrf"]
    assert lrf["position_rmse_m"] < 0.03


def test_speeds_along_the_frame_of_the_poses_turn_nothing_and_no_reading_is_lost_to_swapped_stamps() -> None:
    """74 pairs of neighbours of this bag were recorded together with their stamps swapped."""
    log = open_log([real_log("strangers/world_frame_twist.bag")])
    stream = log.stream("/gazebo_odom")
    poses = pose_and_speed(stream, WheelSettings())
    reading = read_wheels(stream, WheelSettings())
    assert reading.dropped == {}
    end = se2.compose(poses[0, :3], reading.wheels.pose[-1])
    assert np.hypot(*(end - poses[-1, :3])[:2]) < 0.1
    assert any("along the axes of its poses" in note for note in reading.notes)


# ---- wheels first, and scans by their name ----


def wheels_and_laser(path: Path) -> Path:
    """Wheels of 0.05 m, 0.3 m apart, at a changing speed, and the scans of the same drive in closed form."""
    t = np.arange(0.0, 30.0, 0.02)
    rolled = 0.35 * t - 0.6 * (np.cos(0.4 * t) - 1.0)  # rad of the body's turn, at a radius of 1.2 m
    angle = np.stack((rolled * (1.2 - 0.15) / 0.05, rolled * (1.2 + 0.15) / 0.05), axis=-1)
    return log_of(path, joint_states(t, angle), scans_of(t[::10], on_circle(rolled[::10], 1.2)))


def test_wheels_whose_size_nobody_says_come_first_in_headline_and_next(tmp_path: Path) -> None:
    log = wheels_and_laser(tmp_path / "x.mcap")
    done = reported("compare", log, "-v", "--write", "json,md", "--no-advice")
    report = done.report
    assert report["headline"].startswith(
        "Wheel angles are in /joint_states but radius and track are unknown: "
        f"`locfuse init {log} -o robot.toml` asks for them."
    )
    assert "scan matching" in done.rows
    assert "odometry" not in done.rows
    assert "odometry" not in json.dumps(report["verdicts"]) + report["headline"]
    assert "scan matching" in (done.out / "report.md").read_text()
    assert "scan matching" in done.stdout
    assert "of the same scans, which count twice" in done.stderr
    info = locfuse("info", log).stdout
    assert f"locfuse init {log} -o robot.toml" in info[info.index("\nnext") :]


def test_radius_and_track_by_the_scans_are_offered_and_bring_the_wheels_in(tmp_path: Path) -> None:
    log = wheels_and_laser(tmp_path / "x.mcap")
    known = json.loads(locfuse("info", log, "--json").stdout)
    (found,) = (f for f in known["findings"] if f["code"] == "geometry")
    fixes = dict(fix.split("=") for fix in found["fixes"])
    assert float(fixes["wheels.radius"]) == pytest.approx(0.05, rel=0.02)
    assert float(fixes["wheels.track"]) == pytest.approx(0.3, rel=0.05)
    assert "1 sigma" in found["source"]
    written = locfuse("init", log)
    assert "fill in wheels.radius, wheels.track" in written.stderr
    assert "topic = " not in written.stdout.partition("[wheels]")[2].partition("[")[0]
    robot = tmp_path / "robot.toml"
    robot.write_text(written.stdout)
    sets = [word for fix in found["fixes"] for word in ("--set", fix)]
    told = json.loads(locfuse("info", log, "--robot", robot, *sets, "--json").stdout)
    assert told["roles"]["wheels"]["topics"] == ["/joint_states"]


@pytest.mark.parametrize(("track", "said"), [(0.3, False), (0.15, True)], ids=["right", "half"])
def test_encoders_that_are_told_a_wrong_track_do_not_lose_to_scan_matching_without_a_word(
    track: float, said: bool, tmp_path: Path
) -> None:
    log = wheels_and_laser(tmp_path / "x.mcap")
    told = ("--set", "wheels.radius=0.05", "--set", f"wheels.track={track}", "--set", "lrf.x=0.0")
    report = reported("compare", log, *told, "--sensors", "odometry").report
    words = [note for note in report["notes"] if "by matching the scans" in note]
    assert bool(words) == said
    if said:
        assert "--set wheels.topic=/scan" in words[0]
        assert "`locfuse calibrate`" in words[0]


def test_a_gate_may_name_a_configuration_of_two_words(tmp_path: Path) -> None:
    log = log_of(tmp_path / "x.mcap", scans_of(T, TRUTH))
    gates = [word for m in (5, 0) for word in ("--fail-if", f"reference.scan matching.position_rmse_m > {m}")]
    done = locfuse("compare", log, "--no-advice", "-o", tmp_path / "out", *gates)
    assert done.exit_code == 4
    assert re.findall("gate: .* > (.):", done.stderr) == ["0"]


# --- without a laser the motion is taken that explains what gyro, compass or fixes saw

AT = np.arange(0.0, 40.0, 0.1)
TURN = 1.5 * np.sin(0.3 * AT)  # rad; 1 m/s along it
STEP = np.stack((np.cos(TURN), np.sin(TURN)), axis=-1) * 0.1
WAY = np.column_stack((np.cumsum(STEP, axis=0), TURN))
OTHER = np.column_stack((0.3 * AT, 0.0 * AT, 0.9 * np.cos(0.8 * AT) - 0.9))  # of another robot
METRES_PER_DEGREE = 111_320.0


def imu(turn: Array = TURN, late_s: float = 0.0) -> list[Said]:
    rows = (
        {"angular_velocity": {"z": rate}, "orientation": turned(heading)}
        for rate, heading in zip(np.gradient(turn, AT).tolist(), turn.tolist(), strict=True)
    )
    return messages("/imu", "sensor_msgs/msg/Imu", AT + late_s, rows, "imu")


def fixes(places: Array) -> list[Said]:
    rows = (
        {"latitude": y / METRES_PER_DEGREE, "longitude": x / METRES_PER_DEGREE}
        for x, y, _ in places[::10].tolist()
    )
    return messages("/fix", "sensor_msgs/msg/NavSatFix", AT[::10], rows, "gps")


def speeds(topic: str, turn: Array, frame: str | None = "base_link") -> list[Said]:
    return twists(AT, topic, 1.0, np.gradient(turn, AT), frame)


# ---- the shares ----


def wheels_of(poses: Array) -> Wheels:
    from locfuse.fusion import se2

    return Wheels.from_twists(AT, se2.log(se2.between(poses[:-1], poses[1:])), 0.3, 0.0)


def test_a_motion_explains_its_own_turns_and_ways_and_a_standing_one_none() -> None:
    true, still = wheels_of(WAY), wheels_of(np.zeros_like(WAY))
    assert turns_explained(true, AT, TURN) == pytest.approx(1.0, abs=1e-9)
    assert turns_explained(true, AT + 0.5, TURN) == pytest.approx(1.0, abs=0.01)  # a late clock
    assert turns_explained(true, AT, -TURN) == pytest.approx(1.0, abs=1e-9)  # an axis that points down
    assert distances_explained(true, AT, WAY[:, :2]) == pytest.approx(1.0, abs=1e-9)
    assert turns_explained(still, AT, TURN) == 0.0
    assert distances_explained(still, AT, WAY[:, :2]) == 0.0


def test_half_of_every_turn_explains_three_quarters_and_a_sensor_at_rest_nothing() -> None:
    half = wheels_of(np.column_stack((WAY[:, :2], 0.5 * TURN)))
    assert turns_explained(half, AT, TURN) == pytest.approx(0.75, abs=0.01)
    true = wheels_of(WAY)
    assert turns_explained(true, AT, 0.01 * TURN) is None
    assert distances_explained(true, AT, 0.1 * WAY[:, :2]) is None


# ---- which topic is taken ----


def test_of_two_odometries_of_one_kind_the_gyro_chooses_and_without_it_the_user_must(tmp_path: Path) -> None:
    both = odometry(AT, OTHER, "/odom1"), odometry(AT, WAY, "/odom2")
    choice = chosen(tmp_path, *both, imu())
    assert choice.of("wheels") == ("/odom2",)
    (note,) = choice.notes
    assert note.words.startswith("/odom2 is used: /odom1 explains ")
    assert "of the turning of /imu; it explains 100% of the turning of /imu" in note.words
    assert note.fixes == ("wheels.topic=/odom2",)
    with pytest.raises(LocfuseError, match="2 topics that fit: /odom1, /odom2"):
        chosen(tmp_path, *both)


def test_measured_speeds_come_before_an_odometry_that_does_not_turn_as_the_gyro_does(tmp_path: Path) -> None:
    choice = chosen(tmp_path, odometry(AT, OTHER), speeds("/base_speed", TURN), imu(late_s=0.4))
    assert choice.of("wheels") == ("/base_speed",)
    assert "/odom explains" in choice.notes[0].words
    assert chosen(tmp_path, odometry(AT, WAY), speeds("/base_speed", OTHER[:, 2]), imu()).of("wheels") == (
        "/odom",
    )


@pytest.mark.parametrize("half", [False, True], ids=["it never moves", "it ends half-way"])
def test_an_odometry_that_does_not_go_as_far_as_the_fixes_gives_way(half: bool, tmp_path: Path) -> None:
    straight = np.column_stack((1.0 * AT, 0.0 * AT, 0.0 * AT))
    bad = odometry(AT[:150], straight[:150]) if half else odometry(AT, np.zeros_like(WAY))
    choice = chosen(tmp_path, bad, speeds("/base_speed", 0.0 * AT), fixes(straight))
    assert choice.of("wheels") == ("/base_speed",)
    assert "of the way between the fixes of /fix" in choice.notes[0].words


def test_where_nothing_judges_two_motions_the_better_kind_is_taken_and_said_to_be_unjudged(tmp_path: Path) -> None:
    choice = chosen(tmp_path, odometry(AT, WAY), speeds("/base_speed", OTHER[:, 2]))
    assert choice.of("wheels") == ("/odom",)
    assert "of the motion by /base_speed; nothing shows which is right" in choice.notes[0].words
    assert chosen(tmp_path, odometry(AT, WAY), speeds("/base_speed", TURN)).notes == []


@pytest.mark.parametrize(
    ("said", "words"),
    [
        ([odometry(AT, OTHER), speeds("/speed", TURN)], "/odom is used: it explains 0% of the motion by /speed"),
        ([odometry(AT[:200], WAY[:200]), imu()], "The motion by /odom covers 19.9 s of the 39.9 s of this log. "),
        ([odometry(AT, 0.0 * WAY), speeds("/cmd_vel", TURN)], "The robot does not move in this log"),
    ],
    ids=["two disagree", "it ends half-way", "all that was measured stands"],
)
def test_what_makes_figures_doubtful_comes_before_them(said: list[list[Said]], words: str, tmp_path: Path) -> None:
    log = log_of(tmp_path / "x.mcap", *said)
    done = ok("compare", log, "--no-advice", "-o", tmp_path / "out")
    assert done.stdout.startswith(words)
    assert ("next:" in locfuse("init", log).stderr) == ("not move" not in words)


def test_a_command_is_taken_only_where_nothing_was_measured_and_of_two_that_of_the_gyro(tmp_path: Path) -> None:
    command = speeds("/cmd_vel", TURN, None)
    assert chosen(tmp_path, odometry(AT, OTHER), command, imu()).of("wheels") == ("/odom",)
    alone = chosen(tmp_path, command, imu())
    assert alone.of("wheels") == ("/cmd_vel",)
    assert alone.notes[0].is_fault
    said = speeds("/a/cmd_vel", OTHER[:, 2], None), speeds("/b/cmd_vel", TURN, None)
    choice = chosen(tmp_path, *said, imu())
    assert choice.of("wheels") == ("/b/cmd_vel",)
    assert "/a/cmd_vel explains" in choice.notes[0].words


def test_a_gyro_that_no_motion_explains_judges_nothing(tmp_path: Path) -> None:
    noise = np.cumsum(np.random.default_rng(3).normal(0.0, 0.4, len(AT)))
    choice = chosen(tmp_path, odometry(AT, WAY), speeds("/base_speed", TURN), imu(noise))
    assert choice.of("wheels") == ("/odom",)


def test_what_was_read_to_choose_is_not_read_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from locfuse.cli.analysis import load as loading

    log = log_of(tmp_path / "x.mcap", odometry(AT, OTHER, "/odom1"), odometry(AT, WAY, "/odom2"), imu())
    monkeypatch.setattr(loading, "read_wheels", lambda *_: pytest.fail("the wheels are read twice"))
    assert load([log], LogOptions()).choice.of("wheels") == ("/odom2",)


def test_an_odometry_that_holds_other_sensors_by_its_name_says_so(tmp_path: Path) -> None:
    (note,) = chosen(tmp_path, odometry(AT, WAY, "/odometry/filtered"), imu()).notes
    assert note.words.startswith("/odometry/filtered already holds other sensors (IMU, GPS), by its name")
    assert chosen(tmp_path, odometry(AT, WAY, "/odometry/wheel"), imu()).notes == []
