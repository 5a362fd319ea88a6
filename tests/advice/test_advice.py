"""Advice on whole logs: what is wrong is named, obeying helps, and what was obeyed is not advised again."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bags import Said, cdr, header
from commands import locfuse, ok, refused, report_in, reported
from rewrite_log import rewritten
from rooms import ARENA, scan
from wheel_bags import log_of, odometry, stamps, turned

import locfuse as product
from benchmarks.consistency import LATE_CLOCK, MOVING, OFFSET, SCENARIO
from locfuse.cli.session.session import load
from locfuse.fusion.data import UsageError
from locfuse.sample_logs.scenario import load as scenario_of
from locfuse.sample_logs.simulate import on_truth, write_log

FAULTS = ("compass.offset_deg=-60", "lrf.time_offset=0.1")
PICTURES = "/omni/image/compressed"


def options(*sets: str) -> tuple[str, ...]:
    return tuple(word for one in sets for word in ("--set", one))


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A lap with compass and laser: the pictures would cost most of the time and are not what is wrong."""
    return rewritten(tmp_path_factory.mktemp("log") / "log.mcap", None, PICTURES)


@pytest.fixture(scope="module")
def half(log: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The first 30 s of the lap: enough for faults that one half of it tells as well."""
    return rewritten(tmp_path_factory.mktemp("half") / "log.mcap", source=log, keep=lambda _, t: t < 30.0)


@pytest.fixture(scope="module")
def faulty(log: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("faulty") / "out"
    ok("compare", log, *options(*FAULTS), "-o", out, "--write", "json,md", "-q")
    return out


def test_two_faults_are_named_with_their_values_and_the_answer_comes_first(faulty: Path) -> None:
    fixes = dict(fix.split("=") for fix in report_in(faulty)["fixes"])
    assert float(fixes["lrf.time_offset"]) == pytest.approx(0.0, abs=0.015)
    assert float(fixes["compass.offset_deg"]) == pytest.approx(-65.0, abs=1.0)
    assert {f["role"] for f in report_in(faulty)["findings"] if f["fixes"]} == {"lrf", "compass"}
    for finding in report_in(faulty)["findings"]:
        if finding["fixes"]:
            tried = finding["tried"]
            assert tried["after"]["position_rmse_m"] < 0.9 * tried["before"]["position_rmse_m"]
    headline = report_in(faulty)["headline"]
    assert headline.startswith("As configured the best is the ")
    assert "Set the fixes first." in headline
    assert headline in (faulty / "report.md").read_text()


def test_a_wrong_start_is_corrected_before_a_clock_is_judged_by_its_errors(half: Path) -> None:
    found = load(half, sets=("start.x=4", "start.y=3", "compass.time_offset=0.3")).findings()["findings"]
    first, second = (f for f in found if f["fixes"])
    assert (first["role"], first["fixes"]) == ("truth", ["start.x=1.500", "start.y=1.500"])
    assert (second["role"], second["code"]) == ("compass", "lag")
    assert second["tried"]["before"]["position_rmse_m"] < 0.5  # no longer the metres of the start


def test_obeying_helps_and_is_not_advised_again(log: Path, faulty: Path) -> None:
    files = ("--robot", faulty / "robot.toml", "--robot", faulty / "fixes.toml")
    again = reported("compare", log, *files)
    before = report_in(faulty)["configurations"]["all"]["position_rmse_m"]
    assert again.rows["all"]["position_rmse_m"] < 0.5 * before
    assert not again.report["fixes"]


def test_run_gives_the_same_findings_as_compare(log: Path, faulty: Path) -> None:
    assert reported("run", log, *options(*FAULTS)).report["findings"] == report_in(faulty)["findings"]


def test_fixes_of_an_earlier_result_go_and_fixes_that_are_given_stay(log: Path, faulty: Path) -> None:
    refusal = refused("compare", log, "--robot", faulty / "fixes.toml", "-o", faulty, "-q", code=2)
    assert "fixes.toml is an input and would be replaced" in refusal
    out = faulty.parent / "again"
    out.mkdir()
    for name in ("fixes.toml", "report.json"):
        (out / name).write_bytes((faulty / name).read_bytes())
    (out / "fixes-mine.toml").write_text("# somebody else's\n")
    ok("compare", log, "--no-advice", "-o", out, "--write", "json", "-q")
    assert [path.name for path in out.glob("fixes*")] == ["fixes-mine.toml"]


def test_a_track_too_little_off_to_be_reported_untried_is_found_without_truth(half: Path) -> None:
    """By 3 %: no residual complains, only the laser turns less than the wheels."""
    found = load(half, sets=("truth.topic=none", "wheels.track=0.618")).findings()
    ((key, value),) = (fix.split("=") for fix in found["fixes"])
    assert key == "wheels.track"
    assert float(value) == pytest.approx(0.6, abs=0.01)


@pytest.mark.parametrize("by", ["ranges", "camera"])
@pytest.mark.parametrize("swapped", [True, False])
def test_swapped_wheels_are_found_if_no_sensor_measures_turns(tmp_path: Path, by: str, swapped: bool) -> None:
    unread = {"/scan", "/compass", "/omni/image/compressed" if by == "ranges" else ""}
    lap = rewritten(tmp_path / "log.mcap", keep=lambda topic, t: t < 30.0 and topic not in unread)
    truth = load(lap).drive.truth
    assert truth is not None
    anchors, rng = {7: (0.0, 0.0), 8: (6.0, 0.0), 9: (0.0, 5.0)}, np.random.default_rng(1)
    rows = [
        f"{1.7e9 + t:.3f},{one},{np.hypot(*(xy - anchors[one])) + 0.05 * rng.normal():.3f}"
        for t, xy in zip(truth.t[5::10], truth.xy[5::10], strict=True)
        for one in anchors
    ]
    (tmp_path / "ranges.csv").write_text("\n".join(("t,id,range", *rows)))
    (tmp_path / "map.csv").write_text("id,x,y\n" + "\n".join(f"{i},{x},{y}" for i, (x, y) in anchors.items()))
    sets = [f"ranges.topic={tmp_path / 'ranges.csv'}", f"ranges.map={tmp_path / 'map.csv'}"] * (by == "ranges")
    sides = ("wheels.left=right_wheel_joint", "wheels.right=left_wheel_joint") if swapped else ()
    found = load(lap, sets=("truth.topic=none", *sets, *sides)).findings()
    right = ["wheels.left=left_wheel_joint", "wheels.right=right_wheel_joint"] if swapped else []
    assert [fix for fix in found["fixes"] if fix.startswith("wheels.")] == right


@pytest.mark.parametrize(("camera", "left_open"), [(False, True), (True, False)])
def test_a_compass_that_contradicts_the_start_is_left_open_where_nothing_locates(
    half: Path, tmp_path: Path, camera: bool, left_open: bool
) -> None:
    """A camera that sees a known landmark knows where the robot is; lines of a map that is grown do not."""
    sets = ("truth.topic=none", "start.x=0", "start.y=0", "start.theta_deg=0", "compass.offset_deg=-57")
    lap = tmp_path / "log.mcap"
    drive = rewritten(lap, None, "/scan", keep=lambda _, t: t < 30.0) if camera else half
    found = load(drive, sets=sets).findings()
    of_start = [f for f in found["findings"] if f["role"] == "start"]
    open_ = [f for f in of_start if "Nothing in this log says which" in f["message"]]
    assert len(open_) == left_open
    assert not any(fix.startswith("start.") for fix in found["fixes"])
    if left_open:
        assert "compass.offset_deg=-6" in open_[0]["message"]
        assert not any("compass.offset_deg" in fix for fix in found["fixes"])


@pytest.mark.parametrize("truth", [True, False])
def test_a_mount_that_the_filter_estimates_is_offered_as_it_finds_it(log: Path, half: Path, truth: bool) -> None:
    """Three centimetres aside, where one was thought likely: it is found, but only in the course of the drive."""
    drive, sets = (half, ()) if truth else (log, ("truth.topic=none",))
    found = load(drive, sets=("lrf.y=0.03", *sets)).findings()
    values = dict(fix.split("=") for fix in found["fixes"])
    assert float(values["lrf.y"]) == pytest.approx(0.0, abs=0.015)


@pytest.mark.parametrize("late", [0.0, 0.02])
def test_a_laser_20_ms_late_is_named_with_its_sigma_and_a_right_one_is_not(tmp_path: Path, late: float) -> None:
    """The direction of its map, drawn at the first scan, hides what the clock does: the path's shape tells it."""
    log = tmp_path / "log.mcap"
    write_log(scenario_of(SCENARIO, (*MOVING, LATE_CLOCK) if late else MOVING), 1001, on_truth, log)
    found = [f for f in load(log, sets=(OFFSET,)).findings()["findings"] if f["role"] == "lrf"]
    assert len(found) == bool(late)
    for finding in found:
        (fix,) = finding["fixes"]
        assert float(fix.removeprefix("lrf.time_offset=")) == pytest.approx(-late, abs=0.005)
        assert "s late (1 sigma: 0.002 s) against the wheels, the compass and the truth" in finding["message"]
        before, after = finding["tried"]["before"], finding["tried"]["after"]
        assert before["aligned"]
        assert after["position_rmse_m"] < before["position_rmse_m"]


@pytest.fixture(scope="module")
def with_pictures(tmp_path_factory: pytest.TempPathFactory) -> Path:
    log = tmp_path_factory.mktemp("pictures") / "log.mcap"
    write_log(scenario_of(SCENARIO), 3000, on_truth, log)
    return log


@pytest.mark.parametrize("wrong", ["lrf.range_scale=1.05", "wheels.radius=0.053"])
def test_bearings_to_a_mark_decide_whether_laser_or_wheels_are_wrong(with_pictures: Path, wrong: str) -> None:
    right = {"lrf.range_scale": 1.0, "wheels.radius": 0.05, "wheels.track": 0.6}
    found = load(with_pictures, sets=(OFFSET, "camera.sigma_deg=0.18", "truth.topic=none", wrong)).findings()
    fixes = dict(fix.split("=") for fix in found["fixes"])
    assert wrong.partition("=")[0] in fixes
    assert all(float(fixes[key]) == pytest.approx(right[key], rel=0.01) for key in right.keys() & fixes)
    assert not fixes.keys() & {"lrf.x", "lrf.y", "lrf.yaw_deg"}


def test_ranges_all_too_long_are_named_without_truth_where_nothing_else_looks_wrong(with_pictures: Path) -> None:
    sets = (OFFSET, "camera.sigma_deg=0.18", "truth.topic=none", "lrf.range_offset=0.05")
    (fix,) = (f for f in load(with_pictures, sets=sets).findings()["fixes"] if f.startswith("lrf."))
    assert float(fix.removeprefix("lrf.range_offset=")) == pytest.approx(0.0, abs=0.015)


def test_laser_and_wheels_that_differ_in_distance_are_both_named(half: Path) -> None:
    """The laser's own readings are predicted better by the wheels' distances, even if the wheels are wrong."""
    for wrong in (("lrf.range_scale=1.04",), ("wheels.radius=0.046", "wheels.track=0.552")):
        found = load(half, sets=("truth.topic=none", *wrong)).findings()
        assert not {fix.partition("=")[0] for fix in found["fixes"]} & {"lrf.range_scale", "wheels.radius"}
        (message,) = (f["message"] for f in found["findings"] if f["code"] == "distances")
        values = {k: float(v) for k, v in re.findall(r"(lrf.range_scale|wheels.radius)=([0-9.]+[0-9])", message)}
        right = "wheels.radius" if len(wrong) > 1 else "lrf.range_scale"
        assert values[right] == pytest.approx(0.05 if len(wrong) > 1 else 1.0, rel=0.02)
        assert len(values) == 2


# --- a robot that stands still for a whole log: nothing can be judged, and that is said instead of figures

SCAN, IMU = "sensor_msgs/msg/LaserScan", "sensor_msgs/msg/Imu"
T = np.arange(0.0, 6.01, 0.1)
ANGLES = np.radians(np.arange(-180.0, 180.0, 1.0))
SAID = "the robot does not move in this log, so no sensor can be judged"


def standing(path: Path) -> Path:
    """A robot in the middle of a room whose odometry is zero to the bit, with a laser and an IMU."""
    rng = np.random.default_rng(4)
    ranges = scan(ARENA, np.array([1.0, 1.0, 0.0]), ANGLES)
    said: list[Said] = []
    for ns in stamps(T):
        values = ranges + 0.01 * rng.normal(size=len(ANGLES))
        beams: dict[str, Any] = {"angle_min": ANGLES[0], "angle_increment": np.radians(1.0), "range_max": 10.0}
        said.append(Said("/scan", SCAN, cdr(SCAN, header=header(ns, "laser"), ranges=values, **beams), ns))
        sensed: dict[str, Any] = {"orientation": turned(0.001 * rng.normal()), "linear_acceleration": {"z": 9.81}}
        sensed["angular_velocity"] = {"z": 0.002 * rng.normal()}
        said.append(Said("/imu", IMU, cdr(IMU, header=header(ns, "imu"), **sensed), ns))
    return log_of(path, odometry(T, np.zeros((len(T), 3))), said)


def test_a_robot_at_rest_is_said_to_be_and_gets_no_fix_and_no_reference(tmp_path: Path) -> None:
    log = standing(tmp_path / "x.mcap")
    report = reported("compare", log).report
    assert report["headline"] == f"T{SAID[1:]}."
    assert not report["findings"]
    assert report["reference"] is None
    assert {v["verdict"] for v in report["verdicts"].values()} <= {"no effect seen", "no verdict"}
    assert SAID in " ".join(locfuse("info", log).stdout.split())
    with pytest.raises(UsageError, match="does not move"):
        product.load(log).compare(reference=True)


def test_a_lost_chunk_is_said_and_charged_to_no_sensor(log: Path, tmp_path: Path) -> None:
    """8 s of all topics are lost in the middle of the lap, in which the robot rounds a corner."""
    cut = rewritten(tmp_path / "log.mcap", source=log, keep=lambda _, t: not 23.4 < t < 31.4)
    found = load(cut).findings()
    (hole,) = (f for f in found["findings"] if f["role"] == "log")
    assert re.match(r"nothing was recorded from 23.4 s to 31.4 s, .* moved 2.4 m and turned 90°", hole["message"])
    assert [v["code"] for v in found["validity"]] == ["hole"]
    assert not found["fixes"]
    severe = [f for f in product.info(cut)["findings"] if f["severe"]]
    assert [f["message"] for f in severe] == [hole["message"]]
    assert "nothing was recorded from 23.4 s" in refused("calibrate", cut)


def test_a_start_that_is_metres_off_voids_the_errors_and_blames_no_sensor(log: Path, tmp_path: Path) -> None:
    """The first chunk is lost, and [start] is the pose at the start of the drive."""
    cut = rewritten(tmp_path / "log.mcap", source=log, keep=lambda _, t: t > 11.0)
    found = load(cut).compare(audits=False, smooth=False).report
    assert "the truth starts 2.97 m from where the drive starts" in found["headline"]
    assert {v["verdict"] for v in found["verdicts"].values()} == {"no verdict"}
    assert "the robot drives at the first reading: its beginning may be lost" in found["findings"][0]["message"]
    assert found["findings"][0]["fixes"]
