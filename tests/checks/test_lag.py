"""A sensor's clock against the wheels': the lag that was put in is found, by wheels that slip too."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from locfuse.fusion.checks.lag import MAX_LAG_S, by_wheels, find_lag
from locfuse.fusion.wheels.motion import Wheels

Array = NDArray[np.float64]
T = np.arange(0.0, 120.0, 0.02)
TURNED = np.cumsum(0.02 * np.sin(0.9 * T) * np.cos(0.13 * T))  # rad


def wheels(turned: Array = TURNED) -> Wheels:
    twist = np.zeros((len(T) - 1, 3))
    twist[:, 2] = np.diff(turned)
    return Wheels.from_twists(T, twist, 0.3, 1e-4)


@pytest.mark.parametrize("lag", [-1.32, -0.13, -0.004, 0.0, 0.0371, 0.9])
def test_the_lag_that_was_put_in_is_found(lag: float) -> None:
    rng = np.random.default_rng(0)
    t = np.arange(3.0, 117.0, 0.1)
    heading = np.interp(t + lag, T, TURNED) + rng.normal(0.0, 0.002, len(t)) + 0.7
    found = find_lag(t, heading, by_wheels(wheels()))
    assert found is not None
    assert found.offset == pytest.approx(lag, abs=0.005)
    assert found.correlation > 0.999
    assert found.without <= found.correlation + 1e-6


def test_a_lag_beyond_the_longest_is_none() -> None:
    t = np.arange(4.0, 115.0, 0.1)
    assert find_lag(t, np.interp(t + MAX_LAG_S + 0.3, T, TURNED), by_wheels(wheels())) is None


def test_a_robot_that_hardly_turns_says_nothing_of_clocks() -> None:
    t = np.arange(3.0, 117.0, 0.1)
    assert find_lag(t, np.interp(t, T, 0.001 * TURNED), by_wheels(wheels())) is None


def test_readings_seconds_apart_that_turn_otherwise_do_not_vouch_for_a_clock() -> None:
    t = np.arange(3.0, 117.0, 2.5)
    heading = np.interp(t, T, TURNED) + np.random.default_rng(0).normal(0.0, 0.3, len(t))
    assert find_lag(t, heading, by_wheels(wheels())) is None


def steered(seed: int, gain: float) -> tuple[Array, Array]:
    """Headings by the wheels and in truth of a robot with corners every 7 s, which turns its slips back."""
    rng = np.random.default_rng(seed)
    corner = np.where(T % 7.0 < 3.0, 0.5, 0.0) * np.sign(np.sin(0.3 * T))  # rad/s
    slips = rng.normal(0.0, np.sqrt(6.7e-4 * 0.02), len(T))  # rad, white: the paper's robot at 0.3 m/s
    rate, off, turned = 0.0, 0.0, np.zeros(len(T))
    for i in range(1, len(T)):
        rate += 0.02 / 0.12 * (corner[i] - gain * off - rate)
        off += 0.02 * (rate - corner[i]) + slips[i]
        turned[i] = turned[i - 1] + 0.02 * rate
    return turned, turned + np.cumsum(slips)


@pytest.mark.parametrize("gain", [0.0, 0.75])
def test_wheels_that_slip_tell_the_lag_whoever_steers(gain: float) -> None:
    t = np.arange(3.0, 117.0, 0.1)
    offsets = []
    for seed in range(40):
        rolled, true = steered(seed, gain)
        lag = find_lag(t, np.interp(t, T, true), by_wheels(wheels(rolled)))
        assert lag is not None
        offsets.append(lag.offset)
    assert abs(np.mean(offsets)) < 0.0025
    assert np.std(offsets) < 0.0065


def test_readings_from_either_side_of_a_gap_are_not_compared() -> None:
    t = np.concatenate((np.arange(3.0, 50.0, 0.1), np.arange(70.0, 117.0, 0.1)))
    heading = np.interp(t - 0.2, T, TURNED) + np.where(t > 60.0, 2.0, 0.0)
    found = find_lag(t, heading, by_wheels(wheels()))
    assert found is not None
    assert found.offset == pytest.approx(-0.2, abs=0.002)
