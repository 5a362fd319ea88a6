"""The graph of anchors: closed loops, and what the filter's state learns from it."""

from __future__ import annotations

import numpy as np

from locfuse.fusion.ekf.belief_arrays import JointBelief
from locfuse.fusion.map.anchors import Anchors, Edge, inverted

P_STEP = np.diag(np.square((0.1, 0.05, 0.02)))


def square_with_a_closure() -> Anchors:
    """Four sides of 10 m driven with an error, and the start recognised at the end."""
    rng = np.random.default_rng(3)
    graph = Anchors()
    at = graph.first(np.zeros(3), np.zeros((3, 3)))
    for _ in range(4):
        z = np.array([10.0, 0.0, np.pi / 2]) + rng.normal(0.0, (0.1, 0.05, 0.02))
        at = graph.next(at, z, P_STEP)
    return graph


def test_a_closure_makes_the_far_anchor_as_certain_as_the_closure_and_moves_it_home() -> None:
    graph = square_with_a_closure()
    drifted, before = np.hypot(*graph.pose[4, :2]), graph.covariance((4,))
    graph.add(Edge(0, 4, np.zeros(3), np.diag((1e4, 1e4, 1e6))))
    graph.solve()
    assert drifted > 0.2
    assert np.hypot(*graph.pose[4, :2]) < 0.01
    after = graph.covariance((4,))
    assert np.diagonal(before)[:2].min() > 0.02
    assert np.diagonal(after)[:2].max() < 1.1e-4


def test_where_one_anchor_is_seen_from_another_has_the_covariance_of_the_edge_between_them() -> None:
    graph = square_with_a_closure()
    z, P = graph.relative(2, 3)
    np.testing.assert_allclose(z, graph.edges[3].z, atol=1e-9)
    np.testing.assert_allclose(P, P_STEP, atol=1e-9)


def test_a_frame_that_is_known_better_teaches_the_rest_as_a_reading_of_it_would() -> None:
    """The textbook update by a reading of the frame gives a posterior; told only that, the rest must follow."""
    rng = np.random.default_rng(5)
    belief = JointBelief((1.0, 2.0, 0.3), (0.04, 0.01, 0.0, 0.05, 0.002, 0.003), ())
    belief.begin_frame()
    belief.augment(np.array([3.0, 0.4]), np.eye(3)[:2], 0.01 * np.eye(2))
    root = rng.normal(size=(belief.n, belief.n))
    belief._P[: belief.n, : belief.n] += 0.01 * root @ root.T  # everything has to do with everything
    x, P = belief.state.copy(), belief.covariance.copy()
    at = np.arange(3, 6)
    z, R = x[at] + (0.05, -0.02, 0.01), np.diag((0.01, 0.02, 0.001))
    K = P[:, at] @ np.linalg.inv(P[np.ix_(at, at)] + R)
    wanted_x, wanted_P = x + K @ (z - x[at]), P - K @ P[at]
    belief.know_frame(wanted_x[at], wanted_P[np.ix_(at, at)])
    np.testing.assert_allclose(belief.state, wanted_x, atol=1e-9)
    np.testing.assert_allclose(belief.covariance, wanted_P, atol=1e-9)


def test_a_way_that_was_worse_than_claimed_is_loosened_until_its_error_is_an_ordinary_one() -> None:
    """The closure contradicts the way by 10 sigma; by the variance factor its chi-square becomes about 3."""
    graph = Anchors()
    at = graph.first(np.zeros(3), np.zeros((3, 3)))
    for _ in range(2):
        at = graph.next(at, np.array([10.0, 0.0, 0.0]), P_STEP)
    other = graph.next(at, np.array([5.0, 0.0, 0.0]), P_STEP)
    aside = graph.relative(at, other)[1].copy()
    z, P = graph.relative(0, at)
    z = z + 10.0 * np.sqrt(np.diagonal(P)) * (0.0, 1.0, 0.0)
    closure = Edge(0, at, z, np.diag((1e6, 1e6, 1e8)))
    graph.add(closure)
    graph.solve()
    worse = graph.cost()
    assert worse > 30.0
    graph.remove(closure)
    graph.loosen(0, at, worse / 3.0)
    graph.add(closure)
    graph.solve()
    assert 1.5 < graph.cost() < 4.5
    np.testing.assert_allclose(graph.pose[at, :2], z[:2], atol=0.01)
    np.testing.assert_allclose(graph.relative(at, other)[1], aside, atol=1e-12)  # what lies beyond is as it was


def test_a_covariance_is_inverted_as_it_should_be() -> None:
    root = np.random.default_rng(4).normal(size=(3, 3)) * (10.0, 0.1, 0.01)
    np.testing.assert_allclose(
        inverted(root.T @ root), np.linalg.inv(root.T @ root + 1e-12 * np.eye(3)), rtol=1e-7
    )
    np.testing.assert_allclose(inverted(np.zeros((3, 3))), 1e12 * np.eye(3))


def test_a_covariance_beyond_all_bounds_has_an_information() -> None:
    """Of a log whose stamps lie: its numbers do not know that it is positive."""
    P = np.array(
        (
            (1.25829551e25, 1.71387634e25, 1.68172119e16),
            (1.71387634e25, 2.33440562e25, 2.29060831e16),
            (1.68172119e16, 2.29060831e16, 2.24763272e07),
        )
    )
    L = inverted(P)
    assert np.isfinite(L).all()
    assert np.linalg.eigvalsh(L).min() >= -1e-12 * np.abs(L).max()
