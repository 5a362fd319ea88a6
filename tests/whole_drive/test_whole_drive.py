"""The whole drive: loops are closed where a place is seen again, and nowhere else."""

from functools import cache
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace
from present import present
from ring_drive import WIDTH, ring_drive, robot
from rows import readings

import locfuse
from locfuse.fusion import data, se2
from locfuse.fusion.data import VERDICTS, Array, Audit, Drive, Estimates, Evaluation, Ints, LocfuseError
from locfuse.fusion.fuse import fuse
from locfuse.fusion.judge.evaluate import evaluate
from locfuse.fusion.robot import Robot
from locfuse.fusion.scan_matching.match import clouds_of
from locfuse.fusion.sensors.compass import CompassSettings
from locfuse.fusion.sensors.gps import GpsSettings
from locfuse.fusion.whole_drive import closures, odometry, pose_graph, smooth
from locfuse.fusion.whole_drive.closures import recognised
from locfuse.fusion.whole_drive.odometry import (
    STEP_P,
    Odometry,
    OdometryErrors,
    Spans,
    bridged,
    errors_at_scans,
    moving_scans,
    odometry_of,
    points_of,
    smoothed,
)
from locfuse.fusion.whole_drive.others import Others
from locfuse.fusion.whole_drive.reference import Reference, References, reference_sets, refuse_reference


@cache
def solved(alike: bool = False) -> tuple[Drive, Array, pose_graph.Graph]:
    drive, truth = ring_drive(3, alike=alike)
    graph = present(pose_graph.whole_drive(drive, robot(), ["lrf"]))
    return drive, truth, graph


def worst(pose: Array, truth: Array) -> float:
    return float(np.hypot(*(pose - truth)[:, :2].T).max())


def test_a_ring_driven_twice_is_closed_straight_and_as_certain_as_it_claims() -> None:
    drive, truth, graph = solved()
    pose, P = graph.poses()
    assert worst(odometry_of(drive).pose, truth) > 1.5, "the wheels alone are good: the test shows nothing"
    assert worst(pose, truth) < 0.12
    assert len(graph.closures) >= 3
    assert "closed" in graph.notes()[0]
    assert (np.linalg.eigvalsh(P) > 0.0).all()
    e = pose - truth
    e[:, 2] = se2.wrap_all(e[:, 2])
    later = slice(50, None)  # the start is known
    nees = np.einsum("ni,nij,nj->n", e[later], np.linalg.inv(P[later]), e[later])
    assert nees.mean() / 3.0 < 2.0
    then, now = np.searchsorted(drive.t, graph.seen_again()[0]).T
    assert len(now) == len(graph.closures)
    assert (drive.t[now] - drive.t[then] > 10.0).all(), "that is no return"
    assert np.hypot(*(truth[now] - truth[then])[:, :2].T).max() < WIDTH, "that is another corridor"
    assert (np.diff(now) >= 0).all()


@pytest.mark.parametrize("alike", [False, True])
def test_no_closure_joins_two_places(alike: bool) -> None:
    """The ring with the same lockers on opposite sides looks the same from half a ring on."""
    _, truth, graph = solved(alike)
    e = graph.closures
    at = truth[graph.keys]
    apart = se2.between(e.z, se2.between(at[e.i], at[e.j]))
    assert np.hypot(apart[:, 0], apart[:, 1]).max(initial=0.0) < 0.15
    assert worst(graph.poses()[0], truth) < 0.2


def having_recognised(drive: Drive, truth: Array, *places: tuple[float, float], wrong: Any = 0.0) -> Estimates:
    """A run of the filter that recognised places, (then, now) [s] each, as they are or `wrong` by a pose."""
    then, now = np.searchsorted(drive.t, np.array(places).reshape(-1, 2)).T
    poses = se2.between(truth[then], truth[now]) + wrong
    found = drive.t[np.column_stack((then, now))]
    return Estimates("lrf", ("lrf",), drive.t, truth, np.zeros((len(truth), 6)), {}, loops=found, loop_poses=poses)


