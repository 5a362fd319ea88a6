"""The equations of the filter's kernel against a textbook's, whatever stands in the numbers, interpreted too."""

from __future__ import annotations

import math

import numpy as np
import pytest
from textbook import TextbookEkf, move, numeric_jacobian
from told import Told, correct, dense, some_told, step

from locfuse.fusion.data import Array, LocfuseError
from locfuse.fusion.ekf.belief_arrays import JointBelief
from locfuse.fusion.kernels import ekf

UPPER = (0.04, 0.01, 0.002, 0.09, -0.003, 0.01)
Q = np.array([[1e-4, 1e-6, 2e-6], [1e-6, 2e-5, 1e-5], [2e-6, 1e-5, 4e-4]])


def random_belief(states: int, seed: int) -> JointBelief:
    """A pose and states that hang together with it."""
    rng = np.random.default_rng(seed)
    belief = JointBelief((0.3, -0.2, 3.0), UPPER)
    for _ in range(states):
        belief.augment(rng.normal(size=1), rng.normal(size=(1, 3)), np.array([[rng.uniform(0.01, 0.1)]]))
    return belief


def book_of(belief: JointBelief) -> TextbookEkf:
    return TextbookEkf(belief.state, belief.covariance)


def lines(count: int, states: int, seed: int) -> list[Told]:
    """Readings of two numbers each, by the pose and two states."""
    rng = np.random.default_rng(seed)
    some = [tuple((3 + rng.choice(states, 2, replace=False)).tolist()) if states > 1 else () for _ in range(count)]
    return [some_told(rng, 2, columns) for columns in some]


def agrees(belief: JointBelief, book: TextbookEkf) -> None:
    np.testing.assert_allclose(belief.state, book.x, atol=1e-9)
    np.testing.assert_allclose(belief.covariance, book.P, atol=1e-9)
    np.testing.assert_array_equal(belief.covariance, belief.covariance.T)


@pytest.mark.parametrize("states", [0, 1, 5, 30])
@pytest.mark.parametrize("wheels", [False, True])
def test_a_prediction_is_that_of_the_textbook(states: int, wheels: bool) -> None:
    rng = np.random.default_rng(states)
    belief = random_belief(states, 1)
    book, p = book_of(belief), min(states, 3) if wheels else 0
    u, J = rng.normal(size=3), 0.1 * rng.normal(size=(3, p))
    belief.wheels = 3 if p else -1
    belief.predict(step(u, Q, 0.1, J), 0)
    book.predict(u, Q, J if p else None, range(3, 3 + p))
    agrees(belief, book)


@pytest.mark.parametrize("states", [0, 1, 5, 30])
@pytest.mark.parametrize("count", [1, 2, 3, 7])
@pytest.mark.parametrize("considered", [(), (0, 3)])
def test_a_correction_is_that_of_the_textbook_and_of_schmidt(
    states: int, count: int, considered: tuple[int, ...]
) -> None:
    belief, told = random_belief(states, 1), lines(count, states, count)
    kept, book = [c for c in considered if c < belief.n], book_of(belief)
    belief.consider(np.array(kept, np.int64))
    y, H, R = dense(told, belief.n)
    S = H @ book.P @ H.T + R
    belief.begin()
    seen = [one.judged(belief) for one in told]
    for i, one in enumerate(seen):
        at = slice(2 * i, 2 * i + 2)
        assert one.nis == pytest.approx(y[at] @ np.linalg.solve(S[at, at], y[at]), rel=1e-9)
        np.testing.assert_allclose(one.sigma, np.sqrt(np.diagonal(S[at, at])), rtol=1e-12)
        belief.queue(one)
    assert belief.fit_of(0, 2 * count) == pytest.approx(y @ np.linalg.solve(S, y), rel=1e-9)
    belief.correct()
    assert belief.fit(2) == pytest.approx(seen[0].nis, rel=1e-9)  # the first alone
    book.correct(y, H, R, kept)
    agrees(belief, book)


