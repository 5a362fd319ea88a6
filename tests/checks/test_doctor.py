"""The doctor's measurements on drives whose answer is known exactly, and its silence where it cannot know."""

import math
import pickle
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from bags import real_log
from msgspec.structs import replace
from present import present
from rows import readings
from small_drive import START, TRACK, drive, path, robot

import locfuse
from locfuse.cli.analysis.load import load
from locfuse.cli.analysis.settings import LogOptions
from locfuse.fusion import se2
from locfuse.fusion.checks import truth as truth_checks
from locfuse.fusion.checks.clocks import CLOCK, of_clocks, truth_lag
from locfuse.fusion.checks.compass import angles, by_gravity
from locfuse.fusion.checks.examine import examine, gaps, scales, unseen
from locfuse.fusion.checks.finding import Finding, Least, of_error
from locfuse.fusion.checks.gyro import of_gyro
from locfuse.fusion.checks.laser import (
    WallMotion,
    WallPairs,
    bumped,
    laser_motion,
    of_laser,
    of_radius,
    range_fix,
    slipping,
)
from locfuse.fusion.checks.probes import path_scale
from locfuse.fusion.checks.start import start_pose
from locfuse.fusion.checks.tracked_point import swing_by_positions
from locfuse.fusion.checks.truth import JUMP, SIZE, STEP, UNIT, of_axes, of_size, of_truth, of_unit
from locfuse.fusion.checks.turning import (
    RATIO,
    SURE_RATIO,
    Headings,
    and_truth,
    explain,
    of_ratio,
    of_track,
    turnings,
)
from locfuse.fusion.data import Array, ArrayStream, Drive, LocfuseError, Measurements, Truth, UsageError
from locfuse.fusion.robot import StartSettings, WheelSettings
from locfuse.fusion.se2 import rotation_3d
from locfuse.fusion.sensors.gyro import GyroSettings
from locfuse.fusion.truth import elsewhere
from locfuse.fusion.wheels.motion import Wheels


def told(found: list[Finding]) -> dict[str, float]:
    """The numbers that the cures set."""
    pairs = (cure.split("=") for f in found for cure in f.fixes)
    return {key: float(value) for key, value in pairs}


def truth_of(drive: Drive) -> Truth:
    return present(drive.truth)


def with_truth(drive: Drive, **fields: Any) -> Drive:
    """The drive under a truth of which some fields are others."""
    return replace(drive, truth=replace(truth_of(drive), **fields))


def beside(drive: Drive, x: float, y: float) -> Drive:
    """The drive under a truth of the point (x, y) m on the body."""
    truth = truth_of(drive)
    pose = np.column_stack((truth.xy, present(truth.theta)))
    return with_truth(drive, xy=se2.compose(pose, np.broadcast_to([x, y, 0.0], pose.shape))[:, :2])


def rolled(drive: Drive, ways: Array, track: float = TRACK) -> Drive:
    """The drive of wheels that rolled (n, 2) m from reading to reading and are said to stand `track` apart."""
    return replace(drive, wheels=drive.wheels.rerolled(ways, track))


def seen(drive: Drive, m: Measurements | None = None) -> WallMotion | None:
    """What the laser's walls say of a drive, or readings `m` instead of its own."""
    drive = drive if m is None else replace(drive, measurements={**drive.measurements, "lrf": m})
    return laser_motion(drive, robot(), 0.0)


# the laser's walls


@pytest.mark.parametrize("scale", [0.8, 1.0, 1.25])
def test_the_laser_s_metre_is_measured_by_walls_seen_twice(scale: float) -> None:
    healthy = drive(1, robot())
    m = healthy.measurements["lrf"]
    motion = present(seen(healthy, replace(m, z=m.z * [1.0 / scale, 1.0])))
    assert motion.scale == pytest.approx(scale, rel=0.02)
    found = of_laser(motion, robot())
    assert bool(found) == (scale != 1.0)
    assert not found or f"wheels.radius={0.05 / motion.scale:.4g}" in found[0].message  # who is right is not known
    by_truth = of_laser(motion, robot(), by_truth=True)
    assert [f.code for f in by_truth] == ["range scale"] * bool(found)
    assert not any("wheels.radius" in f.message for f in by_truth)


@pytest.mark.parametrize("yaw_deg", [-120.0, 20.0, 90.0, 180.0])
def test_the_laser_s_yaw_is_measured_by_how_walls_come_nearer(yaw_deg: float) -> None:
    """The lines of a laser that looks elsewhere than its settings say."""
    healthy = drive(2, robot())
    m = healthy.measurements["lrf"]
    motion = present(seen(healthy, replace(m, z=m.z - [0.0, math.radians(yaw_deg)])))
    assert abs(se2.wrap(-motion.yaw - math.radians(yaw_deg))) < math.radians(2.0)
    wrapped = math.degrees(se2.wrap(math.radians(yaw_deg)))
    assert told(of_laser(motion, robot()))["lrf.yaw_deg"] == pytest.approx(wrapped, abs=2)


def test_ways_sideways_are_compared_with_walls_apart_from_those_ahead() -> None:
    rng = np.random.default_rng(3)
    angle, moved = rng.uniform(-np.pi, np.pi, 400), rng.uniform(-0.3, 0.3, (400, 2))
    n, zero = np.column_stack((np.cos(angle), np.sin(angle))), np.zeros(400)
    y = (n * moved).sum(axis=1) + rng.normal(0.0, 0.005, 400)
    walls = WallPairs(y, n, moved * [1.0, 0.88], zero, zero, np.arange(400.0), np.arange(400.0))
    assert slipping(walls) == pytest.approx(0.88, abs=0.005)
    assert slipping(walls._replace(d=1.1 * moved)) == pytest.approx(1.0, abs=0.005)


