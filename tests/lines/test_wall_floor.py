"""Walls that are not planes are recognised from the lines alone, and flat ones are left alone."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from locfuse.fusion.ekf.belief_arrays import JointBelief
from locfuse.fusion.kernels.sight import Rules
from locfuse.fusion.lines.flatness import LAG_SCANS, bend, wall_floor
from locfuse.fusion.map.line_map import Association, LineMap, seat_of
from locfuse.fusion.map.scan import Scan
from locfuse.fusion.se2 import wrap_all

Array = NDArray[np.float64]
FIT = math.radians(0.2)


class Straight:
    """A robot that drives 0.1 m from scan to scan along x."""

    def relative(self, t_from: Array, t_to: Array) -> Array:
        ahead = np.asarray(t_to - t_from)
        return np.stack((0.1 * ahead, 0.0 * ahead, 0.0 * ahead), axis=-1)

    track = 1.0

    def slips(self, t: Array) -> Array:
        return np.zeros((*t.shape[:-1], t.shape[-1] - 1, 2))

    def heading(self, t: Array) -> Array:
        return np.zeros_like(t)


def corridor(bend: float, seed: int, scans: int = 600) -> tuple[float, float]:
    """Floors found from a corridor whose walls point off by `bend` [rad], anew wherever they are looked at."""
    rng = np.random.default_rng(seed)
    t = np.arange(scans, dtype=float)
    psi = np.tile([math.pi / 2, -math.pi / 2], scans) + rng.normal(0.0, math.hypot(FIT, bend), 2 * scans)
    z = np.stack((np.ones(2 * scans), wrap_all(psi)), axis=-1)
    return wall_floor(t, np.arange(scans + 1) * 2, z, np.full(2 * scans, FIT**2), Straight())


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("bend_deg", [0.3, 0.6])
def test_the_floor_is_what_walls_bend(bend_deg: float, seed: int) -> None:
    _, angle = corridor(math.radians(bend_deg), seed)
    assert math.degrees(angle) == pytest.approx(bend_deg, rel=0.2)


@pytest.mark.parametrize("seed", range(5))
def test_flat_walls_ask_for_no_floor(seed: int) -> None:
    assert corridor(0.0, seed) == (0.0, 0.0)


def test_too_few_walls_say_nothing() -> None:
    assert corridor(math.radians(1.0), 0, scans=100) == (0.0, 0.0)
    assert corridor(math.radians(1.0), 0, scans=5) == (0.0, 0.0)


def test_a_line_that_bends_changes_over_the_lag_as_the_walls_did() -> None:
    """Two readings of a wall with unevenness u differ by 2 u; a random walk must get there in LAG_SCANS steps."""
    uneven = np.array([1e-4, 7e-5])
    steps = np.random.default_rng(0).normal(size=(4000, LAG_SCANS, 2)) * np.sqrt(bend(uneven))
    assert steps.sum(axis=1).var(axis=0) == pytest.approx(2.0 * uneven, rel=0.1)


def test_a_line_that_is_seen_for_ever_stays_within_its_walls_unevenness() -> None:
    """Looked at again and again, a wall that is known well becomes as uncertain as it is uneven, and no more."""
    uneven = np.array([1e-4, 7e-5])
    belief = JointBelief((0.0, 0.0, 0.0), (1e-6, 0.0, 0.0, 1e-6, 0.0, 1e-6), [])
    walls = LineMap()
    for start in (1e-6, 4e-4):  # one well known, one worse than it is uneven
        column = belief.augment(np.zeros(2), np.zeros((2, 3)), start * np.eye(2))
        walls.append(np.array([2.0, 0.0]), np.zeros(2), np.zeros((2, 2)), column, (-1.0, 1.0), 0)
    z, R, ends = np.array([[2.0, 0.0]]), np.diag([1e-4, 1e-4])[None], np.array([[-1.0, 1.0]])
    for which in (0, 1):
        walls.lo[:], walls.hi[:] = 10.0, 11.0  # the other one lies elsewhere
        walls.lo[which], walls.hi[which] = -1.0, 1.0
        found = Association(Rules(math.inf, True, True, 0, 0, 0), seat_of(None, belief))
        found.compare(belief, walls, Scan.of(z, R, ends).rows)
        for _ in range(10 * LAG_SCANS):
            found.bend(belief, uneven.tolist(), bend(uneven).tolist())
    np.testing.assert_allclose(np.diagonal(belief.covariance)[3:], [*uneven, 4e-4, 4e-4], rtol=1e-9)
