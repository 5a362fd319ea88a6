"""The first line: what a reference may say of sensors, and what a fix that was found would give."""

from __future__ import annotations

from typing import Any

import pytest

from locfuse.cli.advice.report import covariance, headline


@pytest.mark.parametrize(
    ("verdicts", "end"),
    [
        ({"lrf": "no verdict"}, "the laser itself cannot be checked."),
        ({"lrf": "no verdict", "compass": "no verdict"}, "of the sensors nothing is sure."),
        ({"lrf": "no effect seen"}, "of the sensors nothing is sure."),
        ({"lrf": "helps", "compass": "no verdict"}, "the laser helps."),
        ({"lrf": "helps", "compass": "hurts"}, "the laser helps; the compass hurts."),
    ],
)
def test_a_reference_says_which_sensors_help_and_what_nobody_judges(verdicts: dict[str, str], end: str) -> None:
    report: dict[str, Any] = {
        "configurations": {"odometry": {"position_rmse_m": 0.052, "sensors": []}},
        "verdicts": {sensor: {"verdict": verdict} for sensor, verdict in verdicts.items()},
        "reference": {"sensors": ["lrf"]},
    }
    found = headline(report, {"odometry": ()})
    assert found == f"Measured against a reference, not truth: odometry alone differs by 52 mm; {end}"


@pytest.mark.parametrize(
    ("after", "aligned", "end"),
    [
        (0.0035, False, "With the laser and the fixes found it is 3.5 mm."),
        (0.0320, False, "before the fixes."),  # as good as the best without it
        (0.0035, True, "before the fixes."),  # of the path's shape: another figure
    ],
)
def test_a_sensor_that_is_good_once_its_fix_is_set_is_named(after: float, aligned: bool, end: str) -> None:
    """A laser 0.2 s late: without its fix one would keep the compass and sell the laser."""
    errors = {"odometry": 0.25, "compass": 0.033, "lrf": 0.058, "all": 0.055}
    score = {"position_rmse_m": after, "aligned": aligned}
    tried = {"configuration": "lrf", "before": {"position_rmse_m": 0.058}, "after": score}
    report: dict[str, Any] = {
        "configurations": {name: {"position_rmse_m": e} for name, e in errors.items()},
        "verdicts": {"lrf": {"verdict": "hurts"}},
        "findings": [{"fixes": ["lrf.time_offset=0"], "tried": tried}, {"fixes": [], "tried": None}],
    }
    sets = {"odometry": (), "compass": ("compass",), "lrf": ("lrf",), "all": ("compass", "lrf")}
    found = headline(report, sets)
    assert found.startswith("Keep the compass: 33 mm. With all sensors it is 55 mm before the fixes.")
    assert found.endswith(end)


@pytest.mark.parametrize(
    ("compass", "camera", "end"),
    [
        ("hurts", "no effect seen", "the compass hurts."),
        ("seems to hurt", "hurts", "one of the compass and the camera hurts."),
        ("seems to help", "no effect seen", "leave the compass and the camera out."),
    ],
)
def test_hurts_is_said_only_of_a_sensor_whose_verdict_says_so(compass: str, camera: str, end: str) -> None:
    errors = {"odometry": 3.0, "lrf": 0.75, "all": 4.2}
    report: dict[str, Any] = {
        "configurations": {name: {"position_rmse_m": error} for name, error in errors.items()},
        "verdicts": {"lrf": {"verdict": "helps"}, "compass": {"verdict": compass}, "camera": {"verdict": camera}},
    }
    found = headline(report, {"odometry": (), "lrf": ("lrf",), "all": ("lrf", "compass", "camera")})
    assert found == f"Keep the laser: 0.75 m. With all sensors it is 4.20 m: {end}"


def test_while_a_setting_is_surely_wrong_no_sensor_is_to_be_left_out() -> None:
    errors = {"odometry": 0.25, "compass": 0.033, "lrf": 0.058, "all": 0.055}
    report: dict[str, Any] = {
        "configurations": {name: {"position_rmse_m": e} for name, e in errors.items()},
        "verdicts": {"lrf": {"verdict": "no verdict"}},
        "validity": [{"void": False, "message": "lrf: stamps look 0.2 s late"}],
        "fixes": ["lrf.time_offset=-0.2"],
    }
    sets = {"odometry": (), "compass": ("compass",), "lrf": ("lrf",), "all": ("compass", "lrf")}
    assert headline(report, sets) == "As configured the best is the compass: 33 mm. Set the fixes first."
    report["configurations"]["compass-smoothed"] = {"position_rmse_m": 0.016}
    assert (
        headline(report, sets)
        == "As configured the best is the compass: 33 mm, smoothed 16 mm. Set the fixes first."
    )


@pytest.mark.parametrize(
    ("anees", "fixed", "sigma", "words"),
    [
        (2.9, None, 0.0, ""),
        (9.0, None, 0.0, " The covariance (all) is 3.0 times too small, and no setting explains it."),
        (9.0, 1.1, 0.0, ""),
        (9.0, 4.0, 0.0, " The covariance (all) is still 2.0 times too small, and no setting explains it."),
        (4235.0, None, 0.0, " ANEES (all) is over 50: set truth.sigma, the truth's own noise, to judge it."),
        (400.0, None, 0.01, " The covariance (all) is 20.0 times too small, and no setting explains it."),
    ],
)
def test_a_covariance_that_is_too_small_and_that_nothing_explains_is_said(
    anees: float, fixed: float | None, sigma: float, words: str
) -> None:
    tried = {"configuration": "all", "after": {"anees": fixed}}
    report: dict[str, Any] = {
        "configurations": {"lrf": {"anees": 100.0}, "all": {"anees": anees}},
        "findings": [{"fixes": ["lrf.yaw_deg=1"], "tried": tried}] if fixed else [],
        "settings": {"truth": {"sigma": sigma}},
    }
    assert covariance(report, {"lrf": ("lrf",), "all": ("compass", "lrf")}) == words


@pytest.mark.parametrize(
    ("smoothed", "end"),
    [
        (0.64, "agree, in lrf-smoothed 64%, which hints that it is better. Try: --reference"),
        (0.68, "agree, in lrf-smoothed 68%, which shows that it is better. Try: --reference"),
        (0.50, " At places seen twice 47% of the points agree, in lrf-smoothed 50%. Try: --reference"),
        (None, "errors cannot be measured. Try: --reference"),  # no place was seen twice
    ],
)
def test_without_truth_the_places_seen_twice_judge_the_smoothed_path(smoothed: float | None, end: str) -> None:
    rows = {"odometry": None, "lrf": 0.47, "lrf-smoothed": smoothed}
    report = {
        "configurations": {name: {"revisit_agreement": share} for name, share in rows.items()},
        "verdicts": {"lrf": {"verdict": "no verdict"}},
    }
    assert headline(report, {"odometry": (), "lrf": ("lrf",)}).endswith(end)
