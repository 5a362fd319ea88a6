"""Noise of deskewing: what lines owe to wheels that slip within a sweep, against scans of a slipping robot."""

from __future__ import annotations

import math

import numpy as np
import pytest

from locfuse.fusion import se2
from locfuse.fusion.data import Array
from locfuse.fusion.lines.extract import Lines, LineSettings
from locfuse.fusion.lines.flatness import wall_floor
from locfuse.fusion.lines.scans import Laser, lines_in_base, sweep_time
from locfuse.fusion.se2 import wrap_all
from locfuse.fusion.wheels.motion import Wheels

BEAMS, SWEEP, TRACK, NOISE = 360, 0.1, 0.3, 4e-4
MOUNT = np.array([0.2, -0.1, 0.7])
ANGLES = np.linspace(-math.pi, math.pi, BEAMS, endpoint=False)
WALLS = np.array([(2.0, 0.3), (1.5, 0.3 + math.pi / 2), (2.5, 0.3 + math.pi), (1.8, 0.3 - math.pi / 2)])  # r, psi


def seen_from(poses: Array) -> Array:
    """Ranges (..., b) of beams along ANGLES from laser poses (..., b, 3) in the room of WALLS."""
    heading = ANGLES + poses[..., 2]
    away = WALLS[:, 0] - poses[..., :1] * np.cos(WALLS[:, 1]) - poses[..., 1:2] * np.sin(WALLS[:, 1])
    towards = np.cos(heading[..., None] - WALLS[:, 1])
    ranges: Array = np.where(towards > 1e-6, away / np.maximum(towards, 1e-6), np.inf).min(axis=-1)
    return ranges


def driven(speed: float, turn: float) -> Wheels:
    """Wheels that roll steadily for two seconds."""
    t = np.linspace(0.0, 2.0, 201)
    left, right = (speed - 0.5 * TRACK * turn) * t, (speed + 0.5 * TRACK * turn) * t
    return Wheels.from_wheels(t, left, right, TRACK, NOISE)


def measured(wheels: Wheels, base: Array) -> Lines:
    """Lines in the base of scans whose beams were fired from base poses (n, b, 3) seen from the middle."""
    ranges = seen_from(se2.compose(base, MOUNT))
    n = len(ranges)
    scans = {
        "ranges": ranges,
        "angle_min": np.full(n, ANGLES[0]),
        "angle_increment": np.full(n, ANGLES[1] - ANGLES[0]),
        "range_min": np.zeros(n),
        "range_max": np.full(n, 100.0),
        "time_increment": np.full(n, SWEEP / (BEAMS - 1)),
    }
    laser = Laser(MOUNT, False, 1.0, 0.0, None, True, LineSettings(sigma_range=0.01))
    return lines_in_base(scans, np.full(n, 1.0 - 0.5 * SWEEP), laser, wheels)[0]


