"""Advice in commands: what `info --check` tries, what --no-advice leaves out, why a command exits with 3."""

import json
import math
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest
from commands import locfuse, ok, reported
from lock_step import simulated
from msgspec.structs import replace
from present import present
from trap_logs import COMPASS, SCAN, TRUTH, WHEELS, Change, Drive, S, recorded, seconds
from traps import changed, each, elsewhere, field, gyro, late, short_metre, upside_down

from locfuse.cli.analysis.load import start_error
from locfuse.fusion import se2
from locfuse.sample_logs.table import RawMessage


def test_info_check_says_what_its_fix_did_and_without_advice_nothing_is_fused_again(tmp_path: Path) -> None:
    hanging = recorded(tmp_path, upside_down)
    done = locfuse("info", hanging, "--check")
    assert done.exit_code == 3
    tried = done.stdout.partition("tried by fusing")[2]
    (line,) = (line for line in tried.splitlines() if line.startswith("Warning: lrf: "))
    assert "mounted upside-down" in line
    assert "error" in line.partition("Fix (tried with")[2]
    assert "--set lrf.flipped=true" in line
    assert "tried by fusing" not in locfuse("info", hanging, "--check", "--no-advice").stdout
    lost = reported("compare", hanging, "--no-advice", code=3)  # lost, and said so
    assert lost.report["findings"] is None
    assert not (lost.out / "fixes.toml").exists()


def test_a_gyro_in_degrees_is_read_with_the_fixes_of_compare(tmp_path: Path) -> None:
    log = recorded(tmp_path, gyro(np.eye(3), angular_velocity__z=math.degrees))
    done = reported("compare", log, "-q")
    assert "gyro" in done.report["absent"]
    (one,) = (f for f in done.report["findings"] if f["role"] == "gyro")
    assert (one["fixes"], one["tried"]) == (["gyro.unit=deg"], None)
    files = (done.out / "robot.toml", "--robot", done.out / "fixes.toml")
    again = reported("compare", log, "-q", "--no-advice", "--robot", *files)
    assert "gyro" in again.report["configurations"]


@pytest.mark.parametrize("command", ["run", "compare"])
def test_quiet_commands_that_exit_with_3_say_why_on_one_line(command: str, tmp_path: Path) -> None:
    done = reported(command, recorded(tmp_path, elsewhere), "-q", "--no-advice", code=3)
    (line,) = done.stderr.splitlines()
    assert line.startswith("void: the truth starts 3.26 m from where the drive starts")


def test_a_truth_that_begins_metres_later_has_begun_where_the_robot_is_by_then() -> None:
    drive, robot = simulated(5, sets=("camera.enabled=false", "lrf.enabled=false"))
    unstated, truth = replace(robot, start_given=False), drive.truth
    assert truth is not None
    late = slice(int(np.searchsorted(drive.wheels.driven(truth.t), 2.0)), None)
    theta = present(truth.theta)[late]
    pose = np.column_stack((truth.xy[late], theta))
    xy = se2.transform(pose, np.broadcast_to([0.3, -0.1], truth.xy[late].shape))  # of a marker on the robot
    later = replace(truth, t=truth.t[late], xy=xy, theta=theta, point=(0.3, -0.1))
    assert np.hypot(*(later.xy[0] - truth.xy[0])) > 1.5
    assert start_error(unstated, replace(drive, truth=later)) == pytest.approx(0.0, abs=0.2)
    elsewhere_too = replace(later, xy=xy + np.array([3.0, 4.0]))
    assert start_error(unstated, replace(drive, truth=elsewhere_too)) == pytest.approx(5.0, abs=0.2)
    assert start_error(robot, replace(drive, truth=elsewhere_too)) is None
    vague = replace(robot, start=replace(robot.start, sigma_xy=2.0))
    moved = replace(truth, xy=truth.xy + 5.0)
    assert start_error(robot, replace(drive, truth=moved)) == pytest.approx(np.hypot(5.0, 5.0), abs=0.1)
    assert start_error(vague, replace(drive, truth=replace(moved, sigma=2.0))) is None


def test_a_truth_that_jumps_all_the_time_judges_nothing(tmp_path: Path) -> None:
    """A tracker that takes one of two bodies for the robot, in turn, ten times a second."""
    log = recorded(
        tmp_path,
        each(
            TRUTH,
            lambda m: changed(
                m, **{"pose.position.x": m.fields["pose.position.x"] + 4.0 * (int(seconds(m) * 10) % 2)}
            ),
        ),
    )
    done = locfuse("info", log, "--check")
    assert done.exit_code == 3
    assert "by more than the wheels rolled" in done.stdout
    for command in ("run", "compare"):
        found = reported(command, log, "--no-advice", code=3)
        assert "by more than the wheels rolled" in found.stdout + found.stderr
        assert {v["code"] for v in found.report["validity"] if v["void"]} == {"jump"}
        assert all(v["drift_5m"] is None for v in found.rows.values())
        assert all(v["void"]["figures"]["position_rmse_m"] > 0.5 for v in found.rows.values())


