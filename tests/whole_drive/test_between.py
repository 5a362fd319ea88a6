"""Between two key poses the scans correct the wheels."""

import numpy as np
import pytest
from ring_drive import ring_drive

from locfuse.fusion import se2
from locfuse.fusion.data import Array
from locfuse.fusion.scan_matching.clouds import clouds_of
from locfuse.fusion.scan_matching.key_scans import spaced
from locfuse.fusion.whole_drive import between
from locfuse.fusion.whole_drive.between import (
    STEP_P,
    Fixes,
    Spans,
    bridged,
    moving_scans,
    points_of,
    scans_between,
    smoothed,
)
from locfuse.fusion.whole_drive.odometry import Odometry, odometry_of
from locfuse.fusion.whole_drive.pose_graph import KEY_TURN_RAD, KEY_WAY_M


def straight(n: int, step: float) -> Odometry:
    """Return a way of n steps along x, whose noise grows evenly."""
    pose = np.zeros((n + 1, 3))
    pose[:, 0] = step * np.arange(n + 1)
    one = np.diag([1e-6, 4e-6, 2.5e-5])
    return Odometry(pose, np.arange(n + 1.0)[:, None, None] * one)


def test_scans_between_exact_keys_take_out_a_slip_that_the_wheels_did_not_see() -> None:
    drive, truth = ring_drive(3)
    odometry = odometry_of(drive)
    scans = drive.instant["lrf"]
    readings = spaced(odometry.way()[scans], odometry.pose[scans, 2], KEY_WAY_M, KEY_TURN_RAD)
    keys = drive.instant["lrf"][readings]
    slip = np.zeros_like(odometry.pose)
    for k in keys[20:60:4] + 2:  # 6 degrees at once, just behind ten of the keys
        slip[k:, 2] += np.radians(6.0)
    u = se2.between(odometry.pose[:-1], odometry.pose[1:])
    u[:, 2] += np.diff(slip[:, 2])
    pose = np.vstack((odometry.pose[:1], np.zeros_like(u)))
    for k, motion in enumerate(u):
        pose[k + 1] = se2.compose(pose[k], motion)
    slipped = Odometry(pose, odometry.C).loosened()
    clouds = clouds_of(drive.measurements["lrf"], readings)
    P = np.tile(np.diag([1e-6, 1e-6, 1e-8]), (len(keys), 1, 1))
    span = slice(int(keys[20]), int(keys[61]))

    def heading(fixes: Fixes) -> float:
        at, _ = bridged(slipped, slipped, np.arange(len(drive.t)), keys, truth[keys], P, P[1:], fixes)
        return float(np.degrees(np.sqrt((se2.wrap_all(at[span, 2] - truth[span, 2]) ** 2).mean())))

    by_wheels = heading(Fixes.of_keys(slipped, keys, truth[keys]))
    by_scans = heading(scans_between(slipped, drive, "lrf", readings, clouds, truth[keys]))
    assert by_wheels > 2.0, "the slip does not show: the test shows nothing"
    assert by_scans < 0.5 * by_wheels


def test_one_scan_between_two_keys_weighs_as_least_squares_does() -> None:
    """The oracle is the dense joint Gaussian of the error at the scan, known at both keys."""
    odometry = straight(10, 0.05)
    x = np.array([[0.0, 0.0, 0.0], [0.5, 0.02, 0.03]])
    keys, k = np.array([0, 10]), np.array([4])
    ends = Fixes.of_keys(odometry, keys, x)
    z, L = np.array([[0.004, 0.01, -0.02]]), np.diag([1e4, 2e4, 4e5])[None]
    fixes = smoothed(odometry, ends, np.array([0]), k, z, L)
    Q1, Q2 = odometry.C[4] + STEP_P, odometry.C[10] - odometry.C[4] + STEP_P
    H = np.linalg.inv(Q1) + np.linalg.inv(Q2) + L[0]
    mean = np.linalg.solve(H, np.linalg.inv(Q2) @ ends.xi[1] + L[0] @ z[0])
    np.testing.assert_allclose(fixes.xi[1], mean, rtol=1e-3, atol=1e-6)
    np.testing.assert_allclose(fixes.rest[1], np.linalg.inv(H), rtol=1e-3, atol=1e-9)
    np.testing.assert_allclose(fixes.xi[2], ends.xi[1], atol=1e-5)