def returns(drive: Drive, truth: Array) -> list[tuple[float, float]]:
    """Some times (then, now) [s] at which the robot was at one place, one round of the ring apart."""
    k = np.arange(0, len(drive.t), 40)
    apart = np.hypot(*(truth[k, None, :2] - truth[None, k, :2]).transpose(2, 0, 1))
    i, j = np.nonzero((apart < 0.5) & (drive.t[k] - drive.t[k][:, None] > 20.0))
    return list(zip(drive.t[k[i]].tolist(), drive.t[k[j]].tolist(), strict=True))[:4]


def test_a_place_that_the_filter_recognised_lies_between_keys_where_the_truth_has_it() -> None:
    drive, truth, graph = solved()
    places = returns(drive, truth)
    edges = recognised(having_recognised(drive, truth, *places), odometry_of(drive), graph.keys)
    assert len(edges) == len(places) > 2
    at = truth[graph.keys]
    off = se2.between(edges.z, se2.between(at[edges.i], at[edges.j]))
    assert np.abs(off[:, :2]).max() < 0.05  # the wheels err over less than half a key's way
    assert np.abs(se2.wrap_all(off[:, 2])).max() < np.radians(2.0)


def test_without_a_search_what_the_filter_recognised_is_closed(monkeypatch: pytest.MonkeyPatch) -> None:
    """After a long loop every window is too wide, as here, where a window is soon called wide."""
    monkeypatch.setattr(closures, "MAX_SEARCHES", 0)
    monkeypatch.setattr(closures, "NARROW_M", 0.05)
    monkeypatch.setattr(closures, "SIGMA_M", 0.02)
    drive, truth, _ = solved()
    recognised = having_recognised(drive, truth, *returns(drive, truth))
    lone, known = (present(pose_graph.whole_drive(drive, robot(), ["lrf"], run)) for run in (None, recognised))
    assert len(lone.closures) == 0
    assert worst(lone.poses()[0], truth) > 0.25
    assert len(known.closures) >= 3
    assert worst(known.poses()[0], truth) < 0.12


def test_where_matches_fix_no_poses_the_backward_pass_smooths_and_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    drive, _, _ = solved()
    fault = LocfuseError("the matches of scans do not fix the 9 poses")

    def no_solution(*_: object) -> None:
        raise fault

    monkeypatch.setattr(smooth, "whole_drive", no_solution)
    filtered, found = smooth.fuse_and_smooth(drive, robot(), ["lrf"])
    assert found.smoothed
    assert not filtered.smoothed
    assert found.notes[-1] == f"smoothing: no loop was closed: {fault}"


def test_a_run_of_the_filter_that_is_known_is_smoothed_as_a_new_one(monkeypatch: pytest.MonkeyPatch) -> None:
    drive, _, _ = solved()
    filtered, found = smooth.fuse_and_smooth(drive, robot(), ["lrf"])
    monkeypatch.setattr(pose_graph.Graph, "is_needed", lambda *_: True)
    monkeypatch.setattr(smooth, "fuse", None)  # it is not called
    same, again = smooth.fuse_and_smooth(drive, robot(), ["lrf"], known=filtered)
    assert same is filtered
    assert again.smoothed
    if found.loops.size:  # it was the graph's too
        assert np.array_equal(again.pose, found.pose)


@pytest.mark.parametrize("wrong", [(6.0, 0.0, 0.0), (0.0, 0.0, np.pi), (0.0, -3.0, 0.4)])
def test_a_place_that_was_recognised_wrongly_bends_nothing(wrong: tuple[float, float, float]) -> None:
    drive, truth, graph = solved()
    misled = having_recognised(drive, truth, *returns(drive, truth), wrong=np.array(wrong))
    found = present(pose_graph.whole_drive(drive, robot(), ["lrf"], misled))
    assert worst(found.poses()[0], truth) < 0.12
    assert len(found.closures) >= 0.5 * len(graph.closures)


