"""A counter that rolled over, and one that did not."""

from __future__ import annotations

import math

import numpy as np
import pytest

from locfuse.fusion.wheels.repairs import unrolled

RANGE = 64.0


def test_a_counter_that_rolled_over_counts_on() -> None:
    true = np.arange(200.0)
    found = unrolled(true % RANGE, likely=(RANGE,))
    assert (found.modulus, found.turns) == (RANGE, 3)
    np.testing.assert_array_equal(found.values, true)


@pytest.mark.parametrize("top", [66.0, 90.0, 120.0])
@pytest.mark.parametrize("zero", [0.0, -50.0])
def test_values_that_span_more_than_one_range_never_rolled_over_it(top: float, zero: float) -> None:
    """A counter modulo 64 shows no 66: a fall by 63 is then a fault of the reading, however well it fits."""
    values = zero + np.concatenate((np.arange(0.0, top), np.arange(top - 64.0, top - 40.0)))
    steps = np.abs(np.diff(values))
    assert steps.max() == RANGE - 1.0
    assert values.max() - values.min() > RANGE
    found = unrolled(values, likely=(RANGE,))
    assert found.modulus is None
    np.testing.assert_array_equal(found.values, values)


@pytest.mark.parametrize(("left", "rolled"), [(9.0, True), (14.0, True), (20.0, False)])
def test_a_long_step_is_a_rollover_only_if_an_ordinary_one_is_left(left: float, rolled: bool) -> None:
    """Ordinary steps are of 10; what a fall leaves of the range may be one and a half of them."""
    values = np.array([0.0, 10.0, 20.0, 30.0, 40.0, 50.0, 60.0])
    after = values[-1] + left - RANGE + np.array([0.0, 10.0, 20.0])
    found = unrolled(np.concatenate((values, after)), likely=(RANGE,))
    assert (found.modulus == RANGE) is rolled


@pytest.mark.parametrize("unit", [1e-9, 1.0, 1e9])
@pytest.mark.parametrize("bits", [8, 10, 16])
def test_a_counter_of_so_many_bits_is_found_whatever_its_unit(bits: int, unit: float) -> None:
    true = np.arange(3 * 2**bits, step=2 ** (bits - 6)) * unit
    found = unrolled(true % (2**bits * unit))
    assert found.modulus == pytest.approx(2**bits * unit, rel=1e-9)
    np.testing.assert_allclose(found.values, true, rtol=1e-9)


@pytest.mark.parametrize("turn", [2.0 * math.pi, 360.0])
def test_an_angle_counts_on_over_its_turn(turn: float) -> None:
    true = np.cumsum(np.random.default_rng(1).uniform(0.0, 0.1 * turn, 200))
    found = unrolled(true % turn)
    assert found.modulus == turn
    np.testing.assert_allclose(np.diff(found.values), np.diff(true), atol=1e-9)


def test_a_wheel_at_rest_where_its_angle_rolls_over_does_not_turn_about() -> None:
    """Nothing but rounding moves: 0 and a turn less a billionth are one place."""
    found = unrolled(np.array([0.0, 0.0, 360.0 - 1e-9, 0.0, 360.0 - 1e-9, 360.0 - 1e-9]))
    assert found.modulus == 360.0
    np.testing.assert_allclose(found.values, found.values[0], atol=2e-9)


def test_ticks_that_come_three_at_a_time_are_a_third_of_the_step() -> None:
    true = np.arange(0.0, 20000.0, 3.0)
    found = unrolled(true % 4096.0)
    assert found.modulus == 4096.0
    np.testing.assert_array_equal(found.values, true)


@pytest.mark.parametrize(("miss", "ticks"), [(0.01, True), (0.03, False)])
def test_steps_are_of_ticks_where_they_miss_whole_numbers_by_a_fiftieth_at_most(miss: float, ticks: bool) -> None:
    true = np.cumsum(np.tile([1.0, 2.0 + miss, 3.0 - miss], 100))
    assert (unrolled(true % 256.0).modulus is not None) is ticks
