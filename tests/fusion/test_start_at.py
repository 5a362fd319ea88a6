"""A pose that is known later than the wheels begin: the drive is laid so that it has this pose at that moment."""

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bags import real_log
from commands import locfuse, refused, reported
from lock_step import simulated
from msgspec.structs import replace
from present import present
from rewrite_log import rewritten
from rows import matrix_in_map
from textbook import numeric_jacobian
from worlds import World, instants

import locfuse as api
from locfuse.cli.analysis.load import load
from locfuse.cli.analysis.settings import LogOptions
from locfuse.fusion import se2
from locfuse.fusion.data import VERDICTS, Array, Drive, LocfuseError
from locfuse.fusion.ekf.belief_arrays import JointBelief
from locfuse.fusion.fuse import Filter, fuse
from locfuse.fusion.judge.evaluate import evaluate
from locfuse.fusion.kernels.sight import Rules
from locfuse.fusion.lines.extract import rows_of
from locfuse.fusion.map.line_map import Association, mount_states_of
from locfuse.fusion.map.scan import Scan
from locfuse.fusion.map.tracker import LineTracker
from locfuse.fusion.mount import OTHER_MOUNT, Mount
from locfuse.fusion.robot import Robot, StartSettings
from locfuse.fusion.scan_matching.match import Targets, clouds_of, match, sources_of
from locfuse.fusion.sensors.camera import BearingModel, CameraSettings
from locfuse.fusion.sensors.lrf import LrfSettings
from locfuse.fusion.whole_drive.smooth import fuse_and_smooth

SAMPLE = "rounded_rectangle"
POSE = {"start.x": 3.0, "start.y": -2.0, "start.theta_deg": 50.0}


def late(target: Path, topic: str, seconds: float) -> Path:
    """The sample log without its own robot's start and without a topic's first seconds."""
    return rewritten(
        target,
        keep=lambda name, t: name != topic or t > seconds,
        robot=lambda text: text.replace("[start]", "[start]\nsigma_xy = 0.0"),
    )


def odometry(at: float | str, **more: float) -> Any:
    return api.load(SAMPLE, sets={**POSE, "start.at": at, **more}).run("odometry", advice=False)


def test_the_drive_has_the_given_pose_at_the_given_moment() -> None:
    found = odometry(10.0).estimates["odometry"]
    x, y, theta = (np.interp(10.0, found.t, np.unwrap(column)) for column in found.pose.T)
    assert (x, y) == pytest.approx((3.0, -2.0), abs=0.02)  # 0.4 m/s between two instants
    assert math.remainder(theta - math.radians(50.0), 2.0 * math.pi) == pytest.approx(0.0, abs=0.01)


def test_the_first_scan_is_such_a_moment(tmp_path: Path) -> None:
    log = late(tmp_path / "late.mcap", "/scan", 7.0)
    session = api.load(log, sets={**POSE, "start.at": "scan"})
    first = float(session.drive.measurements["lrf"].t[0])
    assert 7.0 < first < 7.5
    by_seconds = api.load(log, sets={**POSE, "start.at": first})
    assert session.robot.start == by_seconds.robot.start
    assert any("the pose is that at 7." in note for note in session.notes)


def test_what_the_wheels_are_uncertain_by_until_then_adds_to_the_start() -> None:
    """By the wheels' own noise: the heading's variance of a way there is that of the way back."""
    start = odometry(10.0, **{"start.sigma_theta_deg": 1.0}).robot.start
    plain = api.load(SAMPLE).run("odometry", advice=False).estimates["odometry"]
    of_wheels = math.degrees(math.sqrt(np.interp(10.0, plain.t, plain.triangles[:, 5])))
    assert of_wheels > 1.0
    assert start.sigma_theta_deg == pytest.approx(math.hypot(1.0, of_wheels), rel=0.02)
    there = np.array([np.interp(10.0, plain.t, plain.pose[:, i]) for i in (0, 1)])
    back = float(np.hypot(*(there - plain.pose[0, :2])))
    assert start.sigma_xy > math.radians(1.0) * back / math.sqrt(2.0)  # the lever of the degree alone


