"""Two faults that hide each other: a fix that helps only beside another one. Scores are written by hand."""

from __future__ import annotations

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import pytest

from locfuse.cli.advice import evaluator
from locfuse.fusion.checks import tried
from locfuse.fusion.checks.finding import Finding
from locfuse.fusion.checks.tried import Advice, Fixes, Marks

CLOCK, NOISE = "compass.time_offset=0", "lrf.sigma_range=0.03"
LATE = Advice(Finding("compass", "lag", "late", severe=True), tried=((CLOCK,),), judges=("compass", "all"))
HIGH = Advice(Finding("lrf", "overstated", "noise is set too high"), (NOISE,))


class Trial:
    """Errors [m] of the compass alone and of all sensors."""

    def __init__(self, both: float, compass: float = 0.033) -> None:
        self.errors = {(): (0.067, 0.0056), (CLOCK,): (compass, 0.0077), (CLOCK, NOISE): (compass, both)}

    def __call__(self, fixes: Fixes, names: Sequence[str]) -> dict[str, Marks]:
        return {name: Marks(self.errors[fixes][name == "all"]) for name in names}


def found(advice: Advice, trial: Trial, monkeypatch: pytest.MonkeyPatch) -> list[Advice]:
    """Once the clock is set, the laser's noise is found."""

    def look(fixes: Fixes) -> Any:
        assert fixes == (CLOCK,)
        return SimpleNamespace(kept=lambda role: {"all"})

    monkeypatch.setattr(tried, "_first_that_helps", lambda *_: [HIGH])
    return tried._beside_another([advice], (), look, trial, ())


def test_a_clock_that_helps_only_beside_another_fix_is_offered_with_it(monkeypatch: pytest.MonkeyPatch) -> None:
    first, second = found(LATE, Trial(0.0046), monkeypatch)
    assert (first.fixes, second.fixes) == ((CLOCK,), (NOISE,))
    assert first.before is not None
    assert first.after is not None
    assert (first.before["compass"].position, first.after["compass"].position) == (0.067, 0.033)


@pytest.mark.parametrize(("both", "compass"), [(0.0070, 0.033), (0.0046, 0.066)])
def test_not_where_both_together_make_something_worse_or_the_sensor_gains_nothing(
    both: float, compass: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert not found(LATE, Trial(both, compass), monkeypatch)


def test_only_for_what_surely_spoils_the_estimate(monkeypatch: pytest.MonkeyPatch) -> None:
    mild = Advice(Finding("compass", "lag", "late"), tried=((CLOCK,),), judges=("compass", "all"))
    assert not found(mild, Trial(0.0046), monkeypatch)


@pytest.mark.parametrize(
    ("last", "left"),
    [
        ("0.000", [("lrf", ("lrf.range_scale=0.95",))]),
        ("-0.050", [("camera", ("camera.time_offset=-0.050",)), ("lrf", ("lrf.range_scale=0.95",))]),
    ],
)
def test_a_clock_that_is_moved_and_moved_back_is_no_advice(last: str, left: list[tuple[str, Fixes]]) -> None:
    """It only looked wrong beside a laser whose ranges were."""
    moved = Advice(Finding("camera", "lag", "late"), (f"camera.time_offset={last}",))
    scaled = Advice(Finding("lrf", "range scale", "too long"), ("lrf.range_scale=0.95",))
    open_one = Advice(Finding("compass", "outliers", "a third does not fit"))
    kept = (f"camera.time_offset={last}", "lrf.range_scale=0.95")
    robot = SimpleNamespace(settings=lambda _: SimpleNamespace(time_offset=0.0, range_scale=1.0))
    found = evaluator.changing([moved, scaled, open_one], kept, robot)  # type: ignore[arg-type]
    assert [(a.finding.role, a.fixes) for a in found] == [*left, ("compass", ())]
