"""Motion between two times: two intervals on end are one."""

from __future__ import annotations

import math

import numpy as np
import pytest

from locfuse.fusion import se2
from locfuse.fusion.data import Motions
from locfuse.fusion.wheels.motion import Wheels

KINDS = ["wheels", "gap", "twists", "matches"]


def wheels_of(kind: str, rolled: list[tuple[float, float, float]], seed: int) -> Wheels:
    """Wheels, with a silence or not, an odometry that also moves sideways, or scans that were matched."""
    rng, n = np.random.default_rng(seed), len(rolled)
    t = np.cumsum(rng.uniform(0.01, 0.1, n + 1))
    if kind == "gap":
        t[n // 2 + 1 :] += 7.0
    a = np.array(rolled)
    if kind in {"wheels", "gap"}:
        left, right = np.concatenate((np.zeros((1, 2)), np.cumsum(a[:, :2], axis=0))).T
        return Wheels.from_wheels(t, left, right, 0.4, 1e-3)
    if kind == "twists":
        return Wheels.from_twists(t, a, 0.4, 1e-3)
    root = rng.normal(0.0, 0.01, (n, 3, 3))
    return Wheels.from_matches(t, a, root @ root.transpose(0, 2, 1), 0.4, 1e-3)


@pytest.mark.parametrize("kind", KINDS)
def test_two_intervals_on_end_are_one(kind: str) -> None:
    """Motion, and covariance where the noise of either is its own: J Q J' + Q of the second (eq. 6)."""
    rng = np.random.default_rng(4)
    wheels = wheels_of(kind, [tuple(v) for v in rng.normal(0.03, 0.02, (40, 3)).tolist()], 1)
    cuts = wheels.t[[0, 13, 31]]
    (first, second), whole = (
        [wheels.between(cuts[k : k + 1], cuts[k + 1 : k + 2]) for k in (0, 1)],
        wheels.between(cuts[:1], cuts[2:]),
    )
    np.testing.assert_allclose(se2.compose(first.u, second.u), whole.u, atol=1e-13)
    np.testing.assert_allclose(_chained(first, second), whole.Q[0], rtol=1e-9, atol=1e-18)


def _chained(first: Motions, second: Motions) -> np.ndarray:
    c, s = math.cos(first.u[0, 2]), math.sin(first.u[0, 2])
    x, y, _ = second.u[0]
    A = np.array([[1.0, 0.0, -s * x - c * y], [0.0, 1.0, c * x - s * y], [0.0, 0.0, 1.0]])
    W = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    joined: np.ndarray = A @ first.Q[0] @ A.T + W @ second.Q[0] @ W.T
    return joined