def test_a_truth_that_begins_later_gives_the_start_of_its_moment(tmp_path: Path) -> None:
    """What `info` prints, obeyed, lays the drive on the truth where the truth begins."""
    log = late(tmp_path / "late.mcap", "/ground_truth/pose", 12.0)
    wrong = ("--set", "start.x=0", "--set", "start.y=0", "--set", "start.theta_deg=90")
    report = json.loads(locfuse("info", log, *wrong, "--json").stdout)
    (finding,) = (f for f in report["findings"] if f["code"] == "start")
    fixes = dict(fix.split("=") for fix in finding["fixes"])
    assert 12.0 < float(fixes["start.at"]) < 12.2
    session = api.load(log, sets={key: float(value) for key, value in fixes.items()})
    truth = present(session.drive.truth)
    found = session.run("odometry", advice=False).estimates["odometry"]
    there = [np.interp(truth.t[0], found.t, found.pose[:, axis]) for axis in (0, 1)]
    assert there == pytest.approx(truth.xy[0].tolist(), abs=0.06)


@pytest.mark.parametrize(
    ("at", "says"),
    [
        (1e4, "start.at = 10000: the drive ends at 54.8 s"),
        (-1, "start.at = -1: must be a number >= 0.0"),
        ("noon", "start.at = 'noon': must be a number >= 0.0, or 'scan'"),
    ],
)
def test_a_moment_outside_the_drive_is_one_line(at: Any, says: str) -> None:
    with pytest.raises(LocfuseError, match=says.replace(".", r"\.")):
        api.load(SAMPLE, sets={"start.at": at})


def test_a_log_without_scans_has_no_first_one(tmp_path: Path) -> None:
    log = late(tmp_path / "blind.mcap", "/scan", 1e9)
    with pytest.raises(LocfuseError, match=r'start\.at = "scan": no scan lies within the drive'):
        api.load(log, sets={"start.at": "scan"})


# --- a part of a drive: the same measurements, the same motion, a start that is known there


def test_a_window_holds_what_lies_in_it_and_its_motion_is_that_of_the_whole_drive() -> None:
    whole, window = api.load(SAMPLE).drive, api.load(SAMPLE, between=(10.0, 25.0)).drive
    assert window.t[0] >= 10.0
    assert window.t[-1] <= 25.0
    for name, m in window.measurements.items():
        t = whole.measurements[name].t
        inside = (t >= window.t[0]) & (t <= window.t[-1])
        np.testing.assert_array_equal(m.t, t[inside])
    shared = window.t[2:-1]  # the first and the last reading of the wheels in the window are instants of its own
    ours, theirs = np.isin(window.t, shared), np.isin(whole.t, shared)
    assert ours.sum() == theirs.sum() > 400
    np.testing.assert_allclose(window.motions.u[ours], whole.motions.u[theirs], atol=1e-12)
    np.testing.assert_allclose(window.motions.Q[ours], whole.motions.Q[theirs], atol=1e-15)
    assert window.truth is not None
    assert window.truth.t[0] >= 10.0


def test_it_starts_at_the_truths_pose_and_says_so() -> None:
    session = api.load(SAMPLE, between=(10.0, 25.0))
    truth = present(api.load(SAMPLE).drive.truth)
    start = session.robot.start
    assert start.x == pytest.approx(np.interp(session.drive.t[0], truth.t, truth.xy[:, 0]), abs=1e-9)
    figures = session.run("odometry", advice=False).evaluations["odometry"].figures
    assert figures["duration_s"] == pytest.approx(15.0, abs=0.1)
    assert present(figures["position_rmse_m"]) < 0.3
    assert any("starts there at the truth's pose" in note for note in session.notes)


def test_without_a_truth_it_starts_where_the_wheels_lead(tmp_path: Path) -> None:
    """Odometry alone in the window is then the piece of odometry over the whole drive."""
    robot = tmp_path / "robot.toml"
    robot.write_text('[truth]\ntopic = "/none"\n')
    whole = api.load(SAMPLE, robot=robot).run("odometry", advice=False).estimates["odometry"]
    session = api.load(SAMPLE, robot=robot, between=(10.0, 25.0))
    part = session.run("odometry", advice=False).estimates["odometry"]
    common = np.isin(whole.t, part.t)
    np.testing.assert_allclose(part.pose[np.isin(part.t, whole.t)], whole.pose[common], atol=1e-9)
    assert any("--align origin" in note for note in session.notes)