@pytest.mark.parametrize("in_map", [False, True])
def test_a_row_by_the_pose_in_the_map_is_one_by_the_local_pose_and_the_frame(in_map: bool) -> None:
    belief = random_belief(5, 2)
    belief.frame = 5
    H = np.random.default_rng(7).normal(size=(2, 3))
    belief.begin()
    _, columns, by, _ = belief.equation([belief.compare(0, (0.1, 0.2), H, np.eye(2), 9.0, in_map=in_map)])
    found = np.zeros((2, belief.n))
    found[:, columns] = by

    def seen(x: Array) -> Array:
        return np.asarray(H @ (move(x[5:8], x[:3]) if in_map else x[:3]))

    np.testing.assert_allclose(found, numeric_jacobian(seen, belief.state.copy()), atol=1e-8)


def test_a_place_in_the_map_has_the_covariance_of_finite_differences() -> None:
    belief = random_belief(5, 2)
    belief.frame = 5
    x, P = belief.state.copy(), belief.covariance
    J = numeric_jacobian(lambda v: move(v[5:8], v[:3]), x)
    pose, triangle = belief.located(in_map=True)
    expected, r = J @ P @ J.T, (move(x[5:8], x[:3]) - x[5:8])[:2]
    expected[:2, :2] += ekf.bent(float(P[7, 7])) * np.outer(r, r)
    np.testing.assert_allclose(pose, move(x[5:8], x[:3]), atol=1e-14)
    np.testing.assert_allclose(triangle, expected[np.triu_indices(3)], atol=1e-8)
    assert belief.located() == (belief.pose(), tuple(P[:3, :3][np.triu_indices(3)].tolist()))


def test_turning_the_frame_is_a_linear_map_of_the_covariance() -> None:
    belief = random_belief(5, 2)
    belief.frame = 5
    A, P = np.eye(belief.n), belief.covariance.copy()
    A[5, 7], A[6, 7] = 0.2, 0.1
    belief.turn_frame(0.1, -0.2)
    np.testing.assert_allclose(belief.covariance, A @ P @ A.T, atol=1e-12)
    np.testing.assert_array_equal(belief.covariance, belief.covariance.T)


@pytest.mark.parametrize(("first", "states"), [(0, 3), (2, 1)])
def test_a_clone_is_the_state_that_it_was_taken_of(first: int, states: int) -> None:
    belief = random_belief(6, 2)
    P, x = belief.covariance.copy(), belief.state.copy()
    belief.copy_pose(4, first, states)
    A = np.eye(belief.n)
    A[4 : 4 + states] = A[first : first + states]
    np.testing.assert_array_equal(belief.state, A @ x)
    np.testing.assert_allclose(belief.covariance, A @ P @ A.T, atol=1e-15)


def test_states_are_replaced_by_functions_of_themselves() -> None:
    belief, rng = random_belief(6, 2), np.random.default_rng(3)
    belief.begin_frame()
    P, x, at, G = belief.covariance.copy(), belief.state.copy(), [5, 2, 7], rng.normal(size=(3, 3))
    row = np.zeros(belief.n)
    row[at] = G[0]
    assert belief.variance((0.0, 0.0, 0.0), at, G[0]) == pytest.approx(row @ P @ row, rel=1e-12)
    belief.transform(at, (1.0, 2.0, 3.0), G)
    A = np.eye(belief.n)
    A[np.ix_(at, at)] = G
    x[at] = 1.0, 2.0, 3.0
    np.testing.assert_array_equal(belief.state, x)
    np.testing.assert_allclose(belief.covariance, A @ P @ A.T, atol=1e-12)


def test_a_number_that_is_none_is_refused_in_one_line() -> None:
    bad = Told((0.1, 0.1), np.ones((2, 3)), ((math.nan, 0.0), (0.0, 1.0)))
    with pytest.raises(LocfuseError, match="too many powers of ten"):
        correct(random_belief(0, 1), bad)
