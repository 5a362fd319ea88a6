"""Keeping the map small: doubles become one as a filter would join them, chance lines leave, a loop closes."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from locfuse.fusion.ekf.belief_arrays import JointBelief
from locfuse.fusion.map.line_map import FLAT_SIGMAS, MIN_HITS, TRIAL_SCANS, LineMap, merge_doubles, prune

Array = NDArray[np.float64]
EVEN = np.zeros(2)


def a_map(*walls: tuple[float, float, float, float], hits: int = 10) -> tuple[LineMap, JointBelief]:
    """A belief at the origin and walls (x, y of the anchor, beta, sigma), each 2 m long and known on its own."""
    belief = JointBelief((0.0, 0.0, 0.0), (0.01, 0.0, 0.0, 0.01, 0.0, 0.001), [])
    lines = LineMap()
    for x, y, beta, sigma in walls:
        P = np.diag([sigma**2, (0.3 * sigma) ** 2])
        value = np.array([0.0, beta])
        column = belief.augment(value, np.zeros((2, 3)), P)
        lines.append(np.array([x, y]), value, P, column, (-1.0, 1.0), 1)
    lines.hits[:] = hits
    lines.seen[:] = 100
    return lines, belief


def test_two_pieces_of_one_wall_become_their_weighted_mean() -> None:
    """About one anchor the measurement "equal" is linear: information adds up (inverse variances)."""
    lines, belief = a_map((3.0, 0.0, 0.0, 0.02), (3.0, 0.0, 0.0, 0.04))
    belief.state[lines.column[1]] = 0.03
    merge_doubles(lines, belief, 100, EVEN)
    assert len(lines) == 1
    assert belief.n == 5
    a, b, flat = 0.02**2, 0.04**2, FLAT_SIGMAS[0] ** 2
    assert belief.state[3] == pytest.approx(0.03 * a / (a + b + flat))
    assert belief.covariance[3, 3] == pytest.approx(a - a * a / (a + b + flat))
    assert lines.hits[0] == 20


def test_a_wall_that_was_seen_in_two_stretches_reaches_over_both() -> None:
    lines, belief = a_map((3.0, 0.0, 0.0, 0.02), (3.0, 2.1, 0.0, 0.02))
    merge_doubles(lines, belief, 100, EVEN)
    assert len(lines) == 1
    assert (lines.lo[0], lines.hi[0]) == pytest.approx((-1.0, 3.1))


@pytest.mark.parametrize(
    ("second", "why"),
    [
        ((3.2, 0.0, 0.0, 0.02), "ten standard deviations away"),
        ((3.0, 0.0, math.pi, 0.02), "the other face of a thin wall"),
        ((3.0, 4.0, 0.0, 0.02), "a gap of two metres: a door"),
        ((3.3, 0.0, 0.0, 1.0), "further than any double, however vague"),
    ],
)
def test_two_walls_stay_two(second: tuple[float, float, float, float], why: str) -> None:
    lines, belief = a_map((3.0, 0.0, 0.0, 0.005), second)
    before = belief.covariance.copy()
    merge_doubles(lines, belief, 100, EVEN)
    assert len(lines) == 2, why
    np.testing.assert_array_equal(belief.covariance, before)


def test_uneven_walls_are_held_to_each_other_less_tightly() -> None:
    left = {}
    for name, uneven in (("flat", EVEN), ("uneven", np.array([0.01**2, 0.008**2]))):
        lines, belief = a_map((3.0, 0.0, 0.0, 0.02), (3.01, 0.0, 0.0, 0.02))
        merge_doubles(lines, belief, 100, uneven)
        assert len(lines) == 1
        left[name] = float(belief.covariance[3, 3])
    assert left["uneven"] > left["flat"]


def test_a_merge_closes_a_loop_the_pose_follows_the_wall_it_knows_again() -> None:
    """A new wall was laid down from a pose that drifted; that it is an old one moves the pose back."""
    lines, belief = a_map((3.0, 0.0, 0.0, 0.002))
    value, noise = np.array([0.08, 0.0]), np.diag([1e-6, 1e-6])  # the pose is 0.08 m too far ahead
    column = belief.augment(value, np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), noise)
    lines.append(np.array([3.0, 0.0]), value, noise, column, (-1.0, 1.0), 90)
    lines.seen[1] = 100
    merge_doubles(lines, belief, 100, EVEN)
    assert len(lines) == 1
    assert belief.x == pytest.approx(-0.08, abs=0.001)
    assert math.sqrt(belief.covariance[0, 0]) < 0.007  # it was 0.1


def test_lines_that_were_hardly_seen_again_leave_with_their_states() -> None:
    lines, belief = a_map((3.0, 0.0, 0.0, 0.02), (0.0, 3.0, math.pi / 2, 0.02), (-3.0, 0.0, math.pi, 0.02))
    lines.hits[1] = MIN_HITS - 1
    kept = belief.state[[0, 1, 2, 3, 4, 7, 8]].copy()
    prune(lines, belief, 1 + TRIAL_SCANS)
    assert len(lines) == 3
    prune(lines, belief, 2 + TRIAL_SCANS)
    assert lines.ids.tolist() == [0, 2]
    np.testing.assert_array_equal(belief.state, kept)
    assert lines.column.tolist() == [3, 5]
