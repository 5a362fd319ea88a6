"""Split and merge are held to a plain recursive split-and-merge in NumPy."""

from __future__ import annotations

import math
from typing import Any, cast

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


def test_runs_are_split_each_for_itself() -> None:
    """Two corners of three points, side by side: no chord leads from one run to the next."""
    x, y = [0.0, 1.0, 1.0, 5.0, 6.0, 6.0, 7.0], [0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 1.0]
    first, linked, todo = [0] * 8, [0] * 8, [0] * 18
    n = pieces.split(x, y, [0.3] * 7, 2, [0, 3, 7], todo, first, linked)
    assert (first[: n + 1], linked[:n]) == ([0, 1, 3, 4, 5, 7], [1, 0, 1, 1, 0])
    assert pieces.farthest(x, y, [0.3] * 7, 2, 4) == -1  # two points have no third


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


# --- returns, gaps and weights, written out in NumPy


@pytest.mark.parametrize("begin", [0, 5, 39])
def test_returns_are_gathered_once_round_with_their_directions_and_ends(begin: int) -> None:
    rng = np.random.default_rng(begin)
    beams, scan, column = 40, 2, 3
    ranges = rng.uniform(0.0, 6.0, 3 * beams)
    ranges[[85, 100]] = math.nan, math.inf
    ranges[[90, 91]] = 0.5, 5.0  # the ends: [0.5, 5)
    angle, x0, y0 = np.linspace(-3.0, 3.0, beams + 5), rng.normal(size=beams + 5), rng.normal(size=beams + 5)
    out: Any = [[0.0] * beams for _ in range(8)]
    k = pieces.gather(
        ranges.tolist(), np.cos(angle).tolist(), np.sin(angle).tolist(), x0.tolist(), y0.tolist(), scan, column,
        beams, begin, 0.5, 5.0, *out,
    )  # fmt: skip
    order = np.roll(np.arange(beams), -begin)
    d = ranges[scan * beams + order]
    seen, at = order[(d >= 0.5) & (d < 5.0)], column + order[(d >= 0.5) & (d < 5.0)]
    d, c, s = d[(d >= 0.5) & (d < 5.0)], np.cos(angle[at]), np.sin(angle[at])
    assert k == len(seen) > 20
    expected = d, c, s, x0[at], y0[at], x0[at] + d * c, y0[at] + d * s, seen
    np.testing.assert_allclose([column[:k] for column in out], expected, atol=1e-15)


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
    first = [0] * 41
    runs = pieces.cut_at_gaps(d.tolist(), x.tolist(), y.tolist(), 40, 0.1, 0.3, first)
    apart = np.hypot(np.diff(x), np.diff(y))
    starts = [0] + [i + 1 for i in range(39) if apart[i] > allowed(d[i], d[i + 1])]
    assert first[: runs + 1] == [*starts, 40]
    for i in range(39):
        found = pieces.gap(x[i + 1] - x[i], y[i + 1] - y[i], d[i + 1], d[i], 0.1, 0.3)
        assert found == pytest.approx((apart[i] / allowed(d[i], d[i + 1])) ** 2)


@pytest.mark.parametrize("seed", range(8))
def test_a_ring_begins_behind_its_widest_gap_or_at_its_farthest_return(seed: int) -> None:
    d, x, y = cluster(seed)
    jump = [np.hypot(x[i] - x[i - 1], y[i] - y[i - 1]) / allowed(d[i], d[i - 1]) for i in range(40)]
    assert pieces.ring_start(d.tolist(), x.tolist(), y.tolist(), 40, 0.1, 0.3) == int(np.argmax(jump))
    angle = np.linspace(0.0, 2.0 * math.pi, 40, endpoint=False)
    close = (1.0 * np.cos(angle)).tolist(), (1.0 * np.sin(angle)).tolist()  # 0.16 m from one to the next
    for unit in (1.0, 0.1):
        assert pieces.ring_start((unit * d).tolist(), *close, 40, 0.1, 0.3) == -1 - int(np.argmax(d))


def test_a_return_may_lie_off_a_straight_piece_by_so_many_sigmas_of_both_its_errors() -> None:
    d, tolerance = [0.1, 1.0, 5.0, 20.0], [0.0] * 4
    pieces.tolerances(d, 4, 0.02, 0.01, 3.0, 0.08, tolerance)
    assert tolerance == pytest.approx([max(0.08, 3.0 * math.hypot(0.02, 0.01 * r)) for r in d])
    pieces.tolerances(d, 4, 0.0, 0.0, 3.0, 0.0, tolerance)
    assert min(tolerance) > 0.0


@pytest.mark.parametrize("seed", range(6))
def test_points_count_by_their_variance_across_the_chord_of_their_piece(seed: int) -> None:
    rng = np.random.default_rng(seed)
    angle, d = np.linspace(-1.0, 1.0, 30), rng.uniform(1.0, 4.0, 30)
    u = np.column_stack((np.cos(angle), np.sin(angle)))
    p = d[:, None] * u
    first, m = [0, 12, 30], [0.0] * 12
    columns, moments = [column.tolist() for column in (d, *u.T, *p.T)], cast("Any", pieces.moments)
    moments(*columns, first, 2, 0.02, 0.01, 0.005, m)
    for piece, at in enumerate((slice(0, 12), slice(12, 30))):
        chord = p[at][-1] - p[at][0]
        n = np.array([-chord[1], chord[0]]) / np.linalg.norm(chord)
        side = np.column_stack((-u[at, 1], u[at, 0]))
        w = 1.0 / ((0.02 * u[at] @ n) ** 2 + (0.01 * d[at] * (side @ n)) ** 2 + 0.005**2)
        x, y = p[at].T
        expected = [float((w * v).sum()) for v in (1.0 + 0.0 * x, x, y, x * x, x * y, y * y)]
        assert m[6 * piece : 6 * piece + 6] == pytest.approx(expected)


def test_a_single_point_counts_by_its_variance_in_some_direction() -> None:
    """It has no chord; 2 cm along the beam and 5 cm across it, whichever way."""
    m = [0.0] * 6
    pieces.moments([5.0], [0.8], [0.6], [4.0], [3.0], [0, 1], 1, 0.02, 0.01, 0.0, m)
    assert 1.0 / 0.05**2 <= m[0] <= 1.0 / 0.02**2
    assert m[1:3] == pytest.approx([4.0 * m[0], 3.0 * m[0]])


def test_of_a_loop_that_closes_exactly_the_point_off_it_is_measured_in_some_direction() -> None:
    """Begin and end are one point, 0.5 m from the other two in x and in y: no direction makes that 0 or more."""
    x, y = [0.0, 0.5, 0.5, 0.0], [0.0, 0.5, 0.5, 0.0]
    assert pieces.farthest(x, y, [0.45] * 4, 0, 4) == 1
    assert pieces.farthest(x, y, [0.75] * 4, 0, 4) == -1
