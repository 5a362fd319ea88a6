"""Thinning keeps what one looks for; geometry is held to closed forms and to se2."""

from __future__ import annotations

import math

import numpy as np
import pytest

from locfuse.formats.geometry import ellipses, mounted, segments, to_map, wall, wall_band
from locfuse.formats.thin import evenly, extremes
from locfuse.fusion import se2
from locfuse.fusion.data import MapLine


def test_a_spike_of_one_sample_survives_thinning() -> None:
    values = np.sin(np.arange(200_000) / 5000.0)
    values[123_457], values[77_771] = 50.0, -50.0
    picks = extremes(values, 4000)
    assert len(picks) <= 4000
    assert {0, 77_771, 123_457, 199_999} <= set(picks.tolist())
    assert (np.diff(picks) > 0).all()


def test_a_short_curve_is_kept_whole() -> None:
    assert extremes(np.zeros(4000), 4000).tolist() == list(range(4000))
    assert extremes(np.zeros(0), 4000).tolist() == []


@pytest.mark.parametrize("n", [4001, 4003, 7999, 8001, 36_000])
@pytest.mark.parametrize("curves", [1, 2])
def test_thinning_never_exceeds_the_limit_and_brackets_every_curve(n: int, curves: int) -> None:
    values = np.random.default_rng(n).normal(size=(n, curves)).cumsum(axis=0)
    picks = extremes(values, 4000)
    assert len(picks) <= 4000
    for curve in values.T:
        assert {int(curve.argmin()), int(curve.argmax())} <= set(picks.tolist())


def test_a_gap_is_no_extreme() -> None:
    values = np.arange(50_000, dtype=float)
    values[100:40_000] = np.nan
    picks = extremes(values, 1000)
    assert np.isnan(values[picks]).sum() <= 1000 * 0.9  # a bucket of nothing but gaps still says so
    assert {49_999, 99, 40_000} <= set(picks.tolist())


def test_scans_are_picked_evenly_with_both_ends() -> None:
    picks = evenly(36_000, 2000)
    assert len(picks) == 2000
    assert picks[0] == 0
    assert picks[-1] == 35_999
    assert np.diff(picks).max() <= 19
    assert evenly(7, 2000).tolist() == list(range(7))
    assert evenly(0, 2000).tolist() == []


def test_ellipses_are_three_sigma_of_the_covariance() -> None:
    rng = np.random.default_rng(1)
    A = rng.normal(size=(50, 2, 2))
    P = np.zeros((50, 3, 3))
    P[:, :2, :2] = A @ A.transpose(0, 2, 1)
    axes, angle = ellipses(P)
    for p, (a, b), turn in zip(P[:, :2, :2], axes, angle, strict=True):
        ahead, left = np.array([math.cos(turn), math.sin(turn)]), np.array([-math.sin(turn), math.cos(turn)])
        for length, direction in ((a, ahead), (b, left)):
            tip = length * direction
            assert tip @ np.linalg.solve(p, tip) == pytest.approx(9.0, rel=1e-6)


def test_a_certain_position_is_a_point() -> None:
    axes, _ = ellipses(np.zeros((1, 3, 3)))
    assert axes.tolist() == [[0.0, 0.0]]


def test_points_and_mounts_agree_with_se2() -> None:
    pose = np.array([[1.0, -2.0, 2.5], [0.3, 0.2, -3.0]])
    points = np.array([[0.5, 0.1], [-1.0, 4.0]])
    np.testing.assert_allclose(to_map(pose, points), se2.transform(pose, points), atol=1e-12)
    mount = (0.1, -0.2, 0.7)
    np.testing.assert_allclose(mounted(pose, mount), se2.compose(pose, np.array(mount)[None]), atol=1e-12)


def test_a_line_is_drawn_where_its_normal_form_says() -> None:
    ((a, b),) = segments(np.array([[2.0, math.pi / 2]]), np.array([[-1.0, 3.0]]))
    np.testing.assert_allclose([a, b], [[1.0, 2.0], [-3.0, 2.0]], atol=1e-12)


def test_the_band_of_a_wall_is_three_sigma_of_its_offset_there() -> None:
    P = np.array([[4e-4, -3e-5], [-3e-5, 1e-5]])
    line = MapLine(0, 3.0, 0.4, (-2.0, 5.0), P)
    band = wall_band(line)
    assert band[0].tolist() == band[-1].tolist()
    (start, end), n = wall(line), np.array([math.cos(0.4), math.sin(0.4)])
    draws = np.random.default_rng(2).multivariate_normal((3.0, 0.4), P, 200_000)
    for point, offset in ((start, band[0]), (end, band[8])):
        # where the drawn wall crosses the normal through the point
        rho, beta = draws.T
        off = (rho - point @ np.stack((np.cos(beta), np.sin(beta)))) / np.cos(beta - 0.4)
        assert (offset - point) @ n == pytest.approx(3.0 * off.std(), rel=0.01)
