"""Lines that may be one wall, and lines that proved nothing: against the same in NumPy, in both forms."""

from __future__ import annotations

import numpy as np
import pytest

from locfuse.fusion.core import doubles
from locfuse.fusion.core.form import form
from locfuse.fusion.core.room import Room
from locfuse.fusion.se2 import wrap_all

ANGLE, OFFSET, APART = 0.14, 0.25, 0.3
FORMS = [None, form().functions] if form().functions is not None else [None]


def in_numpy(rows: np.ndarray, low: np.ndarray, high: np.ndarray, i: int) -> np.ndarray:
    """Which lines may be one wall with line i: the difference of both about the other's anchor."""
    rho, beta = rows[:, 0], rows[:, 1]
    away = rows[i, 2:] - rows[:, 2:]
    offset = rho - (rho[i] + away @ [np.cos(beta[i]), np.sin(beta[i])])
    along = away[:, 1] * np.cos(beta) - away[:, 0] * np.sin(beta)
    apart = np.maximum(low, low[i] + along) - np.minimum(high, high[i] + along)
    near = (np.abs(wrap_all(beta - beta[i])) < ANGLE) & (np.abs(offset) <= OFFSET) & (apart <= APART)
    near[i] = False
    return np.flatnonzero(near)


@pytest.mark.parametrize("functions", FORMS)
def test_lines_that_may_be_one_wall_are_those_of_the_textbook(functions: object) -> None:
    core, rng, pairs = Room.of(doubles, functions).on_arrays, np.random.default_rng(0), 0  # type: ignore[arg-type]
    for _ in range(60):
        n = int(rng.integers(1, 30))
        angles = rng.integers(0, 4, n) * np.pi / 2 + rng.normal(0.0, 0.1, n) + rng.choice([0.0, 2 * np.pi], n)
        rows = np.column_stack((rng.normal(0.0, 0.2, n), angles, rng.uniform(-2.0, 2.0, (n, 2))))
        low = rng.uniform(-1.0, 0.0, n)
        high, found = low + rng.uniform(0.2, 2.0, n), np.empty(n, np.intp)
        for i in range(n):
            k = core.neighbours(rows, low, high, n, i, ANGLE, OFFSET, APART, found)
            np.testing.assert_array_equal(found[:k], in_numpy(rows, low, high, i))
            pairs += k
    assert pairs > 100


@pytest.mark.parametrize("functions", FORMS)
def test_a_line_has_its_trial_before_it_is_worthless(functions: object) -> None:
    core = Room.of(doubles, functions).on_arrays  # type: ignore[arg-type]
    hits, born = np.array([3, 4, 3, 3]), np.array([10, 10, 11, 0])
    assert [bool(core.worthless(hits, born, j, 26, 4, 15)) for j in range(4)] == [True, False, False, False]