@pytest.mark.parametrize("place", [(0.2, 0.1), (-0.1, 0.2)], ids=["inverted", "turned"])
def test_an_inverted_mount_is_told_from_one_with_another_yaw(place: tuple[float, float]) -> None:
    """A mount of (0.2, 0.1) m and 90 degrees has the inverse (-0.1, 0.2) m and -90 degrees, as configured."""
    healthy, wrong = drive(2, robot()), robot(lrf={"x": -0.1, "y": 0.2, "yaw_deg": -90.0})
    m = healthy.measurements["lrf"]
    r, psi = m.z.T
    own = r - np.cos(psi) * place[0] - np.sin(psi) * place[1]
    psi = psi - math.pi
    z = np.stack((own - 0.1 * np.cos(psi) + 0.2 * np.sin(psi), psi), axis=-1)
    motion = laser_motion(replace(healthy, measurements={"lrf": replace(m, z=z)}), wrong, 0.0)
    found = told(of_laser(motion, wrong))
    assert found["lrf.yaw_deg"] == pytest.approx(90.0, abs=2.0)
    assert (found.get("lrf.x"), found.get("lrf.y")) == (place if place[0] > 0.0 else (None, None))


@pytest.mark.parametrize("yaw_deg", [-8.0, 0.0, 8.0])
def test_walls_that_come_nearer_by_less_than_their_noise_tell_neither_metre_nor_yaw(yaw_deg: float) -> None:
    """A depth camera on a robot that mostly turns on the spot."""
    options = LogOptions(sets=(f"lrf.yaw_deg={yaw_deg}",), quiet=True)
    loaded = load([real_log("strangers/odometry_in_tf.bag")], options)
    motion = present(laser_motion(loaded.drive, loaded.robot, 0.0))
    assert motion.walls > 100
    assert of_laser(motion, loaded.robot) == []


