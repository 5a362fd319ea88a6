"""The wheels' noise by how their turning leaves that of other sensors: held to drives whose noise is known."""

import math
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from msgspec.structs import replace
from present import present
from small_drive import NOISE, drive, robot

from locfuse.cli.session.session import Session, load
from locfuse.fusion import se2
from locfuse.fusion.checks.examine import holes, longest_part, of_carried, unseen
from locfuse.fusion.checks.finding import Finding
from locfuse.fusion.checks.laser import WallMotion
from locfuse.fusion.checks.raw_data import STUCK, of_signs, of_stuck_wheel, of_wheel_unit
from locfuse.fusion.checks.slip import LONG_S, MAX_FACTOR, SHORT_S, beside_path, of_spins, slip
from locfuse.fusion.checks.tracked_point import of_odometry
from locfuse.fusion.checks.turning import MIRROR, SWAPPED, Turning, observed_track, of_turning
from locfuse.fusion.data import Array, Drive
from locfuse.fusion.robot import WheelSettings
from locfuse.fusion.wheels.calibrate import truth_sigma
from locfuse.fusion.wheels.motion import Wheels
from locfuse.fusion.wheels.read import SPEEDS_ALONE
from locfuse.sample_logs.scenario import load as scenario_of
from locfuse.sample_logs.simulate import on_truth, write_log


def drawn(seed: int = 0, laps: float = 2.0, compass_noise_deg: float = 1.0) -> Drive:
    return drive(seed, robot(), ("compass",), laps=laps, compass_noise_deg=compass_noise_deg, truth=False)


def configured(drawn: Drive, factor: float) -> Drive:
    """The same drive under another wheels.noise."""
    return replace(drawn, wheels=replace(drawn.wheels, noise=factor * NOISE))


@pytest.mark.parametrize("noise_deg", [0.3, 1.0])
@pytest.mark.parametrize("factor", [1 / 9, 1.0, 9.0])
def test_the_noise_that_was_drawn_is_found_whatever_is_configured(factor: float, noise_deg: float) -> None:
    """Five drives' geometric mean: one drive of 105 s knows it to a third."""
    found = [present(slip(configured(drawn(i, compass_noise_deg=noise_deg), factor))) for i in range(5)]
    assert np.exp(np.mean([np.log(one.factor) for one in found])) == pytest.approx(1.0 / factor, rel=0.35)
    assert factor == 1.0 or all(one.unusual for one in found)


def test_what_is_seen_and_expected_are_turns_over_the_long_window() -> None:
    """On a straight 2 sqrt(v T k) / track: each wheel rolls v T."""
    found = present(slip(drawn()))
    assert found.expected == pytest.approx(np.sqrt(2.0 * 0.3 * LONG_S * NOISE) / 0.6, rel=0.1)
    assert found.seen == pytest.approx(found.expected * np.sqrt(found.factor))
    assert "wheels.noise says" in found.words


