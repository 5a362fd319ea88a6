"""NEES of many errors, against a solver of linear equations."""

from __future__ import annotations

import numpy as np
import pytest

from locfuse.fusion.judge.evaluate import nees


@pytest.mark.parametrize("d", [2, 3])
def test_it_is_the_error_in_units_of_what_was_claimed(d: int) -> None:
    rng = np.random.default_rng(d)
    root, e = rng.normal(size=(50, d, d)) * rng.uniform(1e-3, 10.0, (50, 1, 1)), rng.normal(size=(50, d))
    S = root @ root.transpose(0, 2, 1)
    expected = np.einsum("ni,ni->n", e, np.linalg.solve(S, e[:, :, None])[:, :, 0]) / d
    np.testing.assert_allclose(nees(e, S), expected, rtol=1e-6)


def test_a_singular_covariance_judges_nothing() -> None:
    line = np.array([1.0, 2.0, -1.0])
    singular = [np.zeros((3, 3)), np.outer(line, line), np.diag([1.0, 1.0, 1e-13]), np.diag([1.0, -1.0, 1.0])]
    turned = np.array([[1e-13, 1.0, 0.0], [-1.0, 1e-13, 1.0], [0.0, 1.0, 1.0]])
    singular.append(turned @ np.diag([1.0, 1e-13, 1.0]) @ turned.T)  # no single variance shows it
    no_number = np.eye(3)
    no_number[1, 1] = np.nan
    S = np.array([*singular, no_number, np.diag([1.0, 1.0, 1e-11])])
    assert np.isfinite(nees(np.ones((7, 3)), S)).tolist() == [False] * 6 + [True]
