"""Listening, scoring and ranking without truth, and thinning a sensor."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest
import small_drive
from numpy.typing import NDArray
from scipy import stats

from locfuse.fusion.data import Audit, Drive, Estimates, Measurements, Motions
from locfuse.fusion.fuse import fuse
from locfuse.fusion.judge.predictive import (
    OUTLIER_SHARE,
    contradictions,
    listeners,
    log_density,
    ranking,
    scores,
)
from locfuse.fusion.robot import Robot

SETS: tuple[tuple[str, ...], ...] = ((), ("compass",), ("lrf",), ("compass", "lrf"))


def tried(drive: Drive, robot: Robot) -> list[Estimates]:
    sets = [s for s in SETS if set(s) <= set(drive.measurements)]
    return [fuse(drive, robot, s, listen=listeners(drive, s)) for s in sets]


@pytest.mark.parametrize("mode", ["consider", "refine", "grow"])
@pytest.mark.parametrize("sensors", [(), ("compass",), ("lrf",)])
def test_a_sensor_that_listens_never_moves_the_pose(mode: str, sensors: tuple[str, ...]) -> None:
    robot = small_drive.robot(lrf={"map": mode})
    drive = small_drive.drive(1, robot, laps=0.4)
    alone, heard = fuse(drive, robot, sensors), fuse(drive, robot, sensors, listen=listeners(drive, sensors))
    np.testing.assert_allclose(heard.pose, alone.pose, atol=1e-12)
    np.testing.assert_allclose(heard.P, alone.P, atol=1e-12)
    assert heard.sensors == sensors
    assert set(heard.audits) == {"compass", "lrf"}


def test_a_listening_sensor_of_an_honest_filter_is_predicted_as_well_as_claimed() -> None:
    means = []
    for seed in range(4):
        robot = small_drive.robot()
        drive = small_drive.drive(seed, robot, laps=0.6)
        audit = fuse(drive, robot, ("lrf",), listen=listeners(drive, ("lrf",))).audits["compass"]
        means.append(np.nanmean(audit.nis))
    assert 0.8 < np.mean(means) < 1.3


def test_the_score_is_the_mixture_of_the_predicted_normal_and_anything() -> None:
    y, sigma = np.array([[0.5], [math.nan]]), np.array([[2.0], [math.nan]])
    audit = Audit(
        np.array([0, 1]),
        np.array([0, 2]),
        np.zeros(2, dtype=np.int8),
        np.full(2, -1),
        np.zeros(2),
        np.zeros(2),
        y,
        sigma,
    )
    z = np.array([[0.0], [4.0], [10.0]])
    found = log_density(audit, z)
    density = (1 - OUTLIER_SHARE) * stats.norm.pdf(0.5, scale=2.0) + OUTLIER_SHARE / 10.0
    assert found[0] == pytest.approx(math.log(density), rel=1e-12)
    assert math.isnan(found[1])  # never compared
    assert found[2] == pytest.approx(math.log(OUTLIER_SHARE / 10.0))  # compared, and nothing was predicted


N = 40


def laid(matched: object = None) -> Drive:
    """Forty readings of two sensors, one each half second, with values from -5 to 5."""
    m = Measurements(
        np.linspace(0.0, 19.5, N), np.arange(N + 1), np.linspace(-5.0, 5.0, N)[:, None], np.ones((N, 1, 1)), 1.0,
        np.zeros((1, 1)),
    )  # fmt: skip
    motions = Motions(np.zeros((N, 3)), np.zeros((N, 3, 3)), np.zeros((N, 3, 0)))
    sensors = {"compass": m, "lrf": m}
    return Drive(
        0, m.t, motions, sensors, {s: np.arange(N) for s in sensors}, {}, wheels=SimpleNamespace(matched=matched)
    )


def density(y: NDArray[np.float64], sigma: float) -> NDArray[np.float64]:
    normal = stats.norm.pdf(y, scale=sigma)
    return np.asarray(np.log(0.95 * normal + 0.05 / 10.0))


def test_sensors_take_turns_of_five_seconds_where_none_is_left_out() -> None:
    drive = laid()
    turns = listeners(drive, ("compass", "lrf"))
    assert turns["compass"].tolist() == [5.0 <= t < 10.0 for t in drive.t]
    assert turns["lrf"].tolist() == [10.0 <= t < 15.0 for t in drive.t]
    assert {s: flags.all() for s, flags in listeners(drive, ("lrf",)).items()} == {"compass": True}


@pytest.mark.parametrize("seed", range(2))
def test_good_sensors_predict_each_other_better_than_odometry_does(seed: int) -> None:
    robot = small_drive.robot()
    drive = small_drive.drive(seed, robot, laps=0.6, truth=False)
    found = scores(drive, tried(drive, robot))
    ranked = ranking(found, ["odometry", "compass", "lrf", "all"])
    assert ranked[-2].configuration == "odometry"
    assert ranked[-1].configuration == "all"
    assert ranked[-1].gain is None  # it leaves nothing out
    assert all(s.low > 0.0 for s in found if s.configuration in {"compass", "lrf"})
    assert contradictions(found, {"compass": "compass", "lrf": "lrf"}) == []


@pytest.mark.parametrize("seed", range(2))
def test_a_biased_compass_and_a_laser_contradict_each_other(seed: int) -> None:
    robot = small_drive.robot(compass={"offset_deg": 0.0})
    drive = small_drive.drive(seed, robot, laps=0.6, compass_noise_deg=0.5, compass_bias_deg=5.0, truth=False)
    found = scores(drive, tried(drive, robot))
    assert contradictions(found, {"compass": "compass", "lrf": "lrf"}) == [("compass", "lrf")]
    assert ranking(found, ["odometry", "compass", "lrf"])[0].configuration == "odometry"