@pytest.mark.usefixtures("jobs_in_this_process")
def test_several_logs_of_which_one_is_void_exit_with_3(tmp_path: Path) -> None:
    void = Drive()
    elsewhere(void)
    logs = [d.record(tmp_path / f"{name}.mcap") for name, d in (("right", Drive()), ("void", void))]
    done = locfuse("compare", *logs, "-q", "-o", tmp_path / "out", "--write", "json", "--sensors", "compass")
    assert done.exit_code == 3
    assert [line for line in done.stderr.splitlines() if line.startswith("lost:")] == []
    (line,) = (line for line in done.stderr.splitlines() if line.startswith("void:"))
    assert line.startswith("void: void: the truth starts 3.26 m from where the drive starts")
    assert "the best in 1 of 1 logs. 1 void." in done.stdout
    logs_of = json.loads((tmp_path / "out" / "summary.json").read_text())["logs"]
    assert [len(logs_of[name]["void"]) for name in ("right", "void")] == [0, 1]


def test_where_every_error_is_void_no_sensor_gets_a_verdict_and_the_start_is_the_fix(tmp_path: Path) -> None:
    done = reported("compare", recorded(tmp_path, elsewhere), code=3)
    report = done.report
    assert {v["verdict"] for v in report["verdicts"].values()} == {"no verdict"}
    assert len(report["verdicts"]) > 1
    assert done.stdout.count("All errors of this log are void.") == 1  # once for all sensors
    assert report["credit"] is None  # nor does it count in the mean over several logs
    assert {fix.split("=")[0] for fix in report["fixes"]} >= {"start.x", "start.y", "start.theta_deg"}


def wheels_and_truth(drive: Drive) -> None:
    drive.drop(COMPASS, SCAN)
    del drive.tables["compass"], drive.tables["lrf"]


def test_a_log_with_wheels_and_truth_alone_gets_the_fix_of_its_start(tmp_path: Path) -> None:
    log = recorded(tmp_path, elsewhere, wheels_and_truth)
    done = reported("compare", log, code=3)
    assert list(done.rows) == ["odometry"]
    assert {fix.split("=")[0] for fix in done.report["fixes"]} >= {"start.x", "start.y", "start.theta_deg"}
    fixed = ("--robot", done.out / "robot.toml", "--robot", done.out / "fixes.toml")
    assert reported("compare", log, *fixed).rows["odometry"]["position_rmse_m"] < 0.5


def test_info_init_and_compare_set_a_late_truth_and_measure_the_start_by_its_clock(tmp_path: Path) -> None:
    """With the wheels alone beside it no third clock shows which is late: all three commands take the truth's."""
    log, file = recorded(tmp_path, elsewhere, late(TRUTH, 0.5), wheels_and_truth), tmp_path / "robot.toml"
    assert "--set truth.time_offset=" in ok("info", log).stdout.partition("\nnext\n")[2]
    ok("init", log, "-o", file)
    fixes = dict(fix.split("=") for fix in reported("compare", log, code=3).report["fixes"])
    robot = tomllib.loads(file.read_text())
    assert robot["truth"]["time_offset"] == pytest.approx(float(fixes["truth.time_offset"]), abs=0.02)
    assert robot["truth"]["time_offset"] == pytest.approx(-0.5, abs=0.05)
    assert robot["start"]["theta_deg"] == pytest.approx(float(fixes["start.theta_deg"]), abs=1.0)
    again = reported("compare", log, "--robot", file).report["fixes"]
    assert not any(fix.startswith(("start.", "truth.time_offset")) for fix in again)


def rare(topic: str, step: int) -> Change:
    """Only every so many messages of a topic."""

    def change(drive: Drive) -> None:
        kept = drive.on(topic)[::step]
        drive.drop(topic)
        drive.add(kept)

    return change


@pytest.mark.parametrize(
    ("topic", "step", "words"),
    [
        (TRUTH, 120, "truth: it has 3 poses in the 30.4 s of the drive, too few"),
        (WHEELS, 700, "wheels: /joint_states: 2 readings in 28.0 s, one each 28.0 s"),
    ],
)
def test_what_is_too_rare_judges_and_charges_nothing(tmp_path: Path, topic: str, step: int, words: str) -> None:
    log = recorded(tmp_path, rare(topic, step))
    said = locfuse("info", log).stdout.partition("would spoil an estimate\n")[2].partition("\n\n")[0]
    assert said.splitlines()[0].startswith(f"  {words}")
    assert all(line.startswith("    fix: --set truth.topic=none") for line in said.splitlines()[1:])
    done = reported("compare", log, code=3)
    assert done.stdout.startswith(f"No verdict on this log: {words}")
    assert not done.report["findings"]
    assert {v["verdict"] for v in done.report["verdicts"].values()} == {"no verdict"}


def test_one_pose_before_the_drive_is_too_few_and_no_other_clock(tmp_path: Path) -> None:
    said = locfuse("info", recorded(tmp_path, rare(TRUTH, 400), late(TRUTH, -1.0))).stdout
    assert "truth: it has 1 pose, 0 of them in the 30.4 s of the drive, too few to measure errors" in said
    assert "truth.time_offset" not in said


