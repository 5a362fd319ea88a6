"""The ruler: what a consistent claim scores, at any body point, against a truth with errors of its own."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from msgspec.structs import replace
from pose_streams import reckoned
from present import present
from scipy.integrate import quad

import locfuse
from locfuse.fusion import data, se2
from locfuse.fusion.data import VERDICTS, Array, Audit, Drive, Estimates, Measurements, Truth
from locfuse.fusion.judge.evaluate import Align, evaluate, nees, noise_of, shape_error, steps_of
from locfuse.fusion.statistics import chi_square

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
    return beside(t, pose, P, truth)


def beside(t: Array, pose: Array, P: Array, truth: Truth, after: float = 0.0) -> tuple[Estimates, Drive]:
    """Estimates (n, 3) at the stamps of a truth, and the drive, which goes on for `after` [s] without it."""
    n = len(t)
    motions = data.Motions(np.zeros((n, 3)), np.zeros((n, 3, 3)), np.zeros((n, 3, 0)))
    drive = Drive(0, np.append(t, t[-1] + after) if after else t, motions, {}, {}, {}, truth)
    return Estimates("all", (), t, pose, data.upper_triangles(P), {}, truth_pose=pose, truth_P=P), drive


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
    truth = present(drive.truth)
    assert truth.theta is not None
    noise = np.random.default_rng(5).normal(0.0, 0.05, N)
    noisy = replace(truth, theta=truth.theta + noise)
    unknown = present(evaluate(estimates, replace(drive, truth=noisy)).figures["anees"])
    assert unknown > 1.5
    known = replace(noisy, sigma_theta=0.05)
    assert evaluate(estimates, replace(drive, truth=known)).figures["anees"] == pytest.approx(1.0, abs=0.05)


MOVE = np.array([3.0, -7.0, 2.1])


@pytest.mark.parametrize("align", ["origin", "se2"])
@pytest.mark.parametrize("point", POINTS)
def test_an_estimate_in_another_frame_is_moved_onto_the_truth(align: Align, point: tuple[float, float]) -> None:
    estimates, drive = exact(point)
    moved = se2.compose(np.broadcast_to(MOVE, estimates.pose.shape), estimates.pose)
    found = evaluate(replace(estimates, pose=moved, truth_pose=moved), drive, align)
    assert np.abs(found.deviation).max() < 1e-9


@pytest.mark.parametrize("align", ["origin", "se2"])
def test_the_claim_turns_with_the_estimate_that_is_aligned(align: Align) -> None:
    """A start turned by 90 degrees: once aligned, sigma in x and y are those of the right start, not swapped."""

    def sigma(start_deg: float, how: Align) -> Array:
        session = locfuse.load("rounded_rectangle", sets={"start.theta_deg": start_deg})
        return session.run("odometry", align=how, advice=False).evaluations["odometry"].sigma

    right, turned = sigma(3.5, "none"), sigma(93.5, align)
    half = len(right) // 2
    assert right[half, 0] > 1.5 * right[half, 1]
    np.testing.assert_allclose(turned[half:], right[half:], rtol=0.15)


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
    assert estimates.truth_pose is not None
    for n, error in ((0, None), (1, pytest.approx(0.0, abs=1e-12))):  # stamps that lie in the drive
        known = np.where(np.arange(N)[:, None] < n, estimates.truth_pose, np.nan)
        assert shape_error(replace(estimates, truth_pose=known), drive) == error


def exact(point: tuple[float, float]) -> tuple[Estimates, Drive]:
    """Estimates that are the truth."""
    estimates, drive = judged(point, 0.0)
    truth = present(drive.truth)
    theta = present(truth.theta)
    turned = np.column_stack((np.zeros((N, 2)), theta))
    pose = np.column_stack((truth.xy - se2.transform(turned, np.broadcast_to(point, (N, 2))), theta))
    return replace(estimates, pose=pose, truth_pose=pose), drive


# --- every figure of a short drive, written out


def wandering(heading: bool, n: int = 90, gap: int | None = None) -> tuple[Estimates, Drive]:
    """A robot on a winding path of about 18 m, and an estimate that drifts; the truth may have a hole."""
    rng = np.random.default_rng(8)
    t: Any = 7.0 + 0.25 * np.arange(n)
    if gap is not None:
        t[gap:] += 40.0
    i = np.arange(n - 1.0)  # smooth, so that nothing of it is taken for noise of the truth
    steps = np.column_stack((0.2 + 0.1 * np.sin(0.3 * i), np.zeros(n - 1), 0.15 * np.sin(0.2 * i + 1.0)))
    true = se2.chained(np.array([3.0, -2.0, 0.5]), steps)
    true = np.vstack(([3.0, -2.0, 0.5], true))
    pose = true + np.cumsum(rng.normal(0.0, 0.02, (n, 3)), axis=0)
    truth = Truth("/truth", t, true[:, :2], true[:, 2] if heading else None, (0.0, 0.0), 0.0)
    return beside(t, pose, np.broadcast_to(claimed(), (n, 3, 3)), truth, 5.0)


def matrix(pose: Array) -> Array:
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return np.array([[c, -s, pose[0]], [s, c, pose[1]], [0.0, 0.0, 1.0]])


@pytest.mark.parametrize("gap", [None, 40])
@pytest.mark.parametrize("heading", [True, False])
def test_drift_is_the_error_of_the_way_from_here_to_so_many_metres_on(heading: bool, gap: int | None) -> None:
    """Of the relative pose, by matrices; of the displacement without a heading; never over a hole in the truth."""
    estimates, drive = wandering(heading, gap=gap)
    assert drive.truth is not None
    xy, pose = drive.truth.xy, estimates.pose
    figures = evaluate(estimates, drive).figures
    piece = np.zeros(len(xy)) if gap is None else (np.arange(len(xy)) >= gap).astype(float)
    jumps = np.hypot(*np.diff(xy, axis=0).T) * (np.diff(piece) == 0.0)
    way = np.append(0.0, np.cumsum(jumps))
    for length in (1, 5, 10):
        errors = []
        for i in range(len(xy)):
            ahead = np.flatnonzero(way >= way[i] + length)
            if not len(ahead) or piece[ahead[0]] != piece[i]:
                continue
            at = (ahead[0] - 1, ahead[0])  # between these two stamps the length ends
            end, true_end = (
                np.array([np.interp(way[i] + length, way[list(at)], c[list(at)]) for c in p.T])
                for p in (pose[:, :2], xy)
            )
            if drive.truth.theta is None:
                errors.append((end - pose[i, :2]) - (true_end - xy[i]))
                continue
            true = np.column_stack((xy, drive.truth.theta))
            ours, theirs = (np.linalg.solve(matrix(p[i]), [*e, 1.0]) for p, e in ((pose, end), (true, true_end)))
            errors.append((ours - theirs)[:2])
        expected = float(np.hypot(*np.array(errors).T).mean()) / length if errors else None
        assert figures[f"drift_{length}m"] == (None if expected is None else pytest.approx(expected, rel=1e-5))
    assert figures["drift_5m"] is not None


@pytest.mark.parametrize("heading", [True, False])
def test_errors_along_and_across_are_by_the_way_the_robot_goes(heading: bool) -> None:
    estimates, drive = wandering(heading)
    assert drive.truth is not None
    xy, found = drive.truth.xy, evaluate(estimates, drive)
    tangent = np.gradient(xy[:, 0]) + 1j * np.gradient(xy[:, 1])
    way = np.exp(1j * drive.truth.theta) if drive.truth.theta is not None else tangent / np.abs(tangent)
    error = estimates.pose[:, :2] - xy
    turned = (error[:, 0] + 1j * error[:, 1]) / way
    np.testing.assert_allclose(found.along_cross, np.column_stack((turned.real, turned.imag)), atol=1e-6)
    assert found.figures["cross_rmse_m"] == pytest.approx(float(np.sqrt(np.mean(turned.imag**2))))
    apart = np.abs(turned)
    for name, expected in (("max", apart.max()), ("mean", apart.mean()), ("median", np.median(apart))):
        assert found.figures[f"position_{name}_m"] == pytest.approx(float(expected))
    assert found.figures["final_position_error_m"] == pytest.approx(float(apart[-1]))


@pytest.mark.parametrize("away", [False, True])
def test_without_a_truth_in_the_drive_columns_are_empty_and_figures_none(away: bool) -> None:
    estimates, drive = wandering(True)
    if away:  # a truth that was recorded before the drive began
        assert estimates.truth_pose is not None
        never = np.full_like(estimates.truth_pose, np.nan)
        found = evaluate(replace(estimates, truth_pose=never), drive)
    else:
        found = evaluate(estimates, replace(drive, truth=None))
    names = ("t", "deviation", "along_cross", "sigma", "nees", "distance", "estimate_xy")
    assert [getattr(found, name).shape for name in names] == [(0,), (0, 2), (0, 2), (0, 3), (0,), (0,), (0, 2)]
    assert found.heading is None
    assert {name for name, value in found.figures.items() if value is not None} == {"duration_s", "distance_m"}
    assert found.figures.keys() == evaluate(estimates, drive).figures.keys()


def test_readings_are_counted_by_their_verdicts_and_the_mean_nis_is_of_those_accepted() -> None:
    estimates, drive = wandering(True)
    names = ["accepted"] * 3 + ["gate"] * 2 + ["new"] + ["repeated"] + ["ambiguous"]
    verdict = np.array([VERDICTS.index(v) for v in names], np.int8)
    n = len(verdict)
    nis = np.array([1.0, 2.0, 6.0, 50.0, 60.0, 0.0, 0.0, 3.0])
    joint = np.array([[3.0, 4.0], [9.0, 6.0]])
    audit = Audit(
        np.arange(n),
        np.arange(n),
        verdict,
        np.full(n, -1),
        nis,
        np.full(n, 9.2),
        np.zeros((n, 2)),
        np.ones((n, 2)),
        joint,
    )
    first, zeros = np.array([0, *range(9), 8]), np.zeros((8, 2))
    m = Measurements(np.arange(10.0), first, zeros, np.ones((8, 2, 2)), 1.0, np.zeros((2, 2)))
    found = evaluate(replace(estimates, audits={"lrf": audit}), replace(drive, measurements={"lrf": m})).sensors
    figures = found["lrf"]
    assert (figures.accepted, figures.rejected) == (3, 3)
    assert figures.nis == pytest.approx(3.0 / 2.0)
    assert figures.joint_nis == pytest.approx(12.0 / 10.0)
    assert figures.verdicts == {"accepted": 3, "gate": 2, "new": 1, "repeated": 1, "ambiguous": 1}


# --- nEES of many errors, against a solver of linear equations


@pytest.mark.parametrize("d", [2, 3])
def test_it_is_the_error_in_units_of_what_was_claimed(d: int) -> None:
    rng = np.random.default_rng(d)
    root, e = rng.normal(size=(50, d, d)) * rng.uniform(1e-3, 10.0, (50, 1, 1)), rng.normal(size=(50, d))
    S = root @ root.transpose(0, 2, 1)
    expected = np.einsum("ni,ni->n", e, np.linalg.solve(S, e[:, :, None])[:, :, 0]) / d
    np.testing.assert_allclose(nees(e, S), expected, rtol=1e-6)


def test_a_singular_covariance_judges_nothing() -> None:
    line = np.array([1.0, 2.0, -1.0])
    singular = [np.zeros((3, 3)), np.outer(line, line), np.diag([1.0, 1.0, 1e-13]), np.diag([1.0, -1.0, 1.0])]
    turned = np.array([[1e-13, 1.0, 0.0], [-1.0, 1e-13, 1.0], [0.0, 1.0, 1.0]])
    singular.append(turned @ np.diag([1.0, 1e-13, 1.0]) @ turned.T)  # no single variance shows it
    no_number = np.eye(3)
    no_number[1, 1] = np.nan
    S = np.array([*singular, no_number, np.diag([1.0, 1.0, 1e-11])])
    assert np.isfinite(nees(np.ones((7, 3)), S)).tolist() == [False] * 6 + [True]


# --- the quantiles of chi-square are those of the integral of its density


@pytest.mark.parametrize("dof", [1, 2, 3, 4, 10, 61, 299])
@pytest.mark.parametrize("confidence", [0.025, 0.5, 0.975, 0.9999, 0.99999])
def test_a_quantile_leaves_its_confidence_below(confidence: float, dof: int) -> None:
    def density(x: float) -> float:
        scale = 0.5 * dof * math.log(2.0) + math.lgamma(0.5 * dof)
        return math.exp((0.5 * dof - 1.0) * math.log(x) - 0.5 * x - scale)

    limit = chi_square(confidence, dof)
    above = quad(density, limit, limit + 200.0 + 10.0 * dof, limit=400, points=[limit + 5.0, limit + 20.0])[0]
    assert above == pytest.approx(1.0 - confidence, rel=1e-6)


# --- the path of the truth: length, directions and drift do not depend on how often and exactly it was recorded


FINE_S = 1e-3  # s: the true path in steps of 1 ms
DURATION_S = 60.0
T: Array = np.linspace(0.0, DURATION_S, round(DURATION_S / FINE_S) + 1)


def driven(speed: Array, turn: Array) -> Array:
    """True poses (n, 3) of a robot at T with this speed [m/s] and turn rate [rad/s]."""
    return reckoned(np.column_stack((speed, turn))[:-1] * FINE_S)


def recorded(pose: Array, hz: float, noise_m: float, seed: int = 1) -> tuple[Array, Array]:
    """Stamps (q,) and noisy places (q, 2) of a tracker that sees the robot `hz` times a second."""
    at = np.unique(np.round(np.arange(0.0, DURATION_S, 1.0 / hz) / FINE_S).astype(int))
    return T[at], pose[at, :2] + np.random.default_rng(seed).normal(0.0, noise_m, (len(at), 2))


def way(t: Array, xy: Array) -> float:
    return float(np.hypot(*steps_of(t, xy, np.zeros(len(t), np.int64)).T).sum())


STOPS = np.where((T > 20.0) & (T < 25.0), 0.0, 1.0)  # the robot stands for five seconds
WINDING = 0.8 * np.sin(0.4 * T) + 0.3 * np.cos(1.1 * T)


@settings(max_examples=30, deadline=None)
@given(
    hz=st.floats(5.0, 250.0),
    noise=st.floats(0.0, 0.005),
    speed=st.floats(0.3, 1.5),
    seed=st.integers(0, 10**6),
    heading=st.booleans(),
)
def test_length_and_drift_are_true(hz: float, noise: float, speed: float, seed: int, heading: bool) -> None:
    """Oracle: the true path in steps of 1 ms, and the error of an odometry 15 % long that turns 2 % too far."""
    pose = driven(speed * STOPS * (1.0 + 0.3 * np.sin(0.9 * T)), WINDING)
    estimate = driven(1.15 * speed * STOPS * (1.0 + 0.3 * np.sin(0.9 * T)), 1.02 * WINDING)
    gone = np.append(0.0, np.cumsum(np.hypot(*np.diff(pose[:, :2], axis=0).T)))
    t, xy = recorded(pose, hz, noise, seed)
    at = np.round(t / FINE_S).astype(int)
    truth = Truth("/truth", t, xy, pose[at, 2] if heading else None, (0.0, 0.0), 0.0)
    P = np.broadcast_to(1e-4 * np.eye(3), (len(t), 3, 3))
    found = evaluate(*beside(t, estimate[at], P, truth))
    assert found.distance[-1] == pytest.approx(gone[-1], rel=0.02)
    for length in (1, 5):
        start = np.arange(0, len(T), 20)
        start = start[gone[start] + length < gone[-1]]
        end = np.searchsorted(gone, gone[start] + length)
        if heading:
            ours, theirs = (se2.between(p[start], p[end])[:, :2] for p in (estimate, pose))
        else:
            ours, theirs = (p[end, :2] - p[start, :2] for p in (estimate, pose))
        expected = float(np.hypot(*(ours - theirs).T).mean()) / length
        # 5 mm of noise at 5 Hz: over 5 m, of 120 drives 118 are within 2 %, the others within 2.7 %
        assert found.figures[f"drift_{length}m"] == pytest.approx(expected, rel={1: 0.02, 5: 0.04}[length])


@pytest.mark.parametrize("hz", [5.0, 10.0, 100.0, 250.0])
@pytest.mark.parametrize("noise", [0.0005, 0.002, 0.005, 0.03])
def test_a_robot_that_stands_for_a_minute_goes_nowhere(noise: float, hz: float) -> None:
    """As recorded its steps add up: to 21 m for 2 mm at 100 Hz."""
    t, xy = recorded(driven(np.zeros_like(T), np.zeros_like(T)), hz, noise)
    assert np.hypot(*np.diff(xy, axis=0).T).sum() > 500.0 * noise
    assert way(t, xy) < 0.01


@pytest.mark.parametrize("noise", [0.001, 0.005])
def test_a_tracker_that_repeats_readings_or_whose_noise_lasts_is_seen_through(noise: float) -> None:
    """Each reading of a 25 Hz tracker five times in a log of 125 Hz; and noise through a filter of 40 ms."""
    standing = driven(np.zeros_like(T), np.zeros_like(T))
    _, xy = recorded(standing, 25.0, noise)
    t: Array = np.linspace(0.0, len(xy) / 25.0, 5 * len(xy))
    assert way(t, np.repeat(xy, 5, axis=0)) < 0.01
    t, xy = recorded(standing, 250.0, noise)
    slow = np.stack([np.convolve(c, np.full(10, 0.1), "same") for c in xy.T], axis=-1)
    assert way(t, slow) < 0.01


@pytest.mark.parametrize("even", [True, False])
def test_the_noise_of_a_moving_truth_is_found(even: bool) -> None:
    pose = driven(0.5 * STOPS, WINDING)
    rng = np.random.default_rng(2)
    at = np.arange(0, len(T), 10) if even else np.sort(rng.choice(len(T), 6000, replace=False))
    for sigma in (0.0005, 0.002, 0.02):
        xy = pose[at, :2] + rng.normal(0.0, sigma, (len(at), 2))
        assert noise_of(T[at], xy, np.zeros(len(at), np.int64)) == pytest.approx(sigma, rel=0.1)


def test_a_smooth_path_has_no_noise_and_a_truth_slower_than_turns_is_as_it_is() -> None:
    """A polynomial of degree 4, and a hole in the truth: what it jumps there is no noise."""
    t = np.sort(np.random.default_rng(3).uniform(0.0, 30.0, 300))
    xy = np.column_stack((t**4 / 1e4 - t**2, t**3 / 100.0 + 5.0 * t))
    assert noise_of(t, xy, np.zeros(300, np.int64)) < 1e-9
    pieces = np.repeat(np.arange(43), 7)[:300]
    xy += 100.0 * np.random.default_rng(4).normal(size=(43, 2))[pieces]
    assert noise_of(t, xy, pieces) < 1e-9
    t = np.linspace(0.0, 78.0, 40)  # one reading every 2 s: a corner is no noise
    xy = np.cumsum(np.random.default_rng(6).normal(0.0, 1.0, (40, 2)), axis=0)
    assert way(t, xy) == pytest.approx(float(np.hypot(*np.diff(xy, axis=0).T).sum()))
