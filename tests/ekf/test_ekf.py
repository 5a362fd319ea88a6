"""The filter against a textbook filter in plain matrices."""

from __future__ import annotations

import math

import numpy as np
import pytest
from textbook import TextbookEkf
from told import Told, correct, dense, some_told, step

from locfuse.fusion.ekf.belief_arrays import JointBelief
from locfuse.fusion.se2 import wrap
from locfuse.fusion.sensor import Block

POSE = (1.0, -2.0, 3.1)
P0 = np.array([[0.04, 0.01, 0.002], [0.01, 0.09, -0.003], [0.002, -0.003, 0.01]])
UPPER = (0.04, 0.01, 0.002, 0.09, -0.003, 0.01)


def motion(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    L = rng.normal(size=(3, 3)) * 0.01
    return rng.normal(size=3) * [0.1, 0.01, 0.1], L @ L.T


def line(rng: np.random.Generator, beta: float) -> Told:
    """A line in the base frame: r tells x and y, psi tells theta, their noise correlated."""
    L = np.tril(rng.normal(size=(2, 2))) * 0.01 + 0.01 * np.eye(2)
    H = ((-math.cos(beta), -math.sin(beta), 0.0), (0.0, 0.0, -1.0))
    return Told(tuple((rng.normal(size=2) * 0.02).tolist()), H, L @ L.T)


@pytest.mark.parametrize(
    "beta",
    [
        [0.3, 1.8],  # two walls
        [0.0, math.pi / 2, math.pi, -math.pi / 2, 0.4, 0.5],  # a room
        [math.pi / 2] * 3,  # parallel walls along an axis: nothing is told of x
        [1.1, 1.1 - math.pi, 1.1],  # and along no axis
        [0.7, 0.7 + 1e-7, 0.7 - 3e-6],  # almost parallel
        [0.2],
    ],
)
@pytest.mark.parametrize("start", [UPPER, (0.0,) * 6, (25.0, 0.0, 0.0, 25.0, 0.0, 3.0)])
def test_walls_that_leave_the_pose_open_or_not_say_what_the_textbook_says(
    beta: list[float], start: tuple[float, ...]
) -> None:
    """Also from an exact start and from being lost, and beside a heading and a position with a lever arm."""
    rng = np.random.default_rng(5)
    xx, xy, xt, yy, yt, tt = start
    for others in ([], [some_told(rng, 1), some_told(rng, 2)]):
        fast = JointBelief(POSE, (xx, xy, xt, yy, yt, tt))
        book = TextbookEkf(np.array(POSE), np.array([[xx, xy, xt], [xy, yy, yt], [xt, yt, tt]]))
        told = [line(rng, b) for b in beta] + others
        correct(fast, *told)
        book.correct(*dense(told, 3))
        np.testing.assert_allclose((fast.x, fast.y, fast.theta), book.x, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(fast.matrix(), book.P, rtol=1e-9, atol=1e-9)


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
        np.testing.assert_allclose(belief.state, book.x, atol=1e-9)
        np.testing.assert_allclose(belief.covariance, book.P, atol=1e-9)
    np.testing.assert_array_equal(belief.covariance, belief.covariance.T)


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


@pytest.mark.parametrize("heading", [math.pi, -math.pi, math.pi - 1e-9, 3 * math.pi])
def test_heading_survives_the_wrap_at_pi(heading: float) -> None:
    belief = JointBelief((0.0, 0.0, heading), (0.0, 0.0, 0.0, 0.0, 0.0, 0.01))
    y = wrap(heading + 0.02 - belief.theta)
    correct(belief, Told((y,), ((0.0, 0.0, 1.0),), ((0.01,),)))
    assert belief.theta - heading == pytest.approx(0.01)
