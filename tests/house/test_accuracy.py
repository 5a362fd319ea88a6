"""A small sample of `python -m benchmarks.accuracy`: four of its drives, without the camera (it takes long)."""

from __future__ import annotations

import pytest

from benchmarks import accuracy

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
