"""Smoothing: against textbook RTS, a filter that carries all its past, and the truth."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
import six_sensors
import small_drive
from lock_step import simulated
from msgspec.structs import replace
from present import present
from rows import Told, correct, step
from textbook import TextbookEkf, move, numeric_jacobian, wrap
from worlds import World

import locfuse
from locfuse.fusion import fuse as loop
from locfuse.fusion.data import Array, Drive, Estimates, MapLine, Measurements, Motions, UsageError
from locfuse.fusion.ekf import events as noted_events
from locfuse.fusion.ekf.belief_arrays import JointBelief
from locfuse.fusion.ekf.events import Before, Events, undone
from locfuse.fusion.fuse import fuse
from locfuse.fusion.judge.evaluate import evaluate
from locfuse.fusion.kernels.ekf import Steps
from locfuse.fusion.robot import Robot
from locfuse.fusion.sensor import Block
from locfuse.fusion.whole_drive.smooth import MAX_WALLS, check_smoothing, fuse_and_smooth, smoothed

OFFSET = 0.7


# --- textbook Rauch-Tung-Striebel on poses alone


def textbook_rts(drive: Drive, robot: Robot, found: Estimates) -> tuple[Array, Array]:
    """Filter by the compass with plain matrices, then Särkkä, Bayesian Filtering and Smoothing, eq. 8.6."""
    start = robot.start
    P0 = np.diag([start.sigma_xy, start.sigma_xy, math.radians(start.sigma_theta_deg)]) ** 2
    book = TextbookEkf(np.array([start.x, start.y, math.radians(start.theta_deg)]), P0)
    m, audit = drive.measurements["compass"], found.audits["compass"]
    kept: list[tuple[Array, Array, Array, Array, Array]] = []
    posterior, spread = book.x.copy(), book.P.copy()
    for k in range(len(drive.t)):
        A = np.eye(3)
        book.predict(drive.motions.u[k], drive.motions.Q[k])
        A[:2, 2] = -(book.x[1] - posterior[1]), book.x[0] - posterior[0]
        kept.append((posterior, spread, A, book.x.copy(), book.P.copy()))
        for row in audit.row[(audit.instant == k) & (audit.verdict == 0)]:
            y = np.array([wrap(m.z[row, 0] - book.x[2] - OFFSET)])
            book.correct(y, np.array([[0.0, 0.0, 1.0]]), m.R[row])
        posterior, spread = book.x.copy(), book.P.copy()
    x, P = posterior, spread
    poses, covariances = [x], [P]
    for before, V, A, predicted, W in kept[:0:-1]:
        G = V @ A.T @ np.linalg.inv(W)
        x, P = before + G @ (x - predicted), V + G @ (P - W) @ G.T
        poses.append(x)
        covariances.append(P)
    return np.array(poses[::-1]), np.array(covariances[::-1])


def test_poses_alone_equal_the_textbook_smoother() -> None:
    drive, robot = World(seconds=12.0, settings={"compass": {"offset_deg": math.degrees(OFFSET)}}).measured()
    robot = replace(robot, start=type(robot.start)(x=1.5, y=1.5, sigma_xy=0.1, sigma_theta_deg=5.0))
    filtered, found = fuse_and_smooth(drive, robot, ["compass"])
    pose, P = textbook_rts(drive, robot, filtered)
    np.testing.assert_allclose(found.pose, pose, atol=1e-9)
    np.testing.assert_allclose(found.P, P, atol=1e-9)
    assert np.abs(filtered.pose - pose).max() > 1e-3, "smoothing changed nothing: the test shows nothing"


# --- a filter whose state holds every pose it ever had: its last state is the smoothed drive


class Remembering(JointBelief):
    """Clones the pose into the state before every motion; correlations do the smoothing."""

    clones: list[int]
    local: list[bool]  # whether a clone's pose was in the frame of a map of its own

    def predict(self, steps: Steps, k: int) -> None:
        if not hasattr(self, "clones"):
            self.clones, self.local = [], []
        else:
            where = self._grow(3)
            self.copy_pose(where.start)
            self.clones.append(where.start)
            self.local.append(self.framed)
        super().predict(steps, k)

    def remove(self, columns: Any) -> None:
        columns = np.asarray(columns)
        self.clones = [c - int((columns < c).sum()) for c in self.clones]
        super().remove(columns)


def remembered(drive: Drive, robot: Robot, sensors: Sequence[str]) -> tuple[Array, Array]:
    made: list[Remembering] = []

    def joint(*args: Any) -> Remembering:
        made.append(Remembering(*args))
        return made[0]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(loop, "JointBelief", joint)
        fuse(drive, robot, sensors)
    belief, poses, covariances = made[0], [], []
    for column, local in zip([*belief.clones, 0], [*belief.local, belief.framed], strict=True):
        at = list(range(column, column + 3))
        if local:
            at += range(belief.frame, belief.frame + 3)
        pose, P = in_map(belief.state[at], belief.covariance[np.ix_(at, at)])
        poses.append(pose)
        covariances.append(P)
    return np.array(poses), np.array(covariances)


def in_map(x: Array, P: Array) -> tuple[Array, Array]:
    """Return a pose, or one in a frame, in the map; what a bent Gaussian adds along the lever included."""
    if len(x) == 3:
        return x, P
    J = numeric_jacobian(lambda v: move(v[3:], v[:3]), x)
    pose = move(x[3:], x[:3])
    out = J @ P @ J.T
    out[:2, :2] += 0.75 * P[5, 5] ** 2 * np.outer(pose[:2] - x[3:5], pose[:2] - x[3:5])
    return pose, out


CASES: dict[str, dict[str, Any]] = {
    "refine": {"settings": {"lrf": {"map": "refine"}}},
    "grow": {"settings": {"lrf": {"map": "grow"}}, "turning": 0.5},
    "an offset that drifts": {"settings": {"lrf": {"map": "grow"}, "compass": {"offset_drift_deg": 0.5}}},
    "wheel parameters": {"settings": {"lrf": {"map": "grow"}}, "wheels": {"estimate": True}},
}


@pytest.mark.parametrize("case", CASES)
def test_smoothing_equals_a_filter_that_carries_all_its_past(case: str) -> None:
    drive, robot = World(**{"seconds": 6.0, **CASES[case]}).measured()
    sensors = ["compass", "lrf"]
    filtered, found = fuse_and_smooth(drive, robot, sensors)
    pose, P = remembered(drive, robot, sensors)
    np.testing.assert_allclose(found.pose, pose, atol=1e-9)
    np.testing.assert_allclose(found.P, P, atol=1e-10, rtol=1e-5)
    assert np.abs(filtered.pose - pose).max() > 1e-4


def test_walls_that_bend_are_smoothed_as_what_moves() -> None:
    """Walls that are not flat get noise with every scan (wall_floor): the events must undo that too."""
    drive, robot = World(seconds=6.0).measured()
    m = drive.measurements["lrf"]
    uneven = replace(m, extra={**m.extra, "uneven": np.broadcast_to([1e-4, 7e-5], m.z.shape)})
    bent = replace(drive, measurements={**drive.measurements, "lrf": uneven})
    filtered, found = fuse_and_smooth(bent, robot, ["lrf"])
    pose, P = remembered(bent, robot, ["lrf"])
    np.testing.assert_allclose(found.pose, pose, atol=1e-9)
    np.testing.assert_allclose(found.P, P, atol=1e-10, rtol=1e-5)
    assert np.trace(filtered.P[-1]) > 1.03 * np.trace(fuse(drive, robot, ["lrf"]).P[-1])


def test_lines_that_are_dropped_on_the_way_still_count_for_what_was_before() -> None:
    """Drops, births, slips, being carried off and corrections, straight on the beliefs."""
    rng = np.random.default_rng(4)
    block = [Block("offset", np.zeros(1), np.eye(1), np.array([0.01]))]
    start = ((0.0, 0.0, 0.0), (0.01, 0.0, 0.0, 0.01, 0.0, 0.001))
    noted, oracle, events = JointBelief(*start, block), Remembering(*start, block), Events(backward=True)
    noted.note_events(events)
    oracle_lines: list[int] = []
    lines: list[int] = []
    poses = 12
    for k in range(poses):
        u, Q = rng.normal(size=3).tolist(), (0.02, 0.001, 0.0, 0.03, 0.002, 0.01)
        for belief, columns in ((noted, lines), (oracle, oracle_lines)):
            belief.predict(step(u, Q, 0.1), 0)
            _see(belief, columns, k)
    events.final = Before(noted.state, noted.covariance)
    at = np.array([*oracle.clones, 0])[:, None] + np.arange(3)
    x, P = oracle.state[at], oracle.covariance[at[:, :, None], at[:, None, :]]
    drive = Drive(0, 0.1 * np.arange(float(poses)), still(poses), {}, {}, {})
    blocks = {"offset": np.zeros((poses, 1))}
    shell = Estimates("x", (), drive.t, np.zeros((poses, 3)), np.zeros((poses, 6)), {}, blocks)
    found = smoothed(drive, shell, events)
    np.testing.assert_allclose(found.pose, x, atol=1e-9)
    np.testing.assert_allclose(found.P, P, atol=1e-9)


def _see(belief: JointBelief, columns: list[int], k: int) -> None:
    """Sight of the lines known, then a new one, and in some steps the end of an old one."""
    rng = np.random.default_rng(k)
    for j in range(len(columns)):
        H = ((-0.6, -0.8, 0.0), (0.0, 0.0, -1.0))
        y = tuple((0.05 * rng.normal(size=2)).tolist())
        at = (columns[j], columns[j] + 1)
        correct(belief, Told(y, H, ((0.01, 0.0), (0.0, 0.02)), at, ((1, 0.3), (0, 1))))
    G = np.array([[0.6, 0.8, 0.2], [0.0, 0.0, 1.0]])
    columns.append(belief.augment(rng.normal(size=2), G, 0.02 * np.eye(2)))
    if k == 4:
        belief.shift((0.0, 0.0, 0.2), 0.01, 0.02)
    if k == 7:
        belief.place((3.0, 2.0, 1.0), 4.0, 2.0)
    if k % 3 == 2:
        gone = columns.pop(k % len(columns))
        belief.remove(np.array([gone, gone + 1]))
        columns[:] = [c - 2 if c > gone else c for c in columns]


def test_a_return_to_the_frame_of_another_submap_moves_no_smoothed_pose() -> None:
    """The robot does not move when the local frame changes: without a change the poses must be the same.

    Headings are nearly exact, since what a bent Gaussian adds along the lever depends on the frame.
    """
    found = []
    for returns in (False, True):
        rng, events = np.random.default_rng(1), Events(backward=True)
        belief = JointBelief((1.0, 2.0, 0.5), (0.01, 0.0, 0.0, 0.01, 0.0, 1e-6), [])
        belief.note_events(events)
        for k in range(8):
            belief.predict(step(rng.normal(size=3).tolist(), (0.02, 0.001, 0.0, 0.03, 0.0, 1e-6), 0.1), 0)
            if k == 2:
                belief.begin_frame()
            if k == 5 and returns:
                belief.change_frame(np.array([3.0, -2.0, 0.7]))
        events.final = Before(belief.state, belief.covariance)
        drive = Drive(0, 0.1 * np.arange(8.0), still(8), {}, {}, {})
        shell = Estimates("x", (), drive.t, np.zeros((8, 3)), np.zeros((8, 6)), {}, {})
        found.append(smoothed(drive, shell, events))
    one, other = found
    np.testing.assert_allclose(other.pose, one.pose, atol=1e-9)
    np.testing.assert_allclose(other.P, one.P, atol=1e-9)
    assert np.ptp(one.pose, axis=0).min() > 0.5


def still(n: int) -> Motions:
    return Motions(np.zeros((n, 3)), np.zeros((n, 3, 3)), np.zeros((n, 3, 0)))


# --- the truth's stamps, consistency, what must not change


def test_truth_between_instants_is_smoothed_as_if_it_were_an_instant() -> None:
    """Readings of an unused sensor at the truth's stamps make instants of them."""
    robot = small_drive.robot()
    drive = small_drive.drive(2, robot, laps=0.15)
    assert drive.truth is not None
    nothing = np.zeros(len(drive.truth.t) + 1, np.int64)
    blind = Measurements(drive.truth.t, nothing, np.zeros((0, 1)), np.zeros((0, 1, 1)), 1.0, np.zeros((1, 1)))
    wheels = drive.wheels
    t = np.union1d(drive.t, drive.truth.t)
    motions = wheels.between(np.concatenate((t[:1], t[:-1])), t, False)
    seen = {**drive.measurements, "camera": blind}
    instant = {s: np.searchsorted(t, m.t) for s, m in seen.items()}
    finer = replace(drive, t=t, motions=motions, measurements=seen, instant=instant, truth_motions=None)
    _, coarse = fuse_and_smooth(drive, robot, ["compass", "lrf"])
    _, exact = fuse_and_smooth(finer, robot, ["compass", "lrf"])
    at = np.searchsorted(t, drive.truth.t)
    pose = present(coarse.truth_pose)
    inside = np.isfinite(pose[:, 0])
    np.testing.assert_allclose(pose[inside], exact.pose[at][inside], atol=1e-8)
    np.testing.assert_allclose(present(coarse.truth_P)[inside], exact.P[at][inside], atol=1e-10)
    assert inside.sum() > 50


