"""NEES of many errors, against a solver of linear equations, and the same in both forms."""

from __future__ import annotations

import numpy as np
import pytest

from locfuse.fusion.core import nees as interpreted
from locfuse.fusion.core.form import form
from locfuse.fusion.core.room import Room
from locfuse.fusion.data import Array

LEAST = 1e-12


def judged(e: Array, S: Array) -> Array:
    rows, d = e.shape
    out = [np.full(rows, np.nan) for _ in range(2)]
    for unit, found in zip((None, form().functions), out, strict=True):
        on = Room.of(interpreted, unit).on_arrays
        on.nees(
            e, np.ascontiguousarray(S.reshape(rows, d * d)), rows, d, LEAST, np.empty((d, d)), np.empty(d), found
        )
    np.testing.assert_array_equal(out[0], out[1])
    return out[0]


@pytest.mark.parametrize("d", [2, 3])
def test_it_is_the_error_in_units_of_what_was_claimed(d: int) -> None:
    rng = np.random.default_rng(d)
    root, e = rng.normal(size=(50, d, d)) * rng.uniform(1e-3, 10.0, (50, 1, 1)), rng.normal(size=(50, d))
    S = root @ root.transpose(0, 2, 1)
    expected = np.einsum("ni,ni->n", e, np.linalg.solve(S, e[:, :, None])[:, :, 0]) / d
    np.testing.assert_allclose(judged(e, S), expected, rtol=1e-6)


def test_a_singular_covariance_judges_nothing() -> None:
    line = np.array([1.0, 2.0, -1.0])
    singular = [np.zeros((3, 3)), np.outer(line, line), np.diag([1.0, 1.0, 1e-13]), np.diag([1.0, -1.0, 1.0])]
    turned = np.array([[1e-13, 1.0, 0.0], [-1.0, 1e-13, 1.0], [0.0, 1.0, 1.0]])
    singular.append(turned @ np.diag([1.0, 1e-13, 1.0]) @ turned.T)  # no single variance shows it
    no_number = np.eye(3)
    no_number[1, 1] = np.nan
    S = np.array([*singular, no_number, np.diag([1.0, 1.0, 1e-11])])
    assert np.isfinite(judged(np.ones((7, 3)), S)).tolist() == [False] * 6 + [True]
