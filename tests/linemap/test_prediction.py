"""What the robot should see of a line, and how sure: against numerical derivatives and the joint covariance."""

from __future__ import annotations

import math

import numpy as np
import pytest
from line_scene import scene

from locfuse.fusion import se2
from locfuse.fusion.data import Array

STEP = 1e-6


def seen(pose: Array, value: Array, anchor: Array) -> Array:
    """(r, psi) of a line from a pose, in the paper's words: distance to the line, and its normal's direction."""
    n = np.array([math.cos(value[1]), math.sin(value[1])])
    return np.array([value[0] - n @ (pose[:2] - anchor), value[1] - pose[2]])


@pytest.mark.parametrize("seed", range(20))
def test_a_predicted_line_and_its_covariance_are_those_of_pose_and_line_together(seed: int) -> None:
    _, lines, belief = scene(seed, True)
    which = np.arange(len(lines))
    values, pose = lines.values(belief), np.array(belief.pose())
    found = lines.predict(which, values, belief)
    for j in which:
        at = np.array([0, 1, 2, lines.column[j], lines.column[j] + 1])
        both = np.concatenate((pose, values[j]))

        def of(x: Array, anchor: Array = lines.anchor[j]) -> Array:
            return seen(x[:3], x[3:], anchor)

        H = np.stack([(of(both + d) - of(both - d)) / (2.0 * STEP) for d in STEP * np.eye(5)], axis=1)
        r, psi = of(both)
        assert found.r[j] == pytest.approx(r, abs=1e-9)
        assert se2.wrap(float(found.psi[j]) - psi) == pytest.approx(0.0, abs=1e-9)
        S = H @ belief.covariance[np.ix_(at, at)] @ H.T
        np.testing.assert_allclose(found.spread[j], S, rtol=1e-5, atol=1e-7 * np.abs(S).max())
