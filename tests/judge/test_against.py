"""A reference in the place of truth: what it measures, and what its own errors leave open."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from locfuse.fusion.data import Drive, Estimates, Motions, upper_triangles
from locfuse.fusion.judge.against import Reference, interpolated
from locfuse.fusion.judge.evaluate import evaluate
from locfuse.fusion.judge.verdict import Effect

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
