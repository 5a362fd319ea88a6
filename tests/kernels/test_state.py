"""The equations of the filter's kernel against a textbook's, whatever stands in the numbers, interpreted too."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from interpreted import interpreted
from textbook import TextbookEkf, move, numeric_jacobian
from told import Told, correct, dense, some_told, step

from locfuse.fusion.data import Array, LocfuseError
from locfuse.fusion.ekf.belief_arrays import JointBelief
from locfuse.fusion.kernels import ekf

UPPER = (0.04, 0.01, 0.002, 0.09, -0.003, 0.01)
Q = np.array([[1e-4, 1e-6, 2e-6], [1e-6, 2e-5, 1e-5], [2e-6, 1e-5, 4e-4]])
NUMBERS = st.one_of(
    st.floats(-1e3, 1e3), st.sampled_from([math.nan, math.inf, -math.inf, 0.0, 1e-300, 1e160, -1e160])
)


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


def test_a_correction_by_a_hundred_walls_is_that_of_numpy() -> None:
    belief, told = random_belief(200, 3), lines(12, 200, 4)
    P = belief.covariance.copy()
    correct(belief, *told)
    _, H, R = dense(told, belief.n)
    expected = P - P @ H.T @ np.linalg.solve(H @ P @ H.T + R, H @ P)
    np.testing.assert_allclose(belief.covariance, expected, atol=1e-9)


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


# ---- interpreted


class RefusedError(Exception):
    """S is not positive."""


class Alone:
    """The kernel's state with arrays of its own, compiled or interpreted."""

    def __init__(self, kernel: Any, x: Array, P: Array, frame: int, kept: Any) -> None:
        n, m = len(x), 24

        class Refusing(kernel.State):  # type: ignore[misc]
            def not_positive(self, greatest: float) -> None:
                raise RefusedError

        self.kernel, self.state, self.x, self.P = kernel, Refusing(), x.copy(), P.copy()
        self.state.hold(self.x, self.P, kept.astype(np.intp))
        self.state.n, self.state.frame, self.state.keeps = n, frame, bool(kept.any())
        wide = m, 12
        at, H, count, y, R = np.zeros(wide, np.intp), np.zeros(wide), np.zeros(m, np.intp), np.zeros(m), np.eye(m)
        self.state.hold_rows(at, H, count, y, R)
        V, S, e, queue = np.zeros((m + 4, n)), np.zeros((m, m)), np.zeros(m), np.zeros(m, np.intp)
        self.state.hold_room(V, S, e, queue, np.zeros((16, 16)))

    def drive(self, told: list[Told], u: Array, noise: Array, in_map: bool) -> list[float]:
        """One instant; return all that came out, the verdicts too, as far as it was not refused."""
        s, out = self.state, list[float]()
        steps = self.kernel.Steps(u[None].copy(), noise.reshape(1, 9).copy(), np.array([0.1]), np.zeros((1, 0)))
        s.move(steps, 0)
        s.begin()
        try:
            for one in told:
                seen = s.compare(0, one.y, one.H, one.R, 9.0, one.columns, one.own, in_map=in_map)
                out += [seen.verdict, seen.nis, *seen.sigma]
                s.queue_rows(seen.first, seen.numbers)
            s.correct_queued()
            out.append(s.fit(len(told)))
        except RefusedError:
            out.append(math.inf)
        pose, triangle = s.located(True)
        return [*out, *pose, *triangle, *self.x, *self.P.ravel()]


def both(x: Array, P: Array, frame: int, kept: Any) -> tuple[Alone, Alone]:
    return Alone(ekf, x, P, frame, kept), Alone(interpreted("ekf"), x, P, frame, kept)


@pytest.mark.parametrize("frame", [-1, 3])
@pytest.mark.parametrize("considered", [False, True])
def test_the_source_agrees_with_what_is_compiled_over_a_drive(frame: int, considered: bool) -> None:
    rng = np.random.default_rng(8)
    belief = random_belief(6, 2)
    kept = np.arange(belief.n) == (7 if considered else -1)
    compiled, source = both(belief.state, belief.covariance, frame, kept)
    assert type(compiled.state).move is not type(source.state).move
    for k in range(60):
        told = [some_told(rng, 1 + k % 2, (6, 8)), some_told(rng, 3), some_told(rng, 1, (7,))]
        u = 0.1 * rng.normal(size=3)
        found, expected = (one.drive(told, u, Q, k % 3 > 0) for one in (compiled, source))
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9)


@settings(deadline=None, max_examples=100)
@given(st.lists(NUMBERS, min_size=60, max_size=60), st.integers(0, 4), st.sampled_from([-1, 0]), st.booleans())
def test_no_numbers_make_either_fail_or_tell_otherwise_what_is_a_number(
    given_numbers: list[float], states: int, frame: int, considered: bool
) -> None:
    """NaN, Inf, what overflows and what is singular: the same answer whether S is positive, and the same NaN."""
    n = 6 + states

    def numbers(*shape: int) -> Array:
        return np.resize(np.array(given_numbers), math.prod(shape)).reshape(shape)

    shapes = [((d, 3), (d, d), (d, 1)) for d in (1, 2)]
    parts = [[numbers(*shape).tolist() for shape in of_one] for of_one in shapes]
    told = [Told(tuple(R[0]), H, R, (4,), own) for H, R, own in parts]
    kept = np.arange(n) % 2 * int(considered)
    found, expected = (
        one.drive(told, numbers(3), numbers(9), True)
        for one in both(numbers(n), numbers(n, n), 3 if frame == 0 else -1, kept)
    )
    assert [math.isfinite(v) for v in found] == [math.isfinite(v) for v in expected]