def test_a_laser_that_the_filter_found_elsewhere_is_taken_to_be_there() -> None:
    drive, truth = ring_drive(3, mount=np.array([0.0, 0.25, 0.0]))
    blocks = {"lrf_y": np.linspace(0.0, 0.25, len(truth))[:, None]}
    known = replace(having_recognised(drive, truth), blocks=blocks)
    graphs = [present(pose_graph.whole_drive(drive, robot(), ["lrf"], run)) for run in (None, known)]
    apart = [worst(graph.poses()[0], truth) for graph in graphs]
    assert apart[0] > 0.2
    assert apart[1] < 0.12


@pytest.mark.parametrize(("true_deg", "found_deg", "taken_deg"), [(2.0, 2.0, 2.0), (0.0, 2.0, 0.0)])
def test_a_yaw_under_which_the_robot_would_go_sideways_is_not_taken_over(
    true_deg: float, found_deg: float, taken_deg: float
) -> None:
    """Half a metre ahead, ten times, then a turn; scans show it from a laser turned by `true_deg` on the robot."""
    u = np.array([[0.5, 0.0, 0.0]] * 10 + [[0.4, 0.1, 0.6]])
    base = se2.chain(u)
    true, found = (np.array([0.2, 0.05, np.radians(deg)]) for deg in (true_deg, found_deg))
    x = se2.compose(base, se2.compose(true, se2.inverse(found)))  # key poses as they follow from `found`
    taken = pose_graph.straight_mount(found, np.array([0.2, 0.0, 0.0]), x, u)
    assert taken == pytest.approx([0.2, 0.05, np.radians(taken_deg)])


def test_between_key_poses_the_way_leads_from_one_to_the_other() -> None:
    """And turning both keys turns what lies between."""
    drive, truth, _ = solved()
    assert pose_graph.whole_drive(drive, robot(), []) is None  # without a laser there is no graph
    odometry = odometry_of(drive)
    keys = np.arange(0, len(drive.t), 25)
    P = np.tile(np.diag([1e-4, 1e-4, 1e-5]), (len(keys), 1, 1))
    errors = OdometryErrors.of_keys(odometry, keys, truth[keys])
    pose, out = bridged(odometry, odometry, np.arange(len(drive.t)), keys, truth[keys], P, 0.5 * P[1:], errors)
    np.testing.assert_allclose(pose[keys], truth[keys], atol=1e-6)
    np.testing.assert_allclose(out[keys[:-1]], P[:-1], atol=1e-7)
    assert worst(pose, truth) < 0.05
    middle = (keys[:-1] + keys[1:]) // 2
    moving = np.hypot(*(truth[keys[1:]] - truth[keys[:-1]])[:, :2].T) > 0.3
    assert (out[middle, 0, 0] + out[middle, 1, 1] > 2e-4)[moving].all(), "between two keys less is known"
    G, k = np.array([3.0, -1.0, 2.0]), np.arange(len(drive.t))
    turned, _ = bridged(odometry, odometry, k, keys, se2.compose(G, truth[keys]), P, 0.5 * P[1:], errors)
    np.testing.assert_allclose(turned, se2.compose(G, pose), atol=1e-9)


def test_scans_tell_how_much_of_their_noise_the_wheels_have() -> None:
    rng = np.random.default_rng(3)
    n, claimed, real = 400, np.radians(5.0), np.radians(0.5)
    turns = np.column_stack((np.full(n, 0.5), np.zeros(n), rng.normal(0.0, 0.1, n)))
    variances = np.cumsum(np.tile(np.diag([1e-4, 1e-4, claimed**2]), (n + 1, 1, 1)), axis=0)
    way = Odometry(np.vstack((np.zeros(3), np.cumsum(turns, axis=0))), variances)
    seen = way.pose.copy()
    seen[1:, 2] += np.cumsum(rng.normal(0.0, real, n))
    share = pose_graph.wheels_share(way, np.arange(n + 1), seen)
    assert share == pytest.approx((real / claimed) ** 2, rel=0.2)