def test_the_commands_take_it_and_refuse_what_holds_nothing(tmp_path: Path) -> None:
    words = ("compare", SAMPLE, "--no-advice", "--sensors", "odometry", "-o", tmp_path / "o", "--overwrite")
    figures = reported(*words, "--from", 10, "--to", 25).rows["odometry"]
    assert figures["duration_s"] == pytest.approx(15.0, abs=0.1)
    assert "the drive lasts from 0 to" in refused(*words, "--from", 1000)
    refused(*words, "--from", 25, "--to", 10, code=2)
    with pytest.raises(LocfuseError, match="nothing moves there"):
        api.load(SAMPLE, between=(1000.0, None))


# --- extreme settings: a start that is exact, nearly exact or unknown, no floors, a robot that never moves

SIGMAS = [(0.0, 0.0), (1e-9, 0.0), (0.0, 1e-9), (1e-9, 1e-9), (1e-9, 1000.0)]  # degrees, m
SIGMAS += [(0.0, 1000.0), (5.0, 1000.0), (180.0, 0.3), (180.0, 1000.0)]
ROUNDING = 1e-12


def correlation(P: Array) -> Array:
    """Scale a covariance to a unit diagonal: its smallest eigenvalue is then free of units."""
    assert (np.diagonal(P) >= 0.0).all()
    scale = np.sqrt(np.diagonal(P))
    scale = np.where(scale > 0.0, scale, 1.0)
    return np.asarray(P / np.outer(scale, scale))


def positive_throughout(drive: Drive, robot: Robot, sensors: list[str]) -> Filter:
    """Run the filter; its state and the pose in the map have a positive covariance at every instant."""
    run = Filter(robot, sensors)
    for _ in instants(run, drive, *sensors):
        belief = run.belief
        for P in (belief.covariance, matrix_in_map(run.belief)):
            assert np.isfinite(P).all()
            assert np.linalg.eigvalsh(correlation(P))[0] > -ROUNDING
    return run


@pytest.fixture(scope="module")
def driven() -> tuple[Drive, Robot]:
    return World(seconds=3.0, settings={"compass": {"offset_deg": math.degrees(0.7)}}).measured()


@pytest.mark.parametrize("sensors", [["lrf"], ["compass", "lrf"]], ids="+".join)
@pytest.mark.parametrize(("degrees", "metres"), SIGMAS)
def test_any_start_gives_a_positive_covariance_and_the_same_shape(
    driven: tuple[Drive, Robot], degrees: float, metres: float, sensors: list[str]
) -> None:
    drive, robot = driven
    start = StartSettings(x=1.5, y=1.5, sigma_theta_deg=degrees, sigma_xy=metres)
    robot = replace(robot, start=start)
    positive_throughout(drive, robot, sensors)
    for run in fuse_and_smooth(drive, robot, sensors):
        shape = present(evaluate(run, drive, align="se2").figures["position_rmse_m"])
        assert shape < 0.004
        assert (run.triangles[:, [0, 3, 5]] >= 0.0).all()
        assert run.triangles[-1, 0] >= 0.9 * metres**2


@pytest.mark.parametrize("seconds", [2.0, 30.0])
@pytest.mark.parametrize("mode", ["first-scan", "consider", "refine", "grow"])
def test_a_robot_at_rest_without_floors_keeps_a_positive_covariance(mode: str, seconds: float) -> None:
    """Nothing then stops a wall from being known exactly but the number of scans that count."""
    settings = {"floor_range": 0.0, "floor_angle_deg": 0.0, "walls": "flat", "map": mode}
    world = World(seconds=seconds, speed=0.0, turning=0.0, settings={"lrf": settings})
    drive, robot = world.measured()
    robot = replace(robot, start=StartSettings(x=1.5, y=1.5, sigma_theta_deg=2.0, sigma_xy=0.1))
    run = positive_throughout(drive, robot, ["lrf"])
    np.testing.assert_allclose(run.pose(), (1.5, 1.5, 0.0), atol=1e-3)
    assert matrix_in_map(run.belief)[2, 2] > 0.999 * np.radians(2.0) ** 2


def test_a_covariance_beyond_the_square_of_a_float_refuses_the_reading() -> None:
    """Its products are infinite and its NIS is no number: the gate refuses, and nothing is raised."""
    belief = JointBelief((0.0, 0.0, 0.0), (1e200, 1e200, 0.0, 1e200, 0.0, 1.0))
    H, R = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)), ((1.0, 0.0), (0.0, 1.0))
    assert VERDICTS[belief.compare(0, (1.0, 1.0), H, R, 9.0).verdict] == "gate"


# --- where the laser sits: what is uncertain of it is a state

