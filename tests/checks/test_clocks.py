"""Whose clock is off: sensors that see how the robot turned tell a lag better than wheels that slip."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace
from numpy.typing import NDArray

from locfuse.fusion import se2
from locfuse.fusion.checks.clocks import clock_lags, in_words, lag_of_run, lags_by_truth
from locfuse.fusion.checks.lag import Lag, worth_saying
from locfuse.fusion.data import Drive, Estimates, Measurements, Motions, Truth
from locfuse.fusion.wheels.motion import Wheels

Array = NDArray[np.float64]
T = np.arange(0.0, 90.0, 0.02)
SEEDS = range(12)


def turned(seed: int) -> tuple[Wheels, Array]:
    """Wheels of a robot with corners, and how it truly turned (n,) [rad]: they slip as the paper's do."""
    rng = np.random.default_rng(seed)
    rate = np.convolve(np.where(T % 12.0 < 3.0, 0.5, 0.0), np.ones(15) / 15.0, "same")  # rad/s
    by_wheels = np.cumsum(0.02 * rate)
    true = by_wheels + np.cumsum(rng.normal(0.0, np.sqrt(6.7e-4 * 0.02), len(T)))
    twist = np.zeros((len(T) - 1, 3))
    twist[:, 2] = np.diff(by_wheels)
    return Wheels.from_twists(T, twist, 0.6, 4e-4), true


def headings(true: Array, seed: int, rate: float, sigma_deg: float, late: float = 0.0) -> Measurements:
    """A sensor that sees the heading, dated `late` [s]."""
    t = np.arange(1.0, 89.0, 1.0 / rate)
    sigma = np.radians(sigma_deg)
    z = np.interp(t, T, true) + np.random.default_rng(900 + seed).normal(0.0, sigma, len(t))
    n = len(t)
    return Measurements(t + late, np.arange(n + 1), z[:, None], np.ones((n, 1, 1)), sigma, np.zeros((1, 1)))


def test_a_late_clock_is_told_by_the_sensor_that_sees_the_same_turning() -> None:
    errors, alone = [], []
    for seed in SEEDS:
        wheels, true = turned(seed)
        late = headings(true, seed, 10.0, 0.05, late=0.12)
        seen = {"compass": headings(true, seed + 50, 20.0, 0.5), "gyro": late}
        lags = clock_lags(seen, wheels)
        assert lags["gyro"].against == "compass"
        assert not worth_saying(lags["compass"])
        errors.append(lags["gyro"].offset + 0.12)
        alone.append(clock_lags({"gyro": late}, wheels)["gyro"].offset + 0.12)
    assert np.abs(errors).max() < 0.01
    assert np.std(alone) > 1.5 * np.std(errors)


def test_a_sensor_that_is_late_itself_tells_nothing() -> None:
    wheels, true = turned(0)
    seen = {"compass": headings(true, 0, 20.0, 0.5, late=0.2), "gyro": headings(true, 1, 10.0, 0.05, late=0.2)}
    lags = clock_lags(seen, wheels)
    assert {lag.against for lag in lags.values()} == {"wheels"}
    assert [lag.offset for lag in lags.values()] == pytest.approx([-0.2, -0.2], abs=0.03)


def test_a_sensor_that_knows_less_than_the_wheels_is_not_asked() -> None:
    wheels, true = turned(3)
    seen = {"compass": headings(true, 0, 20.0, 4.0), "gyro": headings(true, 1, 10.0, 0.05, late=0.2)}
    assert clock_lags(seen, wheels)["gyro"].against == "wheels"


def test_the_note_says_who_told() -> None:
    wheels, true = turned(0)
    seen = {"compass": headings(true, 0, 20.0, 0.5), "gyro": headings(true, 1, 10.0, 0.05, late=0.12)}
    words = in_words(clock_lags(seen, wheels)["gyro"])
    assert words.startswith("stamps look 0.1")
    assert "s late (1 sigma: 0.00" in words
    assert "s) against the compass, which agrees with the wheels (correlation" in words