# --- between two key poses the scans correct the wheels


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
    ways, turns = odometry.path_length()[scans], odometry.pose[scans, 2]
    readings = data.spaced((ways, pose_graph.KEY_DISTANCE_M), (turns, pose_graph.KEY_TURN_RAD))
    keys = drive.instant["lrf"][readings]
    slip = np.zeros_like(odometry.pose)
    for k in keys[20:60:4] + 2:  # 6 degrees at once, just behind ten of the keys
        slip[k:, 2] += np.radians(6.0)
    u = se2.between(odometry.pose[:-1], odometry.pose[1:])
    u[:, 2] += np.diff(slip[:, 2])
    pose = np.vstack((odometry.pose[:1], np.zeros_like(u)))
    for k, motion in enumerate(u):
        pose[k + 1] = se2.compose(pose[k], motion)
    slipped = Odometry(pose, odometry.C).with_slip_noise()
    clouds = clouds_of(drive.measurements["lrf"], readings)
    P = np.tile(np.diag([1e-6, 1e-6, 1e-8]), (len(keys), 1, 1))
    span = slice(int(keys[20]), int(keys[61]))

    def heading(errors: OdometryErrors) -> float:
        at, _ = bridged(slipped, slipped, np.arange(len(drive.t)), keys, truth[keys], P, P[1:], errors)
        return float(np.degrees(np.sqrt((se2.wrap_all(at[span, 2] - truth[span, 2]) ** 2).mean())))

    by_wheels = heading(OdometryErrors.of_keys(slipped, keys, truth[keys]))
    by_scans = heading(errors_at_scans(slipped, drive, "lrf", readings, clouds, truth[keys]))
    assert by_wheels > 2.0, "the slip does not show: the test shows nothing"
    assert by_scans < 0.5 * by_wheels


@pytest.mark.parametrize("information", [(1e4, 2e4, 4e5), (0.0, 0.0, 0.0)])
def test_one_scan_between_two_keys_weighs_as_least_squares_does(information: tuple[float, float, float]) -> None:
    """The dense joint Gaussian of the error at the scan, known at both keys; 0: what the wheels alone say."""
    odometry = straight(10, 0.05)
    x = np.array([[0.0, 0.0, 0.0], [0.5, 0.02, 0.03]])
    keys, k = np.array([0, 10]), np.array([4])
    ends = OdometryErrors.of_keys(odometry, keys, x)
    z, L = np.array([[0.004, 0.01, -0.02]]), np.diag(information)[None]
    errors = smoothed(odometry, ends, np.array([0]), k, z, L)
    Q1, Q2 = odometry.C[4] + STEP_P, odometry.C[10] - odometry.C[4] + STEP_P
    H = np.linalg.inv(Q1) + np.linalg.inv(Q2) + L[0]
    mean = np.linalg.solve(H, np.linalg.inv(Q2) @ ends.xi[1] + L[0] @ z[0])
    np.testing.assert_allclose(errors.xi[1], mean, rtol=1e-3, atol=1e-6)
    np.testing.assert_allclose(errors.rest[1], np.linalg.inv(H), rtol=1e-3, atol=1e-9)
    np.testing.assert_allclose(errors.xi[2], ends.xi[1], atol=1e-5)


def test_what_is_known_at_a_fix_is_what_the_bridge_says_there() -> None:
    odometry = straight(10, 0.05)
    keys = np.array([0, 10])
    rest = np.zeros((3, 3, 3))
    rest[1] = np.diag([1e-4, 2e-4, 3e-4])
    xi = np.array([[0.0, 0.0, 0.0], [0.01, 0.02, 0.03], [0.0, 0.0, 0.0]])
    errors = OdometryErrors(np.zeros(3, np.int64), np.array([0, 5, 10]), xi, rest)
    k = np.array([0, 5, 7])
    at, P = errors.at(odometry, k, Spans.of(odometry, odometry.at(k), k, keys))
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
    monkeypatch.setattr(odometry, "SCANS_AT_ONCE", 4)
    parts = points_of(m, chosen)
    assert len(parts) == len(whole) == len(chosen)
    for k in range(len(chosen)):
        one, other = (c.xy[c.first[k] : c.first[k + 1]] for c in (whole, parts))
        common = {tuple(p) for p in one.tolist()} & {tuple(p) for p in other.tolist()}
        assert len(common) >= 0.95 * max(len(one), len(other))


