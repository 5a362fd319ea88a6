"""The equations by number, held to a textbook filter and to finite differences."""

from __future__ import annotations

import numpy as np
import pytest
from textbook import TextbookEkf, move, numeric_jacobian

from locfuse.fusion import se2
from locfuse.fusion.ekf.equations import eq5_x, eq7_A, eq10_12, predicted


def some(seed: int, n: int) -> tuple[np.random.Generator, np.ndarray]:
    g = np.random.default_rng(seed)
    A = g.normal(size=(n, n))
    return g, A @ A.T


@pytest.mark.parametrize("seed", range(4))
def test_a_prediction_is_the_textbook_filters(seed: int) -> None:
    g, P = some(seed, 3)
    Q = some(seed + 10, 3)[1]
    x, u = g.normal(size=3), g.normal(size=3)
    book = TextbookEkf(x, P)
    book.predict(u, Q)
    after, P_after = predicted(
        np.tile(x, (2, 1)), np.tile(P, (2, 1, 1)), np.tile(u, (2, 1)), np.tile(Q, (2, 1, 1))
    )
    np.testing.assert_allclose(after, [book.x, book.x], atol=1e-12)
    np.testing.assert_allclose(P_after, [book.P, book.P], atol=1e-12)


@pytest.mark.parametrize("u", [(0.0, 0.0, 0.0), (0.3, 0.1, -2.0), (-1.0, 0.0, 3.1)])
def test_eq_7_is_the_derivative_of_eq_5(u: tuple[float, float, float]) -> None:
    x, step = np.array([1.0, -2.0, 3.0]), np.array(u)
    np.testing.assert_allclose(eq5_x(x, step), move(x, step), atol=1e-14)
    np.testing.assert_allclose(eq7_A(x, eq5_x(x, step)), numeric_jacobian(lambda p: eq5_x(p, step), x), atol=1e-8)


@pytest.mark.parametrize("seed", range(4))
def test_a_correction_is_the_textbook_filters(seed: int) -> None:
    g, P = some(seed, 5)
    R = some(seed + 10, 2)[1]
    x, y, H = g.normal(size=5), g.normal(size=2), g.normal(size=(2, 5))
    book = TextbookEkf(x, P)
    book.correct(y, H, R)
    V, e, L = eq10_12(P @ H.T, H @ P @ H.T + R, y)
    np.testing.assert_allclose(x + V.T @ e, book.x, atol=1e-9)
    np.testing.assert_allclose(P - V.T @ V, book.P, atol=1e-9)
    np.testing.assert_allclose(L @ L.T, H @ P @ H.T + R, atol=1e-9)


def test_a_rotation_of_poses_turns_places_and_leaves_headings() -> None:
    theta, v = np.array([0.0, 1.0, -3.1]), np.array([[1.0, 2.0], [0.5, -1.0], [3.0, 0.1]])
    turned = np.einsum("nij,nj->ni", se2.rotation(theta), np.column_stack((v, theta)))
    np.testing.assert_allclose(turned[:, :2], se2.rotated(theta, v))
    np.testing.assert_array_equal(turned[:, 2], theta)