@pytest.mark.parametrize("late", [0.0, 0.02])
def test_the_sigma_of_a_lag_is_as_large_as_its_error(late: float) -> None:
    """Over seeds the error in sigmas has a mean square of about 1."""
    errors = []
    for seed in SEEDS:
        wheels, true = turned(seed)
        lag = clock_lags({"gyro": headings(true, seed, 10.0, 0.05, late)}, wheels)["gyro"]
        errors.append((lag.offset + late) / lag.sigma)
    assert 0.3 < np.mean(np.square(errors)) < 2.5


def test_a_lag_is_said_from_four_of_its_own_sigmas_on() -> None:
    """20 ms are said where they are known to 4 ms, and not where to 6 ms."""
    said = Lag(0.02, 0.999, 0.98, sigma=0.004)
    assert worth_saying(said)
    assert not worth_saying(said._replace(sigma=0.006))
    assert not worth_saying(said._replace(without=0.9989))
    assert not worth_saying(Lag(0.13, 0.99, 0.9))
    assert not worth_saying(Lag(0.005, 0.999, 0.98, sigma=0.0001))


def a_run(wheels: Wheels, true: Array, seed: int, late: float) -> tuple[Drive, Truth, Estimates]:
    """A laser's run at 10 Hz whose heading is that of `late` [s] before, with errors of 0.1 degrees."""
    t = np.arange(1.0, 89.0, 0.1)
    errors = np.random.default_rng(700 + seed).normal(0.0, np.radians(0.1), len(t))
    pose = np.zeros((len(t), 3))
    pose[:, 2] = np.interp(t - late, T, true) + errors
    none = np.zeros((len(t), 6))
    motions = Motions(pose, np.zeros((len(t), 3, 3)), none)
    drive = Drive(0, t, motions, {}, {"lrf": np.arange(len(t))}, {}, wheels=wheels)
    truth = Truth("/truth", T, np.zeros((len(T), 2)), se2.wrap_all(true))
    return drive, truth, Estimates("lrf", ("lrf",), t, pose, none, {})


@pytest.mark.parametrize("late", [0.0, 0.02])
def test_a_run_whose_map_holds_the_heading_tells_its_clock_by_the_truth(late: float) -> None:
    """As far off as its sigma says, and within 1.5 ms."""
    errors, sigmas = [], []
    for seed in SEEDS:
        lag = lag_of_run(*a_run(*turned(seed), seed, late))
        assert lag is not None
        assert lag.against == "truth"
        errors.append(lag.offset + late)
        sigmas.append(lag.sigma)
    assert np.abs(errors).max() < 0.0015
    assert max(sigmas) < 0.001
    assert 0.2 < np.mean(np.square(np.array(errors) / sigmas)) < 2.5


@pytest.mark.parametrize("iron_deg", [0.0, 1.0])
def test_a_compass_tells_its_clock_beside_the_truth_far_better_than_beside_wheels(iron_deg: float) -> None:
    """Bound: noise / (rms of the rate * sqrt(readings)), 2.7 ms here; iron adds a heading's own error to it."""
    errors, sigmas, beside_wheels = [], [], []
    for seed in SEEDS:
        wheels, true = turned(seed)
        compass = headings(true, seed, 10.0, 1.0, late=0.03)
        iron = np.radians(iron_deg) * np.sin(np.interp(compass.t - 0.03, T, true) + seed)
        compass = replace(compass, z=compass.z + iron[:, None])
        drive = replace(a_run(wheels, true, seed, 0.0)[0], measurements={"compass": compass})
        truth = Truth("/truth", T, np.zeros((len(T), 2)), se2.wrap_all(true))
        lag = lags_by_truth(drive, truth)["compass"]
        errors.append(lag.offset + 0.03)
        sigmas.append(lag.sigma)
        beside_wheels.append(clock_lags(drive.measurements, wheels)["compass"].sigma)
    assert np.abs(errors).max() < 0.008
    assert 4.0 * max(sigmas) < min(beside_wheels)
    assert 0.3 < np.mean(np.square(np.array(errors) / sigmas)) < 2.5


def test_a_run_without_truth_s_headings_tells_no_clock() -> None:
    drive, truth, run = a_run(*turned(0), 0, 0.02)
    assert lag_of_run(drive, None, run) is None
    assert lag_of_run(drive, replace(truth, theta=None), run) is None