@pytest.mark.parametrize("straight", [False, True])
def test_without_a_straight_metre_no_range_scale_is_told(straight: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    t, _ = path(1.0)
    if not straight:  # a circle with a radius of 0.8 m in the middle of the room
        angle = 0.3 / 0.8 * t
        at = np.stack((3.0 + 0.8 * np.sin(angle), 4.0 - 0.8 * np.cos(angle), angle), axis=-1)
        monkeypatch.setattr("small_drive.path", lambda laps: (t, at))
    drawn = drive(1, robot(), truth=False)
    m = drawn.measurements["lrf"]
    short = replace(drawn, measurements={"lrf": replace(m, z=m.z * [1.25, 1.0])})
    found = scales(short, robot(), turnings(short))
    assert [f.code for f in found] == (["distances"] if straight else [])
    assert straight != any("no metre of its way is straight" in f.message for f in unseen(short))


def test_nothing_is_said_of_a_laser_that_sees_too_few_walls() -> None:
    healthy = drive(3, robot(), laps=0.1)
    assert seen(healthy, healthy.measurements["lrf"].take(np.arange(12))) is None


def test_the_track_is_measured_by_the_turning_of_the_walls() -> None:
    right, settings = drive(4, robot()), robot().wheels
    wrong = replace(rolled(right, right.wheels.rolled, 0.8 * TRACK), truth=None)
    found = of_track(wrong, replace(settings, track=0.8 * TRACK), turnings(wrong), seen(wrong))
    assert told(found)["wheels.track"] == pytest.approx(TRACK, rel=0.03)
    assert of_track(right, settings, turnings(right), seen(right)) == []


@pytest.mark.parametrize("factor", [0.9, 1.06])
def test_ways_and_turns_that_are_too_long_alike_are_a_wrong_radius(factor: float) -> None:
    """What the encoders count is multiplied by a radius that is off."""
    right = drive(4, robot())
    found = of_radius(seen(rolled(right, factor * right.wheels.rolled)), robot(), tried=True)
    assert told(found)["wheels.radius"] == pytest.approx(0.05 / factor, rel=0.02)


@pytest.mark.parametrize(("ways", "turns", "radius"), [(3.7, 4.4, 0.05 / 3.7), (3.7, 1.0, None), (1.7, 1.9, None)])
def test_ways_and_turns_beyond_twice_are_a_wrong_radius_though_they_differ(
    ways: float, turns: float, radius: float | None
) -> None:
    """Walls are paired by the wheels, and such wheels bias both factors."""
    motion = WallMotion(ways, 0.05, 0.0, 0.01, 1.0 / turns, 0.002, 500)
    found = told(of_radius(motion, robot()))
    assert found.get("wheels.radius") == (radius and pytest.approx(radius, rel=1e-3))


@pytest.mark.parametrize("truth", [True, False])
@pytest.mark.parametrize("factor", [0.3, 4.0])
def test_a_radius_that_is_far_off_is_named_and_the_track_is_left(factor: float, truth: bool) -> None:
    """Wheels that seem to roll less than 0.1 m in a second, or to turn so far that a chord is much shorter."""
    right = drive(4, robot(), truth=truth)
    wrong = rolled(right, factor * right.wheels.rolled)
    found = told(scales(wrong, robot(), turnings(wrong)))
    assert found.pop("wheels.radius") == pytest.approx(0.05 / factor, rel=0.05)
    assert found.pop("wheels.track", TRACK) == pytest.approx(TRACK, rel=0.05)
    assert not found


@pytest.mark.parametrize("truth", [True, False])
@pytest.mark.parametrize(("factor", "ticks"), [(4.0, 4096.0), (0.5, 512.0), (3.0, None)])
def test_a_factor_of_2_or_4_is_a_wrong_number_of_ticks(factor: float, ticks: float | None, truth: bool) -> None:
    right = drive(4, robot(), truth=truth)
    wrong = rolled(right, factor * right.wheels.rolled)
    counting = replace(robot(), wheels=replace(robot().wheels, ticks_per_revolution=1024.0))
    found = told(scales(wrong, counting, turnings(wrong)))
    assert found.get("wheels.ticks_per_revolution") == ticks
    assert found.get("wheels.radius") == (None if ticks else pytest.approx(0.05 / factor, rel=0.05))


def test_the_noise_of_a_truth_does_not_lengthen_its_metre() -> None:
    healthy = drive(1, robot())
    noise = 0.1 * np.random.default_rng(3).normal(size=truth_of(healthy).xy.shape)
    noisy = with_truth(healthy, xy=truth_of(healthy).xy + noise)
    assert present(truth_checks.wheels_metre(noisy))[0] > 1.04  # in windows that are short for this noise
    assert present(truth_checks.wheels_metre(with_truth(noisy, sigma=0.1)))[0] == pytest.approx(1.0, abs=0.015)


@pytest.mark.parametrize("by", ["truth", "positions", "compass", "lrf"])
def test_a_larger_wheel_is_named_by_headings(by: str) -> None:
    right = drive(5, robot(), truth=by in {"truth", "positions"})
    right = with_truth(right, theta=None) if by == "positions" else right
    larger = rolled(right, right.wheels.rolled * [1.0, 0.94])  # the right wheel is larger than it is said to be
    shown = turnings(larger)
    (found,) = of_ratio(larger, robot(), and_truth(larger, {by: shown[by]} if by in shown else {}))
    assert told([found])["wheels.ratio"] == pytest.approx(1.0 / 0.94, rel=0.015)
    assert of_ratio(right, robot(), turnings(right)) == []
    states = replace(robot(), wheels=replace(robot().wheels, estimate=True))
    assert of_ratio(larger, states, shown) == []
    # odometry by these wheels: in a metre the right one is said to roll 0.06 / 0.97 m less, at a track of 0.6 m
    driver = replace(states, wheels=WheelSettings())
    (found,) = of_ratio(larger, driver, and_truth(larger, {by: shown[by]} if by in shown else {}))
    degrees, _, side = found.message.partition(" they turn ")[2].partition("°")
    assert float(degrees) == pytest.approx(math.degrees(0.06 / 0.97 / 0.6), rel=0.2)
    assert side.startswith(" per metre too far to the right")


def test_two_sensors_that_agree_make_a_small_difference_of_the_wheels_sure() -> None:
    right = drive(5, robot(), truth=False)
    larger = rolled(right, right.wheels.rolled * [1.0, 0.965])
    shown = turnings(larger)
    several = [{name: shown[name] for name in names} for names in (("compass", "lrf"), ("compass",))]
    found = [f for some in several for f in of_ratio(larger, robot(), some, Least(0.005, 2.0))]
    assert [f.code for f in found] == [SURE_RATIO, RATIO]


@pytest.mark.parametrize("even", [True, False])
def test_a_larger_wheel_is_named_by_a_gyro_if_the_speed_varies(even: bool) -> None:
    """At an even speed the bias of the gyro looks the same."""
    right = drive(5, robot(), truth=False)
    rolled_more, (t, pose) = rolled(right, right.wheels.rolled * [1.0, 0.85]), path(1.0)
    warped = [one if even else one + 2.0 * np.sin(one / 2.5) for one in (right.wheels.t, t)]
    at = np.arange(0.0, warped[0][-1], 0.1)
    turned = np.interp(at, warped[1], pose[:, 2]) + 0.01 * at
    wheels, gyro = replace(rolled_more.wheels, t=warped[0]), readings(at, turned[:, None], 1e-3)
    larger = replace(rolled_more, wheels=wheels, measurements={"gyro": gyro})
    found = told(of_ratio(larger, robot(), turnings(larger)))
    assert found == ({} if even else {"wheels.ratio": pytest.approx(1.0 / 0.85, rel=0.03)})


@pytest.mark.parametrize("by", ["truth", "compass", "lrf"])
@pytest.mark.parametrize("scale", [0.94, 1.0])
def test_a_gyro_of_another_scale_is_named_by_headings_and_its_bias_is_not(by: str, scale: float) -> None:
    right = drive(5, robot(), truth=by == "truth")
    t, pose = path(1.0)
    at = np.arange(0.0, t[-1], 0.1)
    turned = np.interp(at, t, pose[:, 2]) / scale + 0.01 * at
    known = {name: m for name, m in right.measurements.items() if name == by}
    both = replace(right, measurements={**known, "gyro": readings(at, turned[:, None], 1e-3)})
    settings = replace(robot(), sensors={**robot().sensors, "gyro": GyroSettings(scale=0.5)})
    found = of_gyro(both, settings, and_truth(both, turnings(both)))
    assert [f.code for f in found] == ["gyro scale"] * (scale != 1.0)
    assert told(found).get("gyro.scale", 0.5) == pytest.approx(0.5 * scale, rel=0.01)
    alone = replace(right, truth=None, measurements={"gyro": both.measurements["gyro"]})
    assert of_gyro(alone, settings, turnings(alone)) == []


def test_a_wrong_track_or_range_scale_is_no_radius_and_a_straight_run_tells_no_track() -> None:
    right = drive(4, robot())
    m = right.measurements["lrf"]
    narrow = rolled(right, right.wheels.rolled, 0.8 * TRACK)
    slips = WallMotion(1.022, 0.003, 0.0, 0.003, 0.963, 0.01, 500)  # ranges x 0.98, turns wrong by slip
    for motion in (seen(right), seen(narrow), seen(right, replace(m, z=m.z * [0.9, 1.0])), slips):
        assert of_radius(motion, robot(), tried=True) == []
    # What the wheels tell of turning there is their noise.
    rng = np.random.default_rng(0)
    healthy = drive(5, robot())
    motion = seen(rolled(healthy, 0.006 + 0.001 * rng.normal(size=(len(healthy.wheels.t) - 1, 2))))
    assert motion is None or motion.turns is None


# turning


SENSES = {(1, 1): (1, -1), (-1, 1): (1, 1), (1, -1): (-1, -1), (-1, -1): (-1, 1)}  # signs of counters -> of a, b


@pytest.mark.parametrize("signs", SENSES)
def test_how_wheels_turn_the_robot_tells_which_one_counts_backward(signs: tuple[int, int]) -> None:
    """At constant speed, where both wheels move as one: turns are R - L over the track, whatever is counted."""
    t, pose = path(1.0)
    twist = se2.log(se2.between(pose[:-1], pose[1:]))
    ways = [np.concatenate(([0.0], np.cumsum(twist[:, 0] + side * 0.5 * TRACK * twist[:, 2]))) for side in (-1, 1)]
    wheels = Wheels.from_wheels(t, signs[0] * ways[0], signs[1] * ways[1], TRACK, 4e-4)
    found = present(explain(Headings(t[::5], np.unwrap(pose[::5, 2])), wheels))
    assert (found.a, found.b) == pytest.approx(tuple(sense / TRACK for sense in SENSES[signs]), rel=0.05)


# clocks


def late(drive: Drive, **by: float) -> Drive:
    """The drive with the stamps of some sensors, or of the truth, moved."""
    truth = truth_of(drive)
    m = {name: replace(m, t=m.t + by.get(name, 0.0)) for name, m in drive.measurements.items()}
    return replace(drive, measurements=m, truth=replace(truth, t=truth.t + by.get("truth", 0.0)))


def test_of_two_clocks_alone_nobody_knows_which_is_off() -> None:
    moved = late(drive(6, robot()), truth=0.3)
    (found,) = of_clocks(replace(moved, measurements={}), robot())
    assert (found.role, found.code) == ("truth", CLOCK)
    assert "(equivalent: wheels.time_offset=0.3" in found.message
    (found,) = of_clocks(moved, robot())
    assert found.role == "truth"
    assert "third clock" not in found.message  # compass and laser agree with the wheels


@pytest.mark.parametrize(
    ("by", "fixes"),
    [
        ({"compass": 0.3}, {"compass.time_offset": -0.3}),
        ({"compass": 0.2, "lrf": 0.2, "truth": 0.2}, {"wheels.time_offset": 0.2}),  # all others alike
        ({"compass": 0.2, "lrf": 0.2}, {"compass.time_offset": -0.2, "lrf.time_offset": -0.2}),  # two of three
    ],
)
def test_an_outvoted_clock_is_set_on_top_of_what_is_set(by: dict[str, float], fixes: dict[str, float]) -> None:
    found = of_clocks(late(drive(6, robot()), **by), robot())
    assert told(found) == pytest.approx(fixes, abs=0.03)
    assert found[0].severe
    if by == {"compass": 0.3}:
        settings = robot(compass={"time_offset": 0.5})
        found = of_clocks(late(drive(9, settings), **by), settings)
        assert told(found) == pytest.approx({"compass.time_offset": 0.2}, abs=0.03)


def test_clocks_that_agree_and_a_healthy_truth_are_not_mentioned() -> None:
    for seed in range(10, 15):
        assert of_clocks(drive(seed, robot()), robot()) == []
    for seed in range(19, 24):
        assert of_truth(drive(seed, robot()), robot()) == []


# truth


@pytest.mark.parametrize("headings", [True, False])
def test_where_the_drive_started_by_poses_and_by_points_only(headings: bool) -> None:
    healthy = drive(17, robot())
    truth = truth_of(healthy)
    start = present(start_pose(truth if headings else replace(truth, theta=None), healthy))
    assert start.pose[:2] == pytest.approx(START[:2], abs=0.01 if headings else 0.1)
    assert abs(se2.wrap(start.pose[2] - START[2])) < math.radians(1.0 if headings else 8.0)
    if not headings:  # nor does it depend on the wheels' metre
        larger = rolled(healthy, 1.2 * healthy.wheels.rolled, 1.2 * TRACK)
        assert present(start_pose(replace(truth, theta=None), larger)).pose == pytest.approx(start.pose, abs=0.01)


def test_headings_that_the_robot_does_not_drive_along_do_not_tell_where_it_started_to() -> None:
    healthy = drive(16, robot(), laps=1.5)
    truth = truth_of(healthy)
    assert truth.theta is not None
    turned = with_truth(healthy, theta=truth.theta + math.radians(4.0))
    elsewhere = replace(robot(), start=replace(robot().start, theta_deg=math.degrees(START[2]) + 20.0))
    found = of_truth(turned, elsewhere)
    fixes = told([f for f in found if f.code == "start"])
    assert fixes["start.theta_deg"] == pytest.approx(math.degrees(START[2]), abs=4.0)
    assert fixes["start.sigma_theta_deg"] == pytest.approx(4.0, abs=0.5)


@pytest.mark.parametrize(("x", "y"), [(0.0, 0.0), (0.3, 0.1)])
@pytest.mark.parametrize("seed", range(3))
def test_wheels_whose_turns_are_noisy_make_no_body_point(x: float, y: float, seed: int) -> None:
    """Their noise is in how far they turned; the truth knows that, and the point is what it is."""
    healthy = drive(18, robot(), laps=1.5)
    w, rng = healthy.wheels, np.random.default_rng(seed)
    turn = rng.normal(0.0, math.radians(5.0), len(w.t) - 1) * np.sqrt(np.diff(w.t))  # 5 degrees in a second
    noisy = rolled(healthy, w.rolled + np.outer(turn, (-0.5, 0.5)) * TRACK)
    found = of_truth(beside(noisy, x, y), robot())
    if x:
        assert told(found) == pytest.approx({"truth.x": x, "truth.y": y}, abs=0.05)
    else:
        assert "body point" not in {f.code for f in found}


def noisy(drive: Drive, sigma: float, sigma_deg: float) -> Drive:
    """The drive under a truth with white noise [m, deg]."""
    truth, rng = truth_of(drive), np.random.default_rng(4)
    theta = present(truth.theta) + rng.normal(0.0, math.radians(sigma_deg), len(truth.t))
    return with_truth(drive, xy=truth.xy + rng.normal(0.0, sigma, truth.xy.shape), theta=theta)


def aside(drive: Drive, when: Any) -> Drive:
    """The drive under a truth that lies 6 cm aside at some of its readings."""
    xy = truth_of(drive).xy
    return with_truth(drive, xy=xy + np.outer(np.isin(np.arange(len(xy)), when), [0.06, 0.0]))


def held(drive: Drive) -> Drive:
    """The drive under a truth that holds each pose for a second."""
    truth = truth_of(drive)
    rows = np.arange(len(truth.t)) // 10 * 10
    return with_truth(drive, xy=truth.xy[rows], theta=present(truth.theta)[rows])


Value = dict[str, float]
Change = Callable[[Drive], Drive]
TRUTHS: dict[str, tuple[Change, str, Value, dict[str, Any]]] = {  # change, code, fixes or none, within
    "a marker off the axle": (
        lambda d: beside(d, 0.06, 0.03),
        "body point",
        {"truth.x": 0.06, "truth.y": 0.03},
        {"abs": 0.003},
    ),
    "by positions alone": (
        lambda d: with_truth(beside(d, 0.3, 0.0), theta=None),
        "body point",
        {"truth.x": 0.3, "truth.y": 0.0},
        {"abs": 0.05},
    ),
    "positions of the axle": (lambda d: with_truth(d, theta=None), "body point", {}, {}),
    # by the path's shape 0.15 m is within the wheels' slip
    "a start elsewhere": (
        lambda d: with_truth(d, theta=None, xy=truth_of(d).xy + np.array([0.15, 0.0])),
        "start",
        {"start.x": START[0] + 0.15, "start.y": START[1]},
        {"abs": 0.01},
    ),
    "noise": (
        lambda d: noisy(d, 0.008, 0.5),
        "noise",
        {"truth.sigma": 0.008, "truth.sigma_theta_deg": 0.5},
        {"rel": 0.2},
    ),
    "noise of half a millimetre": (
        lambda d: noisy(d, 0.0005, 0.4),
        "noise",
        {"truth.sigma": 0.0005, "truth.sigma_theta_deg": 0.4},
        {"rel": 0.15},
    ),
    "noise like jumps": (lambda d: noisy(d, 0.25, 0.0), "noise", {"truth.sigma": 0.25}, {"rel": 0.15}),
    "noise is no jump": (lambda d: noisy(d, 0.25, 0.0), JUMP, {}, {}),
    "a reading that jumps and returns": (lambda d: aside(d, 200), STEP, {}, {}),
    "poses that are held": (held, STEP, {}, {}),
}


@pytest.mark.parametrize("case", TRUTHS)
def test_what_is_wrong_with_a_truth_is_named_with_its_value(case: str) -> None:
    change, code, fixes, within = TRUTHS[case]
    found = [f for f in of_truth(change(drive(18, robot(), laps=1.5)), robot()) if f.code == code]
    assert bool(found) == bool(fixes)
    assert {k: v for k, v in told(found).items() if k in fixes} == pytest.approx(fixes, **within)


@pytest.mark.parametrize("late", [0.0, 0.2, 0.4])
def test_positions_of_an_antenna_show_its_place_and_its_lag_together(late: float) -> None:
    """Where the speed changes, a lag and a point further back are two things."""
    rng, t = np.random.default_rng(4), np.arange(0.0, 90.0, 0.02)
    speed, rate = np.maximum(0.0, 0.25 + 0.4 * np.sin(0.5 * t)), np.sin(0.3 * t)
    twist = 0.02 * np.column_stack((speed, 0.0 * speed, rate))[1:]
    pose = se2.chain(se2.exp(twist))
    wheels = Wheels.from_twists(t, twist, TRACK, 4e-4)
    at = np.arange(2.0, 88.0, 0.2)
    xy = se2.compose(np.array([4.0, 1.0, 2.0]), se2.compose(pose, np.array([0.3, 0.1, 0.0])))[:, :2]
    places = np.stack([np.interp(at, t, c) for c in xy.T], axis=-1) + 0.02 * rng.normal(size=(len(at), 2))
    truth = Truth("/fix", at + late, places, None)
    seen = replace(drive(18, robot()), wheels=wheels, truth=truth)
    found = present(swing_by_positions(truth, seen))
    assert found.x[:2] == pytest.approx([0.3, 0.1], abs=0.01)
    assert (found.lag is not None) == bool(late)
    if found.lag:
        assert found.lag[0] == pytest.approx(-late, abs=0.03)
        assert present(truth_lag(seen)).offset == pytest.approx(-late, abs=0.03)


def test_wheels_that_creep_sideways_are_named_by_the_truth() -> None:
    healthy = drive(18, robot(), laps=1.5)
    xy = truth_of(healthy).xy
    step = np.diff(xy, axis=0)
    aside = np.pad(0.02 * np.stack((-step[:, 1], step[:, 0]), axis=-1), ((1, 0), (0, 0)))
    (found,) = of_truth(with_truth(healthy, xy=xy + aside.cumsum(axis=0)), robot())
    assert (found.role, found.code, found.fixes) == ("wheels", "sideways", ())
    aside_deg = float(found.message.partition("drives ")[2].partition("°")[0])
    assert aside_deg == pytest.approx(math.degrees(0.02), abs=0.1)
    assert "to the left of where it points" in found.message


@pytest.mark.parametrize("off_deg", [-8.0, 90.0, 180.0])
def test_a_tracked_body_that_is_turned_on_the_robot_is_named_and_its_scale_is_not(off_deg: float) -> None:
    healthy = drive(18, robot(), laps=1.5)
    truth = truth_of(healthy)
    turned = with_truth(healthy, theta=present(truth.theta) + math.radians(off_deg))
    (found,) = of_truth(turned, robot())
    assert (found.role, found.code, found.severe) == ("truth", "body yaw", True)
    assert math.cos(math.radians(told([found])["truth.yaw_deg"] - off_deg)) == pytest.approx(1.0, abs=2e-4)
    assert of_size(turned, seen(turned)) == []


@pytest.mark.parametrize("headings", [True, False])
@pytest.mark.parametrize("seed", range(3))
def test_a_truth_that_steps_aside_once_is_named(seed: int, headings: bool) -> None:
    healthy = drive(20 + seed, robot())
    healthy = healthy if headings else with_truth(healthy, theta=None)
    assert of_truth(healthy, robot()) == []
    truth = truth_of(healthy)
    aside = np.where(truth.t[:, None] > 30.0, [0.05, -0.06], 0.0)
    (found,) = of_truth(with_truth(healthy, xy=truth.xy + aside), robot())
    assert found.code == "step"
    assert "at 30." in found.message


@pytest.mark.parametrize("seed", range(3))
def test_a_smaller_step_beside_a_sure_one_is_named_too(seed: int) -> None:
    """As by a SLAM that closes two loops: the noise of 10 mm makes steps of 14 mm."""
    healthy = drive(20 + seed, robot())
    truth = truth_of(healthy)
    noisy = truth.xy + 0.01 * np.random.default_rng(seed).normal(size=truth.xy.shape)

    def steps(aside: float) -> list[str]:
        xy = noisy + np.outer(truth.t > 15.0, [0.0, 0.17]) + np.outer(truth.t > 35.0, [aside, 0.0])
        return [f.message for f in of_truth(with_truth(healthy, xy=xy), robot()) if f.code == STEP]

    assert steps(0.0) == []
    (found,) = steps(0.27)
    assert [part in found for part in ("m at 15.", "m at 35.")] == [True, True]
    assert "errors after the first of these are the truth's" in found


@pytest.mark.parametrize("headings", [True, False])
def test_another_body_that_is_tracked_for_ten_seconds_can_be_left_out(headings: bool) -> None:
    """The start that is named beside it is that of the right body."""
    off = replace(robot(), start=StartSettings(x=START[0] - 1.0, y=START[1], theta_deg=math.degrees(START[2])))
    healthy = drive(20, off)
    healthy = healthy if headings else with_truth(healthy, theta=None)
    truth = truth_of(healthy)
    other = (truth.t > 30.0) & (truth.t < 40.0)
    two = with_truth(healthy, xy=np.where(other[:, None], [6.0, -4.0], truth.xy))
    found = of_truth(two, off)
    (jump,) = (f for f in found if f.code == JUMP)
    assert f"{other.sum()} readings can be left out" in jump.message
    assert told(found)["start.x"] == pytest.approx(START[0], abs=0.03)
    limit = np.full(len(truth.t) - 1, 0.1)
    np.testing.assert_array_equal(elsewhere(truth.t, truth_of(two).xy, limit), other)
    stays = truth.xy + np.where(truth.t > 30.0, 3.0, 0.0)[:, None] + np.where(truth.t >= 40.0, 3.0, 0.0)[:, None]
    assert not elsewhere(truth.t, stays, limit).any()


@pytest.mark.parametrize(("sigma_deg", "named"), [(0.0, True), (1.0, True), (4.0, False)])
def test_a_start_four_degrees_off_is_named_unless_its_sigma_says_so(sigma_deg: float, named: bool) -> None:
    healthy = drive(22, robot())
    off = math.degrees(START[2]) - 4.0
    start = StartSettings(x=START[0], y=START[1], theta_deg=off, sigma_theta_deg=sigma_deg)
    found = told(of_truth(healthy, replace(robot(), start=start)))
    assert ("start.theta_deg" in found) == named
    if named:
        assert found["start.theta_deg"] == pytest.approx(math.degrees(START[2]), abs=0.5)


@pytest.mark.parametrize("place", [0.0, 5e-324])
def test_a_truth_that_does_not_move_measures_no_wheels(place: float) -> None:
    healthy = drive(1, robot())
    assert truth_checks.wheels_metre(healthy) is not None
    rng = np.random.default_rng(1)
    still = with_truth(healthy, xy=place * rng.integers(0, 3, truth_of(healthy).xy.shape))
    assert truth_checks.wheels_metre(still) is None
    assert truth_checks.metre(still, robot()) == (1.0, [])
    assert of_size(still, seen(still)) == []


@pytest.mark.parametrize("factor", [0.95, 1.05])
def test_an_odometry_s_wrong_radius_or_track_is_the_wheels_and_not_the_laser_s(factor: float) -> None:
    """Without a radius and a track of its own it has two scales; the laser stays as it is."""
    right, settings = drive(4, robot(), laps=3.0), robot().wheels
    driver = replace(robot(), wheels=replace(settings, radius=None, track=None))
    long = rolled(right, factor * right.wheels.rolled, TRACK * factor)
    found = scales(long, driver, turnings(long))
    assert [(f.role, f.code) for f in found] == [("wheels", "wheel scale")]
    assert told(found)["wheels.scale"] == pytest.approx(1.0 / factor, abs=0.005)
    turned = rolled(right, right.wheels.rolled, TRACK / factor**4)
    found = scales(turned, driver, turnings(turned))
    assert [(f.role, f.code) for f in found] == [("wheels", "track")]
    assert told(found)["wheels.turn_scale"] == pytest.approx(factor**-4, rel=0.01)
    assert ("too far by the truth" in found[0].message) == (factor > 1.0)
    for one in (long, turned):
        estimated = replace(driver, wheels=replace(driver.wheels, estimate=True))
        assert scales(one, estimated, turnings(one)) == []


@pytest.mark.parametrize(
    ("truth", "wheels", "named"),
    [(1.045, 1.0, True), (1.02, 1.0, True), (1.0, 1.02, False), (1.1, 1.1, False), (1.01, 1.0, False)],
)
def test_a_truth_whose_size_wheels_and_laser_both_deny_is_wrong(truth: float, wheels: float, named: bool) -> None:
    """Where only the wheels are wrong, the laser denies them; where both are right, a small error is no reason."""
    healthy = drive(4, robot(), laps=3.0)
    own = rolled(healthy, wheels * healthy.wheels.rolled, TRACK * wheels)
    scaled = with_truth(own, xy=truth * truth_of(own).xy)
    found = of_size(scaled, seen(scaled))
    assert [(f.role, f.code, f.fixes, f.severe) for f in found] == ([("truth", SIZE, (), True)] if named else [])
    sizes = scales(scaled, robot(), turnings(scaled))
    assert (("truth", SIZE) in {(f.role, f.code) for f in sizes}) == named
    assert not named or not told(sizes)


@pytest.mark.parametrize(("every", "spoil"), [(400, False), (50, True)])
def test_a_truth_with_a_jump_in_more_than_one_of_a_hundred_steps_judges_nothing(every: int, spoil: bool) -> None:
    healthy = drive(1, robot())
    assert truth_checks.jumps_of(healthy) is None
    truth = truth_of(healthy)
    moved = 4.0 * (np.arange(len(truth.t)) // every % 2)
    found = present(truth_checks.jumps_of(with_truth(healthy, xy=truth.xy + moved[:, None])))
    assert (found.number, found.steps) == ((len(truth.t) - 1) // every, len(truth.t) - 1)
    assert found.unusable is spoil


@pytest.mark.parametrize(
    ("factor", "unit"), [(1000.0, "mm"), (100.0, "cm"), (0.001, "km"), (1.0, None), (1.2, None), (10.0, None)]
)
def test_a_truth_that_is_not_in_metres_is_named_by_its_unit(factor: float, unit: str | None) -> None:
    healthy = drive(1, robot())
    scaled = with_truth(healthy, xy=factor * truth_of(healthy).xy)
    found = of_unit(scaled)
    assert [(f.role, f.code, f.fixes, f.severe) for f in found] == ([("truth", UNIT, (), True)] if unit else [])
    assert unit is None or f"its unit looks like {unit}." in found[0].message
    assert unit is None or truth_checks.unusable(scaled) == found[0]
    # the same ratio by wheels of a radius in another unit: then the truth is right
    assert of_unit(rolled(healthy, healthy.wheels.rolled / factor, TRACK / factor)) == []


@pytest.mark.parametrize("height", [0, 1])
def test_a_truth_with_its_height_in_place_of_an_axis_judges_nothing(height: int) -> None:
    healthy = drive(1, robot())
    assert of_axes(healthy) == []
    xy = truth_of(healthy).xy.copy()
    xy[:, height] = 0.31 + 0.002 * np.sin(np.arange(len(xy)))
    found = present(truth_checks.unusable(with_truth(healthy, xy=xy)))
    assert f"its {'xy'[height]} changes by 0.00 m only, while the robot covers" in found.message
    # a corridor by wheels that turn wrongly: both moved equally far
    corridor = np.stack((healthy.wheels.driven(truth_of(healthy).t), xy[:, 1] * 0.0), axis=-1)
    assert of_axes(with_truth(healthy, xy=corridor)) == []


def test_a_truth_of_another_robot_is_named_and_a_truth_whose_headings_are_wrong_is_not() -> None:
    healthy, backwards = drive(1, robot()), slice(None, None, -1)
    truth = truth_of(healthy)
    theta = present(truth.theta)
    other = with_truth(healthy, xy=truth.xy[backwards], theta=theta[backwards])
    found = present(truth_checks.unusable(other))
    assert (found.code, found.severe) == (truth_checks.OTHER, True)
    assert found.message.startswith("the wheels explain 0% of its turns, and ")
    alone = replace(other, measurements={})  # the wheels may be wrong
    for right in (healthy, with_truth(healthy, theta=theta[backwards]), alone):
        assert truth_checks.unusable(right) is None


def test_a_scale_that_no_laser_has_gets_no_fix_and_a_path_of_another_shape_has_none() -> None:
    assert range_fix(robot(), 1.1) == ("lrf.range_scale=1.1",)
    assert range_fix(robot(), 0.27) == range_fix(robot(), 4.0) == ()
    motion = present(seen(drive(1, robot())))._replace(scale=4.2)
    (found,) = of_laser(motion, robot(), by_truth=True)
    assert (found.code, found.fixes) == ("range scale", ())
    # A mirror image of a path, fitted by a similarity, looks much too large.
    healthy = drive(1, robot())
    xy = truth_of(healthy).xy
    right, mirrored = (cast("Any", SimpleNamespace(truth_pose=xy * [1.25, 1.25 * y])) for y in (1.0, -1.0))
    assert path_scale(right, healthy) == pytest.approx(0.8)
    assert path_scale(mirrored, healthy) is None


def test_the_noise_of_a_truth_is_measured_at_rest_unless_it_is_told() -> None:
    session = locfuse.load("rounded_triangle", between=(None, 20.0))
    truth, rng = truth_of(session.drive), np.random.default_rng(25)
    assert truth.theta is not None
    xy = truth.xy + rng.normal(0.0, 0.006, truth.xy.shape)
    noisy = replace(truth, xy=xy, theta=truth.theta + rng.normal(0.0, math.radians(0.4), len(truth.t)))
    (found,) = of_truth(replace(session.drive, truth=noisy), session.robot)
    assert found.code == "noise"
    assert told([found]) == pytest.approx({"truth.sigma": 0.006, "truth.sigma_theta_deg": 0.4}, rel=0.15)
    assert not found.severe  # it spoils no estimate
    (found,) = of_truth(replace(session.drive, truth=replace(noisy, theta=None)), session.robot)
    assert told([found]) == pytest.approx({"truth.sigma": 0.006}, rel=0.15)  # no heading, no noise of it
    known = replace(noisy, sigma=0.006, sigma_theta=math.radians(0.4))
    assert of_truth(replace(session.drive, truth=known), session.robot) == []


# smaller instruments


@pytest.mark.parametrize(("roll", "pitch"), [(0, 0), (90, 0), (180, 0), (-90, 0), (0, 90), (0, -90), (30, -20)])
def test_gravity_tells_roll_and_pitch(roll: int, pitch: int) -> None:
    up = present(by_gravity(9.81 * np.tile(rotation_3d(roll, pitch, 0.0)[2], (20, 1))))
    assert angles(up) == (roll, pitch)


def test_gaps_are_silences_of_several_periods_and_what_is_not_gravity_tells_no_mount() -> None:
    t = np.concatenate((np.arange(0.0, 5.0, 0.1), np.arange(7.0, 9.0, 0.1)))
    ((start, end),) = gaps(t)
    assert (start, end) == pytest.approx((4.9, 7.0))
    assert gaps(np.arange(0.0, 30.0, 3.0)) == []
    assert by_gravity(np.zeros((20, 3))) is None
    assert by_gravity(np.full((20, 3), np.nan)) is None


def test_a_finding_says_what_an_error_says_and_names_another_role() -> None:
    words, hint = "2 topics fit: /a, /b.", "Choose one with --set lrf.topic=/a"
    error = LocfuseError(words, role="lrf", fixes=("lrf.topic=/a",), hint=hint)
    assert str(error) == "lrf: 2 topics fit: /a, /b. Choose one with --set lrf.topic=/a"
    finding = of_error(error, "lrf", "choice")
    known = finding.role, finding.code, finding.fixes, finding.severe
    assert known == ("lrf", "choice", ("lrf.topic=/a",), True)
    assert finding.sentence == "2 topics fit: /a, /b. Choose one with --set lrf.topic=/a"
    assert finding.brief == "2 topics fit: /a, /b"  # what says how is printed below it
    assert of_error(LocfuseError("no way", role="wheels"), "log", "unusable").message == "wheels: no way"
    assert of_error(LocfuseError("bag.mcap: cut short"), "log", "unusable").message == "bag.mcap: cut short"


def test_an_error_survives_the_way_between_processes() -> None:
    error = UsageError("no such path:", fixes=("lrf.map=grow",), hint="see --help")
    again = pickle.loads(pickle.dumps(error))
    assert (type(again), str(again), again.hint, again.fixes) == (
        UsageError,
        "no such path: see --help",
        "see --help",
        ("lrf.map=grow",),
    )


# --- a laser that is bumped while driving, by walls whose distances are those of a turned laser

WALLS, BUMP_S = 600, 41.0


def walls(degrees: float, seed: int, scale: float = 1.0, noise: float = 0.01) -> WallPairs:
    """Return walls of a drive of 100 s whose laser turns by so much on the robot at BUMP_S."""
    rng = np.random.default_rng(seed)
    t, normal = np.linspace(0.0, 100.0, WALLS), rng.uniform(-math.pi, math.pi, WALLS)
    heading = rng.uniform(-0.2, 0.2, WALLS)  # in which the robot moves, in its own frame
    yaw = math.radians(2.0) + np.where(t < BUMP_S, 0.0, math.radians(degrees))
    # a wall whose normal is thought to lie at `normal` lies further to the left by the laser's real yaw
    nearer = 0.3 * np.cos(normal + yaw - heading) / scale + rng.normal(0.0, noise, WALLS)
    n, d = (np.stack((np.cos(a), np.sin(a)), axis=-1) for a in (normal, heading))
    return WallPairs(nearer, n, 0.3 * d, np.zeros(WALLS), np.zeros(WALLS), t, t)


@pytest.mark.parametrize("scale", [1.0, 1.1])
@pytest.mark.parametrize("degrees", [-8.0, 3.0, 6.0])
def test_a_bump_is_found_with_its_time_and_angle(degrees: float, scale: float) -> None:
    found = present(bumped(walls(degrees, 1, scale), scale))
    assert found[0] == pytest.approx(BUMP_S, abs=3.0)
    assert math.degrees(found[1]) == pytest.approx(degrees, abs=0.7)


def test_a_robot_that_hardly_moves_for_a_while_hides_no_bump() -> None:
    """The walls of the first and of the sixth ten seconds tell no direction: 1 cm of way, 1 cm of noise."""
    few = walls(6.0, 1)
    stands = (few.t < 10.0) | ((few.t > 50.0) & (few.t < 60.0))
    d = np.where(stands[:, None], 0.03 * few.d, few.d)
    y = np.where(stands, np.random.default_rng(2).normal(0.0, 0.01, WALLS), few.y)
    found = present(bumped(few._replace(y=y, d=d), 1.0))
    assert found[0] == pytest.approx(BUMP_S, abs=3.0)
    assert math.degrees(found[1]) == pytest.approx(6.0, abs=1.0)


@pytest.mark.parametrize("seed", range(20))
def test_a_laser_that_stays_where_it_is_was_not_bumped(seed: int) -> None:
    assert bumped(walls(0.0, seed, noise=0.03), 1.0) is None
    assert bumped(WallPairs(*(column[::20] for column in walls(8.0, seed))), 1.0) is None  # too few


def test_wheels_that_slip_for_seconds_at_a_time_are_hardly_ever_a_bump() -> None:
    """The direction in which they say that the robot moved is off by 1.5 degrees, by another angle every 5 s."""
    found = 0
    for seed in range(100):
        slips = np.repeat(np.random.default_rng(100 + seed).normal(0.0, math.radians(1.5), 20), WALLS // 20)
        still = walls(0.0, seed)
        c, s = np.cos(slips), np.sin(slips)
        x, y = still.d.T
        d = np.stack((c * x - s * y, s * x + c * y), axis=-1)
        found += bumped(still._replace(d=d), 1.0) is not None
    assert found <= 3


@pytest.mark.parametrize("begin", [0, WALLS // 2])
def test_a_mount_3_cm_off_is_no_bump_where_the_robot_drives_a_curve(begin: int) -> None:
    """In a fourth of the drive it turns by 20 degrees from scan to scan, and the laser swings."""
    still, turn = walls(0.0, 1, noise=0.002), math.radians(20.0)
    curve = (np.arange(WALLS) >= begin) & (np.arange(WALLS) < begin + WALLS // 4)
    off = np.array([-0.03, 0.0])
    swing = se2.compose(np.array([0.0, 0.0, turn]), np.array([*off, 0.0]))[:2] - off
    nearer = still.y + np.where(curve, still.n @ swing, 0.0)
    assert bumped(still._replace(y=nearer, by_wheels=np.where(curve, turn, 0.0)), 1.0) is None


# a truth that jumps, repeats itself, or is far from the wheels' time


@pytest.mark.parametrize("size", [0.15, 0.8])
def test_one_step_of_the_truth_is_named_beside_wheels_that_slip_often(size: float) -> None:
    right = drive(5, robot())
    slips = right.wheels.rolled + 0.05 * (np.arange(len(right.wheels.rolled)) % 100 == 0)[:, None]
    slipping, truth = rolled(right, slips), truth_of(right)
    assert STEP not in {f.code for f in of_truth(slipping, robot())}
    aside = truth.xy + np.outer(truth.t > 30.0, [0.0, size])
    found = [f for f in of_truth(with_truth(slipping, xy=aside), robot()) if f.code in {STEP, JUMP}]
    assert [f.code for f in found] == [STEP]
    said, when = found[0].message.partition("aside by ")[2].split(" s, ")[0].split(" m at ")
    assert float(said) == pytest.approx(size, abs=0.03)
    assert float(when) == pytest.approx(30.0, abs=0.2)


def test_a_start_is_measured_on_the_clock_that_is_set_with_it() -> None:
    healthy = drive(5, robot())
    late = with_truth(healthy, t=truth_of(healthy).t + 0.5)
    streams = {"wheels": ArrayStream("/joint_states", "sensor_msgs/msg/JointState", np.zeros(0, np.int64), {})}
    alone = replace(late, measurements={})
    codes = {f.code: f.fixes for f in examine(alone, robot(), streams)}
    assert float(codes["lag"][0].removeprefix("truth.time_offset=")) == pytest.approx(-0.5, abs=0.02)
    assert "start" not in codes
    assert "start" in {f.code for f in of_truth(alone, robot())}


@pytest.mark.parametrize("share", [0.2, 0.9])
def test_a_sensor_that_ends_early_is_named(share: float) -> None:
    healthy = drive(5, robot(), truth=False)
    t = healthy.measurements["compass"].t
    few = healthy.measurements["compass"].take(np.flatnonzero(t < share * t[-1]))
    empty = ArrayStream("/topic", "std_msgs/msg/Float64", np.zeros(0, np.int64), {})
    streams = {"wheels": empty, "compass": empty}
    found = examine(replace(healthy, measurements={"compass": few}), robot(), streams)
    assert ("covers" in {f.code for f in found}) == (share < 0.5)