def test_smoothed_errors_are_smaller_and_as_large_as_the_smoother_says() -> None:
    """Three of the drives that `python -m benchmarks.accuracy --smooth --no-camera` runs by the fifty."""
    gain, anees = [], []
    for seed in (1000, 1001, 1002):
        drive, robot = simulated(seed)
        judged = [evaluate(e, drive).figures for e in fuse_and_smooth(drive, robot, ["compass", "lrf"])]
        gain.append(float(judged[0]["position_rmse_m"] or 0) / float(judged[1]["position_rmse_m"] or 1))
        anees.append(float(judged[1]["anees"] or 0))
    assert np.mean(gain) > 1.1
    assert 0.6 < np.mean(anees) < 1.7, anees


@pytest.mark.parametrize("sensors", ["gyro,twist,pose", "compass,gyro,twist,pose,landmarks"])
def test_states_that_are_copies_of_one_another_leave_every_variance_as_small_as_it_is(sensors: str) -> None:
    """A gyro keeps a heading, a twist and a pose source a pose: at an instant of all, they are the pose."""
    filtered, found = fuse_and_smooth(*six_sensors.drive(), sensors.split(","))
    variances, most = (np.diagonal(run.P, axis1=1, axis2=2) for run in (found, filtered))
    assert variances.min() >= 0.0
    assert (variances <= (1.0 + 1e-6) * most + 1e-12).all()
    assert np.sqrt(variances).max() < 0.02
    assert np.linalg.eigvalsh(found.P).min() > -1e-12


