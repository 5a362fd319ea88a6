"""The ruler: what a consistent claim scores, at any body point, against a truth with errors of its own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from locfuse.fusion import se2
from locfuse.fusion.data import Drive, Estimates, Motions, Truth, upper_triangles
from locfuse.fusion.judge.evaluate import Align, evaluate, shape_error

Array = NDArray[np.float64]
N = 6000
POINTS = [(0.0, 0.0), (0.5, 0.0), (0.0, 0.5), (-0.3, 0.4), (0.3, -0.6)]


def claimed() -> Array:
    """Covariance (3, 3) of a pose whose heading and place go together [m^2, m rad, rad^2]."""
    A = np.array([[0.01, 0.0, 0.0], [0.004, 0.006, 0.0], [0.02, -0.015, 0.03]])
    return np.asarray(A @ A.T, np.float64)


def judged(point: tuple[float, float], truth_sigma: float, heading: bool = True) -> tuple[Estimates, Drive]:
    """Estimates whose errors are drawn from the covariance they claim, at headings all round."""
    rng = np.random.default_rng(4)
    t = np.linspace(0.0, 0.1 * N, N)
    true = np.column_stack((rng.uniform(-5.0, 5.0, (N, 2)), rng.uniform(-np.pi, np.pi, N)))
    P = np.broadcast_to(claimed(), (N, 3, 3))
    pose = np.asarray(true + rng.multivariate_normal(np.zeros(3), claimed(), N), np.float64)
    xy = se2.transform(true, np.broadcast_to(np.array(point), (N, 2))) + truth_sigma * rng.normal(size=(N, 2))
    truth = Truth("/truth", t, xy, true[:, 2] if heading else None, point, truth_sigma)
    motions = Motions(np.zeros((N, 3)), np.zeros((N, 3, 3)), np.zeros((N, 3, 0)))
    drive = Drive(0, t, motions, {}, {}, {}, truth)
    return Estimates("all", (), t, pose, upper_triangles(P), {}, truth_pose=pose, truth_P=P), drive


@pytest.mark.parametrize("point", POINTS)
@pytest.mark.parametrize("truth_sigma", [0.0, 0.02])
@pytest.mark.parametrize("heading", [True, False])
def test_a_consistent_claim_scores_one(point: tuple[float, float], truth_sigma: float, heading: bool) -> None:
    """ANEES of errors drawn from the claim is 1 (by chi-square within 0.04 at 3 sigma for 6000 samples)."""
    anees = evaluate(*judged(point, truth_sigma, heading)).figures["anees"]
    assert anees == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize("point", POINTS)
def test_the_claimed_sigma_is_that_of_the_tracked_point(point: tuple[float, float]) -> None:
    """Against the spread of the point itself, at one heading after the other."""
    found = evaluate(*judged(point, 0.0))
    ratio = found.deviation / found.sigma[:, :2]
    assert ratio.std(axis=0) == pytest.approx([1.0, 1.0], abs=0.04)
    quadrant = np.floor(judged(point, 0.0)[0].pose[:, 2] / (np.pi / 2.0))
    for q in np.unique(quadrant)[1:-1]:
        assert ratio[quadrant == q].std(axis=0) == pytest.approx([1.0, 1.0], abs=0.1)


def test_the_noise_of_the_truths_heading_counts() -> None:
    estimates, drive = judged((0.0, 0.0), 0.0)
    truth = drive.truth
    assert truth is not None
    assert truth.theta is not None
    noise = np.random.default_rng(5).normal(0.0, 0.05, N)
    noisy = replace(truth, theta=truth.theta + noise)
    unknown = evaluate(estimates, replace(drive, truth=noisy)).figures["anees"]
    assert unknown is not None
    assert unknown > 1.5
    known = replace(noisy, sigma_theta=0.05)
    assert evaluate(estimates, replace(drive, truth=known)).figures["anees"] == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize("wrong", [0.5, 2.0])
def test_a_claim_that_is_wrong_by_a_factor_scores_its_square(wrong: float) -> None:
    estimates, drive = judged((0.2, 0.3), 0.0)
    assert estimates.truth_P is not None
    found = evaluate(Estimates(**{**vars(estimates), "truth_P": estimates.truth_P * wrong**2}), drive)
    assert found.figures["anees"] == pytest.approx(1.0 / wrong**2, rel=0.05)


MOVE = np.array([3.0, -7.0, 2.1])


@pytest.mark.parametrize("align", ["origin", "se2"])
@pytest.mark.parametrize("point", POINTS)
def test_an_estimate_in_another_frame_is_moved_onto_the_truth(align: Align, point: tuple[float, float]) -> None:
    estimates, drive = exact(point)
    moved = se2.compose(np.broadcast_to(MOVE, estimates.pose.shape), estimates.pose)
    found = evaluate(replace(estimates, pose=moved, truth_pose=moved), drive, align)
    assert np.abs(found.deviation).max() < 1e-9


def test_the_least_squares_alignment_is_that_of_evo() -> None:
    """An estimate that drifts, so that nothing fits exactly; evo aligns in space, and all lies in a plane."""
    from evo.core.geometry import umeyama_alignment

    estimates, drive = exact((0.0, 0.0))
    assert drive.truth is not None
    bent = se2.compose(np.broadcast_to(MOVE, estimates.pose.shape), estimates.pose)
    bent[:, :2] += 1e-3 * np.arange(N)[:, None] * np.array([1.0, 0.3])
    found = evaluate(replace(estimates, pose=bent, truth_pose=bent), drive, "se2")
    flat = np.zeros((N, 1))
    theirs, ours = np.hstack((bent[:, :2], flat)).T, np.hstack((drive.truth.xy, flat)).T
    R, t, _ = umeyama_alignment(theirs, ours)
    oracle = np.linalg.norm(ours - (R @ theirs + t[:, None]), axis=0)
    error = pytest.approx(float(np.sqrt((oracle**2).mean())), rel=1e-9)
    assert found.figures["position_rmse_m"] == error
    assert shape_error(replace(estimates, pose=bent, truth_pose=bent), drive) == error


def test_there_is_no_error_of_the_shape_without_truth() -> None:
    estimates, drive = exact((0.0, 0.0))
    assert shape_error(estimates, replace(drive, truth=None)) is None


def exact(point: tuple[float, float]) -> tuple[Estimates, Drive]:
    """Estimates that are the truth."""
    estimates, drive = judged(point, 0.0)
    assert drive.truth is not None
    assert drive.truth.theta is not None
    back = se2.transform(
        np.column_stack((np.zeros((N, 2)), drive.truth.theta)), np.broadcast_to(np.array(point), (N, 2))
    )
    pose = np.column_stack((drive.truth.xy - back, drive.truth.theta))
    return replace(estimates, pose=pose, truth_pose=pose), drive


def test_a_drive_lasts_from_its_first_instant_to_its_last_and_is_as_long_as_its_steps() -> None:
    estimates, drive = exact((0.0, 0.0))
    figures = evaluate(estimates, drive).figures
    assert figures["duration_s"] == pytest.approx(0.1 * N)
    steps = np.diff(estimates.pose[:, :2], axis=0)
    assert figures["distance_m"] == pytest.approx(float(np.sqrt((steps**2).sum(axis=1)).sum()), rel=1e-12)
