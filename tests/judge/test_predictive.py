"""Listening, scoring and ranking without truth, and thinning a sensor."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest
import small_drive
from msgspec.structs import replace
from numpy.typing import NDArray
from scipy import stats

from locfuse.fusion.data import Audit, Drive, Estimates, Measurements, Motions
from locfuse.fusion.fuse import fuse
from locfuse.fusion.judge.bootstrap import block_means
from locfuse.fusion.judge.predictive import (
    OUTLIER_SHARE,
    Score,
    contradictions,
    interval,
    listeners,
    log_density,
    mean_density,
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


def audit_of(y: list[float], sigma: float, rows: list[int]) -> Audit:
    n = len(y)
    return Audit(
        np.array(rows), np.array(rows), np.zeros(n, np.int8), np.full(n, -1), np.zeros(n), np.zeros(n),
        np.array(y)[:, None], np.full((n, 1), sigma),
    )  # fmt: skip


N = 40
LAID: tuple[float, ...] = tuple(np.random.default_rng(2).normal(size=N).tolist())


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


def run_of(name: str, sigma: float, sensors: tuple[str, ...], *audited: str) -> Estimates:
    t = laid().t
    audits = {s: audit_of(list(LAID), sigma, list(range(N))) for s in audited}
    return Estimates(name, sensors, t, np.zeros((N, 3)), np.zeros((N, 6)), audits)


def density(y: NDArray[np.float64], sigma: float) -> NDArray[np.float64]:
    normal = stats.norm.pdf(y, scale=sigma)
    return np.asarray(np.log(0.95 * normal + 0.05 / 10.0))


def test_the_scores_are_mean_densities_of_the_readings_behind_the_first() -> None:
    drive = laid()
    odometry = run_of("odometry", 3.0, (), "compass", "lrf")
    found = scores(drive, [odometry, run_of("compass", 1.2, ("compass",), "compass", "lrf")])
    assert [(s.configuration, s.sensor, s.stretches, s.shared) for s in found] == [
        ("odometry", "compass", False, False), ("odometry", "lrf", False, False), ("compass", "lrf", False, False),
    ]  # fmt: skip
    y = np.array(LAID[1:])
    mine, theirs = density(y, 1.2), density(y, 3.0)
    assert found[2].numbers == N - 1
    assert found[2].score == pytest.approx(mine.mean())
    assert found[2].gain == pytest.approx((mine - theirs).mean())
    low, high = interval(mine - theirs, drive.t[1:])
    assert (found[2].low, found[2].high) == pytest.approx((low, high))
    assert found[0].gain == 0.0
    drawn = scores(laid(matched=1), [odometry])
    assert [s.shared for s in drawn] == [False, True]


def test_a_reading_that_either_run_did_not_compare_is_not_scored() -> None:
    drive = laid()
    odometry, other = run_of("odometry", 3.0, (), "lrf"), run_of("compass", 1.2, ("compass",), "lrf")
    seen = [i for i in range(N) if i not in {3, 7}]
    part = audit_of([LAID[i] for i in seen], 1.2, seen)
    found = scores(drive, [odometry, replace(other, audits={"lrf": part})])
    assert [s.numbers for s in found] == [N - 1, N - 3]
    never = audit_of([LAID[0]], 1.2, [0])
    assert len(scores(drive, [odometry, replace(other, audits={"lrf": never})])) == 1


def test_the_mean_density_is_that_of_the_sensors_that_listened() -> None:
    drive = laid()
    half = np.arange(N) % 2 == 0
    e = run_of("odometry", 2.0, (), "compass", "lrf")
    every = density(np.array(LAID), 2.0)
    flags = {"compass": half, "lrf": np.ones(N, bool)}
    assert mean_density(drive, e, flags) == pytest.approx(0.5 * (every[half].mean() + every.mean()))
    assert mean_density(drive, e, {"lrf": half}) == pytest.approx(every[half].mean())
    assert mean_density(drive, e, {"lrf": np.zeros(N, bool)}) is None
    assert mean_density(drive, e, {}) is None


def test_of_several_numbers_the_score_is_their_mean() -> None:
    z = np.array([[0.0, 0.0], [4.0, 20.0]])
    audit = Audit(
        np.array([1]), np.array([1]), np.zeros(1, np.int8), np.full(1, -1), np.zeros(1), np.zeros(1),
        np.array([[0.5, -3.0]]), np.array([[2.0, 1.0]]),
    )  # fmt: skip
    found = log_density(audit, z)
    one, other = (
        math.log(0.95 * stats.norm.pdf(y, scale=s) + 0.05 / width)
        for y, s, width in ((0.5, 2.0, 4.0), (3.0, 1.0, 20.0))
    )
    assert math.isnan(found[0])
    assert found[1] == pytest.approx(0.5 * (one + other))
    assert (
        len(log_density(replace(audit, row=np.zeros(0, int), y=np.zeros((0, 2)), sigma=np.ones((0, 2))), z[:0]))
        == 0
    )


def test_sensors_take_turns_of_five_seconds_where_none_is_left_out() -> None:
    drive = laid()
    turns = listeners(drive, ("compass", "lrf"))
    assert turns["compass"].tolist() == [5.0 <= t < 10.0 for t in drive.t]
    assert turns["lrf"].tolist() == [10.0 <= t < 15.0 for t in drive.t]
    assert {s: flags.all() for s, flags in listeners(drive, ("lrf",)).items()} == {"compass": True}


def score(name: str, sensor: str, gain: float, high: float = -0.01, stretches: bool = False) -> Score:
    return Score(name, sensor, 99, 0.0, gain, gain - 1.0, high, stretches)


def test_configurations_are_ranked_by_the_mean_gain_on_what_they_leave_out() -> None:
    found = [
        score("odometry", "compass", 0.0), score("odometry", "lrf", 0.0), score("lrf", "compass", 0.4),
        score("compass", "lrf", 0.6), score("all", "compass", 9.0, stretches=True), score("gyro", "compass", 0.8),
        score("gyro", "lrf", 0.6),
    ]  # fmt: skip
    ranked = ranking(found, ["odometry", "all", "lrf", "compass", "gyro"])
    assert [(r.configuration, r.gain) for r in ranked] == [
        ("gyro", pytest.approx(0.7)), ("compass", 0.6), ("lrf", 0.4), ("odometry", 0.0), ("all", None),
    ]  # fmt: skip
    assert ranked[0].on == ("compass", "lrf")
    assert not ranked[0].stretches


@pytest.mark.parametrize(
    ("gain", "high", "stretches", "contradict"),
    [
        (-0.021, -0.001, False, True),
        (-0.019, -0.001, False, False),
        (-0.5, 0.001, False, False),
        (-0.5, -0.1, True, False),
    ],
)
def test_a_contradiction_is_sure_and_worth_two_hundredths(
    gain: float, high: float, stretches: bool, contradict: bool
) -> None:
    found = contradictions([score("lrf", "compass", gain, high, stretches)], {"lrf": "lrf"})
    assert found == ([("compass", "lrf")] if contradict else [])
    assert contradictions([score("lrf", "compass", gain, high, stretches)], {"gps": "gps"}) == []


@pytest.mark.parametrize(("seconds", "n", "block"), [(20.0, 200, 50), (5.0, 50, 50), (4.0, 40, 40), (100.0, 7, 1)])
def test_the_interval_is_by_blocks_of_five_seconds(seconds: float, n: int, block: int) -> None:
    values = np.random.default_rng(3).normal(size=n)
    means = block_means(values[None], block)[:, 0]
    assert interval(values, np.linspace(3.0, 3.0 + seconds, n)) == pytest.approx(np.percentile(means, (2.5, 97.5)))


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
