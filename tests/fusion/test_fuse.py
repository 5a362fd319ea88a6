"""The loop: against a textbook filter, closed forms, and itself under changes that must not matter."""

import math
import sys
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace
from present import present
from rows import Told, matrix_in_map
from textbook import TextbookEkf, move, numeric_jacobian, wrap
from worlds import World, instants

from locfuse import sample_logs
from locfuse.cli.analysis.compare import compare_log
from locfuse.cli.analysis.configurations import for_comparison
from locfuse.cli.analysis.load import load
from locfuse.cli.analysis.settings import Asked, LogOptions
from locfuse.fusion.data import VERDICTS, Array, ArrayStream, Drive, Estimates, MapLine
from locfuse.fusion.ekf.belief_arrays import JointBelief
from locfuse.fusion.ekf.map_frame import InMap
from locfuse.fusion.fuse import Filter, due_readings, fuse, inflate, steps_of
from locfuse.fusion.judge.evaluate import evaluate
from locfuse.fusion.measure import measure
from locfuse.fusion.robot import Robot, StartSettings
from locfuse.fusion.streams import outside
from locfuse.fusion.whole_drive.smooth import fuse_and_smooth

FROZEN: dict[str, dict[str, Any]] = {"lrf": {"map": "first-scan"}, "compass": {"offset_deg": math.degrees(0.7)}}


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
    drive, robot = World(settings=FROZEN).measured()
    found = fuse(drive, robot, ["compass", "lrf"])
    assert (found.audits["lrf"].verdict == 0).sum() > 500
    pose, P = textbook(drive, robot, found)
    np.testing.assert_allclose(found.pose, pose, atol=1e-9)
    np.testing.assert_allclose(found.P, P, atol=1e-8)


def test_a_truth_moved_by_half_a_period_changes_no_error_figure_on_an_arc() -> None:
    """With noise-free wheels the estimate is the arc itself, so any change would come from interpolation."""
    figures = []
    for shift in (0.0, 0.02, 0.013):
        drive, robot = World(truth_shift=shift, wheel_noise=0.0).measured()
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


@pytest.mark.parametrize(("recorded", "fix"), [(None, "lrf.time_offset=7.250"), (7.002, "lrf.time_offset=7.002")])
def test_of_another_clock_the_times_of_recording_tell_the_offset(recorded: float | None, fix: str) -> None:
    """Readings that begin 7.25 s before a drive of 5 s; 7.002 s by their recording, since they began earlier."""
    error = outside(np.array([-7.25, -3.0]), np.array([0.0, 5.0]), "lrf", 0.0, recorded)
    assert error.fixes == (fix,)
    assert ("recorded with it" in str(error)) == (recorded is not None)


# --- outliers kept with a larger R instead of being refused

GATE = VERDICTS.index("gate")
HEADING = ((0.0, 0.0, 1.0),)


@pytest.mark.parametrize("before", [0, 2])  # numbers of another reading, which stand above it in the equation
def test_an_outlier_is_put_exactly_on_its_gate_and_keeps_its_prediction(before: int) -> None:
    belief, other = JointBelief((0.0,) * 3, (0.0, 0.0, 0.0, 0.0, 0.0, 0.01)), np.ones((before, 3))
    if before:
        belief.compare(0, (0.0,) * before, other, np.eye(before), 9.0)
    seen = Told((1.0,), HEADING, ((0.01,),)).judged(belief, 9.0)
    assert seen.verdict == GATE
    inflate(seen, belief)
    assert seen.verdict == 0
    assert belief.equation([seen]).R[0, 0] == pytest.approx(1.0 / 9.0 - 0.01)  # y^2 / (H P H' + R) = 9
    assert (seen.nis, seen.y) == (9.0, (1.0,))
    assert seen.sigma[0] == pytest.approx(1.0 / 3.0)
    within = Told((0.1,), HEADING, ((0.01,),)).judged(belief, 9.0)
    judged = within.verdict, within.nis, within.sigma
    inflate(within, belief)  # one within its gate stays as it is
    assert (within.verdict, within.nis, within.sigma) == judged
    assert belief.equation([within]).R[-1, -1] == 0.01


