"""Speeds of another source: the chord of an arc, against the textbook's motion."""

from __future__ import annotations

import math

import numpy as np
import pytest
from said import said
from textbook import move, numeric_jacobian, wrap

from locfuse.fusion.data import Measurements
from locfuse.fusion.ekf.belief_arrays import JointBelief
from locfuse.fusion.sensors.twist import Twist, TwistModel, TwistSettings, straight

KEPT = np.array([0.4, -0.3, 0.8])
SETTINGS = TwistSettings(sigma_scale=0.1)


def kept(pose: np.ndarray) -> tuple[TwistModel, JointBelief]:
    """A source whose first reading came at KEPT, and a robot that is at `pose` now."""
    model = Twist().model(SETTINGS)
    assert isinstance(model, TwistModel)
    x, y, theta = KEPT.tolist()
    belief = JointBelief((x, y, theta), (0.01, 0.001, 0.0, 0.02, 0.0, 0.03), model.blocks())
    model.learn(summed(0.0), 0, belief)
    belief.transform(np.arange(3), pose, np.eye(3))
    return model, belief


def summed(turn: float, piece: float = 0.0) -> Measurements:
    """Two readings: 0.6 m and a turn [rad] between them."""
    columns = {"piece": [0.0, piece], "forward_variance": [0.1, 0.14], "turn_variance": [0.2, 0.23]}
    z, floor = np.array([[3.0, 1.0], [3.6, 1.0 + turn]]), np.diag([1e-3, 2e-3])
    extra = {name: np.array(column) for name, column in columns.items()}
    return Measurements(np.arange(2.0), np.arange(3), z, np.zeros((2, 2, 2)), 1.0, floor, extra)


@pytest.mark.parametrize("turn", [0.0, 0.5, -0.5 + math.tau])
def test_way_and_turn_are_compared_with_the_chord_of_an_arc(turn: float) -> None:
    bent = wrap(turn)
    pose = move(KEPT, np.array([0.55 * math.cos(0.5 * bent), 0.55 * math.sin(0.5 * bent), bent + 0.03]))
    model, belief = kept(pose)
    (seen,) = model.innovations(summed(turn), 1, belief)

    def h(x: np.ndarray) -> np.ndarray:
        away, toward = x[:2] - x[3:5], x[2] - x[5]
        middle = x[5] + 0.5 * toward
        return np.array([away @ [math.cos(middle), math.sin(middle)], toward])

    x = np.concatenate((pose, KEPT))
    arc = 0.6 * (math.sin(0.5 * turn) / (0.5 * turn) if turn else 1.0)
    expected = np.array([arc, bent]) - h(x)
    np.testing.assert_allclose(seen.y, [expected[0], wrap(expected[1])], atol=1e-12)
    columns, H, noise = said(seen, belief)
    np.testing.assert_allclose(H, numeric_jacobian(h, x), atol=1e-8)
    R = np.diag((0.04 + 0.01 * 0.36 + 1e-3, 0.03 + 0.01 * turn**2 + 2e-3))
    np.testing.assert_allclose(noise, R, atol=1e-12)
    assert columns == (3, 4, 5)


def test_the_first_reading_and_one_after_a_gap_only_begin() -> None:
    model, belief = kept(KEPT)
    assert model.innovations(summed(0.1, piece=1.0), 1, belief) == []
    fresh = Twist().model(SETTINGS)
    assert fresh.innovations(summed(0.1), 1, belief) == []


@pytest.mark.parametrize("turn", [math.nan, math.inf, -math.inf])
def test_a_turn_that_is_no_number_gives_no_chord(turn: float) -> None:
    assert math.isnan(straight(1.0, turn))
    assert straight(1.5, 0.0) == 1.5