def test_a_singular_covariance_is_solved_with_the_least_solution_whatever_rounding_makes_of_it() -> None:
    """Two states that follow from each other exactly (a frame that swings about a start known exactly).

    A solver finds a pivot of 1e-17 there instead of none, and a solution of 1e16 along that direction.
    """
    rng = np.random.default_rng(3)
    F, relation = rng.normal(size=(5, 5)), np.vstack((np.eye(5), 0.7 * np.eye(5)[4]))
    P = relation @ F @ F.T @ relation.T
    B = P[:, :3] @ np.array([[1.0, 0.0, 0.3], [0.0, 1.0, -0.2], [0.0, 0.0, 1.0]])
    scale = np.sqrt(np.diagonal(P))
    least = np.linalg.lstsq(P / np.outer(scale, scale), B / scale[:, None], rcond=1e-12)[0] / scale[:, None]
    for _ in range(20):
        rounded = P * (1.0 + 3e-16 * rng.normal(size=P.shape))
        found = noted_events._solved(rounded, B)
        assert np.abs(found - least).max() < 1e-2 * np.abs(least).max()


def test_the_filter_is_the_same_whether_its_events_are_noted_or_not() -> None:
    drive, robot = World(seconds=6.0).measured()
    for sensors in ([], ["compass"], ["compass", "lrf"]):
        plain = fuse(drive, robot, sensors)
        filtered, _ = fuse_and_smooth(drive, robot, sensors)
        np.testing.assert_allclose(filtered.pose, plain.pose, rtol=0, atol=1e-11)
        np.testing.assert_allclose(filtered.P, plain.P, rtol=0, atol=1e-11)