def test_of_a_fast_laser_ten_scans_a_second_are_enough() -> None:
    n = 401
    t = np.linspace(0.0, 10.0, n)  # 40 Hz
    chosen = moving_scans(straight(n - 1, 0.01), t, np.arange(n), np.array([0, n - 1]))
    assert np.diff(t[chosen]).min() >= 0.09
    assert len(chosen) > 95


# --- sensors beside the laser in the graph: a GPS and a compass hold a drive that closes no loop

OFFSET_RAD, GPS_M, COMPASS_RAD = 0.4, 0.05, np.radians(1.0)


def described() -> Robot:
    """A robot whose GPS knows where the map lies, and whose compass does not know its offset."""
    sensors = {
        **robot().sensors,
        "gps": GpsSettings(sigma=GPS_M, origin=(50.0, 8.0), east_deg=0.0),
        "compass": CompassSettings(sigma_deg=float(np.degrees(COMPASS_RAD))),
    }
    return replace(robot(), sensors=sensors)


@cache
def drive() -> tuple[Drive, Array]:
    """Three quarters of the ring: no place is seen twice."""
    plain, truth = ring_drive(4, laps=0.75)
    rng = np.random.default_rng(1)
    at = np.arange(0, len(plain.t), 20)
    gps = truth[at, :2] + GPS_M * rng.normal(size=(len(at), 2))
    compass = se2.wrap_all(truth[at, 2:] + OFFSET_RAD + COMPASS_RAD * rng.normal(size=(len(at), 1)))
    extra = {"strength": np.ones(len(at)), "rest": np.zeros(len(at))}
    headings = readings(plain.t[at], compass, COMPASS_RAD, **extra)
    more = {"gps": readings(plain.t[at], gps, GPS_M), "compass": headings}
    instants = {**plain.instant, "gps": at, "compass": at}
    return replace(plain, measurements={**plain.measurements, **more}, instant=instants), truth


@cache
def solved_others(*sensors: str) -> pose_graph.Graph:
    return present(pose_graph.whole_drive(drive()[0], described(), sensors))


def error(graph: pose_graph.Graph) -> Array:
    e = graph.poses()[0] - drive()[1]
    e[:, 2] = se2.wrap_all(e[:, 2])
    return e


def rmse(graph: pose_graph.Graph) -> float:
    return float(np.sqrt((error(graph)[:, :2] ** 2).sum(axis=1).mean()))


def test_a_gps_holds_a_drive_without_loops() -> None:
    alone, held = solved_others("lrf"), solved_others("lrf", "gps")
    assert not len(held.closures)
    assert rmse(held) < 0.06
    assert rmse(held) < rmse(alone)
    end = -1
    assert held.poses()[1][end, 0, 0] < 0.25 * alone.poses()[1][end, 0, 0], "a GPS must narrow what is claimed"


def test_a_compass_tells_headings_and_its_own_offset() -> None:
    alone, held = solved_others("lrf"), solved_others("lrf", "compass")
    assert np.degrees(np.sqrt((error(held)[:, 2] ** 2).mean())) < 0.6
    assert held.poses()[1][-1, 2, 2] < alone.poses()[1][-1, 2, 2]


