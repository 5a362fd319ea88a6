"""Which motion of a log is the robot's: by the share of a scan that lies on one a second before, else by kind."""

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

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
from locfuse.cli.analysis.topics import Choice
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


def seen_from(poses: Array) -> Array:
    """The ranges (n, beams) of the laser from poses (n, 3)."""
    rng = np.random.default_rng(1)
    return np.stack([ranges_of(pose, ROOM, rng) for pose in poses])


def pairs_of(ranges: Array, t: Array, motion: WheelReading, **lrf: Any) -> ScanPairs:
    return present(scan_pairs(scan_stream(stamps(t), ranges), laser_of(LrfSettings(**lrf)), [motion]))


def moved_by(poses: Array, t: Array = T) -> WheelReading:
    twist = se2.log(se2.between(poses[:-1], poses[1:]))
    return WheelReading(Wheels.from_twists(t, twist, 0.3, 0.0), stamps(t[:1])[0], {}, ())


@pytest.mark.parametrize(
    ("yaw", "order", "place"),
    [
        (0.0, 1, {}),
        (np.pi, 1, {}),
        (np.radians(-135.0), 1, {}),
        (np.radians(-135.0), -1, {}),
        (0.0, 1, {"x": -0.2, "y": 0.3}),
        (0.0, -1, {}),
    ],
    ids=["as configured", "turned", "turned aslant", "aslant and upside down", "at a wrong place", "upside down"],
)
def test_points_agree_with_the_true_motion_however_the_laser_sits_and_less_with_one_twice_as_far(
    yaw: float, order: int, place: dict[str, float]
) -> None:
    """Nor does a late clock matter. Upside down, a beam to the left is reported as one to the right."""
    true = moved_by(TRUTH)
    ranges = seen_from(se2.compose(TRUTH, np.broadcast_to([0.0, 0.0, yaw], TRUTH.shape)))[:, ::order]
    pairs = pairs_of(ranges, T, true, **place)
    assert min(pairs.of(true), pairs.matched()) > 0.74
    assert pairs.still < pairs.of(true) - 0.3
    assert pairs.of(moved_by(TRUTH * (2.0, 2.0, 1.0))) < pairs.of(true) - 0.1
    late = true._replace(epoch_ns=true.epoch_ns + 300_000_000)
    assert pairs.of(late) > pairs.of(true) - 0.1