def test_a_variance_that_rounding_took_below_zero_is_zero() -> None:
    """A frame has just begun, the robot moves straight on, and what it does sideways is known to 1e-17 m."""
    before, noise = np.diag((0.0, 0.0, 0.0, 1e-4)), np.diag((1e-6, 0.0, 1e-6))
    after = np.diag((1e-6, 0.0, 1e-6, 1e-4))
    x, x_next, rows = np.zeros(4), np.array([0.1, 0.0, 0.0, 0.0]), np.arange(3)
    right = undone(Before(x, before), Before(x_next, after), rows, noise)
    after[1, 1] = -1e-35
    with np.errstate(all="raise"):
        rounded = undone(Before(x, before), Before(x_next, after), rows, noise)
    for got, wanted in zip(rounded, right, strict=True):
        np.testing.assert_array_equal(got, wanted)


def test_odometry_is_its_own_smoother() -> None:
    drive, robot = World(seconds=5.0).measured()
    filtered, found = fuse_and_smooth(drive, robot, [])
    np.testing.assert_allclose(found.pose, filtered.pose, atol=1e-12)
    np.testing.assert_allclose(found.P, filtered.P, atol=1e-12)
    np.testing.assert_allclose(present(found.truth_pose), present(filtered.truth_pose), atol=1e-12)


