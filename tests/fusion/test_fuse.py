"""The loop: against a textbook filter, closed forms, and itself under changes that must not matter."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace
from textbook import TextbookEkf, move, numeric_jacobian, wrap
from worlds import World

from locfuse.fusion.data import VERDICTS, Drive, Estimates, MapLine
from locfuse.fusion.fuse import fuse
from locfuse.fusion.judge.evaluate import evaluate
from locfuse.fusion.measure import measure
from locfuse.fusion.robot import Robot

FROZEN: dict[str, dict[str, Any]] = {"lrf": {"map": "first-scan"}, "compass": {"offset_deg": math.degrees(0.7)}}


def drive_of(world: World) -> tuple[Drive, Robot]:
    robot = world.robot()
    return measure(world.streams(), robot), robot


def textbook(drive: Drive, robot: Robot, found: Estimates) -> tuple[np.ndarray, np.ndarray]:
    """Redo a frozen-map run from the audit's matches with plain matrices; only the matching is taken over.

    The state is (q, G): the pose in the frame that begins at the first scan, and where that frame lies in the map.
    """
    start = robot.start
    book = TextbookEkf(np.array([0, 0, 0, start.x, start.y, math.radians(start.theta_deg)]), np.zeros((6, 6)))
    book.x[:3], book.x[3:] = book.x[3:].copy(), 0.0  # until the first scan the frame is the map
    lines: dict[int, tuple[float, float, np.ndarray]] = {}
    lrf, compass = drive.measurements["lrf"], drive.measurements["compass"]
    poses, covariances = [], []
    for k in range(len(drive.t)):
        book.predict(drive.motions.u[k], drive.motions.Q[k])
        first_scan = k == drive.instant["lrf"][0]
        if first_scan:
            book.x = np.concatenate((np.zeros(3), book.x[:3]))
            P = book.P[:3, :3].copy()
            book.P = np.zeros((6, 6))
            book.P[3:, 3:] = P
        y: list[float] = []
        H: list[list[float]] = []
        R: list[np.ndarray] = []
        a = found.audits["compass"]
        for row in a.row[(a.instant == k) & (a.verdict == 0)]:
            y += [wrap(compass.z[row, 0] - book.x[2] - book.x[5] - 0.7)]
            H += [[0, 0, 1, 0, 0, 1]]
            R += [compass.R[row]]
        a = found.audits["lrf"]
        for i in np.flatnonzero((a.instant == k) & (a.verdict == 0)):
            (rho, beta, P), (r, psi), noise = lines[int(a.landmark[i])], lrf.z[a.row[i]], lrf.R[a.row[i]].copy()
            c, s = math.cos(beta), math.sin(beta)
            if abs(wrap(psi - beta + book.x[2])) > math.pi / 2:
                r, psi, noise[0, 1], noise[1, 0] = -r, psi + math.pi, -noise[0, 1], -noise[1, 0]
            M = np.array([[1, book.x[0] * s - book.x[1] * c], [0, 1]])
            y += [r - (rho - book.x[0] * c - book.x[1] * s), wrap(psi - (beta - book.x[2]))]
            H += [[-c, -s, 0, 0, 0, 0], [0, 0, -1, 0, 0, 0]]
            R += [noise + M @ P @ M.T]
        if y:
            corrected(book, np.array(y), np.array(H, float), R)
        if first_scan:
            lines = {line.id: seen_from(book.x[3:], line) for line in found.first_map}
        pose, P = placed(book.x, book.P)
        poses.append(pose)
        covariances.append(P)
    return np.array(poses), np.array(covariances)


def corrected(book: TextbookEkf, y: np.ndarray, H: np.ndarray, R: list[np.ndarray]) -> None:
    """Correct by everything of one instant; then the uncertainty of the frame's place follows its correction."""
    full, at = np.zeros((len(y), len(y))), 0
    for block in R:
        full[at : at + len(block), at : at + len(block)] = block
        at += len(block)
    assert at == len(y)
    before = book.x.copy()
    book.correct(y, H, full)
    T = np.eye(6)
    T[3, 5], T[4, 5] = before[4] - book.x[4], book.x[3] - before[3]
    book.P = T @ book.P @ T.T


def seen_from(G: np.ndarray, line: MapLine) -> tuple[float, float, np.ndarray]:
    """Return (rho, beta) of a line of the map in the frame G, and their covariance."""
    c, s = math.cos(line.beta), math.sin(line.beta)
    M = np.array([[1, G[0] * s - G[1] * c], [0, 1]])
    return line.rho - G[0] * c - G[1] * s, line.beta - G[2], M @ line.P @ M.T


