"""A counter that rolled over, and one that did not."""

from __future__ import annotations

import numpy as np
import pytest

from locfuse.fusion.wheels.rollover import unrolled

RANGE = 64.0


def test_a_counter_that_rolled_over_counts_on() -> None:
    true = np.arange(200.0)
    found = unrolled(true % RANGE, likely=(RANGE,))
    assert (found.modulus, found.turns) == (RANGE, 3)
    np.testing.assert_array_equal(found.values, true)


@pytest.mark.parametrize("top", [66.0, 90.0, 120.0])
def test_values_that_span_more_than_one_range_never_rolled_over_it(top: float) -> None:
    """A counter modulo 64 shows no 66: a fall by 63 is then a fault of the reading, however well it fits."""
    values = np.concatenate((np.arange(0.0, top), np.arange(top - 64.0, top - 40.0)))
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