def test_readings_of_another_year_are_named_with_the_offset_and_not_used(tmp_path: Path) -> None:
    done = reported("compare", recorded(tmp_path, late(SCAN, -1e8)))
    assert "not used: lrf: none of its 183 readings lies within the 30.4 s of the drive" in done.stderr
    assert "--set lrf.time_offset=100000000.0" in done.stderr


def test_readings_recorded_at_another_time_spoil_a_check_until_their_offset_is_set(tmp_path: Path) -> None:
    def hour(m: RawMessage) -> RawMessage:
        return m._replace(stamp_ns=m.stamp_ns + 3600 * S, log_ns=m.log_ns + 3600 * S)

    log = recorded(tmp_path, each(SCAN, hour))
    done = locfuse("info", log, "--check", "--no-advice")
    assert done.exit_code == 3
    (offset,) = re.findall(r"fix: --set (lrf\.time_offset=-3\d+\.\d+)", done.stdout)
    assert locfuse("info", log, "--check", "--no-advice", "--set", offset).exit_code == 0


def test_a_drive_of_two_seconds_judges_no_sensor(tmp_path: Path) -> None:
    topics = (WHEELS, COMPASS, SCAN, TRUTH)
    log = recorded(tmp_path, *(each(topic, lambda m: m if seconds(m) < 2.0 else None) for topic in topics))
    assert "too short to judge a sensor" in ok("info", log).stdout
    assert "too short to judge a sensor" in ok("init", log, "-o", tmp_path / "robot.toml").stderr
    assert reported("compare", log).stdout.startswith("The drive lasts 2.0 s")


def test_a_laser_whose_ranges_are_short_gets_its_scale_and_is_called_doubtful_before(tmp_path: Path) -> None:
    """Its ranges are 0.9 times the distances: what puts them right is 1 / 0.9."""
    done = reported("compare", recorded(tmp_path, short_metre), "--write", "json,md,html")
    fixes = dict(fix.split("=") for fix in done.report["fixes"])
    assert float(fixes["lrf.range_scale"]) == pytest.approx(1.0 / 0.9, abs=0.01)
    doubts = [v for v in done.report["validity"] if not v["void"]]
    assert any(v["message"].startswith("lrf: ") and "lrf.range_scale" in v["message"] for v in doubts)
    for text in (done.stdout, (done.out / "report.md").read_text()):
        assert text.index("Warning: lrf") < text.index("rmse")
        assert text.count("too short by the truth") == 1  # not as a finding again
    assert "<strong>Warning:</strong>" in (done.out / "report.html").read_text()


NO_FIELD = field(COMPASS, **dict.fromkeys(("magnetic_field.x", "magnetic_field.y"), math.nan))
EMPTY = [
    *(
        (
            field(SCAN, ranges=lambda r, v=value: np.full(len(r), v, np.float32)),
            "lrf",
            f"no line in {{n}} of {{n}} readings: its ranges are 100% {words}. Check the sensor",
            0,
        )
        for value, words in ((math.nan, "NaN"), (math.inf, "inf"), (0.0, "zero"))
    ),
    (
        NO_FIELD,
        "compass",
        "none of {n} readings can be used: {n} hold NaN, Inf or a quaternion of zeros. Check the sensor",
        3,
    ),
]


@pytest.mark.parametrize(("change", "sensor", "words", "code"), EMPTY, ids=["nan", "inf", "zero", "compass"])
def test_a_sensor_whose_readings_are_empty_is_named_by_info_and_compare_alike(
    change: Change, sensor: str, words: str, code: int, tmp_path: Path
) -> None:
    log, n = recorded(tmp_path, change), len(Drive().on({"lrf": SCAN, "compass": COMPASS}[sensor]))
    assert f"{sensor}: {words.format(n=n)}" in ok("info", log).stdout
    told = reported("compare", log, code=code).stdout
    assert f"{sensor}: {words.format(n=n)}" in told
    assert f"{sensor} no verdict" in told
    assert "lrf.range_scale" not in told


@pytest.mark.parametrize("command", ["run", "compare"])
def test_stamps_that_stand_still_get_recording_times_and_no_other_fix(command: str, tmp_path: Path) -> None:
    log = recorded(tmp_path, each(SCAN, lambda m: m._replace(stamp_ns=m.stamp_ns // 10**9 * 10**9)))
    done = reported(command, log)
    assert done.report["fixes"] == ["order=recorded"]
    assert "Fix (not tried): --set order=recorded" in done.stdout


def test_stamps_that_were_recorded_at_once_too_get_no_fix(tmp_path: Path) -> None:
    def once(m: RawMessage) -> RawMessage:
        t_ns = m.stamp_ns // 10**9 * 10**9
        return m._replace(stamp_ns=t_ns, log_ns=t_ns + 10**6)

    log = recorded(tmp_path, each(SCAN, once))
    assert "order=recorded" not in reported("compare", log).stdout
    assert "lrf: /scan: messages with the header stamp of the one before have its" in ok("info", log).stdout