def placed(x: np.ndarray, P: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return G o q with its covariance: by finite differences, and what a Gaussian heading does to a lever."""

    def pose(x: np.ndarray) -> np.ndarray:
        return move(x[3:], x[:3])

    J = numeric_jacobian(pose, x)
    r = (pose(x) - x[3:])[:2]
    angle = np.linspace(-8, 8, 4001)
    weight = np.exp(-0.5 * angle**2)
    along = float((weight * (np.cos(angle * math.sqrt(P[5, 5])) - 1) ** 2).sum() / weight.sum())
    out = J @ P @ J.T
    out[:2, :2] += along * np.outer(r, r)
    return pose(x), out


def test_the_filter_equals_the_textbook_over_a_whole_drive() -> None:
    drive, robot = drive_of(World(settings=FROZEN))
    found = fuse(drive, robot, ["compass", "lrf"])
    assert (found.audits["lrf"].verdict == 0).sum() > 500
    pose, P = textbook(drive, robot, found)
    np.testing.assert_allclose(found.pose, pose, atol=1e-9)
    np.testing.assert_allclose(found.P, P, atol=1e-8)


@pytest.mark.parametrize("mode", ["first-scan", "consider", "refine", "grow"])
def test_every_map_mode_beats_odometry_and_stays_positive(mode: str) -> None:
    drive, robot = drive_of(World(settings={"lrf": {"map": mode}}, seed=3))
    odometry = evaluate(fuse(drive, robot, []), drive)
    lrf = evaluate(fuse(drive, robot, ["lrf"]), drive)
    assert (lrf.figures["position_rmse_m"] or math.inf) < 0.5 * (odometry.figures["position_rmse_m"] or 0.0)
    P = fuse(drive, robot, ["lrf"]).P[1:]
    # NumPy finds an eigenvalue of zero to within the rounding of the largest
    assert (np.linalg.eigvalsh(P)[:, 0] > -np.finfo(float).eps * np.linalg.norm(P, 2, axis=(1, 2))).all()


def test_a_truth_moved_by_half_a_period_changes_no_error_figure_on_an_arc() -> None:
    """With noise-free wheels the estimate is the arc itself, so any change would come from interpolation."""
    figures = []
    for shift in (0.0, 0.02, 0.013):
        drive, robot = drive_of(World(truth_shift=shift, wheel_noise=0.0))
        figures.append(evaluate(fuse(drive, robot, []), drive).figures)
    for key in ("position_rmse_m", "position_max_m", "heading_rmse_deg", "along_rmse_m", "cross_rmse_m"):
        for other in figures[1:]:
            assert other[key] == pytest.approx(figures[0][key], abs=1e-6)


def test_truth_changes_no_estimate() -> None:
    world = World()
    robot, streams = world.robot(), world.streams()
    with_truth = fuse(measure(streams, robot), robot, ["compass", "lrf"])
    del streams["truth"]
    without = fuse(measure(streams, robot), robot, ["compass", "lrf"])
    np.testing.assert_array_equal(with_truth.pose, without.pose)
    np.testing.assert_array_equal(with_truth.P, without.P)


def test_a_sensor_that_is_present_but_unused_changes_nothing_for_another() -> None:
    """Instants are cut at every sensor in the log, whatever is used: configurations share their clock."""
    drive, robot = drive_of(World())
    alone = fuse(drive, robot, ["lrf"])
    assert alone.t is drive.t
    assert fuse(drive, robot, []).t is drive.t
    again = fuse(drive, robot, ["lrf"])
    np.testing.assert_array_equal(alone.pose, again.pose)


def test_readings_outside_the_wheels_are_counted_and_not_used() -> None:
    world = World()
    streams = world.streams()
    compass = streams["compass"]
    late = replace(compass, t_ns=compass.t_ns + 5_000_000_000)
    drive = measure({**streams, "compass": late}, world.robot())
    outside = int((late.t_ns > streams["wheels"].t_ns[-1]).sum())
    assert outside > 0
    assert drive.dropped["compass"]["outside_wheels"] == outside
    assert drive.t[-1] == pytest.approx(world.seconds)


def test_a_gap_in_a_sensor_equals_a_run_with_that_sensor_masked_there() -> None:
    world = World()
    streams, robot = world.streams(), world.robot()
    scans = streams["lrf"]
    t = (scans.t_ns - scans.t_ns[0]) * 1e-9
    keep = np.flatnonzero((t < 6) | (t > 10))
    columns: Any = scans.data
    ranges = columns["ranges"].matrix()
    from locfuse.fusion.data import Ragged

    data = {k: v[keep] for k, v in columns.items() if k != "ranges"}
    data["ranges"] = Ragged(ranges[keep].ravel(), np.arange(len(keep) + 1) * ranges.shape[1])
    gap = replace(scans, t_ns=scans.t_ns[keep], data=data)
    with_gap = measure({**streams, "lrf": gap}, robot)
    whole = measure(streams, robot)
    masked = replace(
        whole,
        measurements={**whole.measurements, "lrf": whole.measurements["lrf"].take(keep)},
        instant={**whole.instant, "lrf": whole.instant["lrf"][keep]},
    )
    a, b = fuse(with_gap, robot, ["lrf"]), fuse(masked, robot, ["lrf"])
    common = np.isin(b.t, a.t)
    np.testing.assert_allclose(a.pose[np.isin(a.t, b.t)], b.pose[common], atol=1e-9)
    in_gap = (b.t > scans.t_ns[0] * 0 + 6.1) & (b.t < 9.9)
    assert (np.diff(b.P[in_gap, 2, 2]) > 0).all()


def test_verdicts_are_complete() -> None:
    drive, robot = drive_of(World())
    found = fuse(drive, robot, ["compass", "lrf"])
    for sensor, audit in found.audits.items():
        assert len(audit.row) == len(drive.measurements[sensor].z)
        assert set(np.unique(audit.verdict)) <= set(range(len(VERDICTS)))
