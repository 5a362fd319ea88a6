"""Listening, scoring and ranking without truth, and thinning a sensor."""

from __future__ import annotations

import math

import numpy as np
import pytest
import small_drive
from msgspec.structs import replace
from scipy import stats

from locfuse.fusion.data import Audit, Drive, Estimates
from locfuse.fusion.fuse import fuse
from locfuse.fusion.judge.predictive import (
    OUTLIER_SHARE,
    Score,
    contradictions,
    listeners,
    log_density,
    ranking,
    scores,
)
from locfuse.fusion.measure import thinned
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


def test_a_sensor_that_listens_learns_what_is_its_own() -> None:
    robot = small_drive.robot()
    drive = small_drive.drive(2, robot)
    heard = fuse(drive, robot, ("lrf",), listen=listeners(drive, ("lrf",)))
    offset, sigma = heard.blocks["compass_offset"][-1, 0], heard.block_sigmas["compass_offset"][-1, 0]
    assert abs(offset) < 3 * sigma < math.radians(1.0)
    deaf = fuse(drive, robot, (), listen=listeners(drive, ()))
    assert len(deaf.final_map) == 4


def test_a_listening_sensor_of_an_honest_filter_is_predicted_as_well_as_claimed() -> None:
    means = []
    for seed in range(4):
        robot = small_drive.robot()
        drive = small_drive.drive(seed, robot, laps=0.6)
        audit = fuse(drive, robot, ("lrf",), listen=listeners(drive, ("lrf",))).audits["compass"]
        means.append(np.nanmean(audit.nis))
    assert 0.8 < np.mean(means) < 1.3


def test_readings_listen_only_where_they_are_told_to() -> None:
    robot = small_drive.robot()
    drive = small_drive.drive(1, robot, sensors=("compass",))
    none = {"compass": np.zeros(len(drive.measurements["compass"].t), dtype=bool)}
    everything = fuse(drive, robot, ("compass",))
    np.testing.assert_array_equal(fuse(drive, robot, ("compass",), listen=none).pose, everything.pose)
    half = fuse(drive, robot, ("compass",), listen=listeners(drive, ("compass",)))
    assert not np.allclose(half.pose, everything.pose)


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


def test_what_the_motion_was_made_of_contradicts_nobody() -> None:
    """Without wheels the scans say how the robot moved: nothing predicts the laser better than itself."""
    worse = Score("gps", "lrf", 900, 2.0, -0.05, -0.06, -0.04, False)
    alone = {"gps": "gps", "lrf": "lrf"}
    assert contradictions([worse], alone) == [("gps", "lrf")]
    assert contradictions([replace(worse, shared=True)], alone) == []


def test_a_lone_sensor_is_tried_in_stretches() -> None:
    robot = small_drive.robot()
    drive = small_drive.drive(1, robot, sensors=("lrf",), truth=False)
    found = scores(drive, tried(drive, robot))
    ranked = ranking(found, ["odometry", "lrf"])
    assert [r.configuration for r in ranked] == ["lrf", "odometry"]
    assert ranked[0].stretches
    t = drive.measurements["lrf"].t
    listened = listeners(drive, ("lrf",))["lrf"]
    np.testing.assert_array_equal(listened, (t // 5.0) % 2 == 1)


def test_thinning_keeps_the_first_reading_of_every_period_and_nothing_else_changes() -> None:
    robot = small_drive.robot()
    drive = small_drive.drive(1, robot)
    slow = thinned(drive, {"lrf": 1.0})
    before, after = drive.measurements["lrf"], slow.measurements["lrf"]
    assert len(np.unique(np.floor(after.t))) == len(after.t)
    assert set(np.floor(before.t)) == set(np.floor(after.t))
    np.testing.assert_array_equal(slow.t, drive.t)
    np.testing.assert_array_equal(slow.t[slow.instant["lrf"]], after.t)
    assert slow.measurements["compass"] is drive.measurements["compass"]
    rows = np.flatnonzero(np.isin(np.repeat(before.t, np.diff(before.first)), after.t))
    np.testing.assert_array_equal(after.z, before.z[rows])


def test_a_higher_rate_than_the_logs_changes_nothing() -> None:
    robot = small_drive.robot()
    drive = small_drive.drive(1, robot)
    same = fuse(thinned(drive, {"lrf": 1000.0}), robot, ("lrf",))
    np.testing.assert_array_equal(same.pose, fuse(drive, robot, ("lrf",)).pose)