@pytest.mark.parametrize("mode", ["first-scan", "consider"])
def test_maps_that_are_not_weighed_optimally_are_refused(mode: str) -> None:
    drive, robot = World(seconds=3.0, settings={"lrf": {"map": mode}}).measured()
    with pytest.raises(UsageError, match=f"lrf.map = {mode}.*refine or grow"):
        fuse_and_smooth(drive, robot, ["compass", "lrf"])
    fuse_and_smooth(drive, robot, ["compass"])


def test_too_many_walls_and_a_laser_without_a_scan_in_the_drive_are_refused() -> None:
    walls = tuple(MapLine(i, float(i), 0.0, (0.0, 1.0), 1e-6 * np.eye(2)) for i in range(MAX_WALLS + 1))
    robot = replace(World(settings={"lrf": {"map": "given"}}).robot(), lines=walls)
    check_smoothing(replace(robot, lines=walls[1:]), ["lrf"])
    check_smoothing(robot, ["compass"])
    with pytest.raises(UsageError, match=r"the given map has 301 walls, and smoothing takes at most 300; leave"):
        check_smoothing(robot, ["lrf"])
    session = locfuse.load("rounded_triangle", sets=("lrf.time_offset=3600",))
    why = r"of its 428 readings .* another clock.*lrf\.time_offset.*: 0"
    with pytest.raises(locfuse.LocfuseError, match=why):
        session.run("compass,lrf", smooth=True, advice=False)