def test_a_scan_that_says_nothing_leaves_the_bridge_of_the_wheels() -> None:
    odometry = straight(10, 0.05)
    x = np.array([[0.0, 0.0, 0.0], [0.5, 0.02, 0.03]])
    keys, k = np.array([0, 10]), np.arange(11)
    ends = Fixes.of_keys(odometry, keys, x)
    P = np.tile(1e-6 * np.eye(3), (2, 1, 1))
    silent = smoothed(odometry, ends, np.array([0]), np.array([5]), np.ones((1, 3)), np.zeros((1, 3, 3)))
    plain, _ = bridged(odometry, odometry, k, keys, x, P, P[1:], ends)
    found, _ = bridged(odometry, odometry, k, keys, x, P, P[1:], silent)
    np.testing.assert_allclose(found, plain, atol=1e-4)


def test_what_is_known_at_a_fix_is_what_the_bridge_says_there() -> None:
    odometry = straight(10, 0.05)
    keys = np.array([0, 10])
    rest = np.zeros((3, 3, 3))
    rest[1] = np.diag([1e-4, 2e-4, 3e-4])
    xi = np.array([[0.0, 0.0, 0.0], [0.01, 0.02, 0.03], [0.0, 0.0, 0.0]])
    fixes = Fixes(np.zeros(3, np.int64), np.array([0, 5, 10]), xi, rest)
    k = np.array([0, 5, 7])
    at, P = fixes.at(odometry, k, Spans.of(odometry, odometry.at(k), k, keys))
    np.testing.assert_allclose(at[1], xi[1], atol=1e-9)
    np.testing.assert_allclose(P[1], rest[1], atol=1e-9)
    np.testing.assert_allclose(at[2], 0.6 * xi[1], atol=1e-4)


def test_scans_of_a_robot_that_stands_still_are_left_out() -> None:
    n = 100
    pose: Array = np.zeros((n, 3))
    pose[60:, 0] = 0.1 * np.arange(40)
    odometry = Odometry(pose, np.zeros((n, 3, 3)))
    t, instants = np.linspace(0.0, 19.8, n), np.arange(n)
    chosen = moving_scans(odometry, t, instants, np.array([0, 65, 99]))
    assert chosen.min() == 56, "one second before the robot sets out"
    assert 65 not in chosen
    assert 99 not in chosen


def test_scans_read_in_parts_are_the_same_scans(monkeypatch: pytest.MonkeyPatch) -> None:
    """But for a point here and there: what is a surface is judged by the usual spacing of all that is read."""
    drive, _ = ring_drive(3)
    m, chosen = drive.measurements["lrf"], np.arange(5, 60, 3)
    whole = points_of(m, chosen)
    monkeypatch.setattr(between, "SCANS_AT_ONCE", 4)
    parts = points_of(m, chosen)
    assert len(parts) == len(whole) == len(chosen)
    for k in range(len(chosen)):
        one, other = (c.xy[c.first[k] : c.first[k + 1]] for c in (whole, parts))
        common = {tuple(p) for p in one.tolist()} & {tuple(p) for p in other.tolist()}
        assert len(common) >= 0.95 * max(len(one), len(other))


def test_of_a_fast_laser_ten_scans_a_second_are_enough() -> None:
    n = 401
    pose: Array = np.zeros((n, 3))
    pose[:, 0] = 0.01 * np.arange(n)
    t = np.linspace(0.0, 10.0, n)  # 40 Hz
    chosen = moving_scans(Odometry(pose, np.zeros((n, 3, 3))), t, np.arange(n), np.array([0, n - 1]))
    assert np.diff(t[chosen]).min() >= 0.09
    assert len(chosen) > 95
