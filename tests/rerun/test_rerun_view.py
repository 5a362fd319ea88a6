"""`locfuse view`: a log, a folder of results, a recording."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from commands import ok, refused
from recordings import read

LOG = "rounded_triangle"


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("view") / "out"
    words = ("--sensors", "odometry", "--sensors", "lrf", "--write", "json,tum", "--no-advice")
    ok("compare", LOG, *words, "-o", out)
    return out


def test_a_log_becomes_a_recording_of_the_configurations_asked_for(tmp_path: Path) -> None:
    words = ("--sensors", "odometry", "--sensors", "compass", "--images", "none")
    ok("view", LOG, *words, "--save", tmp_path / "drive.rrd", "--tab", "nis")
    entities = read(tmp_path / "drive.rrd")
    assert {"world/odometry/pose", "world/compass/pose", "nis/compass/compass"} <= set(entities)
    assert "world/lrf/pose" not in entities
    assert "camera/omni" not in entities


def test_a_folder_of_results_is_shown_from_its_files(results: Path, tmp_path: Path) -> None:
    ok("view", results, "--save", tmp_path / "drive.rrd")
    entities = read(tmp_path / "drive.rrd")
    tum = np.loadtxt(results / "lrf.tum")
    pose = entities["world/lrf/pose"]
    np.testing.assert_allclose(pose.array("Transform3D:translation")[:, 0, :2], tum[:, 1:3], atol=1e-5)
    np.testing.assert_allclose(pose.ns * 1e-9, tum[:, 0], atol=1e-6)
    truth = np.loadtxt(results / "truth.tum")
    rows = np.isin(np.rint(truth[:, 0] * 1e3), np.rint(tum[:, 0] * 1e3))
    at = np.searchsorted(tum[:, 0], truth[rows, 0] - 1e-6)
    deviation = entities["deviation/x/lrf"].array("Scalars:scalars")[:, 0]
    np.testing.assert_allclose(deviation, tum[at, 1] - truth[rows, 1], atol=1e-9)
    assert "world/lrf/sigma" not in entities  # a .tum holds no covariances


def test_a_run_folder_keeps_its_covariances_and_what_was_smoothed_beside_what_was_not(tmp_path: Path) -> None:
    out = tmp_path / "out"
    words = ("--no-advice", "--smooth", "--sensors", "compass", "--write", "all")
    ok("run", LOG, *words, "-o", out)
    ok("view", out, "--save", tmp_path / "drive.rrd")
    shown = read(tmp_path / "drive.rrd")
    for name, file in (("compass", "trajectory.tum"), ("compass-smoothed", "smoothed.tum")):
        drawn = shown[f"world/{name}/pose"].array("Transform3D:translation")[:, 0, :2]
        np.testing.assert_allclose(drawn, np.loadtxt(out / file)[:, 1:3], atol=1e-5)
    rows = np.loadtxt(out / "trajectory.csv", delimiter=",", skiprows=1)
    P = rows[:, [4, 5, 5, 7]].reshape(-1, 2, 2)
    axes = shown["world/compass/sigma"].array("Ellipses2D:half_sizes")[:, 0]
    np.testing.assert_allclose(
        axes[:, 0], 3.0 * np.sqrt(np.linalg.eigvalsh(P)[:, 1].clip(0)), atol=1e-6, rtol=1e-5
    )


def test_a_recording_beside_the_results_is_used_while_it_is_not_older(results: Path, tmp_path: Path) -> None:
    words = ("--sensors", "compass", "--images", "none", "--save", results / "recording.rrd")
    ok("view", LOG, *words)
    ok("view", results, "--save", tmp_path / "fresh.rrd")
    assert (tmp_path / "fresh.rrd").read_bytes() == (results / "recording.rrd").read_bytes()
    os.utime(results / "recording.rrd", (1.0, 1.0))
    ok("view", results, "--save", tmp_path / "new.rrd")
    assert "world/lrf/pose" in read(tmp_path / "new.rrd")
    (results / "recording.rrd").unlink()


WITHOUT_TRACKS = '{"locfuse": "0.2.0", "schema_version": %d, "configurations": {"all": {}}}'


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("report.json", "{", "not as locfuse writes them"),
        ("report.json", WITHOUT_TRACKS % 1, "lacks all.tum"),
        ("report.json", WITHOUT_TRACKS % 2, "schema_version 2"),
        ("drive.rrd", "junk", "no whole recording"),
    ],
)
def test_what_cannot_be_shown_is_said_in_one_line(tmp_path: Path, name: str, content: str, said: str) -> None:
    (tmp_path / name).write_text(content)
    what = tmp_path if name.endswith("json") else tmp_path / name
    assert said in refused("view", what, "--save", tmp_path / "x.rrd")
    assert not (tmp_path / "x.rrd").exists()


def test_files_of_two_runs_in_one_folder_are_not_drawn_as_one(tmp_path: Path) -> None:
    for sensors, kinds in (("lrf", "tum,csv,json"), ("compass", "tum,json")):
        words = ("--sensors", sensors, "--write", kinds, "--no-advice", "--no-smooth", "--overwrite")
        ok("run", LOG, "-o", tmp_path, *words)
    assert "trajectory.csv and trajectory.tum are of different runs" in refused(
        "view", tmp_path, "--save", tmp_path / "x.rrd"
    )


def test_nothing_to_look_with_is_said_before_anything_is_computed(monkeypatch: pytest.MonkeyPatch) -> None:
    from locfuse.cli.rerun import viewer

    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.setattr(viewer, "PORT", viewer.free_port(0))
    assert "--web" in refused("view", LOG)