TOLD = (0.2, -0.1, 0.4)  # x, y, yaw of the laser
MOUNT_SIGMAS = ("sigma_x", "sigma_y", "sigma_yaw_deg")
# pose, line (rho, beta about its anchor), anchor: ordinary, C < 0 so that the line is flipped, heading near pi
PLACES = [
    ((1.0, 2.0, 0.3), (0.02, 0.4), (4.0, 3.0)),
    ((4.001, 1.9, -3.0), (0.0, 0.0), (4.0, 2.0)),
    ((0.5, -0.2, math.pi - 1e-7), (-0.1, -math.pi + 1e-7), (-3.0, 0.1)),
]


def laser(*free: int) -> Mount:
    x, y, yaw = TOLD
    sigmas: dict[str, Any] = {MOUNT_SIGMAS[i]: 0.02 for i in free}
    return Mount("lrf", LrfSettings(x=x, y=y, yaw_deg=math.degrees(yaw), **sigmas))


def line_from(pose: Any, line: Any, anchor: Any) -> np.ndarray:
    """(r, psi) of a line (rho, beta) seen from a pose, straight from maths.md."""
    n = np.array([math.cos(line[1]), math.sin(line[1])])
    return np.array([line[0] - (np.array(pose[:2]) - np.array(anchor)) @ n, line[1] - pose[2]])


def in_base(z: np.ndarray, mount: Any) -> np.ndarray:
    """A line as the laser saw it, in the base."""
    psi = z[1] + mount[2]
    return np.array([z[0] + mount[0] * math.cos(psi) + mount[1] * math.sin(psi), psi])


def by_laser(z: np.ndarray, mount: Any) -> np.ndarray:
    """A line in the base, as the laser sees it."""
    return np.array([z[0] - mount[0] * math.cos(z[1]) - mount[1] * math.sin(z[1]), z[1] - mount[2]])


@pytest.mark.parametrize(("pose", "line", "anchor"), PLACES[::2])
def test_a_new_line_goes_with_the_mount_that_it_was_seen_by(
    pose: tuple[float, float, float], line: tuple[float, float], anchor: tuple[float, float]
) -> None:
    mount = laser(0, 1, 2)
    belief = JointBelief(pose, (0.0,) * 6, mount.blocks())
    A = np.random.default_rng(2).normal(size=(6, 6))
    before = 1e-3 * A @ A.T
    belief.covariance[:] = before
    model = LineTracker("grow", 0.9999, mount=mount)
    z = line_from(pose, line, anchor)
    C = np.array([[1e-3, 2e-4], [2e-4, 5e-4]])
    seen = Association(Rules(math.inf, True, False, 2, 3, 4), mount_states_of(mount, belief))
    seen.compare(belief, model.map, rows_of(z[None], C[None], np.array([[-0.5, 1.5]])))
    model._add(Scan(np.array(seen.rows)[:1]), 0, belief)
    seen_by_laser = by_laser(z, TOLD)
    middle = model.map.anchor[0]

    def born(v: np.ndarray) -> np.ndarray:
        r, psi = in_base(seen_by_laser, v[3:6]) + v[6:]
        n = np.array([math.cos(psi + v[2]), math.sin(psi + v[2])])
        return np.array([r + (v[:2] - middle) @ n, psi + v[2]])

    G = numeric_jacobian(born, np.array([*pose, *TOLD, 0.0, 0.0]))
    full = np.block([[before, np.zeros((6, 2))], [np.zeros((2, 6)), C]])
    np.testing.assert_allclose(belief.covariance[6:, 6:], G @ full @ G.T, atol=1e-8)
    np.testing.assert_allclose(belief.covariance[6:, :6], G[:, :6] @ before, atol=1e-8)


def test_only_what_is_uncertain_is_a_state() -> None:
    assert LineTracker("first-scan", 0.9999, mount=laser()).blocks() == []
    (block,) = BearingModel(CameraSettings(sigma_yaw_deg=2.0), (1.0, 1.0)).blocks()
    assert block.name == "camera_yaw"
    assert block.P[0, 0] == pytest.approx(math.radians(2.0) ** 2)
    with pytest.raises(ValueError, match="sigma_yaw_deg = -1"):
        LrfSettings(sigma_yaw_deg=-1.0)
    with pytest.raises(ValueError, match="absolute"):
        CameraSettings(bearing="absolute", sigma_x=0.1)


