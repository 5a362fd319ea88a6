"""A small sample of `python -m benchmarks.accuracy`: four of its drives, without the camera (it takes long)."""

from __future__ import annotations

from functools import cache

import pytest
from lock_step import simulated

from benchmarks import accuracy, faults
from locfuse.fusion.checks.clocks import clock_lags
from locfuse.fusion.data import Drive, Evaluation
from locfuse.fusion.fuse import fuse
from locfuse.fusion.judge.evaluate import evaluate

MODES = accuracy.MODES.split(",")


@pytest.fixture(scope="module")
def table() -> dict[str, dict[str, float]]:
    north = ("compass.offset_deg=-65",)
    drives = [accuracy.work(1000 + i, no_camera=True, robot_sets=north)["found"] for i in range(4)]
    return accuracy.over_drives(drives)


def test_every_sensor_beats_odometry_and_all_is_among_the_best(table: dict[str, dict[str, float]]) -> None:
    for mode in MODES:
        rmse = {name: table[f"{mode} {name}"]["mean_mm"] for name in ("odometry", "compass", "lrf", "all")}
        assert rmse["compass"] < rmse["odometry"]
        assert rmse["lrf"] < rmse["odometry"]
        assert rmse["all"] < 1.1 * min(rmse.values()), mode  # over fifty it is the best


def test_a_growing_map_is_accurate_to_millimetres_and_honest(table: dict[str, dict[str, float]]) -> None:
    found = table["grow all"]
    assert found["position_rmse_mm"] < 4.0
    assert found["heading_rmse_deg"] < 0.06
    assert 0.7 < found["anees"] < 1.4


def test_the_more_of_the_map_is_estimated_the_better(table: dict[str, dict[str, float]]) -> None:
    rmse = [table[f"{mode} all"]["mean_mm"] for mode in MODES]
    assert rmse == sorted(rmse, reverse=True)


def test_only_the_papers_frozen_map_is_sure_and_wrong(
    table: dict[str, dict[str, float]],
) -> None:
    anees = {mode: table[f"{mode} lrf"]["anees"] for mode in MODES}
    assert anees["first-scan"] > 2.0
    assert all(0.6 < anees[mode] < 1.6 for mode in ("consider", "refine", "grow")), anees


# --- a small sample of `python -m benchmarks.faults`: two of its drives, without the camera (it takes long)


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
