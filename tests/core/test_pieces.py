"""Split and merge are held to a plain recursive split-and-merge in NumPy."""

from __future__ import annotations

import math

import numpy as np
import pytest
import textbook_lines
from rooms import ARENA, poses, scan

from locfuse.fusion.core import pieces
from locfuse.fusion.data import Array

HALF = np.radians(np.linspace(-90.0, 90.0, 361))


def end_points(rng: np.random.Generator) -> Array:
    """What a noisy laser makes of a room with plates in it, (361, 2)."""
    real = HALF + rng.normal(0.0, math.radians(0.25), 361)
    d = scan(ARENA, poses(rng, 1)[0], real) + rng.normal(0.0, 0.03, 361)
    return np.stack((d * np.cos(HALF), d * np.sin(HALF)), axis=1)


def split(points: Array, tolerance: Array) -> list[int]:
    first, linked = [0] * (len(points) + 1), [0] * (len(points) + 1)
    todo, (x, y) = [0] * (2 * len(points) + 4), points.T.tolist()
    n = pieces.split(x, y, tolerance.tolist(), 1, [0, len(points)], todo, first, linked)
    assert linked[:n] == [1] * (n - 1) + [0]
    return first[: n + 1]


@pytest.mark.parametrize("seed", range(20))
def test_splitting_depth_by_depth_equals_the_recursion(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points, tolerance = end_points(rng), rng.uniform(0.03, 0.12, 361)
    assert split(points, tolerance) == [*textbook_lines.split(points, tolerance), 361]


def merge(m: list[float], n: int, linked: list[int], bounds: list[int]) -> int:
    own, cost = [0.0] * (n + 1), [0.0] * (n + 1)
    after, before, best = [0] * (n + 1), [0] * (n + 1), [0] * (n + 1)
    return pieces.merge(m, n, linked, 20.0, own, cost, after, before, best, bounds)


def test_merging_all_good_pairs_of_a_round_at_a_time_is_nearly_always_merging_the_best_pair_first() -> None:
    assert sum(as_best_pair_first(seed) for seed in range(20)) >= 19


def as_best_pair_first(seed: int) -> bool:
    rng = np.random.default_rng(seed)
    points, w = end_points(rng), rng.uniform(500.0, 1500.0, 361)
    starts = np.array(textbook_lines.split(points, np.full(361, 0.08)))
    x, y = points.T
    moments = np.add.reduceat(w * np.stack((1 + 0 * x, x, y, x * x, x * y, y * y)), starts, axis=1)
    m, n = moments.T.ravel().tolist(), len(starts)
    bounds = [0] * (n + 1)
    groups = merge(m, n, [1] * n, bounds)
    expected = textbook_lines.merge(points, w, starts.tolist(), 20.0)
    joined = np.add.reduceat(moments, bounds[:groups], axis=1)
    np.testing.assert_allclose(np.reshape(m[: 6 * groups], (-1, 6)).T, joined, rtol=1e-12)
    alone = textbook_lines.misfit(points[: expected[1]], w[: expected[1]])
    assert pieces.own_misfit(m, 0) == pytest.approx(alone, abs=1e-6)
    return bool(starts[bounds[:groups]].tolist() == expected)


def test_what_is_not_linked_is_not_joined() -> None:
    along = np.linspace(0.0, 1.0, 10)
    m = [v for x in np.split(along, 2) for v in (5.0, x.sum(), 0.0, (x * x).sum(), 0.0, 0.0)]
    for linked, groups in ((0, 2), (1, 1)):
        assert merge(list(m), 2, [linked, 0], [0] * 3) == groups
