"""Lines in the map: where their frame puts them, how sure, and what happens when one leaves."""

from __future__ import annotations

import math

import numpy as np
import pytest
from line_scene import covariance
from textbook import move, numeric_jacobian
from told import step

from locfuse.fusion.data import Array, MapLine
from locfuse.fusion.ekf.belief_arrays import JointBelief
from locfuse.fusion.map.line_map import LineMap, about_middle


def in_the_map(v: Array, anchor: Array) -> Array:
    """(rho, beta) about the origin of a line (rho about its anchor, beta) in a local frame that lies at v[2:]."""
    beta, at = v[1] + v[4], move(v[2:], np.array([*anchor, 0.0]))[:2]
    return np.array([v[0] + at[0] * math.cos(beta) + at[1] * math.sin(beta), beta])


def three_lines(belief: JointBelief | None, rng: np.random.Generator) -> LineMap:
    lines = LineMap()
    for _ in range(3):
        value, P = rng.normal(0.0, (0.1, 1.0)), covariance(rng)
        column = -1 if belief is None else belief.augment(value, rng.normal(size=(2, 3)), P)
        lines.append(rng.normal(0.0, 3.0, 2), value, P, column, (-0.7, 1.9), 0)
    lines.hits[:] = 5, 6, 7
    return lines


def assert_placed(line: MapLine, v: Array, anchor: Array, joint: Array) -> None:
    """A line of values v (rho, beta, frame) and their covariance (5, 5), where its frame puts it."""
    rho, beta = in_the_map(v, anchor)
    assert (line.rho, math.cos(line.beta - beta)) == pytest.approx((rho, 1.0))
    J = numeric_jacobian(lambda x: in_the_map(x, anchor), v)
    np.testing.assert_allclose(line.P, J[:, :2] @ joint[:2, :2] @ J[:, :2].T, atol=1e-7)
    if line.P_free is not None:
        np.testing.assert_allclose(line.P_free, J @ joint @ J.T, atol=1e-7)
    foot = anchor + v[0] * np.array([math.cos(v[1]), math.sin(v[1])])
    n = np.array([math.cos(line.beta), math.sin(line.beta)])
    for end, along in zip(line.ends, (-0.7, 1.9), strict=True):
        local = foot + along * np.array([-math.sin(v[1]), math.cos(v[1])])
        in_map = line.rho * n + end * np.array([-n[1], n[0]])
        np.testing.assert_allclose(in_map, move(v[2:], np.array([*local, 0.0]))[:2], atol=1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_lines_of_a_frozen_map_are_placed_as_finite_differences_say(seed: int) -> None:
    rng = np.random.default_rng(seed)
    lines, frame = three_lines(None, rng), rng.normal(0.0, 2.0, 3)
    root = 0.1 * rng.normal(size=(3, 3))
    joint = np.zeros((5, 5))
    joint[2:, 2:] = root @ root.T
    for j, line in enumerate(lines.placed_at(frame, joint[2:, 2:])):
        joint[:2, :2] = lines.P[j]
        assert (line.id, line.hits) == (j, 5 + j)
        assert line.P_free is not None
        assert_placed(line, np.concatenate((lines.value[j], frame)), lines.anchor[j], joint)
    still = JointBelief((0.0, 0.0, 0.0), (0.0,) * 6)
    for j, line in enumerate(lines.lines(still)):
        assert_placed(line, np.concatenate((lines.value[j], np.zeros(3))), lines.anchor[j], joint_of(lines.P[j]))


def joint_of(P: Array) -> Array:
    joint = np.zeros((5, 5))
    joint[:2, :2] = P
    return joint


@pytest.mark.parametrize("seed", range(4))
def test_lines_of_a_growing_map_know_what_they_have_to_do_with_their_frame(seed: int) -> None:
    rng = np.random.default_rng(seed)
    belief = JointBelief((1.0, -2.0, 0.7), (0.09, 0.01, 0.004, 0.05, -0.003, 0.02))
    belief.begin_frame()
    belief.predict(step((0.3, 0.02, 0.25), (1e-3, 0.0, 0.0, 2e-3, 1e-4, 4e-3)), 0)
    lines = three_lines(belief, rng)
    root, first = 0.05 * rng.normal(size=(belief.n, belief.n)), belief.frame
    assert belief.framed
    belief.covariance[:] += root @ root.T  # everything has to do with everything
    assert lines.columns() == [6, 8, 10]
    for j, line in enumerate(lines.lines(belief)):
        at = np.array([*(lines.column[j] + np.arange(2)), *(first + np.arange(3))])
        np.testing.assert_array_equal(lines.covariances(belief)[j], belief.covariance[np.ix_(at[:2], at[:2])])
        assert_placed(line, belief.state[at].copy(), lines.anchor[j], belief.covariance[np.ix_(at, at)])


@pytest.mark.parametrize("seed", range(4))
def test_the_middle_of_a_line_lies_between_its_ends_and_is_where_its_place_is_known_without_its_angle(
    seed: int,
) -> None:
    (line, *_) = three_lines(None, np.random.default_rng(seed)).placed_at(np.array([1.0, 2.0, 0.3]), np.eye(3))
    middle, half, P = about_middle(line)
    n = np.array([math.cos(line.beta), math.sin(line.beta)])
    ends = [line.rho * n + end * np.array([-n[1], n[0]]) for end in line.ends]
    np.testing.assert_allclose(middle, (ends[0] + ends[1]) / 2.0, atol=1e-12)
    assert half == pytest.approx(1.3)

    def about(v: Array) -> Array:
        """The distance of the line (rho, beta) from the middle, and its direction."""
        return np.array([v[0] - middle[0] * math.cos(v[1]) - middle[1] * math.sin(v[1]), v[1]])

    J = numeric_jacobian(about, np.array([line.rho, line.beta]))
    np.testing.assert_allclose(P, J @ line.P @ J.T, atol=1e-7)


def test_a_dropped_line_takes_its_states_with_it_and_the_others_move_up() -> None:
    belief = JointBelief((0.0, 0.0, 0.0), (0.01, 0.0, 0.0, 0.01, 0.0, 0.01))
    lines = three_lines(belief, np.random.default_rng(1))
    values = lines.values(belief).copy()
    freed = lines.drop(np.array([1]))
    assert freed.tolist() == [5, 6]
    belief.remove(freed)
    assert lines.column.tolist() == [3, 5]
    np.testing.assert_array_equal(lines.values(belief), values[[0, 2]])
    assert lines.append(np.zeros(2), values[0], np.eye(2), 7, (0.0, 1.0), 4) == 3  # an id that was never used


def test_no_line_is_known_better_than_its_floor() -> None:
    belief = JointBelief((0.0, 0.0, 0.0), (0.01, 0.0, 0.0, 0.01, 0.0, 0.01))
    lines = three_lines(belief, np.random.default_rng(1))
    belief.covariance[range(3, 9), range(3, 9)] = 1e-4, 9e-4, 4e-4, 1e-6, 9e-4, 1e-4
    lines.keep_floor(belief, (4e-4, 2e-4))
    np.testing.assert_allclose(np.diag(belief.covariance)[3:], [4e-4, 9e-4, 4e-4, 2e-4, 9e-4, 2e-4])