def test_heavy_tails_hurt_less_when_outliers_are_inflated() -> None:
    """A compass that is wrong by up to 40 degrees in a fifth of its readings, told that it is good to one."""
    errors = {}
    for outliers in ("reject", "inflate"):
        settings = {"compass": {"outliers": outliers, "offset_deg": math.degrees(0.7)}}
        world = World(settings=settings, wheel_noise=4e-3, seed=5)
        streams, robot = world.streams(), world.robot()
        rng = np.random.default_rng(3)
        data = dict(streams["compass"].data)
        turn = np.where(rng.random(len(data["magnetic_field.x"])) < 0.2, np.radians(rng.uniform(-40, 40)), 0.0)
        x, y = data["magnetic_field.x"], data["magnetic_field.y"]
        data["magnetic_field.x"] = np.cos(turn) * x - np.sin(turn) * y
        data["magnetic_field.y"] = np.sin(turn) * x + np.cos(turn) * y
        stream = ArrayStream("/compass", "sensor_msgs/msg/MagneticField", streams["compass"].t_ns, data)
        drive = measure({**streams, "compass": stream}, robot)
        found = evaluate(fuse(drive, robot, ["compass"]), drive)
        odometry = evaluate(fuse(drive, robot, []), drive)
        errors[outliers] = found.figures["heading_rmse_deg"]
        assert (errors[outliers] or math.inf) < 0.5 * (odometry.figures["heading_rmse_deg"] or 0.0)
        assert (found.sensors["compass"].rejected == 0) == (outliers == "inflate")


# --- what the filter's loop costs, in calls of Python functions, not seconds: the same on every machine


def calls(world: World, sensors: list[str], due: list[str]) -> float:
    """Calls of an instant at which these sensors have a reading each: the median of half a drive."""
    drive, robot = world.measured()
    run, steps = Filter(robot, sensors, instants=len(drive.t)), steps_of(drive)
    found: list[int] = []
    count = 0

    def tally(_frame: Any, event: str, _what: Any) -> None:
        nonlocal count
        count += event == "call"

    for k, readings in enumerate(due_readings(drive, sensors)):
        count = 0
        sys.setprofile(tally)
        try:
            run.advance(k, steps, readings, drive.measurements)
        finally:
            sys.setprofile(None)
        if [sensor for sensor, _ in readings] == due and 2 * k > len(drive.t):
            found.append(count)
    assert len(found) > 50
    return float(np.median(found))


def test_a_motion_costs_three_calls_and_a_heading_fewer_than_twenty() -> None:
    """The loop, the belief and the record; all equations are compiled."""
    assert calls(World(), [], []) <= 3
    assert calls(World(), ["compass"], ["compass"]) <= 17


@pytest.mark.parametrize(("mode", "most"), [("first-scan", 28), ("refine", 32), ("grow", 46)])
def test_a_scan_costs_at_most_so_many_calls_however_many_lines_it_has(mode: str, most: float) -> None:
    assert calls(World(settings={"lrf": {"map": mode}}), ["compass", "lrf"], ["lrf"]) <= most


# --- what an hour of log must not cost, in bytes that are counted, not measured: the same on every machine


def size(table: Any) -> int:
    """Bytes of the arrays of a table."""
    columns = [getattr(table, name) for name in table.__struct_fields__]
    columns += [one for column in columns if isinstance(column, dict) for one in column.values()]
    return sum(column.nbytes for column in columns if isinstance(column, np.ndarray))


def test_audits_end_with_the_judgement_and_a_few_numbers_an_instant_remain() -> None:
    loaded = load([sample_logs.path("rounded_rectangle")], LogOptions(quiet=True))
    configurations, how = for_comparison((), loaded.drive), Asked(audits=False)
    compared = compare_log(loaded, configurations, how, lambda _: None, draws=True)
    assert compared.drawn.nis.keys() == {(e.name, s) for e in compared.estimates for s in e.sensors}
    assert not any(e.audits for e in (*compared.estimates, *(run.estimates for run in compared.runs)))
    truth = present(compared.loaded.drive.truth)
    for e, judged in zip(compared.estimates, compared.evaluations, strict=True):
        assert size(e) <= 8 * (12 * len(e.t) + 12 * len(truth.t))
        assert size(judged) <= 8 * 13 * len(truth.t)


# --- what no reading says: where the map lies, and which way is north

KNOWN = {"compass": {"offset_deg": math.degrees(0.7)}}
TRUE = (1.5, 1.5, 0.0)


def drive_of(settings: Mapping[str, Any] | None = None, seconds: float = 12.0) -> tuple[Drive, Robot]:
    return World(seconds=seconds, settings=dict(settings or {})).measured()


def begun(robot: Robot, sigma_deg: float, off_deg: float = 0.0, sigma_xy: float = 0.3) -> Robot:
    """The robot with a start that is off by some degrees, and known to this."""
    x, y, _ = TRUE
    start = StartSettings(x=x, y=y, theta_deg=off_deg, sigma_xy=sigma_xy, sigma_theta_deg=sigma_deg)
    return replace(robot, start=start)


def run_of(drive: Drive, robot: Robot, sensors: list[str]) -> Filter:
    run = Filter(robot, sensors)
    assert len(list(instants(run, drive, *sensors))) == len(drive.t)
    return run