@pytest.mark.parametrize("late_s", [-25.0, 37.0])
def test_a_clock_that_is_far_off_does_not_speak_against_the_motion(late_s: float) -> None:
    t, rng = np.arange(0.0, 60.0, 0.2), np.random.default_rng(4)
    turns = np.repeat(rng.normal(0.0, 0.6, len(t) // 10), 10)[1:]
    poses = se2.chain(0.2 * np.stack((0.05 + 0.0 * turns, 0.0 * turns, turns), axis=-1))
    true = moved_by(poses, t)
    pairs = pairs_of(seen_from(poses), t, true)
    late = true._replace(epoch_ns=true.epoch_ns + round(late_s * 1e9))
    assert pairs.of(late) > pairs.of(true) - 0.15
    assert pairs.share(pairs._by(late, np.zeros(5))) < pairs.of(true) - 0.3


# ---- which topic is taken ----


def seen(poses: Array = TRUTH, t: Array = T) -> list[Said]:
    return scans_of(t, poses)


def of_other_clock() -> list[Said]:
    """Scans whose stamps are not of the clock that the recording and the odometry have."""
    return [m._replace(log_time=ns) for m, ns in zip(scans_of(T - 1e6, TRUTH), stamps(T), strict=True)]


def frozen() -> list[Said]:
    """The first scan again and again."""
    return [seen()[0]._replace(log_time=ns) for ns in stamps(T)]


CM = TRUTH * (100.0, 100.0, 1.0)
OTHER_WAY = np.stack((0.9 * T, 0.0 * T, -0.4 * T), axis=-1)
EXCHANGED = se2.chain(se2.exp(se2.log(se2.between(TRUTH[:-1], TRUTH[1:]))[:, ::-1]))  # its speeds and its turns
IN_CM = "/odom, in cm as it seems (--set wheels.scale=0.01), is not how the robot moved"
COMMANDED, IN_ROOM = twists(T, "/controller_output_linear", 0.8, 0.0), twists(T, "/speed", 0.6, -0.2)
POSES = {"/marker/pose": "camera_link", "/setpoint": "map", "/slam/pose": "map"}
Case = tuple[Callable[[], list[list[Said]]], str, tuple[str, ...] | None]
BY_SCANS: dict[str, Case] = {  # messages, the topic that is taken, and words of the only note; None: of any number
    "it agrees": (lambda: [odometry(T, TRUTH), seen()], "/odom", ()),
    "a laser with a clock of its own": (lambda: [odometry(T, TRUTH), of_other_clock()], "/odom", ()),
    "a mirror image: the laser hangs": (lambda: [odometry(T, TRUTH * (1.0, -1.0, -1.0)), seen()], "/odom", None),
    "another motion": (
        lambda: [odometry(T, OTHER_WAY), seen()],
        "/scan",
        ("/scan is used: /odom is not how the robot moved: by it", "by matching the scans"),
    ),
    "centimetres": (lambda: [odometry(T, CM), seen()], "/scan", (IN_CM,)),
    "exchanged": (
        lambda: [odometry(T, EXCHANGED), seen()],
        "/scan",
        ("/odom, whose forward speed and turning rate look exchanged, is not how the robot moved",),
    ),
    "one of two": (
        lambda: [odometry(T, TRUTH, "/odom1"), odometry(T, TRUTH * (-1.0, 2.5, 1.0), "/odom2"), seen()],
        "/odom1",
        None,
    ),
    "it never moves": (lambda: [odometry(T, 0.0 * TRUTH), seen()], "/scan", ("/odom",)),
    "it ends half-way": (lambda: [odometry(T[:20], TRUTH[:20]), seen()], "/scan", ("/odom",)),
    "at rest": (lambda: [odometry(T, 0.0 * TRUTH), seen(0.0 * TRUTH)], "/odom", None),
    "a frozen laser": (lambda: [odometry(T, TRUTH), frozen()], "/odom", None),
    "a short log": (lambda: [odometry(T[:25], TRUTH[:25]), seen(TRUTH[:25], T[:25])], "/odom", None),
    "twists of any kind": (lambda: [COMMANDED, IN_ROOM, seen()], "/scan", ("/controller_output_linear", "/speed")),
    "a twist alone": (lambda: [IN_ROOM], "/speed", None),
    "poses of other things": (lambda: [poses_in(f, T, TRUTH, p) for p, f in POSES.items()], "/slam/pose", None),
}


def assert_taken(choice: Choice, topic: str, words: tuple[str, ...] | None) -> None:
    assert choice.of("wheels") == (topic,)
    if words is not None:
        assert len(choice.notes) == bool(words)
        assert all(word in choice.notes[0].words for word in words)
        if words and words[0].startswith(f"{topic} is used"):
            assert choice.notes[0].fixes == (f"wheels.topic={topic}",)


@pytest.mark.parametrize("case", BY_SCANS)
def test_the_motion_is_taken_that_agrees_with_the_laser(case: str, tmp_path: Path) -> None:
    said, topic, words = BY_SCANS[case]
    choice = chosen(tmp_path, *said())
    assert_taken(choice, topic, words)
    assert case != "it agrees" or "% of a scan's points agree with it" in choice.why["wheels"]


def test_an_odometry_that_is_named_or_gets_its_scale_is_used(tmp_path: Path) -> None:
    named = chosen(tmp_path, odometry(T, OTHER_WAY), seen(), wheels={"topic": "/odom"})
    scaled = chosen(tmp_path, odometry(T, CM), seen(), wheels={"scale": 0.01})
    assert named.of("wheels") == scaled.of("wheels") == ("/odom",)


def test_a_laser_that_freezes_for_some_time_does_not_judge_a_motion_there() -> None:
    ranges = seen_from(TRUTH)
    a, b = len(T) // 4, 3 * len(T) // 4
    ranges[a:b] = ranges[a]
    pairs = pairs_of(ranges, T, moved_by(TRUTH))
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
    assert not {word for word in ("truth.topic", "locfuse compare") if word in info.stdout}
    asked = locfuse("init", log, "-o", tmp_path / "robot.toml")
    assert (words in asked.stderr, "next:" in asked.stderr) == (True, False)


def test_where_no_sensor_is_beside_the_odometry_init_does_not_name_tune(tmp_path: Path) -> None:
    robot = tmp_path / "robot.toml"
    log = log_of(tmp_path / "x.mcap", odometry(T, TRUTH))
    done = locfuse("init", log, "-o", robot)
    assert f"next: locfuse compare {log} --robot {robot}" in done.stderr
    assert "locfuse tune" not in robot.read_text()
    assert locfuse("compare", log, "--robot", robot, "-o", tmp_path / "out").exit_code == 0


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
    fast = np.tile((2.5, 0.0, 0.0), (199, 1))  # 25 m/s, evenly
    assert not unlike_a_robot(t, fast, none)
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
    degrees = (places[::10] / METRES_PER_DEGREE).tolist()
    rows = ({"latitude": y, "longitude": x} for x, y, _ in degrees)
    return messages("/fix", "sensor_msgs/msg/NavSatFix", AT[::10], rows, "gps")


def speeds(topic: str, turn: Array, frame: str | None = "base_link") -> list[Said]:
    return twists(AT, topic, 1.0, np.gradient(turn, AT), frame)


# ---- the shares ----


def wheels_of(poses: Array) -> Wheels:
    return moved_by(poses, AT).wheels


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


STRAIGHT = np.column_stack((AT, 0.0 * AT, 0.0 * AT))
NOISE = np.cumsum(np.random.default_rng(3).normal(0.0, 0.4, len(AT)))
FAR = "of the way between the fixes of /fix"
BY_OTHERS: dict[str, Case] = {
    "two odometries": (
        lambda: [odometry(AT, OTHER, "/odom1"), odometry(AT, WAY, "/odom2"), imu()],
        "/odom2",
        ("/odom2 is used: /odom1 explains ", "of the turning of /imu; it explains 100% of the turning of /imu"),
    ),
    "speeds turn as the gyro": (
        lambda: [odometry(AT, OTHER), speeds("/v", TURN), imu(late_s=0.4)],
        "/v",
        ("/odom explains",),
    ),
    "the odometry does": (lambda: [odometry(AT, WAY), speeds("/v", OTHER[:, 2]), imu()], "/odom", None),
    "it never moves": (lambda: [odometry(AT, 0.0 * WAY), speeds("/v", 0.0 * AT), fixes(STRAIGHT)], "/v", (FAR,)),
    "it ends half-way": (
        lambda: [odometry(AT[:150], STRAIGHT[:150]), speeds("/v", 0.0 * AT), fixes(STRAIGHT)],
        "/v",
        (FAR,),
    ),
    "nobody judges": (
        lambda: [odometry(AT, WAY), speeds("/v", OTHER[:, 2])],
        "/odom",
        ("of the motion by /v; nothing shows which is right",),
    ),
    "they agree": (lambda: [odometry(AT, WAY), speeds("/v", TURN)], "/odom", ()),
    "a command beside what was measured": (
        lambda: [odometry(AT, OTHER), speeds("/cmd_vel", TURN, None), imu()],
        "/odom",
        None,
    ),
    "of two commands": (
        lambda: [speeds("/a/cmd_vel", OTHER[:, 2], None), speeds("/b/cmd_vel", TURN, None), imu()],
        "/b/cmd_vel",
        ("/a/cmd_vel explains",),
    ),
    "a gyro of noise": (lambda: [odometry(AT, WAY), speeds("/v", TURN), imu(NOISE)], "/odom", None),
    "other sensors by its name": (
        lambda: [odometry(AT, WAY, "/odometry/filtered"), imu()],
        "/odometry/filtered",
        ("/odometry/filtered already holds other sensors (IMU, GPS), by its name",),
    ),
    "wheels by its name": (lambda: [odometry(AT, WAY, "/odometry/wheel"), imu()], "/odometry/wheel", ()),
}


@pytest.mark.parametrize("case", BY_OTHERS)
def test_the_motion_is_taken_that_explains_what_gyro_or_fixes_saw(case: str, tmp_path: Path) -> None:
    said, topic, words = BY_OTHERS[case]
    assert_taken(chosen(tmp_path, *said()), topic, words)


def test_a_command_alone_is_a_fault_and_of_two_like_odometries_the_user_chooses(tmp_path: Path) -> None:
    alone = chosen(tmp_path, speeds("/cmd_vel", TURN, None), imu())
    assert (alone.of("wheels"), alone.notes[0].is_fault) == (("/cmd_vel",), True)
    with pytest.raises(LocfuseError, match="2 topics that fit: /odom1, /odom2"):
        chosen(tmp_path, odometry(AT, OTHER, "/odom1"), odometry(AT, WAY, "/odom2"))


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


def test_a_simulation_at_half_speed_is_covered_by_its_motion(tmp_path: Path) -> None:
    slow = [m._replace(log_time=10**18 + 2 * m.log_time) for m in odometry(AT, WAY)]
    done = ok("compare", log_of(tmp_path / "x.mcap", slow), "--no-advice", "-o", tmp_path / "out")
    assert "covers" not in done.stdout


def test_what_was_read_to_choose_is_not_read_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from locfuse.cli.analysis import load as loading

    log = log_of(tmp_path / "x.mcap", odometry(AT, OTHER, "/odom1"), odometry(AT, WAY, "/odom2"), imu())
    monkeypatch.setattr(loading, "read_wheels", lambda *_: pytest.fail("the wheels are read twice"))
    assert load([log], LogOptions()).choice.of("wheels") == ("/odom2",)
