"""Chi-square thresholds for gates and consistency bounds, at a given confidence."""

from __future__ import annotations

import math
from functools import cache
from statistics import NormalDist

import numpy as np
from numpy.typing import ArrayLike

EXACT_DOF, MAX_NEWTON_STEPS = 300, 50
CONFIDENCE = 0.95  # confidence of intervals and bounds
SIGMAS_95 = 1.96  # half width of the 95 % interval of a normal distribution, in standard deviations
CLIP_SIGMAS = 3.0  # robust standard deviations at which an error is clipped
MAD_OF_NORMAL = 0.6745  # median absolute deviation / standard deviation of a normal distribution


def robust_sigma(errors: ArrayLike) -> float:
    """Return the standard deviation of errors about 0, from their median size: a few outliers do not matter."""
    return float(np.median(np.abs(errors))) / MAD_OF_NORMAL


def clipped_rms(errors: ArrayLike) -> float:
    """Return the rms of errors (n,) about 0, each at most CLIP_SIGMAS times their robust standard deviation.

    It changes more smoothly with the errors than `robust_sigma` does.
    """
    return float(np.sqrt(np.mean(np.minimum(np.abs(errors), CLIP_SIGMAS * robust_sigma(errors)) ** 2)))


@cache
def chi_square(confidence: float, dof: int) -> float:
    """Return the `confidence` quantile of a chi-square distribution with `dof` degrees of freedom.

    For one and two degrees of freedom in closed form; up to EXACT_DOF by Newton's method, to 1e-9; above by Wilson
    and Hilferty (1931), to 3e-4. SciPy would add 0.4 s and 25 MB to every comparison. A confidence of 1 or more
    gives infinity.
    """
    if confidence >= 1.0:
        return math.inf
    if confidence <= 0.0:
        return 0.0
    if dof == 1:
        return NormalDist().inv_cdf(0.5 * (1.0 + confidence)) ** 2
    if dof == 2:
        return -2.0 * math.log1p(-confidence)
    spread = 2.0 / (9.0 * dof)
    x = float(dof * max(1.0 - spread + NormalDist().inv_cdf(confidence) * math.sqrt(spread), 0.01) ** 3)
    half = 0.5 * dof
    for _ in range(MAX_NEWTON_STEPS if dof <= EXACT_DOF else 0):
        density = 0.5 * math.exp((half - 1.0) * math.log(0.5 * x) - 0.5 * x - math.lgamma(half))
        step = (_upper_tail(x, dof) - (1.0 - confidence)) / density
        x = max(x + step, 0.1 * x)
        if abs(step) < 1e-12 * x:
            break
    return x


def _upper_tail(x: float, dof: int) -> float:
    """Return the probability that a chi-square value exceeds x (Abramowitz and Stegun 1964, 26.4.4, 26.4.5)."""
    half, odd = 0.5 * x, dof % 2
    total = math.erfc(math.sqrt(half)) if odd else 0.0
    term = math.exp(-half) * (math.sqrt(half) / math.gamma(1.5) if odd else 1.0)
    for i in range(dof // 2):
        total += term
        term *= half / (i + (1.5 if odd else 1.0))
    return total


def mean_bounds(dof: float, count: float) -> tuple[float, float]:
    """Return the two-sided bounds, at CONFIDENCE, of the mean of `count` values NIS / dof.

    NIS has a chi-square distribution with `dof` degrees of freedom.
    """
    total = max(1, round(dof * count))
    tail = 0.5 * (1.0 - CONFIDENCE)
    return chi_square(tail, total) / total, chi_square(1.0 - tail, total) / total
