"""A sensor's clock against the wheels': the lag that was put in is found."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from locfuse.fusion.lag import LONGEST, find_lag
from locfuse.fusion.motion import Wheels

Array = NDArray[np.float64]
T = np.arange(0.0, 120.0, 0.02)
TURNED = np.cumsum(0.02 * np.sin(0.9 * T) * np.cos(0.13 * T))  # rad


def wheels() -> Wheels:
    twist = np.zeros((len(T) - 1, 3))
    twist[:, 2] = np.diff(TURNED)
    return Wheels.from_twists(T, twist, 0.3, 1e-4)


@pytest.mark.parametrize("lag", [-1.32, -0.13, -0.004, 0.0, 0.0371, 0.9])
def test_the_lag_that_was_put_in_is_found(lag: float) -> None:
    rng = np.random.default_rng(0)
    t = np.arange(3.0, 117.0, 0.1)
    heading = np.interp(t + lag, T, TURNED) + rng.normal(0.0, 0.002, len(t)) + 0.7
    found = find_lag(t, heading, wheels(), (0.0, float(T[-1])))
    assert found is not None
    assert found.offset == pytest.approx(lag, abs=0.005)
    assert found.correlation > 0.999
    assert found.without <= found.correlation + 1e-12


def test_a_lag_beyond_the_longest_is_none() -> None:
    t = np.arange(4.0, 115.0, 0.1)
    assert find_lag(t, np.interp(t + LONGEST + 0.3, T, TURNED), wheels(), (0.0, float(T[-1]))) is None


def test_a_robot_that_hardly_turns_says_nothing_of_clocks() -> None:
    t = np.arange(3.0, 117.0, 0.1)
    assert find_lag(t, np.interp(t, T, 0.001 * TURNED), wheels(), (0.0, float(T[-1]))) is None
