"""The filter against a textbook filter in plain matrices."""

from __future__ import annotations

import math

import numpy as np
import pytest
from rows import Told, correct, dense, some_told, step
from textbook import TextbookEkf, move, numeric_jacobian

from locfuse.fusion.data import LocfuseError
from locfuse.fusion.ekf.belief_arrays import JointBelief
from locfuse.fusion.ekf.equations import eq5_x, eq7_A, eq10_12, predicted
from locfuse.fusion.ekf.map_frame import Triangle
from locfuse.fusion.sensor import Block

POSE = (1.0, -2.0, 3.1)
P0 = np.array([[0.04, 0.01, 0.002], [0.01, 0.09, -0.003], [0.002, -0.003, 0.01]])
UPPER: Triangle = (0.04, 0.01, 0.002, 0.09, -0.003, 0.01)
EXACT, LOST = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0), (25.0, 0.0, 0.0, 25.0, 0.0, 3.0)


def motion(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    L = rng.normal(size=(3, 3)) * 0.01
    return rng.normal(size=3) * [0.1, 0.01, 0.1], L @ L.T


def joint(rng: np.random.Generator) -> tuple[JointBelief, TextbookEkf]:
    offset = Block("offset", np.array([0.3]), np.array([[1.0]]), np.array([0.0]))
    belief = JointBelief(POSE, UPPER, [offset])
    book = TextbookEkf(np.array([*POSE, 0.3]), np.block([[P0, np.zeros((3, 1))], [np.zeros((1, 3)), np.eye(1)]]))
    for _ in range(8):  # grows past the first allocation
        G, noise = rng.normal(size=(2, 3)), np.diag(rng.uniform(0.01, 0.1, 2))
        value = rng.normal(size=2)
        belief.augment(value, G, noise)
        book.x = np.append(book.x, value)
        G = np.hstack((G, np.zeros((2, len(book.x) - 2 - 3))))
        top = book.P @ G.T
        book.P = np.block([[book.P, top], [top.T, G @ top + noise]])
    return belief, book


def test_the_joint_filter_equals_the_textbook_over_a_whole_drive() -> None:
    rng = np.random.default_rng(1)
    belief, book = joint(rng)
    for _ in range(500):
        u, Q = motion(rng)
        belief.predict(step(u, Q), 0)
        book.predict(u, Q)
        columns = [tuple(int(c) + k for k in range(2)) for c in rng.choice(np.arange(4, 20, 2), 3, replace=False)]
        told = [some_told(rng, 2, c) for c in columns] + [some_told(rng, 1, (3,))]
        correct(belief, *told)
        book.correct(*dense(told, belief.n))
        agrees(belief, book)


@pytest.mark.parametrize("d", [1, 2, 3])
def test_the_spread_of_a_reading_is_h_p_h(d: int) -> None:
    rng = np.random.default_rng(d)
    belief, _ = joint(rng)
    columns, H, own = (3, 9), rng.normal(size=(d, 3)), rng.normal(size=(d, 2))
    full = np.zeros((d, belief.n))
    full[:, :3], full[:, list(columns)] = H, own
    both = np.hstack((H, own))
    np.testing.assert_allclose(belief.spread(both, columns), full @ belief.covariance @ full.T, atol=1e-12)
    np.testing.assert_allclose(belief.spread(H), H @ belief.matrix() @ H.T, atol=1e-12)
    assert belief.variance(tuple(H[0].tolist())) == pytest.approx(H[0] @ belief.matrix() @ H[0], rel=1e-12)


def test_a_block_drifts_by_its_random_walk() -> None:
    belief = JointBelief(POSE, UPPER, [Block("offset", np.zeros(1), np.eye(1) * 0.1, np.array([0.02]))])
    belief.predict(step((0.0, 0.0, 0.0), np.zeros((3, 3)), dt=2.5), 0)
    assert belief.covariance[3, 3] == pytest.approx(0.1 + 0.02 * 2.5)


@pytest.mark.parametrize(
    "gone", [[6, 7], [3], [19], [18, 19], [3, 19], [4, 5, 6, 7, 12, 15, 16], [7, 6], list(range(3, 20)), []]
)
def test_removing_states_is_marginalising_them(gone: list[int]) -> None:
    belief, book = joint(np.random.default_rng(4))
    belief.remove(np.array(gone, dtype=np.int64))
    keep = [i for i in range(20) if i not in gone]
    np.testing.assert_allclose(belief.covariance, book.P[np.ix_(keep, keep)], rtol=1e-9)
    np.testing.assert_array_equal(belief.state, book.x[keep])
    belief._grow(len(gone))  # whoever comes next finds nothing
    assert not belief.state[len(keep) :].any()
    assert not belief.covariance[len(keep) :].any()
    assert not belief.covariance[:, len(keep) :].any()


# --- the equations by number, held to a textbook filter and to finite differences


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


# --- the equations of the filter's kernel against a textbook's, whatever stands in the numbers, interpreted too

Q = np.array([[1e-4, 1e-6, 2e-6], [1e-6, 2e-5, 1e-5], [2e-6, 1e-5, 4e-4]])


def random_belief(states: int, seed: int, start: Triangle = UPPER) -> JointBelief:
    """A pose and states that hang together with it."""
    rng = np.random.default_rng(seed)
    belief = JointBelief((0.3, -0.2, 3.0), start)
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
    np.testing.assert_allclose(belief.state, book.x, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(belief.covariance, book.P, rtol=1e-9, atol=1e-9)
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
@pytest.mark.parametrize("start", [UPPER, EXACT, LOST])
def test_a_correction_is_the_textbook_s(
    states: int, count: int, considered: tuple[int, ...], start: Triangle
) -> None:
    belief, told = random_belief(states, 1, start), lines(count, states, count)
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


def test_turning_the_frame_is_a_linear_map_of_the_covariance() -> None:
    belief = random_belief(5, 2)
    belief.frame = 5
    A, P = np.eye(belief.n), belief.covariance.copy()
    A[5, 7], A[6, 7] = 0.2, 0.1
    belief.turn_frame(0.1, -0.2)
    np.testing.assert_allclose(belief.covariance, A @ P @ A.T, atol=1e-12)
    np.testing.assert_array_equal(belief.covariance, belief.covariance.T)


def test_a_clone_is_the_pose_that_it_was_taken_of() -> None:
    belief = random_belief(6, 2)
    P, x = belief.covariance.copy(), belief.state.copy()
    belief.copy_pose(4)
    A = np.eye(belief.n)
    A[4:7] = A[:3]
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
    with pytest.raises(LocfuseError, match="became singular"):
        correct(random_belief(0, 1), bad)
