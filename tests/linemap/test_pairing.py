"""Candidate pairs by a loop and by arrays are the same pairs."""

from __future__ import annotations

import math

import numpy as np
import pytest
from msgspec.structs import astuple

from locfuse.fusion.ekf.belief_arrays import JointBelief
from locfuse.fusion.ekf.belief_pose import PoseBelief
from locfuse.fusion.linemap.line_map import AnyBelief, LineMap
from locfuse.fusion.linemap.pairing import FEW, pairs_in_arrays, pairs_in_floats
from locfuse.fusion.linemap.scan import Scan

UPPER = (0.01, 0.001, 0.0005, 0.02, -0.0004, 0.001)


def covariance(rng: np.random.Generator, size: float = 0.02) -> np.ndarray:
    L = np.tril(rng.normal(size=(2, 2))) * size + size * np.eye(2)
    return np.asarray(L @ L.T)


def scene(seed: int, states: bool) -> tuple[Scan, LineMap, AnyBelief]:
    """A robot among lines at a few angles, some near and on either side, and a scan that sees some of them."""
    rng = np.random.default_rng(seed)
    pose = (float(rng.normal()), float(rng.normal()), float(rng.uniform(-9.0, 9.0)))
    xx, xy, xt, yy, yt, tt = (np.array(UPPER) * 10 ** rng.uniform(-4, 2)).tolist()
    P0 = (xx, xy, xt, yy, yt, tt)
    belief: AnyBelief = JointBelief(pose, P0, []) if states else PoseBelief(pose, P0)
    lines = LineMap()
    for _ in range(int(rng.integers(1, FEW))):
        value = np.array([rng.normal() * 0.02, rng.choice([0.0, 0.5, 1.0, 1.5]) * math.pi + rng.normal() * 0.1])
        anchor, half = rng.normal(size=2) * 2.0, rng.uniform(0.2, 3.0)
        P, column = covariance(rng), -1
        if isinstance(belief, JointBelief):
            column = belief.augment(value, rng.normal(size=(2, 3)), P)
        lines.append(anchor, value, P, column, (-half, half), 0)
    k = int(rng.integers(1, 9))
    psi = rng.choice([0.0, 0.5, 1.0, 1.5], k) * math.pi + rng.normal(0.0, 0.1, k) - pose[2]
    z = np.stack((rng.uniform(-0.1, 4.0, k), (psi + math.pi) % (2 * math.pi) - math.pi), axis=-1)
    ends = np.sort(rng.normal(size=(k, 2)) * 2.0, axis=1)
    return Scan(z, np.array([covariance(rng) for _ in range(k)]), ends), lines, belief


@pytest.mark.parametrize("states", [False, True])
@pytest.mark.parametrize("limit", [60.0, math.inf])
def test_pairs_by_a_loop_equal_pairs_by_arrays(states: bool, limit: float) -> None:
    count = flipped = 0
    for seed in range(150):
        scan, lines, belief = scene(seed, states)
        floats, arrays = (find(scan, lines, belief, limit) for find in (pairs_in_floats, pairs_in_arrays))
        assert [(p.line, p.which) for p in floats] == [(p.line, p.which) for p in arrays]
        for a, b in zip(floats, arrays, strict=True):
            np.testing.assert_allclose(np.hstack(astuple(a)), np.hstack(astuple(b)), rtol=1e-11, atol=1e-11)
            flipped += np.sign(a.R[1]) != np.sign(scan.R[a.line, 0, 1])
        count += len(floats)
    assert count > 300
    assert flipped > 30
