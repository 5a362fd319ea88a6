"""A reference in the place of truth: what it measures, and what its own errors leave open."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from locfuse.fusion import se2
from locfuse.fusion.data import Array, Drive, Estimates, Motions, upper_triangles
from locfuse.fusion.judge.against import Reference, interpolated
from locfuse.fusion.judge.credit import Effect
from locfuse.fusion.judge.evaluate import evaluate
from locfuse.fusion.judge.own_scans import Distance, Own, OwnScans, is_better

N = 400
SIGMA = 0.02  # m, of each axis of the solved drive


def path() -> NDArray[np.float64]:
    t = np.linspace(0.0, 40.0, N)
    return np.column_stack((np.cos(0.2 * t), np.sin(0.2 * t), 0.2 * t + np.pi / 2.0))


def of_poses(pose: NDArray[np.float64], name: str = "lrf", sigma: float = SIGMA) -> Estimates:
    P = np.broadcast_to(np.diag([sigma**2, sigma**2, 1e-6]), (len(pose), 3, 3))
    return Estimates(name, (name,), np.linspace(0.0, 40.0, len(pose)), pose, upper_triangles(P), {})


def drive() -> Drive:
    motions = Motions(np.zeros((N, 3)), np.zeros((N, 3, 3)), np.zeros((N, 3, 0)))
    return Drive(0, np.linspace(0.0, 40.0, N), motions, {}, {}, {})


def reference() -> Reference:
    return Reference.of(of_poses(path()), drive(), ("compass",))


def test_errors_are_distances_to_the_reference_and_no_claim_is_made_of_consistency() -> None:
    moved = of_poses(path() + np.array([0.3, -0.4, 0.01]), "compass")
    found = reference().judge(evaluate(moved, drive()), moved)
    assert found.reference
    assert found.figures["position_rmse_m"] == pytest.approx(0.5)
    assert found.figures["heading_rmse_deg"] == pytest.approx(math.degrees(0.01))
    assert found.figures["anees"] is None
    assert found.figures["truth_coverage"] is None
    assert np.isnan(found.nees).all()


def test_an_estimate_at_other_times_is_read_between_its_rows_and_not_across_gaps() -> None:
    whole = of_poses(path(), "amcl")
    kept = np.ones(N, bool)
    kept[100:200] = False
    kept[1:90:3] = False
    rare = Estimates("amcl", (), whole.t[kept], whole.pose[kept], whole.triangles[kept], {})
    pose, P = interpolated(whole.t, rare.t, rare.pose, rare.triangles)
    known = np.isfinite(pose[:, 0])
    assert not known[101:199].any()
    assert known[:90].all()
    np.testing.assert_allclose(pose[known], whole.pose[known], atol=1e-3)
    assert np.isfinite(P[known]).all()


def test_an_estimate_is_read_at_its_own_stamps_between_them_and_nowhere_else() -> None:
    """Rows each second but for a gap from 4 to 90 s; theta is three times, y twice x."""
    t = np.array([0.0, 1.0, 2.0, 3.0, 4.0, 90.0, 91.0])
    pose = np.column_stack((t, 2.0 * t, 3.0 * t))
    P = np.eye(3) * (1.0 + t)[:, None, None]
    stamps = np.array([-0.1, 0.0, 0.4, 1.0, 4.0, 4.1, 89.9, 90.0, 90.5, 91.0, 91.1])
    seen, spread = interpolated(stamps, t, pose, upper_triangles(P))
    known = [False, True, True, True, True, False, False, True, True, True, False]
    assert np.isfinite(seen).all(axis=1).tolist() == known
    assert np.isfinite(spread).all(axis=(1, 2)).tolist() == known
    np.testing.assert_allclose(seen[known], (stamps[:, None] * [1.0, 2.0, 3.0])[known])
    row_before = np.array([0.0, 0.0, 1.0, 4.0, 90.0, 90.0, 91.0])
    np.testing.assert_allclose(spread[known], np.eye(3) * (1.0 + row_before)[:, None, None])


def test_an_effect_is_widened_by_what_the_reference_may_add_or_hide() -> None:
    """Errors of 50 and 30 mm by a reference of 28 mm lie between sqrt(e^2 - s^2) and sqrt(e^2 + s^2)."""
    square = 2.0 * SIGMA**2
    least = [math.sqrt(e**2 - square) for e in (0.05, 0.03)]
    most = [math.sqrt(e**2 + square) for e in (0.05, 0.03)]
    value = math.log(0.05 / 0.03)
    found = reference().widened(Effect(value, value - 0.1, value + 0.2, 0.3), 0.05, 0.03)
    assert found.low == pytest.approx(math.log(least[0] / most[1]) - 0.1)
    assert found.high == pytest.approx(math.log(most[0] / least[1]) + 0.2)
    assert (found.value, found.expected) == (value, 0.3)
    below = reference().widened(Effect(0.0, 0.0, 0.0, None), 0.05, 0.02)  # less than the reference's own error
    assert below.high == pytest.approx(math.log(most[0] / 0.05 / 1e-3))


@pytest.mark.parametrize("shares", [False, True])
def test_the_widened_interval_has_the_true_ratio_whether_or_not_errors_are_shared(shares: bool) -> None:
    """Errors drawn anew: of an estimate of its own, or one whose error the reference halves and so shares."""
    rng = np.random.default_rng(5)
    own = rng.normal(size=(N, 2)) * 0.3
    after = rng.normal(size=(N, 2)) * 0.05
    wrong = rng.normal(size=(N, 2)) * SIGMA
    if shares:
        after = after + wrong  # what is measured is then without the error that both have
    rms = {
        "before": np.sqrt(((own - wrong) ** 2).sum(axis=1).mean()),
        "after": np.sqrt(((after - wrong) ** 2).sum(axis=1).mean()),
    }
    true = math.log(np.sqrt((own**2).sum(axis=1).mean()) / np.sqrt((after**2).sum(axis=1).mean()))
    value = math.log(rms["before"] / rms["after"])
    found = reference().widened(Effect(value, value, value, None), float(rms["before"]), float(rms["after"]))
    chance = 0.02  # where errors are shared the bound is what is expected, and so many draws miss it by this
    assert found.low - chance < true < found.high + chance
    assert found.high - found.low < 0.3


# --- a path judged by its own scans: agreement where a place is seen twice, cells that the points fall in


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