def test_rare_slips_do_not_make_wheels_look_better_than_they_are() -> None:
    """Wheels that are exact but for a slip of 5 degrees every 10 s: as much variance, and hardly ever seen."""
    one = drawn(1, compass_noise_deg=0.05)
    m = one.measurements["compass"]
    jumps = np.random.default_rng(1).choice([-1.0, 1.0], 12) * np.radians(5.0)
    turned = np.cumsum(jumps)[np.minimum((m.t // 10.0).astype(int), 11)]
    z = (one.wheels.heading(m.t) + turned)[:, None]
    found = present(slip(replace(one, measurements={"compass": replace(m, z=z)})))
    assert 1.0 / MAX_FACTOR <= found.factor <= 1.0


def test_a_wrong_track_is_no_noise() -> None:
    one = drawn(2)
    wide = replace(one.wheels, pose=one.wheels.pose * [1.0, 1.0, 0.9])
    right, wrong = present(slip(one)), present(slip(replace(one, wheels=wide)))
    assert wrong.factor == pytest.approx(right.factor, rel=0.01)


def test_a_short_drive_a_still_heading_and_no_sensor_that_turns_tell_nothing() -> None:
    short = drawn(3, laps=0.3)
    assert short.wheels.t[-1] < 15 * LONG_S
    assert slip(short) is None
    assert slip(replace(drawn(3), measurements={})) is None
    one = drawn()
    m = one.measurements["compass"]
    still = replace(one, measurements={"compass": replace(m, z=np.zeros_like(m.z))})
    assert slip(still) is None


def test_readings_across_a_gap_are_not_compared() -> None:
    """Every other 3 s are missing: what lies further apart than the window is left out."""
    one = drawn(4)
    m = one.measurements["compass"]
    kept = np.flatnonzero(m.t % 6.0 < 3.0)
    found = present(slip(replace(one, measurements={"compass": m.take(kept)})))
    assert SHORT_S < LONG_S < 3.0
    assert found.factor == pytest.approx(1.0, abs=0.6)


def test_two_sensors_that_see_less_slip_vouch_for_the_larger_of_their_answers() -> None:
    one = configured(drive(5, robot(), ("compass", "lrf"), laps=2.0, truth=False), 9.0)
    alone = [present(slip(replace(one, measurements={k: one.measurements[k]}))) for k in ("compass", "lrf")]
    both = present(slip(one))
    assert both.by == "compass and lrf"
    assert both.factor == max(found.factor for found in alone)


def test_sensors_that_disagree_about_slip_vouch_for_nothing() -> None:
    """The compass' own errors wander: what it sees beyond the laser is not the wheels'."""
    one = configured(drive(6, robot(), ("compass", "lrf"), laps=2.0, truth=False), 9.0)
    m = one.measurements["compass"]
    walk = np.cumsum(np.random.default_rng(6).normal(size=len(m.t))) * np.radians(1.0)
    wandering = {**one.measurements, "compass": replace(m, z=m.z + walk[:, None])}
    found = present(slip(replace(one, measurements=wandering)))
    assert found.by == "lrf"


@pytest.mark.parametrize("noise", [0.0, 4.0 * NOISE])
def test_noise_ahead_counts_where_the_turns_show_less(noise: float) -> None:
    """A path beside which the wheels err ahead by `noise`, and in turns by NOISE: variances of a wheel."""
    one = configured(drawn(7), 12.0)
    turns = present(slip(one))
    assert turns.unusual
    t = np.arange(one.wheels.t[0], one.wheels.t[-1], 0.1)
    steps = one.wheels.relative(t[:-1], t[1:])
    steps[:, 0] += np.random.default_rng(7).normal(size=len(steps)) * np.sqrt(0.5 * noise * np.abs(steps[:, 0]))
    found = beside_path(turns, one, t, se2.chain(steps))
    if noise:
        assert found.factor == pytest.approx(4.0 / 12.0, rel=0.35)
        assert " mm in 2 s" in found.words
    else:
        assert found == turns


def test_wheels_that_spin_together_are_named_with_their_time_and_way() -> None:
    """A path that stands still for a second, from 40 s on, while the wheels roll on at 0.3 m/s."""
    one = drawn(3)
    t = one.wheels.t
    stood = np.clip(t - 40.0, 0.0, 1.0)
    path = one.wheels.at(t - stood)[2]
    (found,) = of_spins(one, t, path, "truth")
    first, last, way = (float(word.strip("s,:")) for word in found.message.split() if word[0].isdigit())
    assert first == pytest.approx(40.0, abs=1.1)
    assert last == pytest.approx(41.0, abs=1.1)
    assert way == pytest.approx(0.3, rel=0.15)
    assert "farther than the truth moved" in found.message
    assert not of_spins(one, t, path, "truth", jumps=[40.5])


@pytest.mark.parametrize("scale", [0.9, 1.0, 1.1])
@pytest.mark.parametrize("late_s", [0.0, 0.2])
def test_a_wrong_radius_or_a_late_clock_is_no_spin(scale: float, late_s: float) -> None:
    one = drawn(4)
    t = one.wheels.t
    path = one.wheels.at(np.maximum(t - late_s, 0.0))[2] * [scale, scale, 1.0]
    assert not of_spins(one, t, path, "truth")


@pytest.mark.parametrize("seed", range(4))
def test_a_compass_that_is_too_noisy_to_see_slips_calls_none_unusual(seed: int) -> None:
    """Of 6 degrees a reading, the difference of two turns tells nothing of slips of half a degree."""
    found = slip(drawn(seed, compass_noise_deg=6.0))
    assert found is None or not found.unusual


# --- an encoder that holds its value


def held(one: Drive, side: int, begin: float, end: float) -> Drive:
    """The drive with one wheel (0: left) that counts nothing between two times [s]."""
    rolled = np.where((one.wheels.t[:-1] < begin) | (one.wheels.t[:-1] >= end), 1.0, np.arange(2)[:, None] != side)
    return replace(one, wheels=one.wheels.rerolled(one.wheels.rolled * rolled.T, one.wheels.track))


@pytest.mark.parametrize(("side", "word"), [(0, "left"), (1, "right")])
@pytest.mark.parametrize("begin", [0.0, 40.0])
def test_a_wheel_that_stands_while_the_other_rolls_is_named_and_when(side: int, word: str, begin: float) -> None:
    one = drawn(8)
    (found,) = of_stuck_wheel(held(one, side, begin, np.inf))
    end = float(one.wheels.t[-1])
    assert f"the {word} wheel stands still from {begin:.1f} s to {end:.1f} s" in found.message
    assert (found.code, found.severe) == (STUCK, True)
    assert not of_stuck_wheel(one)


def test_a_robot_that_turns_about_one_wheel_has_no_stuck_wheel() -> None:
    """The compass saw three whole turns about the left wheel while only the right one rolled."""
    t = np.arange(0.0, 40.0, 0.05)
    heading = np.clip(t - 5.0, 0.0, 30.0) * 2.0 * np.pi / 10.0
    wheels = Wheels.from_wheels(t, np.zeros(len(t)), 0.6 * heading, 0.6, NOISE)
    one = drawn(9)
    compass = one.measurements["compass"].take(np.arange(len(t)))
    turning = replace(one, wheels=wheels, measurements={"compass": replace(compass, t=t, z=heading[:, None])})
    assert not of_stuck_wheel(turning)
    assert of_stuck_wheel(replace(turning, measurements={}))


def test_a_short_time_in_which_one_wheel_stands_is_a_manoeuvre_unless_a_sensor_says_no() -> None:
    """Until the other wheel has rolled 2 pi times the track, the robot may be turning about the standing one."""
    one = drawn(8)
    seconds = 2.0 * np.pi * 0.6 / 0.3
    short = held(one, 0, 20.0, 20.0 + 0.8 * seconds)
    assert not of_stuck_wheel(replace(short, measurements={}))
    assert of_stuck_wheel(short)
    assert of_stuck_wheel(replace(held(one, 0, 20.0, 20.0 + 1.3 * seconds), measurements={}))


@pytest.mark.parametrize("known", ["headings", "places", "compass"])
def test_a_wheel_that_stands_in_bursts_is_named_by_the_truth_or_a_compass(known: str) -> None:
    """For 1.5 s from 4, 30 and 56 s on, each time on a straight: the other wheel turns the robot by 0.75 rad."""
    one = drive(8, robot(), ("compass",), laps=2.0)
    truth = present(one.truth)
    if known == "compass":
        one = replace(one, truth=None)
    else:
        theta = truth.theta if known == "headings" else None
        one = replace(one, truth=replace(truth, theta=theta), measurements={})
    burst = one
    for begin in (4.0, 30.0, 56.0):
        burst = held(burst, 1, begin, begin + 1.5)
    (found,) = of_stuck_wheel(burst)
    stands = "right wheel stands still from 4.0 s to 5.5 s (the first of 3 times), while the other one"
    assert stands in found.message
    assert not of_stuck_wheel(one)


def test_both_counters_that_stand_while_the_truth_moves_are_named() -> None:
    one = drive(8, robot(), (), laps=2.0)
    stopping = held(held(one, 0, 20.0, 24.0), 1, 20.0, 24.0)
    (found,) = of_stuck_wheel(stopping)
    assert "both wheels stand still from 20.0 s to 24.0 s, while the truth moves 1.2 m" in found.message
    # a robot that stops slowly and is carried
    slow = np.where((one.wheels.t[:-1] > 19.0) & (one.wheels.t[:-1] < 20.0), 0.05, 1.0)[:, None]
    carried = one.wheels.rerolled(stopping.wheels.rolled * slow, 0.6)
    assert not of_stuck_wheel(replace(one, wheels=carried))


@pytest.mark.parametrize("shown_by", ["truth", "laser"])
@pytest.mark.parametrize("seconds", [14.4, 2.0])
def test_a_robot_that_is_carried_while_its_wheels_stand_is_named(shown_by: str, seconds: float) -> None:
    """It is carried along 14.4 s of its path at 0.3 m/s, and drives on."""
    one = drive(8, robot(), laps=2.0)
    one = one if shown_by == "truth" else replace(one, truth=None)
    held_, end = held(held(one, 0, 20.0, 34.4), 1, 20.0, 34.4), 20.0 + seconds

    def faster(t: Array) -> Array:
        return np.where(t > 34.4, t - 34.4 + end, np.where(t > 20.0, 20.0 + (t - 20.0) * seconds / 14.4, t))

    seen = {name: replace(m, t=faster(m.t)) for name, m in one.measurements.items()}
    truth = None if one.truth is None else replace(one.truth, t=faster(one.truth.t))
    wheels = replace(held_.wheels, t=faster(one.wheels.t))
    carried = replace(held_, wheels=wheels, truth=truth, measurements=seen)
    assert not of_carried(one)
    (found,) = of_carried(carried)
    assert f"they stand still from 20.0 s to {end:.1f} s" in found.message
    assert ("the truth moves" in found.message, "the laser turns" in found.message) == (shown_by == "truth", True)
    assert found.severe
    if shown_by == "truth":  # its turn in the meantime is not its noise
        assert truth_sigma(present(carried.truth), carried.wheels).theta < math.radians(1.0)


@pytest.mark.parametrize("late", [-1.2, 1.2])
def test_a_late_truth_does_not_show_that_a_standing_robot_is_carried(late: float) -> None:
    """It drives 0.36 m in that time."""
    one = drive(8, robot(), (), laps=2.0)
    standing, truth = held(held(one, 0, 20.0, 23.0), 1, 20.0, 23.0), present(one.truth)
    at = np.clip(truth.t - late, 0.0, one.wheels.t[-1])
    assert not of_carried(replace(standing, truth=replace(truth, xy=standing.wheels.at(at)[2][:, :2])))


# --- wheels in other units


@pytest.mark.parametrize(
    ("factor", "repairs", "ticks"),
    [
        (57.3, (), 360),
        (57.3, (SPEEDS_ALONE,), 360),
        (9.549, (SPEEDS_ALONE,), 60),
        (9.549, (), None),
        (10.0, (SPEEDS_ALONE,), None),
        (1.0, (SPEEDS_ALONE,), None),
    ],
)
def test_wheels_in_another_unit_are_named_by_truth_and_compass(
    factor: float, repairs: tuple[str, ...], ticks: int | None
) -> None:
    one = drive(5, robot(), ("compass",), laps=2.0)
    long = replace(one, wheels=one.wheels.rerolled(factor * one.wheels.rolled, one.wheels.track), repairs=repairs)
    found = of_wheel_unit(long, robot(), "sensor_msgs/msg/JointState")
    assert [f.fixes for f in found] == ([] if ticks is None else [(f"wheels.ticks_per_revolution={ticks}",)])


def test_encoders_that_count_without_a_sign_are_named() -> None:
    one = drive(5, robot(), ("compass",), laps=1.0)
    t, wheels = one.wheels.t, one.wheels
    turn = np.where((t > 5.0) & (t < 7.0), 0.02, 0.0)[1:, None] * [-0.5, 0.5] * wheels.track  # on the spot
    rolled = wheels.rolled * (turn == 0.0) + turn
    signed = wheels.rerolled(rolled, wheels.track)
    truth = replace(present(one.truth), t=t, xy=signed.pose[:, :2], theta=se2.wrap_all(signed.pose[:, 2]))
    known = replace(one, wheels=signed, truth=truth, measurements={})
    assert not of_signs(known)
    (found,) = of_signs(replace(known, wheels=signed.rerolled(np.abs(rolled), wheels.track)))
    other_unit = replace(known, wheels=signed.rerolled(np.abs(rolled) / 57.3, wheels.track))
    assert not of_signs(other_unit)
    assert (found.code, found.severe) == ("unsigned", True)


def test_an_odometry_that_turns_in_degrees_and_radians_configured_as_ticks_are_named_by_the_truth() -> None:
    one, kind = drive(5, robot(), ("compass",), laps=2.0), "nav_msgs/msg/Odometry"
    wheels, driver = one.wheels, replace(robot(), wheels=WheelSettings())
    assert not of_wheel_unit(one, driver, kind)
    turned = Wheels.from_twists(wheels.t, wheels.twist * [1.0, 1.0, 57.3], wheels.track, NOISE)
    (found,) = of_wheel_unit(replace(one, wheels=turned), driver, kind)
    assert found.fixes == ("wheels.turn_scale=0.01745",)
    ticks = replace(robot(), wheels=replace(robot().wheels, ticks_per_revolution=1024.0))
    assert not of_wheel_unit(one, ticks, "sensor_msgs/msg/JointState")
    short = replace(one, wheels=wheels.rerolled(wheels.rolled * 2.0 * np.pi / 1024.0, wheels.track))
    (found,) = of_wheel_unit(short, ticks, "sensor_msgs/msg/JointState")
    assert found.fixes == ("wheels.ticks_per_revolution=6.28319",)
    fixed = replace(ticks, wheels=replace(ticks.wheels, ticks_per_revolution=6.28319))
    assert not of_wheel_unit(one, fixed, "sensor_msgs/msg/JointState")


# --- left and right exchanged, on a robot without a sensor that turns: a truth of points shows it

WHEELS_ALONE = ("compass.enabled=false", "camera.enabled=false", "lrf.enabled=false")


def found(one: Session, *sets: str, headings: bool) -> list[Finding]:
    loaded = load(str(one.log.paths[0]), sets=sets).loaded
    truth = present(loaded.drive.truth)
    drive = loaded.drive if headings else replace(loaded.drive, truth=replace(truth, theta=None))
    return of_turning(drive, loaded.robot, {}, {"wheels": loaded.stream("wheels")})


@pytest.fixture(scope="module")
def wheels_alone(tmp_path_factory: pytest.TempPathFactory) -> Session:
    log = tmp_path_factory.mktemp("wheels") / "wheels.mcap"
    write_log(scenario_of("rounded_rectangle", WHEELS_ALONE), 3000, on_truth, log)
    return load(log)


@pytest.mark.parametrize("headings", [False, True])
def test_exchanged_wheels_are_named_by_joints_and_right_ones_not(wheels_alone: Session, headings: bool) -> None:
    assert found(wheels_alone, headings=headings) == []
    joints = wheels_alone.loaded.stream("wheels").columns("name")["name"][0]
    left, right = (next(j for j in joints if side in j) for side in ("left", "right"))
    exchanged = (f"wheels.left={right}", f"wheels.right={left}")
    (one,) = found(wheels_alone, *exchanged, headings=headings)
    assert (one.code, one.severe) == ("swapped", True)
    assert set(one.fixes) == {f"wheels.left={left}", f"wheels.right={right}"}


def of_mirrored(one: Session, y: int, theta: int | None, sensors: dict[str, Turning], kind: str = "") -> Finding:
    """The only finding on directions if the truth's y and its headings have these signs; None: of points."""
    drive = one.loaded.drive
    truth = present(drive.truth)
    headings = None if theta is None else present(truth.theta) * theta
    stream = one.loaded.stream("wheels")
    wheels = SimpleNamespace(msgtype=kind) if kind else stream
    drive = replace(drive, truth=replace(truth, xy=truth.xy * [1.0, y], theta=headings))
    streams = {"wheels": wheels, "lrf": SimpleNamespace(msgtype="")}
    (found,) = of_turning(drive, one.loaded.robot, sensors, cast("Any", streams))
    assert found.severe
    return found


AGREES, AGAINST = {"lrf": Turning(5.0, -5.0, 0.1, 0.99, 0.0)}, {"lrf": Turning(-5.0, 5.0, 0.1, 0.99, 0.0)}


@pytest.mark.parametrize("theta", [-1, None])
def test_a_sensor_shows_whether_truth_or_wheels_turn_wrongly(wheels_alone: Session, theta: int | None) -> None:
    truth = of_mirrored(wheels_alone, -1, theta, AGREES)
    assert (truth.role, truth.code, truth.fixes) == ("truth", MIRROR, ())
    assert truth.message.endswith("--set lrf.flipped=true")  # if wheels and laser are both wrong
    wheels = of_mirrored(wheels_alone, -1, theta, AGAINST)
    assert (wheels.role, wheels.code, len(wheels.fixes)) == ("wheels", SWAPPED, 2)
    assert "against lrf and the truth" in wheels.message
    assert "or the truth is a mirror image" in of_mirrored(wheels_alone, -1, theta, {}).message
    odometry = of_mirrored(wheels_alone, -1, None, {}, "nav_msgs/msg/Odometry")
    assert (odometry.role, odometry.code) == ("truth", MIRROR)
    assert "or the odometry turns" in odometry.message


@pytest.mark.parametrize("third", ["", "compass", "truth"])
def test_the_only_sensor_that_turns_against_the_wheels_may_be_right(wheels_alone: Session, third: str) -> None:
    loaded, sensors = wheels_alone.loaded, AGAINST | ({"compass": AGREES["lrf"]} if third == "compass" else {})
    drive = loaded.drive if third == "truth" else replace(loaded.drive, truth=None)
    streams = {"wheels": loaded.stream("wheels"), "lrf": cast("Any", SimpleNamespace(msgtype=""))}
    (found,) = of_turning(drive, loaded.robot, sensors, streams)
    assert found.fixes == ("lrf.flipped=true",)
    assert ("or left and right are swapped (wheels.left=" in found.message) == (third == "")
    # a gyro that turns against the wheels is not measured, but it is a third sensor
    gyro = {"gyro": ("gyro.roll_deg=180",)}
    (found,) = of_turning(replace(drive, truth=None, fixes=gyro), loaded.robot, sensors, streams)
    assert (found.code == SWAPPED and "against lrf and gyro" in found.message) == (third != "compass")


@pytest.mark.parametrize(
    ("yaw_deg", "mirrored", "role"), [(0.0, "wheels", "lrf"), (90.0, "wheels", "wheels"), (90.0, "lrf", "lrf")]
)
def test_a_laser_that_looks_aside_shows_whether_it_or_the_odometry_is_mirrored(
    yaw_deg: float, mirrored: str, role: str
) -> None:
    """A laser upside-down with a yaw of 90 degrees sees a wall at psi in the direction 180 degrees - psi."""
    loaded = load("rounded_rectangle").loaded
    drive, wheels, lrf = replace(loaded.drive, truth=None), loaded.drive.wheels, loaded.drive.measurements["lrf"]
    settings = replace(loaded.robot.settings("lrf"), yaw_deg=yaw_deg)
    if mirrored == "wheels":
        turned = Wheels.from_twists(wheels.t, wheels.twist * [1.0, 1.0, -1.0], wheels.track, NOISE)
        drive = replace(drive, wheels=turned)
    else:
        r, psi = lrf.z.T
        r = r - 2.0 * settings.x * np.cos(psi)
        drive = replace(drive, measurements={"lrf": replace(lrf, z=np.column_stack((r, np.pi - psi)))})
    robot = replace(loaded.robot, sensors={**loaded.robot.sensors, "lrf": settings})
    streams = {"wheels": SimpleNamespace(msgtype="nav_msgs/msg/Odometry"), "lrf": SimpleNamespace(msgtype="")}
    (found,) = of_turning(drive, robot, AGAINST, cast("Any", streams))
    assert (found.role, found.severe) == (role, True)
    assert found.fixes == (("wheels.turn_scale=-1",) if role == "wheels" else ("lrf.flipped=true",))
    assert ("(wheels.turn_scale=-1): no third sensor" in found.message) == (role == "lrf")


@pytest.mark.parametrize(("y", "theta"), [(-1, 1), (1, -1)])
@pytest.mark.parametrize("sensors", [{}, AGREES, AGAINST])
def test_a_truth_whose_headings_turn_against_its_path_is_wrong(
    wheels_alone: Session, y: int, theta: int, sensors: dict[str, Turning]
) -> None:
    found = of_mirrored(wheels_alone, y, theta, sensors)
    assert (found.role, found.code) == ("truth", MIRROR)


def test_wheels_that_both_count_backward_are_told_from_swapped_ones(wheels_alone: Session) -> None:
    loaded = load(str(wheels_alone.log.paths[0]), sets=("wheels.mirrored=both",)).loaded
    (one,) = of_turning(loaded.drive, loaded.robot, AGAINST, {"wheels": loaded.stream("wheels")})
    assert (one.code, one.fixes) == (SWAPPED, ("wheels.mirrored=none",))


def test_an_odometry_of_a_body_ahead_of_the_axle_is_named_unless_the_truth_has_the_same_body() -> None:
    """A point 0.2 m ahead of the axle moves aside by 0.2 m per radian (the speed of a point of a rigid body)."""
    clean = drive(0, robot(), ("compass",), laps=2.0)
    twist = clean.wheels.twist + clean.wheels.twist[:, 2:] * [0.0, 0.2, 0.0]
    body = replace(clean, wheels=Wheels.from_twists(clean.wheels.t, twist, 0.3, NOISE))
    truth = present(clean.truth)
    theta = present(truth.theta)
    moved = replace(truth, xy=truth.xy + 0.2 * np.column_stack((np.cos(theta), np.sin(theta))))
    assert of_odometry(clean, robot()) == ([], clean)
    found, _ = of_odometry(replace(body, truth=None), robot())
    assert [f.fixes for f in found] == [("wheels.x=0.200",)]
    found, right = of_odometry(body, robot())
    assert len(found) == 1
    np.testing.assert_allclose(right.wheels.twist[:, 1], 0.0, atol=1e-6)
    assert of_odometry(replace(body, truth=moved), robot())[0] == []


WALLS = "the laser's walls"


@pytest.mark.parametrize(("configured", "by"), [(0.3, "the scans"), (0.58, WALLS), (1.2, "the scans")])
def test_a_track_half_or_twice_the_true_one_is_found_from_scan_to_scan(configured: float, by: str) -> None:
    """Walls that are paired by turns of such wheels show a track between the configured and the true one."""
    scans = Turning(1.0 / 0.6, -1.0 / 0.6, 0.01, 0.99, 0.0)
    walls = WallMotion(1.0, 0.01, 0.0, 0.01, (configured / 0.6) ** 0.5 if by == "the scans" else 0.967, 0.01, 500)
    one = drive(3, robot(), truth=False)
    wheels = Wheels.from_twists(one.wheels.t, one.wheels.twist, configured, one.wheels.noise)
    one = replace(one, wheels=wheels)
    of_driver = present(observed_track(1.0, one, {"lrf": scans}, walls))  # a ratio: no track is configured
    assert of_driver[0] == pytest.approx(0.6 / configured, rel=0.01)
    found = present(observed_track(configured, one, {"lrf": scans}, walls))
    assert found[0] == pytest.approx(0.6, rel=0.01)
    assert found[2] == by


# --- what a drive cannot tell is named, with the manoeuvre that would; a drive that has them all is told nothing

PERIOD_S = 0.05


def drive_of(*parts: tuple[float, float, float], sensors: tuple[str, ...] = ("gyro",)) -> Any:
    """A drive of parts: seconds, speed [m/s], turning rate [rad/s]."""
    speed, rate = (np.concatenate([np.full(round(p[0] / PERIOD_S), p[i]) for p in parts]) for i in (1, 2))
    t = np.arange(len(speed) + 1) * PERIOD_S
    way, turned = (np.append(0.0, np.cumsum(v) * PERIOD_S) for v in (speed, rate))
    heading, driven = (lambda at, v=v: np.interp(at, t, v) for v in (turned, way))
    wheels = SimpleNamespace(t=t, heading=heading, driven=driven)
    return SimpleNamespace(wheels=wheels, measurements=dict.fromkeys(sensors))


STAND, AHEAD, ARC = (6.0, 0.0, 0.0), (8.0, 0.3, 0.0), (30.0, 0.3, 0.3)
LEFT, RIGHT = (4.0, 0.0, 0.8), (4.0, 0.0, -0.8)


@pytest.mark.parametrize(
    ("parts", "manoeuvres"),
    [
        ((STAND, AHEAD, LEFT, RIGHT), ()),
        ((AHEAD, LEFT, RIGHT), ("Stand for 5 s",)),
        ((STAND, AHEAD, LEFT), ("once each way",)),
        ((STAND, ARC, RIGHT), ("Drive 3 m straight",)),
        ((AHEAD,), ("once each way", "Stand for 5 s")),
    ],
)
def test_the_manoeuvre_that_is_missing_is_named(parts: Any, manoeuvres: tuple[str, ...]) -> None:
    found = unseen(drive_of(*parts))
    assert len(found) == len(manoeuvres)
    assert all(any(word in f.message for f in found) for word in manoeuvres)
    assert not any(f.fixes or f.severe for f in found)


def test_a_drive_that_never_moves_a_metre_is_no_error_and_without_a_gyro_none_need_stand() -> None:
    (first, second) = unseen(drive_of(STAND))
    assert "0° to the left" in first.message
    assert "no metre" in second.message
    assert not unseen(drive_of(AHEAD, LEFT, RIGHT, sensors=("compass",)))


# --- a lost chunk: nothing at all was recorded


def without(one: Drive, start: float, end: float, wheels_only: bool = False) -> Drive:
    """The drive whose readings between two times are lost."""
    kept = (one.wheels.t < start) | (one.wheels.t >= end)
    way = np.vstack(([0.0, 0.0], np.cumsum(one.wheels.rolled, axis=0)))[kept]
    wheels = Wheels.from_wheels(one.wheels.t[kept], way[:, 0], way[:, 1], one.wheels.track, NOISE)
    lost = {n: m.take(np.flatnonzero((m.t < start) | (m.t >= end))) for n, m in one.measurements.items()}
    return replace(one, wheels=wheels, measurements=one.measurements if wheels_only else lost)


@pytest.mark.parametrize(("start", "end", "wheels_only"), [(20.0, 28.0, True), (20.0, 20.4, False)])
def test_a_short_gap_or_one_at_rest_is_no_lost_chunk(start: float, end: float, wheels_only: bool) -> None:
    one = drawn(8)
    assert not holes(without(one, start, end, wheels_only))
    stands = (one.wheels.t[:-1] > 19.0) & (one.wheels.t[:-1] < 29.0)
    still = one.wheels.rerolled(np.where(stands[:, None], 0.0, one.wheels.rolled), one.wheels.track)
    assert not holes(without(replace(one, wheels=still), 20.0, 28.0))


@pytest.mark.parametrize(
    ("start", "part"), [(60.0, (None, 60.0)), (45.0, (None, 45.0)), (10.0, (18.0, None))], ids=str
)
def test_fixes_are_tried_on_the_first_part_unless_another_is_twice_as_long(
    start: float, part: tuple[float | None, float | None]
) -> None:
    broken = without(drawn(8), start, start + 8.0)
    found = longest_part(broken, holes(broken))
    assert found == pytest.approx(part, abs=0.11)