OFF = ((0.012, -0.008, 0.6), (-0.009, 0.011, -0.4), (0.004, 0.006, 0.5))  # m, m, deg: about one sigma each
EXACT = tuple(f"lrf.{key}=0" for key in MOUNT_SIGMAS)


def anees(stated: Sequence[str], seeds: Sequence[int]) -> float:
    """Of drives of the paper's robot, whose laser sits at (0.2, 0, 0 deg) and not where the filter is told."""
    found = []
    for seed, (x, y, yaw) in zip(seeds, OFF, strict=True):
        sets = (f"lrf.x={0.2 + x}", f"lrf.y={y}", f"lrf.yaw_deg={yaw}", *stated)
        drive, robot = simulated(seed, robot_sets=sets)
        found.append(evaluate(fuse(drive, robot, ["lrf"]), drive).figures["anees"])
    return float(np.mean(np.array(found, float)))


def test_a_laser_that_sits_elsewhere_makes_the_filter_overconfident_only_where_its_mount_is_called_exact() -> None:
    """benchmarks.mounts draws the mount in many drives; here are three."""
    seeds = range(1000, 1003)
    assert anees(EXACT, seeds) > 10.0
    assert 0.4 < anees((), seeds) < 1.5


# --- two robots whose laser sits otherwise than their log says: the filter finds what matched scans say too

WAY_M, STRAIGHT_RAD = 0.4, math.radians(4.0)  # that lie between two scans, and how far the robot may have turned
LOOSE = np.diag([1e-2, 1e-2, 1e-1])  # information of the wheels' guess: next to none
MOST = 60  # pairs of scans: enough for a median


def direction_of_scans(drive: Drive) -> float:
    """By how much scans say that the robot drives to the left of where its wheels say, the median [rad].

    No map, no filter, no lines: points of two scans along a straight way are laid upon each other. A laser that is
    turned by less than it is configured sees the robot drive so far to the left.
    """
    m, wheels = drive.measurements["lrf"], drive.wheels
    within = np.flatnonzero((m.t >= wheels.t[0]) & (m.t <= wheels.t[-1]))
    t, heading = m.t[within], wheels.heading(m.t[within])
    driven = np.append(0.0, np.cumsum(np.hypot(*wheels.relative(t[:-1], t[1:])[:, :2].T)))
    ends = np.searchsorted(driven, driven + WAY_M)
    there = [(a, b) for a, b in enumerate(ends.tolist()) if b < len(t)]
    pairs = [(a, b) for a, b in there if np.ptp(heading[a : b + 1]) < STRAIGHT_RAD]
    i, j = np.array(pairs)[:: max(1, len(pairs) // MOST)].T
    used = np.union1d(i, j)
    clouds = clouds_of(m, within[used])
    by_wheels = wheels.relative(t[i], t[j])
    priors = np.broadcast_to(LOOSE, (len(i), 3, 3))
    a, b = np.searchsorted(used, i), np.searchsorted(used, j)
    found = match(Targets(clouds), a, sources_of(clouds), b, by_wheels, priors)
    good = (found.inliers > 0.8) & (found.overlap > 0.3)
    assert good.sum() > 20
    scans, by_wheels = found.pose[good], by_wheels[good]
    left = [np.arctan2(u[:, 1], u[:, 0]) - 0.5 * u[:, 2] for u in (scans, by_wheels)]  # of the middle of the way
    return float(np.median(se2.wrap_all(left[0] - left[1])))


@pytest.mark.parametrize(
    ("log", "sets", "configured"),
    [
        ("turtlebot4/tb4_mcap.mcap", ("lrf.time_offset=-0.17",), 90.0),
        ("strangers/pimouse.bag", ("lrf.time_offset=-0.16", "lrf.range_scale=0.93"), 0.0),
    ],
)
def test_a_laser_is_found_turned_as_matched_scans_say(log: str, sets: tuple[str, ...], configured: float) -> None:
    loaded = load([real_log(log)], LogOptions(sets=sets, quiet=True))
    assert loaded.robot.settings("lrf").mount[2] == pytest.approx(math.radians(configured), abs=1e-3)
    found = fuse(loaded.drive, loaded.robot, ["lrf"])
    off = math.degrees(found.blocks["lrf_yaw"][-1, 0]) - configured
    by_scans = -math.degrees(direction_of_scans(loaded.drive))
    assert abs(by_scans) > 0.7  # neither mount is what the log says
    assert off == pytest.approx(by_scans, abs=0.35)
    assert any(OTHER_MOUNT in words for words in found.notes)
