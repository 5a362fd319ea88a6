"""A laser that is bumped while driving, by walls whose distances are those of a turned laser."""

from __future__ import annotations

import math

import numpy as np
import pytest

from locfuse.fusion.checks.laser import Walls, bumped

WALLS, BUMP_S = 600, 41.0


def walls(degrees: float, seed: int, scale: float = 1.0, noise: float = 0.01) -> Walls:
    """Return walls of a drive of 100 s whose laser turns by so much on the robot at BUMP_S."""
    rng = np.random.default_rng(seed)
    t, normal = np.linspace(0.0, 100.0, WALLS), rng.uniform(-math.pi, math.pi, WALLS)
    heading = rng.uniform(-0.2, 0.2, WALLS)  # in which the robot moves, in its own frame
    yaw = math.radians(2.0) + np.where(t < BUMP_S, 0.0, math.radians(degrees))
    # a wall whose normal is thought to lie at `normal` lies further to the left by the laser's real yaw
    nearer = 0.3 * np.cos(normal + yaw - heading) / scale + rng.normal(0.0, noise, WALLS)
    n, d = (np.stack((np.cos(a), np.sin(a)), axis=-1) for a in (normal, heading))
    return Walls(nearer, n, 0.3 * d, np.zeros(WALLS), np.zeros(WALLS), t)


@pytest.mark.parametrize("scale", [1.0, 1.1])
@pytest.mark.parametrize("degrees", [-8.0, 3.0, 6.0])
def test_a_bump_is_found_with_its_time_and_angle(degrees: float, scale: float) -> None:
    found = bumped(walls(degrees, 1, scale), scale)
    assert found is not None
    assert found[0] == pytest.approx(BUMP_S, abs=3.0)
    assert math.degrees(found[1]) == pytest.approx(degrees, abs=0.7)


@pytest.mark.parametrize("seed", range(20))
def test_a_laser_that_stays_where_it_is_was_not_bumped(seed: int) -> None:
    assert bumped(walls(0.0, seed, noise=0.03), 1.0) is None


@pytest.mark.parametrize("seed", range(20))
def test_wheels_that_slip_for_seconds_at_a_time_are_no_bump(seed: int) -> None:
    """The direction in which they say that the robot moved is off by 1.5 degrees, by another angle every 5 s."""
    slips = np.repeat(np.random.default_rng(100 + seed).normal(0.0, math.radians(1.5), 20), WALLS // 20)
    still = walls(0.0, seed)
    c, s = np.cos(slips), np.sin(slips)
    d = np.stack((c * still.d[:, 0] - s * still.d[:, 1], s * still.d[:, 0] + c * still.d[:, 1]), axis=-1)
    assert bumped(still._replace(d=d), 1.0) is None


def test_few_walls_tell_nothing() -> None:
    few = Walls(*(column[::20] for column in walls(8.0, 1)))
    assert bumped(few, 1.0) is None
