"""Standard errors by leaving out parts, against the formula of the mean."""

from __future__ import annotations

import math

import numpy as np
import pytest

from locfuse.fusion.change import jackknife

VALUES = np.random.default_rng(1).normal(3.0, 2.0, (40, 2))


def test_the_error_of_a_mean_is_the_textbook_s_and_values_that_repeat_count_once() -> None:
    found = jackknife(lambda some: VALUES[some].mean(axis=0), len(VALUES), len(VALUES))
    assert found == pytest.approx(VALUES.std(axis=0, ddof=1) / math.sqrt(len(VALUES)), rel=1e-12)
    repeated = np.repeat(VALUES[:8, 0], 50)
    found = jackknife(lambda some: repeated[some].mean(), len(repeated), 8)
    assert float(found) == pytest.approx(VALUES[:8, 0].std(ddof=1) / math.sqrt(8.0), rel=1e-12)
    assert math.isinf(jackknife(lambda some: None if 0 not in some else 1.0, 40, 8))
