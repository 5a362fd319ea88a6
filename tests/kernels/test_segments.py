"""Split and merge are held to a plain recursive split-and-merge in NumPy."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import textbook
from interpreted import interpreted
from rooms import ARENA, poses, scan

from locfuse.fusion.data import Array
from locfuse.fusion.kernels.arrays import view

segments = interpreted("segments")
HALF = np.radians(np.linspace(-90.0, 90.0, 361))


def end_points(rng: np.random.Generator) -> Array:
    """What a noisy laser makes of a room with plates in it, (361, 2)."""
    real = HALF + rng.normal(0.0, math.radians(0.25), 361)
    d = scan(ARENA, poses(rng, 1)[0], real) + rng.normal(0.0, 0.03, 361)
    return np.stack((d * np.cos(HALF), d * np.sin(HALF)), axis=1)


def returns_of(**columns: Any) -> Any:
    """Returns with these columns; the others are 0."""
    count = len(next(iter(columns.values())))
    returns = segments.Returns(count)
    returns.count = count
    for name, values in columns.items():
        setattr(returns, name, np.asarray(values, np.float64))
    return returns


def split(points: Array, tolerance: Array, runs: list[int]) -> tuple[list[int], list[int]]:
    """Where pieces begin, and which go on in the next."""
    x, y = points.T
    pieces = segments.Segments(len(points))
    pieces.runs = len(runs) - 1
    pieces.run_first[: len(runs)] = view(runs, np.intp)
    segments.split(returns_of(x=x, y=y, tolerance=tolerance), pieces)
    return list(pieces.first[: pieces.pieces + 1]), list(pieces.linked[: pieces.pieces])


@pytest.mark.parametrize("seed", range(20))
def test_splitting_depth_by_depth_equals_the_recursion(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points, tolerance = end_points(rng), rng.uniform(0.03, 0.12, 361)
    first, linked = split(points, tolerance, [0, 361])
    assert first == [*textbook.split(points, tolerance), 361]
    assert linked == [1] * (len(first) - 2) + [0]


def pieces_of(moments: Array, linked: list[int]) -> Any:
    """Pieces with these moments (n, 6)."""
    pieces = segments.Segments(len(moments))
    pieces.moments = np.vstack((moments, np.zeros((1, 6))))
    pieces.linked[: len(moments)] = view(linked, np.intp)
    return pieces


def test_merging_all_good_pairs_of_a_round_at_a_time_is_nearly_always_merging_the_best_pair_first() -> None:
    assert sum(as_best_pair_first(seed) for seed in range(20)) >= 19


def as_best_pair_first(seed: int) -> bool:
    rng = np.random.default_rng(seed)
    points, w = end_points(rng), rng.uniform(500.0, 1500.0, 361)
    starts = np.array(textbook.split(points, np.full(361, 0.08)))
    x, y = points.T
    moments = np.add.reduceat(w * np.stack((1 + 0 * x, x, y, x * x, x * y, y * y)), starts, axis=1)
    n = len(starts)
    pieces = pieces_of(moments.T, [1] * n)
    groups = segments.merge(pieces, n, 20.0)
    bounds = list(pieces.bounds[:groups])
    expected = textbook.merge(points, w, starts.tolist(), 20.0)
    joined = np.add.reduceat(moments, bounds, axis=1)
    np.testing.assert_allclose(pieces.moments[:groups].T, joined, rtol=1e-12)
    alone = textbook.misfit(points[: expected[1]], w[: expected[1]])
    assert segments.own_misfit(pieces, 0) == pytest.approx(alone, abs=1e-6)
    return bool(starts[bounds].tolist() == expected)


def test_what_is_not_linked_is_not_joined() -> None:
    along = np.linspace(0.0, 1.0, 10)
    m = [(5.0, x.sum(), 0.0, (x * x).sum(), 0.0, 0.0) for x in np.split(along, 2)]
    for linked, groups in ((0, 2), (1, 1)):
        assert segments.merge(pieces_of(np.array(m), [linked, 0]), 2, 20.0) == groups


# --- returns, gaps and weights, written out in NumPy


def allowed(d: float, before: float) -> float:
    """How far neighbours on one wall may lie apart: 0.3 m, or a tenth of the farther range."""
    return max(0.3, 0.1 * max(d, before))


def cluster(seed: int, k: int = 40) -> tuple[Array, Array, Array]:
    """Ranges, and end points that mostly lie near each other."""
    rng = np.random.default_rng(seed)
    d = rng.uniform(0.5, 8.0, k)
    x, y = np.cumsum(rng.choice([0.05, 0.2, 0.45, 0.9], k)), np.cumsum(rng.choice([0.0, 0.05, -0.4], k))
    return d, x, y


@pytest.mark.parametrize("seed", range(8))
def test_runs_end_where_neighbours_lie_farther_apart_than_a_wall_allows(seed: int) -> None:
    d, x, y = cluster(seed)
    returns, runs = returns_of(ranges=d, x=x, y=y), segments.Segments(40)
    segments.cut_at_gaps(returns, 0.1, 0.3, runs)
    apart = np.hypot(np.diff(x), np.diff(y))
    starts = [0] + [i + 1 for i in range(39) if apart[i] > allowed(d[i], d[i + 1])]
    assert list(runs.run_first[: runs.runs + 1]) == [*starts, 40]
    for i in range(39):
        found = segments.gap(returns, i, i + 1, 0.1, 0.3)
        assert found == pytest.approx((apart[i] / allowed(d[i], d[i + 1])) ** 2)
