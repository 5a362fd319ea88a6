"""Statistics of a series in time order: its split into two parts, and standard errors by leaving out parts.

Both parts of a split have their own least-squares slope. With x = 1 a slope is a mean, and the split is a step of
the mean (Hinkley, Biometrika 1970).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from .data import Array, Ints

MIN_SQUARES = 1e-12  # of x in one part; smaller sums are raised to it


class Split(NamedTuple):
    """Least-squares slopes of y over x in two parts of a series: up to index `at`, and after it."""

    at: int
    before: float
    after: float
    explained: float  # part of the sum of squares of y that both slopes explain
    sigmas: tuple[float, float]  # of the slopes, for errors of 1


def best_split(x: Array, y: Array, edge: int) -> Split:
    """Return the split of y (n,) over x (n,) with least squared error, `edge` or more values from both ends."""
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

    `estimate` returns k numbers or one by the values at some indices, or None: then the error is infinite. One of
    `parts` consecutive parts is left out at a time (Quenouille 1956; Tukey 1958).
    """
    rows = np.arange(n)
    found = [estimate(np.delete(rows, part)) for part in np.array_split(rows, parts)]
    if any(f is None for f in found):
        return np.array(math.inf)
    errors: Array = np.std(found, axis=0) * math.sqrt(parts - 1)
    return errors
