"""A part of a drive: the same measurements, the same motion, a start that is known there."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from commands import locfuse

import locfuse as api
from locfuse.fusion.data import LocfuseError

SAMPLE = "rounded_rectangle"


def test_a_window_holds_what_lies_in_it_and_its_motion_is_that_of_the_whole_drive() -> None:
    whole, window = api.load(SAMPLE).drive, api.load(SAMPLE, between=(10.0, 25.0)).drive
    assert window.t[0] >= 10.0
    assert window.t[-1] <= 25.0
    for name, m in window.measurements.items():
        t = whole.measurements[name].t
        inside = (t >= window.t[0]) & (t <= window.t[-1])
        np.testing.assert_array_equal(m.t, t[inside])
    shared = window.t[2:-1]  # the first and the last reading of the wheels in the window are instants of its own
    ours, theirs = np.isin(window.t, shared), np.isin(whole.t, shared)
    assert ours.sum() == theirs.sum() > 400
    np.testing.assert_allclose(window.motions.u[ours], whole.motions.u[theirs], atol=1e-12)
    np.testing.assert_allclose(window.motions.Q[ours], whole.motions.Q[theirs], atol=1e-15)
    assert window.truth is not None
    assert window.truth.t[0] >= 10.0


def test_it_starts_at_the_truths_pose_and_says_so() -> None:
    session = api.load(SAMPLE, between=(10.0, 25.0))
    truth = api.load(SAMPLE).drive.truth
    assert truth is not None
    start = session.robot.start
    assert start.x == pytest.approx(np.interp(session.drive.t[0], truth.t, truth.xy[:, 0]), abs=1e-9)
    figures = session.run("odometry", advice=False).evaluations["odometry"].figures
    assert figures["duration_s"] == pytest.approx(15.0, abs=0.1)
    assert figures["position_rmse_m"] is not None
    assert figures["position_rmse_m"] < 0.3
    assert any("starts there at the truth's pose" in note for note in session.notes)


def test_without_a_truth_it_starts_where_the_wheels_lead(tmp_path: Path) -> None:
    """Odometry alone in the window is then the piece of odometry over the whole drive."""
    robot = tmp_path / "robot.toml"
    robot.write_text('[truth]\ntopic = "/none"\n')
    whole = api.load(SAMPLE, robot=robot).run("odometry", advice=False).estimates["odometry"]
    session = api.load(SAMPLE, robot=robot, between=(10.0, 25.0))
    part = session.run("odometry", advice=False).estimates["odometry"]
    common = np.isin(whole.t, part.t)
    np.testing.assert_allclose(part.pose[np.isin(part.t, whole.t)], whole.pose[common], atol=1e-9)
    assert any("--align origin" in note for note in session.notes)


def test_the_commands_take_it_and_refuse_what_holds_nothing(tmp_path: Path) -> None:
    words = (
        "compare",
        SAMPLE,
        "--no-advice",
        "--sensors",
        "odometry",
        "-o",
        tmp_path / "o",
        "--write",
        "json",
        "--overwrite",
    )
    done = locfuse(*words, "--from", 10, "--to", 25)
    assert done.exit_code == 0
    report = json.loads((tmp_path / "o" / "report.json").read_text())
    assert report["configurations"]["odometry"]["duration_s"] == pytest.approx(15.0, abs=0.1)
    done = locfuse(*words, "--from", 1000)
    assert done.exit_code == 1
    assert "the drive lasts from 0 to" in done.stderr
    done = locfuse(*words, "--from", 25, "--to", 10)
    assert done.exit_code == 2
    with pytest.raises(LocfuseError, match="nothing moves there"):
        api.load(SAMPLE, between=(1000.0, None))
