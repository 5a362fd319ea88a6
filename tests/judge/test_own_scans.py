"""A path judged by its own scans: agreement where a place is seen twice, cells that the points fall in."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from locfuse.fusion import se2
from locfuse.fusion.data import Array
from locfuse.fusion.judge.own_scans import Distance, Own, OwnScans, is_better

WALL = np.column_stack((np.linspace(-3.0, 3.0, 301), np.full(301, 2.0)))


class Path:
    """Estimates with nothing but poses."""

    def __init__(self, pose: Array) -> None:
        self.pose = pose


def twice(offset: float) -> tuple[OwnScans, Any]:
    """Drive along a straight wall and, a minute later, along it again, believed `offset` [m] aside of it."""
    x = np.tile(np.arange(0.0, 7.0, 0.7), 2)
    true = np.column_stack((x, np.zeros(20), np.zeros(20)))
    seen = [se2.transform(np.broadcast_to(se2.inverse(p), (len(WALL), 3)), WALL) for p in true]
    believed = true + np.outer(np.repeat((0.0, offset), 10), (0.0, 1.0, 0.0))
    t = np.concatenate((np.arange(10.0), 60.0 + np.arange(10.0)))
    return OwnScans(t, np.arange(20), seen), Path(believed)


def test_a_path_that_sees_a_wall_where_it_was_agrees_with_itself() -> None:
    scans, path = twice(0.0)
    assert scans.judge(path)[0] == pytest.approx(1.0)


def test_a_path_that_sees_the_wall_twenty_centimetres_aside_does_not() -> None:
    scans, path = twice(0.2)
    assert scans.judge(path)[0] == 0.0


def test_a_wall_that_is_seen_twice_fills_more_cells_than_one() -> None:
    sharp, blurred = (scans.judge(path)[1] for scans, path in (twice(0.0), twice(0.2)))
    assert 119 <= sharp <= 123  # 6 m of wall in cells of 5 cm
    assert 1.9 * sharp < blurred < 2.1 * sharp


def test_where_no_place_was_seen_twice_nothing_is_said() -> None:
    scans, path = twice(0.0)
    first = OwnScans(scans.t[:10], scans.instants[:10], scans.points[:10])
    assert first.judge(path)[0] is None
    alone = OwnScans(scans.t[:1], scans.instants[:1], scans.points[:1])
    assert alone.judge(path)[2] == 1.0


def test_two_paths_are_laid_on_each_other_before_they_are_compared() -> None:
    t = np.linspace(0.0, 10.0, 101)
    a = np.column_stack((t, np.sin(t)))
    turned = se2.transform(np.broadcast_to(np.array([5.0, -2.0, 1.0]), (101, 3)), a)
    assert Distance.between(t, a, turned).max < 1e-12
    bent = turned.copy()
    bent[-1] += (1.0, 0.0)
    found = Distance.between(t, a, bent)
    assert found.t_s == 10.0
    assert 0.9 < found.max < 1.0
    assert found.doubted(20.0)
    assert not found.doubted(200.0)


def test_a_path_is_better_only_where_agreement_proves_it() -> None:
    assert is_better(0.3, 0.55)
    assert is_better(0.8, 0.8)
    assert not is_better(0.5, 0.6)
    assert not is_better(0.9, 0.8)
    assert not is_better(None, 0.9)


def test_a_covariance_is_too_small_where_the_smoothed_path_is_further_away_than_it_allows() -> None:
    apart = Distance(0.2, 0.4, 10.0)
    assert Own(0.5, None, apart, claimed_m=0.1).is_overconfident
    assert not Own(0.5, None, apart, claimed_m=0.15).is_overconfident
    assert not Own(0.5, None, Distance(0.04, 0.1, 10.0), claimed_m=0.01).is_overconfident  # it could be chance
    assert not Own(0.5, None, claimed_m=0.0).is_overconfident
