"""The quantiles of chi-square are those of the integral of its density."""

from __future__ import annotations

import math

import pytest
from scipy.integrate import quad

from locfuse.fusion.chi_square import chi_square


@pytest.mark.parametrize("dof", [1, 2, 3, 4, 10, 61, 299])
@pytest.mark.parametrize("confidence", [0.025, 0.5, 0.975, 0.9999, 0.99999])
def test_a_quantile_leaves_its_confidence_below(confidence: float, dof: int) -> None:
    def density(x: float) -> float:
        return math.exp(
            (0.5 * dof - 1.0) * math.log(x) - 0.5 * x - 0.5 * dof * math.log(2.0) - math.lgamma(0.5 * dof)
        )

    limit = chi_square(confidence, dof)
    above = quad(density, limit, limit + 200.0 + 10.0 * dof, limit=400, points=[limit + 5.0, limit + 20.0])[0]
    assert above == pytest.approx(1.0 - confidence, rel=1e-6)
