"""A small sample of `python -m benchmarks.faults`: two of its drives, without the camera (it takes long)."""

from __future__ import annotations

from functools import cache

import pytest
from lock_step import simulated

from benchmarks import faults
from locfuse.fusion.checks.clocks import clock_lags
from locfuse.fusion.data import Drive, Evaluation
from locfuse.fusion.fuse import fuse
from locfuse.fusion.judge.evaluate import evaluate

CASES = {name: case for name, case in faults.CASES.items() if case.sensor in {"compass", "lrf", ""}}
SEEDS = (1000, 1001)


@cache
def judged(seed: int, fault: str, without: str = "") -> tuple[Drive, Evaluation]:
    drive, robot = simulated(seed, sets=(f"faults=[{fault}]",) if fault else ())
    return drive, evaluate(fuse(drive, robot, [s for s in ("compass", "lrf") if s != without]), drive)


@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_a_fault_costs_no_more_than_is_allowed_and_passes(case: faults.Case) -> None:
    drives = [judged(seed, case.fault) for seed in SEEDS]
    yard = [judged(seed, case.fault if case.sensor else "", case.sensor) for seed in SEEDS]
    assert sum(faults.rmse(e) for _, e in drives) <= case.factor * sum(faults.rmse(e) for _, e in yard)
    assert max(faults.anees_outside(e) for _, e in drives) < 2.0


def test_a_clock_that_is_off_is_reported_within_20_ms() -> None:
    for seed in SEEDS:
        drive, _ = judged(seed, f'{{kind="clock_offset", sensor="lrf", seconds={faults.OFFSET}}}')
        lag = clock_lags(drive.measurements, drive.wheels).get("lrf")
        assert lag is not None
        assert lag.offset == pytest.approx(-faults.OFFSET, abs=0.02)