@pytest.mark.parametrize("mode", ["first-scan", "refine", "grow"])
def test_the_way_within_the_frame_does_not_depend_on_the_start_bit_for_bit(mode: str) -> None:
    drive, robot = drive_of({"lrf": {"map": mode}}, 6.0)
    starts = ((2.0, 0.0), (5.0, 40.0), (20.0, -9.0))
    runs = [run_of(drive, begun(robot, sigma, off), ["lrf"]) for sigma, off in starts]
    one, *others = [run.belief for run in runs]
    for other in others:
        assert other.pose() == one.pose()
        np.testing.assert_array_equal(other.matrix(), one.matrix())
    assert runs[0].pose() != runs[1].pose()


def aligned(run: Estimates, drive: Drive) -> float:
    return float(evaluate(run, drive, align="se2").figures["position_rmse_m"] or math.nan)


def test_no_scan_says_where_north_is() -> None:
    """No wall's direction is ever known better than the heading was at the first scan, whatever the laser sees."""
    drive, robot = drive_of()
    robot = begun(robot, 2.0)
    found = fuse(drive, robot, ["lrf"])
    first = drive.instant["lrf"][0]
    heading = math.sqrt(found.triangles[first, 5])
    assert heading > math.radians(2.0)
    for line in found.final_map:
        assert math.sqrt(line.P_map[1, 1]) > 0.999 * heading
        assert math.sqrt(line.P[1, 1]) < 0.3 * heading
    assert (np.sqrt(found.triangles[first:, 5]) > 0.999 * heading).all()


def test_a_compass_that_begins_late_turns_the_map_and_bends_nothing() -> None:
    drive, robot = drive_of(KNOWN)
    compass = drive.measurements["compass"]
    late = compass.take(np.flatnonzero(compass.t > 6.0))
    instant = {**drive.instant, "compass": np.searchsorted(drive.t, late.t)}
    drive = replace(drive, measurements={**drive.measurements, "compass": late}, instant=instant)
    robot = begun(robot, 20.0, 25.0, 0.05)
    alone = fuse(drive, robot, ["lrf"])
    filtered, smoothed = fuse_and_smooth(drive, robot, ["compass", "lrf"])
    assert drive.truth is not None
    for run in (filtered, smoothed):
        judged = evaluate(run, drive)
        assert judged.heading is not None
        assert abs(judged.heading[-1]) < 4.0 * judged.sigma[-1, 2] < math.radians(3.0)
    assert (evaluate(smoothed, drive).figures["anees"] or math.inf) < 2.5
    assert abs(evaluate(alone, drive).deviation[-1]).max() > 0.3
    assert aligned(smoothed, drive) < 1.3 * aligned(alone, drive)
    turned = shape(filtered)[filtered.t > 8.0] - shape(alone)[alone.t > 8.0]
    assert np.abs(turned[:, :2]).max() < 0.01


def shape(run: Estimates) -> Array:
    """Return the poses as seen from the last one, (n, 3)."""
    from locfuse.fusion.se2 import between

    return between(np.broadcast_to(run.pose[-1], run.pose.shape), run.pose)


def test_a_frame_begins_only_with_a_map_of_ones_own() -> None:
    """Neither wheels nor compass alone, nor a laser that only listens, have one."""
    drive, robot = drive_of(KNOWN, 3.0)
    robot = begun(robot, 5.0)
    every = np.ones(len(drive.measurements["lrf"].t), bool)
    listening = Filter(robot, ["compass"], {"lrf": every})
    assert len(list(instants(listening, drive, "compass", "lrf"))) == len(drive.t)
    for run in (run_of(drive, robot, []), run_of(drive, robot, ["compass"]), listening):
        assert not run.belief.framed
    assert run_of(drive, robot, ["lrf"]).belief.framed


def test_a_map_that_is_lost_begins_anew_in_a_frame_of_its_own() -> None:
    drive, robot = drive_of(seconds=6.0)
    robot = begun(robot, 2.0)
    run, lrf = Filter(robot, ["lrf"]), drive.measurements["lrf"]
    belief: Any = None
    for k in instants(run, drive, "lrf"):
        if k == len(drive.t) // 2:  # forget every wall
            belief = run.belief
            lines = run.models["lrf"].map  # type: ignore[attr-defined]
            belief.remove(lines.drop(np.arange(len(lines))))
            before, spread = InMap(belief).pose(), matrix_in_map(belief)
    assert len(lrf.t) > 10
    assert belief.frame_pose()[:2] != TRUE[:2]
    assert math.hypot(belief.frame_pose()[0] - before[0], belief.frame_pose()[1] - before[1]) < 0.1
    assert np.trace(matrix_in_map(belief)[:2, :2]) > np.trace(spread[:2, :2])
    error = np.array(run.pose()) - World(seconds=6.0).pose(drive.t[-1:])[0]
    np.testing.assert_allclose(error / np.sqrt(np.diagonal(matrix_in_map(belief))), 0.0, atol=4.0)
