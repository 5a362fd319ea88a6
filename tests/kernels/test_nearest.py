"""The nearest point of a cloud is the one that a comparison with all its points finds."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from interpreted import interpreted

from locfuse.fusion.data import Array, Ints
from locfuse.fusion.kernels import nearest
from locfuse.fusion.kernels.arrays import view
from locfuse.fusion.scan_matching.match import Clouds, Targets


def found(kernel: Any, xy: Array, owner: Ints, n: int, at: Array, clouds: Ints, reach: float) -> Ints:
    out = np.full(len(at), -7, np.intp)
    rows = kernel.cloud_rows(xy, owner, n)
    kernel.find_nearest(rows, view(at), view(clouds, np.intp), reach, view(out, np.intp))
    return out


def by_comparison(xy: Array, owner: Ints, at: Array, clouds: Ints, reach: float) -> Ints:
    d = np.hypot(*(at[:, None] - xy).transpose(2, 0, 1))
    d[clouds[:, None] != owner] = np.inf
    rows = np.arange(len(at))
    best = np.append(d, np.full((len(at), 1), reach), axis=1).argmin(axis=1)
    return np.where((best < len(xy)) & (d[rows, np.minimum(best, len(xy) - 1)] < reach), best, -1)


@settings(deadline=None, max_examples=100)
@given(st.integers(0, 10_000), st.sampled_from([0.01, 0.2, 0.5, 3.0]), st.sampled_from([0.1, 1.0, 20.0]))
def test_the_nearest_point_is_found(seed: int, reach: float, size: float) -> None:
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 5))
    owner = np.sort(rng.integers(0, n, rng.integers(1, 40)))
    xy = rng.normal(0.0, size, (len(owner), 2))
    at, clouds = rng.normal(0.0, 1.5 * size, (60, 2)), rng.integers(0, n, 60)
    at[:20] = xy[rng.integers(0, len(xy), 20)] + rng.normal(0.0, 0.5 * reach, (20, 2))
    expected = by_comparison(xy, owner, at, clouds, reach)
    for kernel in (nearest, interpreted("nearest")):
        assert np.array_equal(found(kernel, xy, owner, n, at, clouds, reach), expected)


def test_places_that_are_far_or_no_numbers_have_no_nearest_point() -> None:
    xy, owner = np.array([(0.0, 0.0), (1.0, 0.3)]), np.zeros(2, np.intp)
    far = [(np.nan, 0.0), (0.0, np.nan), (np.inf, 0.0), (0.0, -np.inf), (0.0, 1e300), (0.0, -1e300), (1e300, 0.1)]
    for kernel in (nearest, interpreted("nearest")):
        out = found(kernel, xy, owner, 3, np.array(far), np.zeros(len(far), np.intp), 0.5)
        assert out.tolist() == [-1] * len(far)
        of_none = found(kernel, xy, owner, 3, xy, np.array([1, 2]), 0.5)
        assert of_none.tolist() == [-1, -1]
        none = found(kernel, np.zeros((0, 2)), np.zeros(0, np.intp), 2, xy, np.array([0, 1]), 0.5)
        assert none.tolist() == [-1, -1]


def test_without_a_compiled_kernel_the_search_tree_finds_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(3)
    first = np.array([0, 30, 30, 90])
    clouds = Clouds(first, rng.normal(0.0, 2.0, (90, 2)), np.tile((1.0, 0.0), (90, 1)))
    clouds.normal[[4, 40, 41]] = np.nan  # no surface: not among the targets
    at, of = rng.normal(0.0, 2.5, (200, 2)), rng.integers(0, 3, 200)
    rows = []
    for compiled in (True, False):
        monkeypatch.setattr(nearest, "COMPILED", compiled)
        rows.append(Targets(clouds).nearest(at, of, 0.4))
        assert (Targets(clouds.kept(np.zeros(0, np.int64))).nearest(at, of, 0.4) == -1).all()
    assert np.array_equal(rows[0], rows[1])
    assert (rows[0] >= 0).any()
    assert (rows[0] < 0).any()
