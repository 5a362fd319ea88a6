"""What several steps of advice for one sensor become: one finding, whose words are those of what is set."""

from __future__ import annotations

from typing import Any

import pytest

from locfuse.cli.advice.evaluator import Advised
from locfuse.cli.advice.values import add_findings
from locfuse.formats.tables.findings import sentence
from locfuse.fusion.advice.search import Advice
from locfuse.fusion.doctor.finding import Finding

LATE = Advice(Finding("lrf", "lag", "stamps look 0.1 s late"), ("lrf.time_offset=-0.1",))
HIGH = Advice(Finding("lrf", "too high", "noise is set too high"), ("lrf.sigma_range=0.01",))
LOW = Advice(Finding("lrf", "anees", "errors are 2 times what is claimed"), ("lrf.sigma_range=0.04",))


def finding(*advice: Advice) -> Any:
    report: dict[str, Any] = {}
    add_findings(report, Advised(advice))
    (found,) = report["findings"]
    return found


def test_steps_that_set_different_things_are_told_one_after_the_other() -> None:
    found = finding(LATE, HIGH)
    assert found["message"] == "stamps look 0.1 s late; then noise is set too high"
    assert found["fixes"] == ["lrf.time_offset=-0.1", "lrf.sigma_range=0.01"]


def test_a_step_that_is_set_otherwise_by_a_later_one_is_not_told() -> None:
    found = finding(HIGH, LOW)
    assert found["message"] == "errors are 2 times what is claimed"
    assert found["fixes"] == ["lrf.sigma_range=0.04"]


@pytest.mark.parametrize(
    ("anees", "said"), [(0.921, "0.92"), (47.3, "47"), (99.7, "100"), (9607.5, "9600"), (6.6e10, "over 100000")]
)
def test_a_ratio_is_said_in_two_digits_without_an_exponent(anees: float, said: str) -> None:
    score = {"lost_share": 0.0, "position_rmse_m": None, "prediction_nats": None, "anees": anees}
    tried = {"configuration": "lrf", "before": score, "after": {**score, "anees": 1.0}, "until_s": None}
    words = sentence({"role": "lrf", "message": "noise", "fixes": ["lrf.sigma_range=1"], "tried": tried})
    assert f"ANEES {said} -> 1)" in words


def test_an_error_of_the_shape_alone_is_said_to_be_that() -> None:
    score = {"lost_share": 0.0, "position_rmse_m": 0.0052, "aligned": True, "prediction_nats": None, "anees": None}
    tried = {
        "configuration": "lrf",
        "before": score,
        "after": {**score, "position_rmse_m": 0.0036},
        "until_s": None,
    }
    words = sentence({"role": "lrf", "message": "late", "fixes": ["lrf.time_offset=-0.02"], "tried": tried})
    assert "(tried with lrf: error of the path's shape 5.2 mm -> 3.6 mm)" in words
