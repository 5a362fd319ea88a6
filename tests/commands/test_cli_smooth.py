"""--smooth as a user meets it: extra configurations and files, labelled; refused where it has no meaning."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from commands import locfuse

LOG = "rounded_rectangle"


def test_compare_smooths_every_configuration_with_sensors(tmp_path: Path) -> None:
    words = ("--sensors", "odometry", "--sensors", "lrf", "--smooth", "--no-advice")
    done = locfuse("compare", LOG, *words, "-o", tmp_path / "out")
    assert done.exit_code == 0, done.stderr
    found = json.loads((tmp_path / "out" / "report.json").read_text())["configurations"]
    assert list(found) == ["odometry", "lrf", "lrf-smoothed"]
    assert [c["smoothed"] for c in found.values()] == [False, False, True]
    assert [c["configuration"] for c in found.values()] == ["odometry", "lrf", "lrf"]
    assert found["lrf-smoothed"]["position_rmse_m"] < found["lrf"]["position_rmse_m"]
    assert (tmp_path / "out" / "lrf-smoothed.tum").is_file()
    assert "reference" not in done.stderr


def test_run_writes_the_smoothed_drive_beside_the_filtered_one(tmp_path: Path) -> None:
    words = ("run", LOG, "--no-advice", "--sensors", "lrf", "--write", "all")
    plain = locfuse(*words, "--no-smooth", "-o", tmp_path / "plain")
    done = locfuse(*words, "-o", tmp_path / "out")
    assert (plain.exit_code, done.exit_code) == (0, 0), done.stderr
    for kind in ("tum", "csv"):
        filtered = (tmp_path / "out" / f"trajectory.{kind}").read_bytes()
        assert filtered == (tmp_path / "plain" / f"trajectory.{kind}").read_bytes()
        assert filtered != (tmp_path / "out" / f"smoothed.{kind}").read_bytes()
    rows = np.loadtxt(tmp_path / "out" / "smoothed.csv", delimiter=",", skiprows=1)
    before = np.loadtxt(tmp_path / "out" / "trajectory.csv", delimiter=",", skiprows=1)
    np.testing.assert_array_equal(rows[:, 0], before[:, 0])
    assert (np.abs(rows[:, 3]) <= np.pi).all()
    assert rows[:, [4, 7, 9]].mean() < before[:, [4, 7, 9]].mean()


def rows(*words: object) -> list[str]:
    done = locfuse("compare", LOG, "--to", 15, "--no-advice", "--write", "json", "--json", *words)
    assert done.exit_code == 0, done.stderr
    return list(json.loads(done.stdout)["configurations"])


def test_what_has_a_laser_is_smoothed_unasked(tmp_path: Path) -> None:
    of = ("--sensors", "odometry", "--sensors", "compass", "--sensors", "lrf", "--sensors", "lrf@2Hz")
    plain = ["odometry", "compass", "lrf", "lrf@2Hz"]
    assert rows(*of, "-o", tmp_path / "a") == [*plain, "lrf-smoothed"]
    assert rows(*of, "--no-smooth", "-o", tmp_path / "b") == plain
    assert rows(*of, "--jitter", 1, "-o", tmp_path / "c") == plain
    assert rows(*of, "--set", "lrf.map=consider", "-o", tmp_path / "d") == plain
    repeated = json.loads((tmp_path / "b" / "report.json").read_text())["repeat"]
    assert "--no-smooth" in repeated


def test_a_fleet_and_a_sweep_are_not_smoothed_unasked(tmp_path: Path) -> None:
    words = ("--to", 10, "--sensors", "lrf", "--write", "json")
    done = locfuse("fleet", LOG, *words, "--sweep", "lrf.sigma_range=0.02,0.03", "-o", tmp_path / "out")
    assert done.exit_code == 0, done.stderr
    found = [json.loads(p.read_text())["configurations"] for p in sorted((tmp_path / "out").rglob("report.json"))]
    assert [list(configurations) for configurations in found] == [["lrf"], ["lrf"]]


@pytest.mark.parametrize("command", ["run", "compare"])
@pytest.mark.parametrize("mode", ["first-scan", "consider"])
def test_a_map_without_optimal_weights_is_refused_in_one_line(command: str, mode: str, tmp_path: Path) -> None:
    done = locfuse(command, LOG, "--smooth", "--set", f"lrf.map={mode}", "-o", tmp_path / "out")
    assert done.exit_code == 2
    assert f"lrf.map = {mode}" in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    assert not (tmp_path / "out").exists()


def test_the_printed_filter_is_not_smoothed(tmp_path: Path) -> None:
    done = locfuse("run", LOG, "--no-advice", "--smooth", "--preset", "paper", "-o", tmp_path / "out")
    assert done.exit_code == 2
    assert "--preset paper" in done.stderr