def test_what_a_sensor_adds_pulls_the_poses_towards_its_readings() -> None:
    """A step along the right side of its normal equations lessens the weighed squares, written out anew here."""
    log, truth = drive()
    odometry = odometry_of(log)
    keys = log.instant["lrf"][::8]
    x = truth[keys] + np.random.default_rng(2).normal(size=(len(keys), 3)) * (0.02, 0.02, 0.005)

    def cost(at: Array) -> float:
        gps, R = log.measurements["gps"], GPS_M**2
        total = 0.0
        for i, instant in enumerate(log.instant["gps"].tolist()):
            key = int(np.searchsorted(keys, instant, side="right")) - 1
            u, _ = odometry.between(keys[[key]], np.array([instant]))
            pose = se2.compose(at[key], u[0])
            total += float(((gps.z[i] - pose[:2]) ** 2).sum()) / R
        return total

    rows = Others(log, described(), ["gps"], odometry, keys).rows(x)
    H, g = np.zeros((3 * len(x), 3 * len(x))), np.zeros(3 * len(x))
    for block in rows:
        for columns, h, right in zip(block.at, block.H, block.g, strict=True):
            H[np.ix_(columns, columns)] += h
            g[columns] += right
    step = np.zeros(3 * len(x))
    step[3 * 5 : 3 * 5 + 3] = np.linalg.solve(H[15:18, 15:18] + 1e-3 * np.eye(3), g[15:18])
    assert cost(x + 0.5 * step.reshape(-1, 3)) < cost(x)
    assert (np.linalg.eigvalsh(H) > -1e-6 * np.abs(H).max()).all()


def test_readings_that_are_left_out_of_a_fast_sensor_make_the_others_no_surer() -> None:
    """Of ten a key four are taken, each with its own noise: they know the heading as they do without the six."""
    log, truth = drive()
    keys = np.arange(len(log.t))[::10]
    sensors = {**described().sensors, "compass": CompassSettings(offset_deg=0.0)}

    def known(at: Ints) -> float:
        extra = {"strength": np.ones(len(at)), "rest": np.zeros(len(at))}
        compass = {**log.measurements, "compass": readings(log.t[at], truth[at, 2:], COMPASS_RAD, **extra)}
        seen = replace(log, measurements=compass, instant={**log.instant, "compass": at})
        robot = replace(described(), sensors=sensors)
        rows = Others(seen, robot, ["compass"], odometry_of(log), keys).rows(truth[keys])
        return sum(float(block.H[:, 2, 2].sum()) for block in rows)

    every = np.arange(len(keys[:-1]) * 10)
    assert known(every) == pytest.approx(known(every[np.isin(every % 10, (0, 3, 6, 9))]))


@pytest.mark.parametrize(("refused", "left"), [(0, 20), (7, 13), (12, 0)])
def test_what_the_filter_refused_is_left_out_and_with_most_of_a_sensor_all_of_it(refused: int, left: int) -> None:
    log, _ = drive()
    keys = log.instant["lrf"][::8]
    at = log.instant["gps"][:20]
    gps = {**log.measurements, "gps": log.measurements["gps"].take(np.arange(20))}
    log = replace(log, instant={**log.instant, "gps": at}, measurements=gps)
    nothing = np.zeros(20)
    verdict = np.where(np.arange(20) < refused, VERDICTS.index("gate"), VERDICTS.index("accepted")).astype(np.int8)
    empty = np.zeros((20, 2))
    audit = Audit(at, np.arange(20), verdict, np.full(20, -1), nothing, nothing, empty, empty)
    others = Others(log, described(), ["gps"], odometry_of(log), keys, {"gps": audit})
    assert len(others._seen) == left
    assert not {seen.reading for seen in others._seen} & set(range(refused))


# --- references of a drive without truth: which sets of sensors are solved, and which of them judges what

NO_TRUTH = {"truth.topic": "none"}


@cache
def session() -> locfuse.Session:
    return locfuse.load("rounded_triangle", sets=NO_TRUTH)


@cache
def references() -> References:
    return present(References.of(session().drive, session().robot, {}, {"compass": 10.0}))


def judged(found: References, *sensors: str) -> tuple[Evaluation, Reference]:
    """Judge a run with these sensors by the references."""
    e = fuse(session().drive, session().robot, sensors)
    return found.judged(evaluate(e, session().drive), e, "none")


