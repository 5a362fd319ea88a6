"""When a slope changes once: the split of a series that two least squares explain best.

Of a constant x = 1 the slope is the mean, so that the split is where a mean steps (Hinkley, Biometrika 1970).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .data import Array

MIN_SQUARES = 1e-12  # of x on one side: with less its slope is not known


class Split(NamedTuple):
    """Two slopes of y over x: of the first values up to `at`, and of the values after it."""

    at: int
    before: float
    after: float
    explained: float  # sum of squares of y that both slopes explain
    sigmas: tuple[float, float]  # of the slopes, for errors of 1


def best_split(x: Array, y: Array, edge: int) -> Split:
    """Return the two slopes through 0 with least squared error; the change is `edge` values from the ends."""
    inner = slice(edge, len(y) - edge)
    seen, weight = np.cumsum(x * y)[inner], np.cumsum(np.square(x))[inner]
    rest, other = float(x @ y) - seen, np.maximum(float(x @ x) - weight, MIN_SQUARES)
    weight = np.maximum(weight, MIN_SQUARES)
    explained = seen**2 / weight + rest**2 / other
    i = int(np.argmax(explained))
    sigmas = float(weight[i]) ** -0.5, float(other[i]) ** -0.5
    return Split(i + edge, float(seen[i] / weight[i]), float(rest[i] / other[i]), float(explained[i]), sigmas)
