"""Statistics of a series: best split into two parts, jackknife standard errors, least squares without outliers.

Each part of a split has its own least-squares slope. With x = 1, a slope is a mean, and the split is a step of the
mean (Hinkley, Biometrika 1970).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .data import Array, Ints, Mask

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
