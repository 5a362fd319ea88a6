"""A real robot in a walled arena (LOCFUSE_DATA/brenner): the figures the product claims."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from commands import locfuse, ok

DATA = os.environ.get("LOCFUSE_DATA")
pytestmark = pytest.mark.skipif(not DATA, reason="LOCFUSE_DATA is not set: no real logs to try")
LOG = Path(DATA or "") / "brenner" / "brenner.mcap"
ROBOT = """\
[wheels]
radius = 0.0199962
track = 0.155

[start]
x = 1.87516
y = 1.91334
theta_deg = 213

[truth]
x = 0.03

[lrf]
x = 0.03
"""
CURED = ("--set", "lrf.time_offset=-0.45", "--set", "lrf.range_scale=1.1286681715575622")


@pytest.fixture
def robot(tmp_path: Path) -> Path:
    path = tmp_path / "robot.toml"
    path.write_text(ROBOT)
    return path


@pytest.mark.parametrize(("track", "rmse"), [(0.155, 0.599), (0.173, 0.069)])
def test_odometry_reproduces_the_known_error(tmp_path: Path, robot: Path, track: float, rmse: float) -> None:
    out = tmp_path / "out"
    words = ("--robot", robot, "--set", f"wheels.track={track}", "-o", out)
    ok("run", LOG, "--no-advice", "--sensors", "odometry", *words)
    report = json.loads((out / "run.json").read_text())
    assert report["configurations"]["odometry"]["position_rmse_m"] == pytest.approx(rmse, rel=0.02)
    assert report["input"]["dropped"]["wheels"] == {"repeat": 61}


@pytest.mark.parametrize(("track", "most"), [(0.155, 0.08), (0.173, 0.09)])
def test_wall_lines_correct_the_drive_once_clock_and_metre_are_set(
    tmp_path: Path, robot: Path, track: float, most: float
) -> None:
    out = tmp_path / "out"
    ok("compare", LOG, "--no-advice", "--robot", robot, *CURED, "--set", f"wheels.track={track}", "-o", out)
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert set(report["configurations"]) == {"odometry", "lrf", "lrf-smoothed"}
    assert report["configurations"]["lrf"]["position_rmse_m"] <= most


def test_the_lag_of_the_scans_is_reported_and_its_cure_silences_it(tmp_path: Path, robot: Path) -> None:
    done = locfuse("run", LOG, "--robot", robot, "-o", tmp_path / "a")
    words = [line for line in done.stdout.splitlines() if line.startswith("lrf: stamps look 0.4")]
    assert len(words) == 1, done.stdout
    offset = float(words[0].split("lrf.time_offset=")[1].split()[0])
    assert offset == pytest.approx(-0.45, abs=0.08)
    done = locfuse("run", LOG, "--robot", robot, "--set", f"lrf.time_offset={offset}", "-o", tmp_path / "b")
    assert "lrf.time_offset=" not in done.stdout


# where the wheels are states too, the mount must be known: on a small floor it takes part of their error
EXACT = [word for key in ("x", "y", "yaw_deg") for word in ("--set", f"lrf.sigma_{key}=0")]


def found_track(tmp_path: Path, robot: Path, start: float, sets: Sequence[str]) -> tuple[float, list[str]]:
    """The track that the filter finds from one that it is told, and all that is said of the wheels."""
    words = ("--robot", robot, *sets, *EXACT, "--set", f"wheels.track={start}", "--set", "wheels.estimate=true")
    done = ok(
        "run", LOG, "--no-advice", "--sensors", "lrf", *words, "-v", "-o", tmp_path / f"{start}", "--overwrite"
    )
    notes = [line for line in done.stderr.splitlines() if "wheels:" in line]
    return float(re.findall(r"track ([0-9.]+) \(1 sigma", done.stderr)[0]), notes


def test_the_track_is_found_whatever_it_was_told(tmp_path: Path, robot: Path) -> None:
    """A fit of the odometry to the truth has 0.178 m, and wheels that are 6 % larger than told."""
    tracks = [found_track(tmp_path, robot, start, CURED)[0] for start in (0.14, 0.155, 0.173, 0.2)]
    assert max(tracks[1:3]) / min(tracks[1:3]) < 1.02
    assert max(tracks) / min(tracks) < 1.04
    assert tracks == pytest.approx([0.1779] * 4, rel=0.05)


def test_without_the_laser_s_metre_track_and_scale_are_said_not_to_be_identifiable(
    tmp_path: Path, robot: Path
) -> None:
    for start in (0.155, 0.173):
        _, notes = found_track(tmp_path, robot, start, CURED[:2])
        (words,) = [note for note in notes if "not identifiable" in note]
        smaller = float(re.findall(r"wheels are ([0-9.]+) % smaller", words)[0])
        assert smaller == pytest.approx(5.05, abs=0.15)
        assert float(re.findall(r"if the radius is right.*the track is ([0-9.]+)", words)[0]) == pytest.approx(
            0.173, rel=0.03
        )


def test_our_error_is_evos_error(tmp_path: Path, robot: Path) -> None:
    """evo_ape tum without alignment pairs our rows at the truth's stamps and must find the same error."""
    from evo.core import metrics, sync
    from evo.tools import file_interface

    # evo compares poses of one body: here the tracked point is the axle itself
    ok("compare", LOG, "--no-advice", "--robot", robot, *CURED, "--set", "truth.x=0", "-o", tmp_path / "out")
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    for name in ("odometry", "lrf"):
        truth = file_interface.read_tum_trajectory_file(str(tmp_path / "out" / "truth.tum"))
        estimate = file_interface.read_tum_trajectory_file(str(tmp_path / "out" / f"{name}.tum"))
        pair = sync.associate_trajectories(truth, estimate, max_diff=1e-6)
        ape = metrics.APE(metrics.PoseRelation.translation_part)
        ape.process_data(pair)
        ours = report["configurations"][name]
        assert ape.get_statistic(metrics.StatisticsType.rmse) == pytest.approx(ours["position_rmse_m"], abs=1e-6)
        assert ape.get_statistic(metrics.StatisticsType.max) == pytest.approx(ours["position_max_m"], abs=1e-6)
        assert len(pair[0].timestamps) == report["truth"]["used"]


def test_other_real_logs_run_and_say_what_they_lack(tmp_path: Path) -> None:
    data = Path(DATA or "")
    done = ok("compare", data / "turtlebot4", "-v", "-o", tmp_path / "tb4")
    assert "against a reference, not truth" in done.stdout
    report = json.loads((tmp_path / "tb4" / "report.json").read_text())
    assert report["settings"]["lrf"]["yaw_deg"] == pytest.approx(90.0, abs=0.1)  # only /tf_static says so
    assert report["configurations"]["lrf"]["sensors"]["lrf"]["accepted"] > 1000
    assert report["truth"] is None
    assert report["reference"]["sensors"] == ["lrf"]
    assert report["configurations"]["lrf"]["reference"]["shared"] == ["lrf"]
    ok("compare", data / "bags" / "evo" / "nav2_turtlebot.mcap", "-o", tmp_path / "evo")
    report = json.loads((tmp_path / "evo" / "report.json").read_text())
    assert set(report["configurations"]) == {"odometry"}
    assert {"compass", "lrf"} <= set(report["absent"])
    tum = np.loadtxt(tmp_path / "evo" / "odometry.tum")
    assert np.isfinite(tum).all()
    assert (np.diff(tum[:, 0]) > 0).all()
