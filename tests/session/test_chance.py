"""`--jitter`: drives that differ by next to nothing, and what may be said of the figures that they give."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import small_drive
from commands import reported

from locfuse import sample_logs
from locfuse.cli.session.jitter import Jittered, add_ranges
from locfuse.fusion.measure import DROPPED_SHARE, MOVED_S, jittered


def test_readings_move_by_a_microsecond_and_a_hundredth_is_missing() -> None:
    robot = small_drive.robot()
    drive = small_drive.drive(0, robot, laps=3.0)
    other = jittered(drive, robot, seed=4)
    for name, m in drive.measurements.items():
        n, kept = len(m.t), other.measurements[name]
        lost = n - len(kept.t)
        assert 0 < lost < n * DROPPED_SHARE + 4.0 * np.sqrt(n * DROPPED_SHARE)
        nearest = np.abs(m.t[np.searchsorted(m.t, kept.t - MOVED_S)] - kept.t)
        assert 0.0 < nearest.max() <= MOVED_S
        assert (np.diff(kept.t) >= 0.0).all()
        np.testing.assert_array_equal(other.t[other.instant[name]], kept.t)
    assert other.wheels is drive.wheels
    assert other.truth is drive.truth


def test_equal_seeds_give_equal_drives_and_others_differ() -> None:
    robot = small_drive.robot()
    drive = small_drive.drive(0, robot)
    one, same, other = (jittered(drive, robot, seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(one.t, same.t)
    assert len(one.t) != len(other.t) or (one.t != other.t).any()


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
