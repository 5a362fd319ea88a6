"""The walls that lead from one map to the next keep what is known of them: held to drawn poses and walls."""

from __future__ import annotations

import numpy as np
import pytest
from told import step

from locfuse.fusion.data import Array
from locfuse.fusion.ekf.belief_arrays import JointBelief
from locfuse.fusion.map.line_map import LineMap
from locfuse.fusion.map.small_maps import cross, heading_among, seen_from_here

POSE = (2.0, -1.0, 0.7)
WALLS = np.array([(6.0, 0.0, 0.1), (2.0, 5.0, 1.6), (-4.0, 1.0, 3.0)])  # m, m, rad: anchor and direction of each
ENDS = ((-1.0, 2.0), (-3.0, 0.5), (-0.2, 0.2))


def drive() -> tuple[JointBelief, LineMap]:
    """Return a pose, and walls that were seen from it: what is known of them hangs together."""
    belief = JointBelief(POSE, (1e-8, 2e-9, 1e-9, 3e-8, -1e-9, 2e-8))
    lines, rng = LineMap(), np.random.default_rng(5)
    for (x, y, beta), ends in zip(WALLS, ENDS, strict=True):
        G = rng.normal(size=(2, 3))
        column = belief.augment(np.array([0.0, beta]), G, np.diag((1e-10, 4e-10)))
        lines.append(np.array([x, y]), np.array([0.0, beta]), np.zeros((2, 2)), column, ends, 4)
    lines.hits = np.array([7, 3, 9])
    return belief, lines


def seen(pose: Array, rho: Array, beta: Array) -> Array:
    """Return r and psi of the walls as seen from poses (n, 3), (n, 2k): how far, and where to."""
    away = WALLS[:, :2] - pose[:, None, :2]
    r = rho + away[..., 0] * np.cos(beta) + away[..., 1] * np.sin(beta)
    return np.stack((r, beta - pose[:, 2:]), axis=-1).reshape(len(pose), -1)


@pytest.fixture(scope="module")
def drawn() -> Array:
    belief, lines = drive()
    draws = np.random.default_rng(6).multivariate_normal(belief.state, belief.covariance, 200_000, method="eigh")
    return seen(draws[:, :3], draws[:, lines.column], draws[:, lines.column + 1])


def test_what_is_seen_from_the_pose_spreads_as_drawn_poses_and_walls_do(drawn: Array) -> None:
    belief, lines = drive()
    bridge = seen_from_here(lines, np.arange(3), belief)
    sigma = np.sqrt(np.diagonal(bridge.P))
    assert np.stack((bridge.r, bridge.psi), axis=-1).reshape(-1) == pytest.approx(drawn.mean(axis=0), abs=1e-5)
    assert bridge.P / np.outer(sigma, sigma) == pytest.approx(np.cov(drawn.T) / np.outer(sigma, sigma), abs=0.02)


def test_the_next_map_knows_of_its_walls_what_the_last_one_knew() -> None:
    belief, lines = drive()
    ends = {int(line): lines.hi[k] - lines.lo[k] for k, line in enumerate(lines.ids)}
    bridge = seen_from_here(lines, np.arange(3), belief)
    belief.remove(lines.drop(np.arange(3)))
    belief.begin_frame()
    cross(bridge, lines, belief, 4)
    assert belief.pose() == (0.0, 0.0, 0.0)
    again = seen_from_here(lines, np.arange(3), belief)
    assert again.r == pytest.approx(bridge.r)
    assert again.psi == pytest.approx(bridge.psi)
    assert again.ends == pytest.approx(bridge.ends)
    assert pytest.approx(bridge.P, rel=1e-9, abs=1e-18) == again.P
    assert lines.hits.tolist() == [7, 3, 9]
    assert (lines.hi - lines.lo).tolist() == pytest.approx(list(ends.values()))


def test_how_two_walls_lie_to_each_other_is_known_as_before() -> None:
    belief, lines = drive()
    before = belief.covariance[np.ix_(lines.column[:2] + 1, lines.column[:2] + 1)]
    bridge = seen_from_here(lines, np.arange(2), belief)
    after = bridge.P[np.ix_((1, 3), (1, 3))]
    apart = np.array([1.0, -1.0])
    assert apart @ after @ apart == pytest.approx(apart @ before @ apart)


def test_the_heading_among_walls_is_what_is_left_of_it_once_they_are_given() -> None:
    belief, lines = drive()
    walls = np.concatenate([lines.column, lines.column + 1])
    P = belief.covariance
    left = P[2, 2] - P[2, walls] @ np.linalg.solve(P[np.ix_(walls, walls)], P[walls, 2])
    assert heading_among(lines, np.arange(3), belief) == pytest.approx(np.sqrt(left), rel=1e-3)


def test_a_motion_that_no_scan_has_followed_leaves_the_heading_as_uncertain_as_the_motion_is() -> None:
    belief, lines = drive()
    told = heading_among(lines, np.arange(3), belief)
    belief.predict(step((0.1, 0.0, 0.0), (1e-10, 0.0, 0.0, 1e-10, 0.0, 0.02**2)), 0)
    assert heading_among(lines, np.arange(3), belief) == pytest.approx(np.hypot(told, 0.02), rel=1e-3)


def test_what_robot_and_walls_have_drifted_together_does_not_count() -> None:
    belief = JointBelief((0.0, 0.0, 0.0), (1e-12, 0.0, 0.0, 1e-12, 0.0, 0.1**2))
    lines = LineMap()
    for x, y, beta in WALLS:  # each is seen from the pose: it turns as the pose does
        column = belief.augment(
            np.array([0.0, beta]), np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), np.diag((1e-8, 0.003**2))
        )
        lines.append(np.array([x, y]), np.array([0.0, beta]), np.zeros((2, 2)), column, (-1.0, 1.0), 4)
    assert heading_among(lines, np.arange(3), belief) == pytest.approx(0.003 / np.sqrt(3.0), rel=0.01)
