"""Sparse least squares over key poses, against dense least squares; robust kernels against a wrong closure."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares

from locfuse.fusion import se2
from locfuse.fusion.data import Array
from locfuse.fusion.scan_matching.solve import Edges, Normal, Problem

N = 12
START = Edges.known(0, np.array([1.0, -2.0, 0.5]), np.diag([1e6, 1e6, 1e6]))
GRADUATIONS = (1e4, 1e3, 1e2, 10.0, 1.0)


def ring(rng: np.random.Generator, noise: float) -> tuple[Array, Edges]:
    """Poses round a circle, and what is measured from each to the next two and of the last from the first."""
    angle = 2.0 * np.pi * np.arange(N) / N
    truth = np.stack((5.0 * np.cos(angle), 5.0 * np.sin(angle), angle + np.pi / 2.0), axis=-1)
    truth = se2.compose(START.z[0], se2.between(truth[:1], truth))
    i = np.concatenate((np.arange(N - 1), np.arange(N - 2), [0]))
    j = np.concatenate((np.arange(N - 1) + 1, np.arange(N - 2) + 2, [N - 1]))
    z = se2.between(truth[i], truth[j]) + noise * rng.normal(size=(len(i), 3))
    information = np.array([np.diag(rng.uniform(100.0, 900.0, 3)) for _ in i])
    return truth, Edges.of(i, j, z, information, np.inf)


def started(edges: Edges) -> Array:
    x = np.tile(START.z[0], (N, 1))
    for k in range(N - 1):
        x[k + 1] = se2.compose(x[k], edges.z[k])
    return x


def test_poses_and_covariances_equal_dense_least_squares() -> None:
    _, edges = ring(np.random.default_rng(1), 0.05)
    x, normal = Problem(START).solve(started(edges), edges)
    roots = np.linalg.cholesky(edges.information)

    def residuals(flat: Array) -> Array:
        poses = flat.reshape(-1, 3)
        e = np.einsum("nji,nj->ni", roots, edges.errors(poses)).ravel()
        return np.concatenate((e, 1e3 * (poses[0] - START.z[0])))

    book = least_squares(residuals, started(edges).ravel(), xtol=1e-15, ftol=1e-15, gtol=1e-12)
    np.testing.assert_allclose(x, book.x.reshape(-1, 3), atol=2e-5)
    P, after = normal.chain(N)
    dense = np.linalg.inv(book.jac.T @ book.jac).reshape(N, 3, N, 3)
    for k in range(N):
        np.testing.assert_allclose(P[k], dense[k, :, k, :], rtol=2e-3, atol=1e-9)
    np.testing.assert_allclose(after[3], dense[3, :, 4, :], rtol=2e-3, atol=1e-9)


def test_the_sparse_and_the_dense_way_to_covariances_agree(monkeypatch) -> None:  # type: ignore[no-untyped-def]
    _, edges = ring(np.random.default_rng(2), 0.05)
    _, normal = Problem(START).solve(started(edges), edges)
    dense = normal.chain(N)
    monkeypatch.setattr("locfuse.fusion.scan_matching.solve.MAX_DENSE_STATES", 0)
    sparse = normal.chain(N)
    for one, other in zip(dense, sparse, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-6, atol=1e-12)


def test_information_that_is_negative_gives_no_covariance() -> None:
    _, edges = ring(np.random.default_rng(3), 0.05)
    x, _ = Problem(START).solve(started(edges), edges)
    normal = Normal(x, np.zeros(2), edges, -np.ones(len(edges)), [], 0)
    with pytest.raises(np.linalg.LinAlgError):
        normal.chain(N)


def test_jacobians_equal_finite_differences() -> None:
    truth, edges = ring(np.random.default_rng(3), 0.1)
    A, B = edges.jacobians(truth)
    for of_i, J in ((True, A), (False, B)):
        for c in range(3):
            moved = [truth.copy(), truth.copy()]
            for sign, x in zip((1e-6, -1e-6), moved, strict=True):
                x[edges.i[4] if of_i else edges.j[4], c] += sign
            numeric = (edges.errors(moved[0])[4] - edges.errors(moved[1])[4]) / 2e-6
            np.testing.assert_allclose(J[4, :, c], numeric, atol=1e-6)


def test_a_wrong_closure_among_right_ones_is_given_up() -> None:
    truth, edges = ring(np.random.default_rng(4), 0.01)
    wrong = Edges.of(
        np.array([2, 3, 1]), np.array([8, 9, 7]), np.array([[0.5, 0.2, 0.1]] * 3), edges.information[:3], 4.0
    )
    right = Edges.of(
        np.array([1, 2]), np.array([9, 10]), se2.between(truth[[1, 2]], truth[[9, 10]]), edges.information[:2], 4.0
    )
    all_edges = Edges.joined(edges, right, wrong)
    x, _ = Problem(START).solve(started(edges), all_edges, GRADUATIONS)
    weights = all_edges.weights(x)
    assert (weights[-3:] < 0.05).all()
    assert (weights[-5:-3] > 0.8).all()
    assert np.hypot(*(x - truth)[:, :2].T).max() < 0.1


def test_a_heading_that_drifts_with_the_way_is_found_and_taken_out() -> None:
    truth, edges = ring(np.random.default_rng(5), 0.0)
    edges.by[:-1, 2, 0] = 2.6 * (edges.j - edges.i)[:-1]
    edges.information[:] *= 1e6
    drift = 0.002
    edges.z[:] += edges.by @ np.array([drift, 0.0])
    problem = Problem(START)
    x, normal = problem.solve(started(edges), edges)
    assert isinstance(normal, Normal)
    assert abs(problem.systematic[0] - drift) < 2e-4
    assert np.hypot(*(x - truth)[:, :2].T).max() < 0.02
