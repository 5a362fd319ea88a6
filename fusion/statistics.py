"""Statistics: chi-square thresholds at a given confidence, robust sigmas and means, best split of a series.

Each part of a split has its own least-squares slope. With x = 1, a slope is a mean, and the split is a step of the
mean (Hinkley, Biometrika 1970).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from statistics import NormalDist
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .data import Array, Ints, Mask

Plane = NDArray[np.complex128]  # points of the plane as complex numbers

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


OUTLIER_LIMIT, ROBUST_ROUNDS = 4.0, 3  # medians of the residuals; fits without outliers
MIN_SQUARES = 1e-12  # least sum of x^2 in a part; smaller sums are raised to this


class Split(NamedTuple):
    """Least-squares slopes of y over x in two parts of a series: up to index `at`, and after it."""

    at: int
    before: float
    after: float
    explained: float  # by how much both slopes reduce the sum of squares of y
    sigmas: tuple[float, float]  # of the slopes, for errors of y with standard deviation 1


def best_split(x: Array, y: Array, edge: int) -> Split:
    """Return the split of y (n,) over x (n,) with the least squared error.

    It is at least `edge` values away from both ends.
    """
    inner = slice(edge, len(y) - edge)
    seen, weight = np.cumsum(x * y)[inner], np.cumsum(np.square(x))[inner]
    rest, other = float(x @ y) - seen, np.maximum(float(x @ x) - weight, MIN_SQUARES)
    weight = np.maximum(weight, MIN_SQUARES)
    explained = seen**2 / weight + rest**2 / other
    i = int(np.argmax(explained))
    sigmas = float(weight[i]) ** -0.5, float(other[i]) ** -0.5
    return Split(i + edge, float(seen[i] / weight[i]), float(rest[i] / other[i]), float(explained[i]), sigmas)


def jackknife(estimate: Callable[[Ints], Any], n: int, parts: int) -> Array:
    """Return the standard errors of an estimate from n values whose errors are correlated in time.

    The series is divided into `parts` parts of consecutive values, and each part is left out once (Quenouille
    1956; Tukey 1958). `estimate` takes indices of values and returns one number or k numbers. If it returns None,
    the error is infinite.
    """
    rows = np.arange(n)
    found = [estimate(np.delete(rows, part)) for part in np.array_split(rows, parts)]
    if any(f is None for f in found):
        return np.array(math.inf)
    return np.asarray(np.std(found, axis=0) * math.sqrt(parts - 1))


def part_of(t: Array, count: int) -> Ints:
    """Return for times (n,), in order, the index of their part, with `count` parts of equal length."""
    return np.asarray(np.minimum((t - t[0]) / (t[-1] - t[0]) * count, count - 1).astype(np.int64))


def sums(part: Ints, values: Plane) -> Plane:
    """Return the sums of complex values (n,) over the parts with these indices (n,)."""
    return np.asarray(np.bincount(part, values.real) + 1.0j * np.bincount(part, values.imag), np.complex128)


def off_turned(y: Plane, moved: Plane, part: Ints) -> Plane:
    """Return the differences (n,) of y from `moved`, which is turned to fit y best in each part.

    Points of the plane are complex numbers (n,), `part` (n,) the indices of their parts.
    """
    turned = np.exp(1.0j * np.angle(sums(part, y * moved.conj())))
    return np.asarray(y - turned[part] * moved)


def robust(A: NDArray[Any], y: NDArray[Any], least: float = 1e-4) -> tuple[NDArray[Any], Mask]:
    """Return the least-squares solution (k,) of A x = y, A (n, k), y (n,), without outliers, and the rows in use.

    Residuals above OUTLIER_LIMIT times their median, but at least times `least`, are left out. Points of the plane
    are complex numbers, so an element of x scales and turns.
    """
    keep, x = np.ones(len(y), dtype=bool), np.zeros(A.shape[1], A.dtype)
    for _ in range(ROBUST_ROUNDS):
        x = np.asarray(np.linalg.lstsq(A[keep], y[keep], rcond=None)[0])
        rest = np.abs(y - A @ x)
        keep = rest <= OUTLIER_LIMIT * max(float(np.median(rest)), least)
    return x, keep


def robust_with_sigmas(A: NDArray[Any], y: NDArray[Any], parts: int) -> tuple[NDArray[Any], Array]:
    """Return the solution (k,) of `robust`, and its standard errors (k,) by a jackknife of `parts` parts."""
    return robust(A, y)[0], jackknife(lambda some: robust(A[some], y[some])[0], len(y), parts)
