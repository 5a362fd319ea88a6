"""Chi-square thresholds: how far a measurement may lie from its prediction, at a stated confidence."""

from __future__ import annotations

import math
from functools import cache
from statistics import NormalDist

MAD = 0.6745  # median absolute deviation of a normal distribution


@cache
def chi_square(confidence: float, dof: int) -> float:
    """Return the `confidence` quantile of a chi-square distribution with `dof` degrees of freedom.

    Exact: in closed form for one and two degrees of freedom, which are all that gates need; above by SciPy, which
    is only then imported. A confidence of 1 or more accepts everything.
    """
    if confidence >= 1.0:
        return math.inf
    if confidence <= 0.0:
        return 0.0
    if dof == 1:
        return NormalDist().inv_cdf(0.5 * (1.0 + confidence)) ** 2
    if dof == 2:
        return -2.0 * math.log1p(-confidence)
    from scipy.special import gammaincinv

    return 2.0 * float(gammaincinv(0.5 * dof, confidence))


def mean_bounds(confidence: float, dof: float, count: float) -> tuple[float, float]:
    """Return the interval that holds the mean of `count` chi-square values per degree of freedom."""
    total = max(1, round(dof * count))
    tail = 0.5 * (1.0 - confidence)
    return chi_square(tail, total) / total, chi_square(1.0 - tail, total) / total