def slipped(wheels: Wheels, n: int, seed: int) -> Array:
    """Base poses (n, b, 3) seen from the middle of the sweep, of robots whose wheels slip as a random walk."""
    dt = SWEEP / (BEAMS - 1)
    rolled = wheels.rolled[1] / (wheels.t[1] - wheels.t[0]) * dt  # (2,) m a beam
    rng = np.random.default_rng(seed)
    steps = rolled + np.sqrt(NOISE * np.abs(rolled)) * rng.normal(size=(n, BEAMS - 1, 2))
    ahead, turn = steps.mean(axis=-1), (steps[..., 1] - steps[..., 0]) / TRACK
    poses = np.zeros((n, BEAMS, 3))
    for k in range(1, BEAMS):
        arc = np.stack((ahead[:, k - 1], np.zeros(n), turn[:, k - 1]), axis=-1)
        poses[:, k] = se2.compose(poses[:, k - 1], arc)
    middle = 0.5 * (poses[:, BEAMS // 2 - 1] + poses[:, BEAMS // 2])
    return se2.compose(se2.inverse(middle)[:, None], poses)


def in_order(lines: Lines, values: Array) -> Array:
    """`values` (m, ...) of scans that show every wall as one line, in the order of WALLS: (scans, walls, ...)."""
    whole = lines.first[:-1][np.diff(lines.first) == len(WALLS)]
    rows = whole[:, None] + np.arange(len(WALLS))
    turn = np.abs(wrap_all(lines.z[rows, 1][:, None, :] - WALLS[:, 1][:, None]))
    ordered: Array = values[np.take_along_axis(rows, turn.argmin(axis=2), axis=1)]
    return ordered


@pytest.mark.parametrize(("speed", "turn"), [(0.3, 0.0), (0.0, 1.2), (0.3, -0.6)])
def test_lines_err_together_as_their_loadings_say(speed: float, turn: float) -> None:
    wheels = driven(speed, turn)
    lines = measured(wheels, slipped(wheels, 1000, seed=1))
    z, G = in_order(lines, lines.z), in_order(lines, lines.sweep)[0].astype(float)
    assert len(z) > 400
    error = np.concatenate((z[..., 0] - WALLS[:, 0], wrap_all(z[..., 1] - WALLS[:, 1])), axis=1)
    G = np.concatenate((G[:, 0], G[:, 1]))  # r of every wall, then psi of every wall
    found, expected = np.cov(error.T), G @ G.T
    # a random walk in six pieces: a line that is seen within one of them errs by a little more
    ratio = np.sqrt(np.diagonal(found) / np.diagonal(expected))
    np.testing.assert_allclose(ratio, 1.0, atol=0.15)
    assert np.median(ratio) == pytest.approx(1.0, abs=0.1)
    np.testing.assert_allclose(correlation(found), correlation(expected), atol=0.4)
    assert np.abs(correlation(found) - correlation(expected)).mean() < 0.15


def correlation(covariance: Array) -> Array:
    sigma = np.sqrt(np.diagonal(covariance))
    ratio: Array = covariance / np.outer(sigma, sigma)
    return ratio


def test_a_robot_at_rest_deskews_without_noise() -> None:
    lines = measured(driven(0.0, 0.0), np.zeros((3, BEAMS, 3)))
    assert len(lines.z) == 12
    assert not lines.sweep.any()


def walls_of_slipping_scans(sweep: float, seed: int) -> tuple[float, float]:
    """The floor that two walls ask for whose angle slips by `sweep` [rad] in every scan; it is told, or not."""
    rng = np.random.default_rng(seed)
    n, fit = 600, math.radians(0.2)
    slip = np.stack((rng.normal(0.0, sweep, n), rng.normal(0.0, sweep, n)), axis=1)
    psi = np.tile([math.pi / 2, -math.pi / 2], (n, 1)) + slip + rng.normal(0.0, fit, (n, 2))
    z = np.stack((np.ones(2 * n), wrap_all(psi.ravel())), axis=-1)
    loadings = np.tile([(sweep, 0.0), (0.0, sweep)], (n, 1))
    t, first, variance, wheels = (
        np.arange(float(n)),
        np.arange(n + 1) * 2,
        np.full(2 * n, fit**2),
        driven(0.0, 0.0),
    )
    without = wall_floor(t / n, first, z, variance, wheels)[1]
    return without, wall_floor(t / n, first, z, variance, wheels, loadings)[1]


@pytest.mark.parametrize("seed", range(5))
def test_slips_within_a_sweep_are_not_taken_for_uneven_walls(seed: int) -> None:
    taken, known = walls_of_slipping_scans(math.radians(0.4), seed)
    assert math.degrees(taken) == pytest.approx(0.4, rel=0.2)
    assert known == 0.0


def test_a_sweep_takes_at_most_a_second_and_no_time_where_its_increment_is_no_number() -> None:
    told = np.array([0.001, -1.0, 0.0, np.nan, np.inf, 5.0])
    np.testing.assert_allclose(sweep_time(told, 101), [0.1, 0.0, 0.0, 0.0, 100.0 / 101.0, 100.0 / 101.0])
