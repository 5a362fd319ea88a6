"""Several drives of one robot with one fault: one fix for the robot, in words, in the summary and as a file."""

import json
from pathlib import Path
from typing import Any

import pytest
from commands import counted_jobs, locfuse, ok

import locfuse as api
from benchmarks.advice_cases import OFFSET, SCENARIO
from locfuse.sample_logs.scenario import load as scenario_of
from locfuse.sample_logs.simulate import on_truth, write_log

pytestmark = pytest.mark.usefixtures("jobs_in_this_process")
LIGHT = (*SCENARIO, "camera.enabled=false", "lrf.enabled=false")
RIGHT = ("--set", OFFSET)


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Three laps with wheels, compass and truth."""
    folder = tmp_path_factory.mktemp("robot")
    places = [folder / f"{day}.mcap" for day in ("monday", "tuesday", "friday")]
    for seed, place in enumerate(places):
        write_log(scenario_of("rounded_rectangle", LIGHT), 40 + seed, on_truth, place)
    return places


def summary(folder: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((folder / "summary.json").read_text())
    return found


def test_one_late_clock_in_all_logs_gets_one_fix_which_helps_where_set(logs: list[Path], tmp_path: Path) -> None:
    out = tmp_path / "out"
    wrong = (*RIGHT, "--set", "compass.time_offset=0.2", "--write", "json,md,html")
    done = ok("compare", *logs, *wrong, "-o", out)
    (robot,) = summary(out)["robots"]
    ((key, value),) = (fix.split("=") for fix in robot["fixes"])
    assert key == "compass.time_offset"
    assert float(value) == pytest.approx(0.0, abs=0.01)
    assert set(robot["tried"][0]["logs"]) == {"monday", "tuesday", "friday"}
    line = f"--set compass.time_offset={value}"
    assert line in done.stdout
    assert f"`{line}`" in (out / "summary.md").read_text()
    assert line in (out / "summary.html").read_text()
    assert f"time_offset = {float(value)}" in (out / "fixes.toml").read_text()
    before = summary(out)["configurations"]["compass"]["figures"]["position_rmse_m"]["worst"]
    ok("compare", *logs, *RIGHT, "--robot", out / "fixes.toml", "--write", "json", "-o", tmp_path / "obeyed")
    obeyed = summary(tmp_path / "obeyed")
    assert obeyed["configurations"]["compass"]["figures"]["position_rmse_m"]["worst"] < 0.8 * before
    assert obeyed["robots"][0]["fixes"] == []
    (out / "fixes-mine.toml").write_text("# somebody else's\n")
    ok("compare", *logs, *RIGHT, "--write", "json", "-o", out)
    assert [path.name for path in out.glob("fixes*")] == ["fixes-mine.toml"]


def test_a_right_robot_costs_no_rerun(logs: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ran = counted_jobs(monkeypatch)
    ok("compare", *logs, *RIGHT, "--write", "json", "-o", tmp_path / "out")
    (robot,) = summary(tmp_path / "out")["robots"]
    assert robot["fixes"] == robot["tried"] == []
    assert not (tmp_path / "out" / "fixes.toml").exists()
    assert len(ran) == len(logs)


def test_one_log_that_disagrees_is_named_and_two_have_nothing_in_common(logs: list[Path], tmp_path: Path) -> None:
    late = tmp_path / "late.mcap"
    fault = 'faults=[{kind="clock_offset", sensor="compass", seconds=0.3}]'
    write_log(scenario_of("rounded_rectangle", (*LIGHT, fault)), 43, on_truth, late)
    words = (*RIGHT, "--set", "compass.time_offset=0.2", "--write", "json", "-q")
    done = ok("compare", *logs, late, *words, "-o", tmp_path / "out")
    assert "late disagrees: -0.3" in done.stdout
    done = ok("compare", logs[0], late, *words, "-o", tmp_path / "two")
    assert "there is no common value" in done.stdout
    assert summary(tmp_path / "two")["robots"][0]["fixes"] == []


def test_robots_with_names_are_asked_one_by_one(logs: list[Path], tmp_path: Path) -> None:
    names = ("--robot-from", "(monday|tuesday|friday)")
    words = (*RIGHT, "--set", "compass.time_offset=0.2", "--write", "json", "-q")
    ok("fleet", *logs, *words, *names, "-o", tmp_path / "each")
    assert summary(tmp_path / "each")["robots"] == []  # a log each
    ok("fleet", *logs, *words, "--robot-from", "(day)", "-o", tmp_path / "all")
    assert (tmp_path / "all" / "fixes-day.toml").is_file()
    assert summary(tmp_path / "all")["robots"][0]["robot"] == "day"


def test_no_advice_tries_nothing(logs: list[Path], tmp_path: Path) -> None:
    words = (*RIGHT, "--set", "compass.time_offset=0.2", "--write", "json", "-q", "--no-advice")
    ok("compare", *logs, *words, "-o", tmp_path / "out")
    assert summary(tmp_path / "out")["robots"] == []


def test_info_says_of_several_logs_what_they_show_together(logs: list[Path]) -> None:
    done = ok("info", *logs, *RIGHT, "--set", "compass.time_offset=0.2")
    assert "all logs together" in done.stdout
    assert "compass.time_offset = -0.00" in done.stdout or "compass.time_offset = 0.00" in done.stdout
    assert "Fix for all of them" not in done.stdout  # nothing was tried
    found = json.loads(ok("info", *logs[:2], *RIGHT, "--json").stdout)
    assert list(found["logs"]) == ["monday", "tuesday"]
    assert found["together"]["fixes"] == []
    assert locfuse("info", *logs[:2], "--preview", "x").exit_code == 2


def test_info_with_check_and_python_offer_the_same_fix(logs: list[Path]) -> None:
    done = locfuse("info", *logs, "--check", *RIGHT, "--set", "compass.time_offset=0.2")
    assert done.exit_code == 3  # the clock would spoil an estimate
    sets = (OFFSET, "compass.time_offset=0.2")
    (robot,) = api.compare(*logs, sets=sets).report["robots"]
    (fix,) = robot["fixes"]
    assert f"--set {fix}" in done.stdout
