"""Bad input in Python: LocfuseError with the command's line; never SystemExit, never a bare KeyError."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import small_drive
from commands import locfuse as command, reported
from rewrite_log import rewritten

import locfuse
from locfuse import sample_logs
from locfuse.cli.analysis.compare import Jittered, add_ranges
from locfuse.fusion.measure import DROPPED_SHARE, MOVED_S, jittered

LOG = "rounded_rectangle"


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("bad")
    (folder / "text.mcap").write_text("hello")
    (folder / "empty.mcap").write_bytes(b"")
    (folder / "folder").mkdir()
    (folder / "typo.toml").write_text("[wheels]\ntrak = 0.6\n")
    rewritten(folder / "wheelless.mcap", seed=None, without="/joint_states")
    return folder


@pytest.fixture(scope="module")
def session() -> locfuse.Session:
    return locfuse.load(LOG, between=(None, 10.0))


@pytest.fixture(scope="module")
def result(session: locfuse.Session) -> locfuse.Comparison:
    return session.compare(["odometry", "compass"], advice=False)


@pytest.mark.parametrize("name", ["nosuch.mcap", "text.mcap", "empty.mcap", "folder", "wheelless.mcap"])
def test_a_log_that_cannot_be_used_gets_the_commands_line(files: Path, tmp_path: Path, name: str) -> None:
    with pytest.raises(locfuse.LocfuseError) as caught:
        locfuse.load(files / name)
    done = command("run", files / name, "-o", tmp_path / "out")
    assert done.stderr == f"locfuse: {caught.value}\n"
    assert done.exit_code == caught.value.exit_code


@pytest.mark.parametrize(
    "setting", ["lrf.topic=/nowhere", "wheels.trak=0.5", "whels.track=0.5", "wheels.track=wide", "wheels.track=-1"]
)
def test_a_setting_that_fits_nothing_gets_the_commands_line(tmp_path: Path, setting: str) -> None:
    key, _, value = setting.partition("=")
    done = command("run", LOG, "--set", setting, "-o", tmp_path / "out")
    for sets in ([setting], {key: -1 if value == "-1" else 0.5 if value == "0.5" else value}):
        with pytest.raises(locfuse.LocfuseError) as caught:
            locfuse.load(LOG, sets=sets)
        assert done.stderr == f"locfuse: {caught.value}\n"


@pytest.mark.parametrize("sensors", ["lrg", "sonar,lrf", "lrf@fast"])
def test_absent_sensors_get_the_commands_line(session: locfuse.Session, tmp_path: Path, sensors: str) -> None:
    done = command("run", LOG, "--sensors", sensors, "-o", tmp_path / "out")
    calls: list[Callable[[], Any]] = [
        lambda: session.run(sensors),
        lambda: session.run(sensors.split(",")),
        lambda: session.compare([sensors]),
        lambda: locfuse.fuse(session.drive, session.robot, sensors),
        lambda: locfuse.smooth(session.drive, session.robot, sensors),
    ]
    for call in calls:
        with pytest.raises(locfuse.LocfuseError) as caught:
            call()
        assert done.stderr.replace("--sensors", "sensors") == f"locfuse: {caught.value}\n"


BAD: dict[str, tuple[Callable[[locfuse.Session, locfuse.Comparison, Path], Any], str]] = {
    "configuration": (lambda s, r, p: r.estimates["compas"], "did you mean compass?"),
    "judgement": (lambda s, r, p: r.evaluations["all"], "There are: odometry, compass"),
    "verdict": (lambda s, r, p: r.verdicts["compss"], "did you mean compass?"),
    "align": (lambda s, r, p: s.run("odometry", align="left"), "choose from none, origin, se2"),
    "align of compare": (lambda s, r, p: s.compare(["odometry"], align="left"), "choose from none, origin, se2"),
    "align of evaluate": (
        lambda s, r, p: locfuse.evaluate(r.estimates["compass"], s.drive, "left"),
        "choose from none, origin, se2",
    ),
    "preset": (lambda s, r, p: locfuse.load(LOG, preset="papr"), "choose from default, paper"),
    "order": (lambda s, r, p: locfuse.load(LOG, order="up"), "choose from auto, stamp, recorded"),
    "no robot": (lambda s, r, p: locfuse.load(LOG, robot=p / "none.toml"), "locfuse init LOG > robot.toml"),
    "robot": (lambda s, r, p: locfuse.load(LOG, robot=p / "typo.toml"), "did you mean track"),
    "value": (lambda s, r, p: locfuse.load(LOG, sets={"lrf.topic": None}), "lrf.topic = None"),
    "no log": (lambda s, r, p: locfuse.load([]), "which log?"),
    "no logs": (lambda s, r, p: locfuse.compare(), "which log?"),  # type: ignore[call-overload]
    "open_log": (lambda s, r, p: locfuse.open_log("nosuch"), "no such log: nosuch"),
    "kind": (lambda s, r, p: r.write(p / "out", write="pdf"), "unknown output 'pdf'"),
    "export": (lambda s, r, p: r.write(p / "out", export="pdf"), "unknown format 'pdf'"),
    "folder": (lambda s, r, p: r.write(p), "is not empty and holds no locfuse result"),
    "map": (lambda s, r, p: s.with_map(p / "none.json"), "none.json: cannot be read"),
    "save_map": (lambda s, r, p: s.run("odometry").save_map(p / "m.json"), "only the laser has a map"),
    "scenario": (lambda s, r, p: locfuse.simulate("rounded_rectangel"), "did you mean rounded_rectangle?"),
    "scenario's key": (lambda s, r, p: locfuse.simulate(LOG, sets={"lrf.bems": 1}), "did you mean beams?"),
    "seed": (lambda s, r, p: locfuse.simulate(LOG, seed=-1), "seed = -1"),
    "one of several": (lambda s, r, p: locfuse.compare(LOG, p / "wheelless.mcap"), "wheelless"),
}


@pytest.mark.parametrize("what", BAD)
def test_anything_else_is_one_line_that_helps(
    session: locfuse.Session, result: locfuse.Comparison, files: Path, what: str
) -> None:
    call, says = BAD[what]
    with pytest.raises(locfuse.LocfuseError) as caught:
        call(session, result, files)
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


def test_results_by_name_are_a_mapping_like_any_other(result: locfuse.Comparison) -> None:
    assert "compass" in result.estimates
    assert "foo" not in result.estimates
    assert result.estimates.get("foo") is None
    assert list(result.estimates) == ["odometry", "compass"]
    with pytest.raises(KeyError):
        result.estimates["foo"]


# --- jitter: ranges of figures by chance


def test_readings_move_by_a_microsecond_and_a_hundredth_is_missing_alike_for_equal_seeds() -> None:
    robot = small_drive.robot()
    drive = small_drive.drive(0, robot, laps=3.0)
    other, same, one = (jittered(drive, robot, seed) for seed in (4, 4, 1))
    for name, m in drive.measurements.items():
        n, kept = len(m.t), other.measurements[name]
        lost = n - len(kept.t)
        assert 0 < lost < n * DROPPED_SHARE + 4.0 * np.sqrt(n * DROPPED_SHARE)
        nearest = np.abs(m.t[np.searchsorted(m.t, kept.t - MOVED_S)] - kept.t)
        assert 0.0 < nearest.max() <= MOVED_S
        assert (np.diff(kept.t) >= 0.0).all()
        np.testing.assert_array_equal(other.t[other.instant[name]], kept.t)
    assert (other.wheels, other.truth) == (drive.wheels, drive.truth)
    np.testing.assert_array_equal(other.t, same.t)
    assert len(other.t) != len(one.t) or (other.t != one.t).any()


def with_verdicts(**words: str) -> dict[str, Any]:
    verdicts = {sensor: {"verdict": word, "words": "Why."} for sensor, word in words.items()}
    return {"configurations": {"all": {"anees": 1.0, "position_rmse_m": 0.2}}, "verdicts": verdicts}


def runs(*verdicts: dict[str, str]) -> list[Jittered]:
    figures = {"all": {"anees": 1.0, "position_rmse_m": 0.1}}
    return [
        Jittered({"all": {**figures["all"], "position_rmse_m": 0.1 * k}}, {"all": 0.01 * k}, found)
        for k, found in enumerate(verdicts, 1)
    ]


def test_a_verdict_that_changes_its_direction_is_none() -> None:
    report = with_verdicts(compass="helps", lrf="helps", gyro="no effect seen")
    seen = [
        {"compass": "helps", "lrf": "seems to help", "gyro": "no effect seen"},
        {"compass": "hurts", "lrf": "helps", "gyro": "seems to hurt"},
        {"compass": "helps", "lrf": "helps", "gyro": "no effect seen"},
    ]
    add_ranges(report, runs(*seen))
    found = {sensor: v["verdict"] for sensor, v in report["verdicts"].items()}
    assert found == {"compass": "no effect seen", "lrf": "helps", "gyro": "no effect seen"}
    words = "The verdict is chance: it changes under jitter (helps 2, hurts 1). As recorded: helps. Why."
    assert report["verdicts"]["compass"]["words"] == words
    assert report["verdicts"]["lrf"]["words"] == "Why."


def test_the_range_holds_the_drive_itself_and_every_run() -> None:
    report = with_verdicts()
    add_ranges(report, runs({}, {}, {}))
    assert report["configurations"]["all"]["jitter"] == {
        "anees": [1.0, 1.0],
        "position_rmse_m": [0.1, pytest.approx(0.3)],
        "path_moved_m": pytest.approx(0.03),
    }
    assert report["jitter"]["runs"] == 3


def test_compare_reports_ranges_everywhere_and_says_how_to_get_them_again() -> None:
    log = sample_logs.path("rounded_rectangle")
    words = ("--sensors", "odometry", "--sensors", "compass", "--jitter", "2", "--no-advice")
    done = reported("compare", log, "-v", *words, "--write", "json,md,html")
    for values in done.rows.values():
        low, high = values["jitter"]["position_rmse_m"]
        assert low <= values["position_rmse_m"] <= high
    assert done.rows["odometry"]["jitter"]["path_moved_m"] < 0.01  # no reading to lose
    low, high = done.rows["compass"]["jitter"]["position_rmse_m"]
    assert low < high < 1.2 * low
    assert "--jitter 2" in done.report["repeat"]
    assert "fused 2 times more" in done.stderr
    assert "under jitter" in done.stdout
    for page in ("report.md", "report.html"):
        assert "under jitter" in (done.out / page).read_text()
