"""The first line where a reference judges: what it may say of sensors, and what it may not."""

from __future__ import annotations

from typing import Any

import pytest

from locfuse.cli.advice.headline import headline


@pytest.mark.parametrize(
    ("verdicts", "end"),
    [
        ({"lrf": "no verdict"}, "nothing else here judges the laser."),
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
    assert found == f"Measured against a reference, not truth: odometry alone is off by 52 mm; {end}"


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