def only(*sensors: str) -> Drive:
    drive = session().drive
    return replace(drive, measurements={s: m for s, m in drive.measurements.items() if s in sensors})


def test_all_sensors_are_solved_and_all_but_each_that_leave_one_which_locates() -> None:
    pairs = [("lrf", "camera"), ("compass", "camera"), ("compass", "lrf")]
    assert reference_sets(session().drive) == [("compass", "lrf", "camera"), *pairs]
    assert reference_sets(only("compass", "lrf")) == [("compass", "lrf"), ("lrf",)]
    assert reference_sets(only("compass")) == []


def test_where_no_sensor_locates_or_a_truth_is_known_there_is_no_reference() -> None:
    with pytest.raises(data.UsageError, match="no sensor of this log shows where"):
        refuse_reference(only("compass"), session().robot)
    log = locfuse.load("rounded_triangle")
    with pytest.raises(data.UsageError, match="has a truth, /ground_truth/pose"):
        refuse_reference(log.drive, log.robot)


def test_a_sensor_that_measured_nothing_makes_no_reference() -> None:
    """A dead laser: its whole-drive solution would be the odometry, and judge it as perfect."""
    both = only("compass", "lrf")
    lrf = both.measurements["lrf"]
    none = replace(lrf, t=lrf.t[:0], first=lrf.first[:1], z=lrf.z[:0], R_unit=lrf.R_unit[:0])
    dead = replace(both, measurements={**both.measurements, "lrf": none})
    assert reference_sets(dead) == []
    with pytest.raises(data.UsageError, match="no sensor of this log shows where"):
        refuse_reference(dead, session().robot)


def test_a_sensor_is_judged_by_the_others_and_all_of_them_by_all() -> None:
    for sensors, judge in [
        ((), ("compass", "lrf", "camera")),
        (("compass",), ("lrf", "camera")),
        (("camera",), ("compass", "lrf")),
        (("compass", "lrf", "camera"), ("compass", "lrf", "camera")),
    ]:
        assert judged(references(), *sensors)[1].sensors == judge


def test_errors_by_reference_are_those_by_truth_where_the_reference_is_exact_enough() -> None:
    """Held against the sample log's truth, which the reference has not seen."""
    with_truth = locfuse.load("rounded_triangle")
    for sensors in [(), ("compass",), ("camera",)]:
        by_reference, _ = judged(references(), *sensors)
        true = evaluate(fuse(with_truth.drive, with_truth.robot, sensors), with_truth.drive)
        assert by_reference.figures["position_rmse_m"] == pytest.approx(true.figures["position_rmse_m"], rel=0.05)


def test_a_laser_better_than_the_reference_without_it_is_judged_by_all_which_it_shares() -> None:
    by_reference, reference = judged(references(), "lrf")
    assert reference.left_out == ()
    error = present(by_reference.figures["position_rmse_m"])
    assert error < references().solved[frozenset({"compass", "camera"})].sigma


def test_the_one_that_contradicts_all_others_is_judged_by_them_and_judges_none() -> None:
    found = replace(references(), contradict=[("camera", "compass"), ("compass", "lrf")])
    assert found.outlier == "compass"
    assert found.whole.left_out == ("compass",)
    for sensor, judge in [("compass", ("lrf", "camera")), ("camera", ("lrf", "camera"))]:
        assert judged(found, sensor)[1].sensors == judge
    found = replace(references(), contradict=[("compass", "lrf")])
    assert judged(found, "compass")[1].left_out == ()


def test_a_reference_is_solved_with_the_noise_that_residuals_show() -> None:
    robot: Robot = session().robot
    drive = only("compass", "camera")
    sure, honest = (present(References.of(drive, robot, {}, {"compass": k})) for k in (1.0, 10.0))
    assert honest.whole.sigma > 1.1 * sure.whole.sigma
    assert np.isfinite(honest.whole.sigma)
