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
