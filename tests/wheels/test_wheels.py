"""Wheels of every kind: whatever counts the turns and whatever happens to the counter, the way is the same."""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import refused, reported
from msgspec.structs import replace
from pose_streams import odometry_stream, reckoned
from wheel_bags import (
    CREATE,
    CREATE_TEXT,
    GEOMETRY,
    RADIUS,
    TICKS,
    TRACK,
    TURTLE,
    TURTLE_TEXT,
    angles,
    custom,
    joint_states,
    log_of,
    numbers,
    pose_of,
)
from worlds import joints

from benchmarks.experiment import simulated
from locfuse.fusion import se2
from locfuse.fusion.data import Array, ArrayStream, LocfuseError
from locfuse.fusion.measure import measure
from locfuse.fusion.robot import Robot, WheelSettings
from locfuse.fusion.wheels.odometry import along_the_way
from locfuse.fusion.wheels.read import WheelReading, read_wheels
from locfuse.fusion.wheels.repairs import unrolled

QUIET = tuple(f"{sensor}.enabled=false" for sensor in ("camera", "lrf", "compass"))
SIZED = WheelSettings(radius=RADIUS, track=TRACK)
T, ANGLE = angles()


def read(t: Array, angle: Array, **keys: Any) -> WheelReading:
    return read_wheels(joints(t, angle), replace(SIZED, **keys))


def final(reading: WheelReading) -> Array:
    pose: Array = reading.wheels.pose[-1]
    return pose


def said_of(reading: WheelReading) -> str:
    return " | ".join(reading.notes)


@pytest.mark.parametrize("first", [0.0, np.array([813.2, -77.1])], ids=["from zero", "from anywhere"])
def test_clean_angles_give_the_plain_sum_of_arcs_and_no_words(first: Any) -> None:
    reading = read(T, ANGLE + first)
    np.testing.assert_allclose(final(reading), pose_of(ANGLE), atol=1e-9)
    assert (reading.notes, reading.dropped) == ((), {})


def test_speeds_in_place_of_positions_are_summed() -> None:
    """The robot stands for 3 s of every 10 s. The positions themselves, read the same way, stay positions."""
    t = np.arange(0.0, 60.0, 0.02)
    noise = 0.1 * np.random.default_rng(1).normal(size=(len(t), 2))
    speed = np.where((t % 10.0 < 7.0)[:, None], np.add([4.0, 5.0], noise), 0.0) * np.sign(30.0 - t)[:, None]
    angle = np.concatenate((np.zeros((1, 2)), np.cumsum(0.01 * (speed[1:] + speed[:-1]), axis=0)))
    reading = read(t, speed)
    np.testing.assert_allclose(final(reading), pose_of(angle), atol=1e-9)
    assert "they are speeds" in said_of(reading)
    assert "they are speeds" not in said_of(read(t, angle))


@pytest.mark.parametrize(
    ("unit", "low", "modulus"),
    [
        pytest.param(1.0, -np.pi, 2 * np.pi, id="angle wrapped to +-pi"),
        pytest.param(1.0, 0.0, 2 * np.pi, id="angle wrapped to 0..2 pi"),
        pytest.param(2 * np.pi / 4000, -128 * 2 * np.pi / 4000, 256 * 2 * np.pi / 4000, id="8-bit angle of ticks"),
        pytest.param(2 * np.pi / 4096, -(2**15) * 2 * np.pi / 4096, 2**16 * 2 * np.pi / 4096, id="16-bit angle"),
    ],
)
def test_a_rollover_is_counted_on(unit: float, low: float, modulus: float) -> None:
    whole = np.round(ANGLE * 1.0 / unit) * unit if unit != 1.0 else ANGLE
    published = (whole + 0.98 * modulus / 2 - low) % modulus + low
    reading = read(T, published)
    np.testing.assert_allclose(final(reading), pose_of(whole), atol=1e-9)
    assert "rolled over" in said_of(reading)
    assert "wheels.rollover" in said_of(reading)


def test_rollover_can_be_set_and_switched_off() -> None:
    np.testing.assert_allclose(final(read(T, ANGLE % 7.0, rollover=7.0)), pose_of(ANGLE), atol=1e-9)
    off = said_of(read(T, (ANGLE + 3.0) % (2 * np.pi), rollover=0))
    assert ("rolled over" in off, "started anew" in off) == (False, True)


@pytest.mark.parametrize("length", [1, 3, 8])
@pytest.mark.parametrize("size", [-1e6, 15.7, 0.8 / RADIUS])
def test_a_spike_that_returns_is_dropped_and_counted(length: int, size: float) -> None:
    published = ANGLE.copy()
    published[300 : 300 + length, 1] += size
    reading = read(T, published)
    assert reading.dropped == {"spike": length}
    assert "jumped away and returned" in said_of(reading)
    np.testing.assert_allclose(final(reading)[:2], pose_of(ANGLE)[:2], atol=2e-3)


@pytest.mark.parametrize("at", [0, -1])
@pytest.mark.parametrize("size", [1e30, 1e305, 50.0])
def test_a_first_or_last_reading_that_is_absurd_does_not_carry_the_robot_off(at: int, size: float) -> None:
    published = ANGLE.copy()
    published[at, 1] += size
    reading = read(T, published)
    assert "started anew" in said_of(reading)
    np.testing.assert_allclose(final(reading)[:2], pose_of(ANGLE)[:2], atol=2e-3)
    motions = reading.wheels.between(T[:-1], T[1:])
    assert np.isfinite(motions.u).all()
    assert np.isfinite(motions.Q).all()


@pytest.mark.parametrize("length", [1, 40])
def test_zeros_in_place_of_both_counters_are_no_readings(length: int) -> None:
    published = ANGLE + 500.0
    published[300 : 300 + length] = 0.0
    reading = read(T, published)
    assert (reading.dropped, reading.notes) == ({"zeros": length}, ())
    np.testing.assert_allclose(final(reading)[:2], pose_of(ANGLE)[:2], atol=2e-3)
    # a wheel that rocks about zero has such values of its own
    rocking = np.where(np.arange(len(T)) % 5 == 0, 0.01, 0.0)[:, None] * np.ones(2)
    assert read(T, rocking).dropped == {}


def test_counters_that_stand_still_and_catch_up_lose_no_way() -> None:
    published = ANGLE.copy()
    published[300:380] = ANGLE[300]
    reading = read(T, published)
    assert said_of(reading).count("caught up (from 6.0 s to 7.6 s): its 79 equal readings are not used") == 2
    np.testing.assert_allclose(reading.wheels.rolled.sum(axis=0), (ANGLE[-1] - ANGLE[0]) * RADIUS, atol=2e-3)
    # a robot that stands while its counters start anew has not driven that way
    standing = np.concatenate((ANGLE[:300], np.repeat(ANGLE[300:301], 80, axis=0), ANGLE[300:500] - ANGLE[300]))
    found = read(np.arange(580) * np.float64(0.02), standing)
    assert "started anew" in said_of(found)
    np.testing.assert_allclose(final(found)[:2], pose_of(ANGLE[:500])[:2], atol=0.02)


@pytest.mark.parametrize("factor", [0.1, 0.5, 1.2])
def test_a_highest_speed_below_usual_ones_is_refused_with_the_speed(factor: float) -> None:
    t, angle = T[::10], ANGLE[::10]  # steps beside which the slack of 2 cm is short
    fastest = RADIUS * float(np.abs(np.diff(angle, axis=0)).max() / (t[1] - t[0]))
    if factor > 1.0:
        np.testing.assert_array_equal(final(read(t, angle, max_speed=factor * fastest)), final(read(t, angle)))
    else:
        with pytest.raises(
            LocfuseError, match=rf"faster than wheels.max_speed={factor * fastest:g} m/s.*90% .* m/s"
        ):
            read(t, angle, max_speed=factor * fastest)


def test_nan_and_repeats_and_two_values_with_one_stamp_are_counted() -> None:
    t, angle = T.copy(), ANGLE.copy()
    angle[100, 0] = np.nan
    angle[101, 1] = np.inf
    t[200] = t[201]
    angle[300], t[300] = angle[301], t[301]
    reading = read(t, angle)
    assert reading.dropped == {"not_finite": 2, "same_stamp": 1, "repeat": 1}
    np.testing.assert_allclose(final(reading), pose_of(ANGLE), atol=2e-3)


def test_gaps_and_bursts_of_speed_are_no_faults() -> None:
    keep = (T < 4.0) | (T > 6.5)
    reading = read(T[keep], ANGLE[keep])
    assert (reading.notes, reading.dropped) == ((), {})
    assert final(reading)[2] == pytest.approx(pose_of(ANGLE)[2], abs=1e-9)
    t = np.arange(0, 20, 0.05)
    speed = np.interp(t, [0, 9.5, 10.0, 10.5, 11.0, 20], [1.0, 1.0, 18.0, 18.0, 1.0, 1.0])
    angle = np.stack((np.cumsum(speed) * 0.05, np.cumsum(speed) * 0.05), axis=-1)
    reading = read(t, angle)
    np.testing.assert_allclose(final(reading), pose_of(angle), atol=1e-9)
    assert not reading.dropped


@pytest.mark.parametrize(("mirrored", "sides"), [("left", (-1, 1)), ("right", (1, -1)), ("both", (-1, -1))])
def test_mirrored_turns_wheels_round(mirrored: str, sides: tuple[int, int]) -> None:
    assert abs(final(read(T, ANGLE * sides)) - pose_of(ANGLE)).max() > 0.1
    np.testing.assert_allclose(final(read(T, ANGLE * sides, mirrored=mirrored)), pose_of(ANGLE), atol=1e-9)


# --- a counter alone that rolled over, and one that did not

RANGE = 64.0


@pytest.mark.parametrize("top", [66.0, 90.0, 120.0])
@pytest.mark.parametrize("zero", [0.0, -50.0])
def test_values_that_span_more_than_one_range_never_rolled_over_it(top: float, zero: float) -> None:
    """A counter modulo 64 shows no 66: a fall by 63 is then a fault of the reading, however well it fits."""
    values = zero + np.concatenate((np.arange(0.0, top), np.arange(top - 64.0, top - 40.0)))
    found = unrolled(values, likely=(RANGE,))
    assert found.modulus is None
    np.testing.assert_array_equal(found.values, values)


@pytest.mark.parametrize(("left", "rolled"), [(9.0, True), (14.0, True), (20.0, False)])
def test_a_long_step_is_a_rollover_only_if_an_ordinary_one_is_left(left: float, rolled: bool) -> None:
    """Ordinary steps are of 10; what a fall leaves of the range may be one and a half of them."""
    after = 60.0 + left - RANGE + np.array([0.0, 10.0, 20.0])
    assert (unrolled(np.append(np.arange(0.0, 70.0, 10.0), after), likely=(RANGE,)).modulus == RANGE) is rolled


BITS = {
    f"{b} bits of {u}": (np.arange(3 * 2**b, step=2 ** (b - 6)) * u, 2**b * u)
    for b in (8, 10, 16)
    for u in (1e-9, 1.0, 1e9)
}
COUNTED: dict[str, tuple[Array, float]] = {
    **BITS,
    "the shortest step is no tick": (np.cumsum(np.resize([18.0, 43.0, 127.0, 44.0, 130.0, 95.0], 200)), 1024.0),
    "three ticks at a time": (np.arange(0.0, 20000.0, 3.0), 4096.0),
}


@pytest.mark.parametrize(("true", "modulus"), COUNTED.values(), ids=COUNTED)
def test_where_a_counter_rolls_over_is_found_whatever_its_unit_and_its_steps(true: Array, modulus: float) -> None:
    found = unrolled(true % modulus)
    assert found.modulus == pytest.approx(modulus, rel=1e-9)
    np.testing.assert_allclose(found.values, true, rtol=1e-9)


def test_a_wheel_at_rest_where_it_rolls_over_stays() -> None:
    """Nothing but rounding moves: 0 and a turn less a billionth are one place."""
    found = unrolled(np.array([0.0, 0.0, 360.0 - 1e-9, 0.0, 360.0 - 1e-9, 360.0 - 1e-9]))
    assert found.modulus == 360.0
    np.testing.assert_allclose(found.values, found.values[0], atol=2e-9)


# --- other messages, as logs


def run(log: Path, *words: str) -> tuple[dict[str, Any], Array, str]:
    done = reported("run", log, "-v", "--no-advice", "--sensors", "odometry", "--write", "json,tum", *words)
    tum = np.loadtxt(done.out / "trajectory.tum")
    theta = 2 * np.arctan2(tum[-1, 6], tum[-1, 7])
    return done.report, np.array([*tum[-1, 1:3], theta]), done.stderr


def assert_pose(found: Array, wanted: Array, atol: float) -> None:
    np.testing.assert_allclose(found[:2], wanted[:2], atol=atol)
    assert abs((found[2] - wanted[2] + np.pi) % (2 * np.pi) - np.pi) < 5 * atol


@pytest.mark.parametrize(
    ("kind", "text", "fields", "a_turn", "offset"),
    [
        (CREATE, CREATE_TEXT, ("ticks_left", "ticks_right"), TICKS, 0),
        (CREATE, CREATE_TEXT, ("ticks_left", "ticks_right"), TICKS, 2**31 - 300),
        (TURTLE, TURTLE_TEXT, ("left_encoder", "right_encoder"), 4096, 0),
    ],
)
def test_ticks_of_a_create_and_a_turtlebot3_are_read_over_32_bits_too(
    tmp_path: Path, kind: str, text: str, fields: tuple[str, str], a_turn: float, offset: int
) -> None:
    ticks = np.round(ANGLE * a_turn / (2 * np.pi)).astype(np.int64) + offset
    wrapped = (ticks + 2**31) % 2**32 - 2**31
    rows = [dict(zip(fields, pair, strict=True)) for pair in wrapped.tolist()]
    log = custom(tmp_path / "ticks.mcap", "/ticks", kind, text, T, rows)
    if kind == TURTLE:
        assert "--set wheels.ticks_per_revolution=4096" in refused("run", log, "-o", tmp_path / "no", *GEOMETRY)
    _, pose, _ = run(log, *GEOMETRY, "--set", f"wheels.ticks_per_revolution={a_turn}")
    assert_pose(pose, pose_of(ticks * 2 * np.pi / a_turn), 1e-6)


@pytest.mark.parametrize(
    ("kind", "left", "right", "bits"),
    [
        ("Int16", "/lwheel", "/rwheel", 16),
        ("Int32", "/left_ticks", "/right_ticks", 32),
        ("Int64", "/encoder/left", "/encoder/right", 64),
        ("Float32", "/wheel/left/angle", "/wheel/right/angle", 0),
    ],
)
def test_two_unsynchronised_topics_are_one_pair_of_wheels(
    tmp_path: Path, kind: str, left: str, right: str, bits: int
) -> None:
    late = T + 0.007  # the right wheel is read 7 ms later
    seen = np.stack((ANGLE[:, 0], np.interp(late, T, ANGLE[:, 1])), axis=-1)
    values: Any = seen.tolist()
    how: tuple[str, ...] = GEOMETRY
    if bits:
        ticks = np.round(seen * TICKS / (2 * np.pi)).astype(np.int64)
        if bits == 16:
            ticks = (ticks + 32_000 + 2**15) % 2**16 - 2**15
        values = ticks.tolist()
        how = (*GEOMETRY, "--set", f"wheels.ticks_per_revolution={TICKS}")
    sides = zip(*values, strict=True)
    log = log_of(tmp_path / "x.mcap", *map(numbers, (left, right), (kind, kind), (T, late), sides))
    report, pose, stderr = run(log, *how)
    assert_pose(pose, pose_of(ANGLE), 2e-3)
    assert report["input"]["topics"]["wheels"] == left
    assert "not synchronised" in stderr


def test_ticks_since_the_message_before_are_summed_and_a_counter_that_goes_to_and_fro_is_not(
    tmp_path: Path,
) -> None:
    t = np.arange(800) / 20.0
    speed = np.where(t % 10 > 4, 1.0, 0.0)[:, None] * np.random.default_rng(0).normal((8.0, 9.0), 0.5, (800, 2))
    count = np.cumsum(np.rint(speed / (2 * np.pi) * TICKS / 20), axis=0).astype(np.int64)
    steps = np.diff(count, axis=0, prepend=0)
    how = (*GEOMETRY, "--set", f"wheels.ticks_per_revolution={TICKS}")
    for name, ticks, summed in (
        ("steps", steps, True),
        ("counter", count, False),
        ("to and fro", count % 1000, False),
    ):
        sides = zip(("/left_ticks", "/right_ticks"), ticks.T.tolist(), strict=True)
        log = log_of(tmp_path / f"{name}.mcap", *(numbers(topic, "Int32", t, side) for topic, side in sides))
        _, pose, stderr = run(log, *how)
        assert ("are summed" in stderr) == summed
        if name != "to and fro":
            assert_pose(pose, pose_of(count * 2 * np.pi / TICKS), 1e-6)


def test_a_pair_can_be_named_and_half_a_pair_is_one_clear_line(tmp_path: Path) -> None:
    pair = [numbers(f"/m{i + 1}", "Float64", T, ANGLE[:, i].tolist()) for i in (0, 1)]
    log = log_of(tmp_path / "odd.mcap", *pair)
    words = ("run", log, *GEOMETRY, "-o", tmp_path / "a")
    refused(*words)
    assert "--set wheels.right_topic=" in refused(*words, "--set", "wheels.left_topic=/m1")
    assert "--set wheels.left_topic=/m1" in refused(*words, "--set", "wheels.topic=/m1")
    named = ("--set", "wheels.left_topic=/m1", "--set", "wheels.right_topic=/m2")
    _, pose, _ = run(log, *GEOMETRY, *named)
    assert_pose(pose, pose_of(ANGLE), 1e-6)


def test_ticks_beat_the_joints_of_an_arm(tmp_path: Path) -> None:
    ticks = np.round(ANGLE * TICKS / (2 * np.pi)).astype(np.int64)
    arm = joint_states(T, np.zeros_like(ANGLE), ("left_shoulder", "elbow"))
    sides = zip(("/left_ticks", "/right_ticks"), ticks.T.tolist(), strict=True)
    pair = [numbers(topic, "Int32", T, values) for topic, values in sides]
    log = log_of(tmp_path / "arm.mcap", arm, *pair)
    report, pose, _ = run(log, *GEOMETRY, "--set", f"wheels.ticks_per_revolution={TICKS}")
    assert report["input"]["topics"]["wheels"] == "/left_ticks"
    assert_pose(pose, pose_of(ticks * 2 * np.pi / TICKS), 1e-6)


# --- other odometries


def odometry(t: Array, pose: Array, speed: Array, turn: Array) -> ArrayStream:
    return odometry_stream(np.rint(t * 1e9).astype(np.int64), pose, speed, turn)


def driven(speed: Array, turn: Array, dt: float) -> Array:
    return reckoned(np.column_stack((speed, turn)) * dt)


@pytest.mark.parametrize("wait_s", [0.0, 0.08])  # a wait of 0.08 s with even stamps is a slow robot's stop
def test_stamps_in_bursts_are_made_even_if_the_way_is_even(wait_s: float) -> None:
    t: Array = 0.02 * np.arange(500.0)
    arrival = np.floor(t / 0.1 + 1e-6) * 0.1 + 0.08 + 0.0004 * (np.arange(500) % 5 - 4)
    speed = np.where(np.arange(500) % 5 == 0, 1.0, 0.01 if wait_s else 1.0)
    pose = driven(speed, 0.0 * t, 0.02)[1:]
    wheels = read_wheels(odometry(arrival, pose, speed, 0.0 * t), WheelSettings())
    made = wheels.epoch_ns * 1e-9 + wheels.wheels.t
    np.testing.assert_allclose(made, arrival if wait_s else t, atol=1e-4)
    assert ("bursts of 5 every 0.100 s" in said_of(wheels)) == (not wait_s)


def way() -> tuple[Array, Array, Array]:
    t = np.arange(0, 30, 0.1)
    speed = np.interp(t, [0, 1, 9, 10, 11, 14, 15, 30], [0, 0.4, 0.4, 0, -0.3, -0.3, 0.4, 0.4])
    return t, speed, 0.3 * np.sin(t / 3)


def test_a_step_over_a_gap_is_not_turned_round_by_the_speeds_at_its_ends() -> None:
    """Five seconds without messages, 1.5 m ahead; the last speed before and the first after say reverse."""
    t = np.arange(0, 30, 0.1)
    pose = driven(np.full(299, 0.3), np.zeros(299), 0.1)
    heard = (t < 9.95) | (t > 15.05)
    speed = np.where(heard & np.roll(heard, 1) & np.roll(heard, -1), 0.3, -0.2)
    stream = odometry(t[heard], pose[heard], speed[heard], np.zeros(heard.sum()))
    reading = read_wheels(stream, WheelSettings())
    np.testing.assert_allclose(final(reading)[:2], pose[-1, :2], atol=1e-9)
    said = [note for note in measure({"wheels": stream}, Robot(), motion=reading).notes if "gap" in note]
    gap = "wheels: a gap of 5.2 s (9.9-15.1 s): the robot moved 1.56 m and 0° there, which is taken for one arc"
    assert said == [gap]


@pytest.mark.parametrize("start", [0.0, 1.0, 2.5, -2.0])
def test_a_twist_along_the_frame_of_the_poses_turns_nothing_round(start: float) -> None:
    """Simulators say how fast the body goes along x of the world: backward wherever it heads away from there."""
    t = np.arange(0, 60, 0.1)
    speed, turn = np.full(len(t), 0.4), np.full(len(t), 0.25)
    pose = driven(speed[:-1], turn[:-1], 0.1)
    turned = se2.compose(np.array([0.0, 0.0, start]), pose)
    jumped = turned + np.where(t[:, None] > 30.0, [50.0, 0.0, 0.0], 0.0)
    for told, notes in ((turned, 1), (jumped, 2)):
        reading = read_wheels(odometry(t, told, speed * np.cos(turned[:, 2]), turn), WheelSettings())
        assert "backward" not in said_of(reading)
        assert len(reading.notes) == notes
        assert final(reading)[:2] == pytest.approx(pose[-1, :2], abs=0.06)


WRONG: dict[str, tuple[str, Callable[[Array], Array]]] = {
    "nothing": ("", lambda q: q),
    "y": ("mirror image of its headings: y is", lambda q: q * [1.0, -1.0, 1.0]),
    "headings": ("mirror image of its headings: its headings are", lambda q: q * [1.0, 1.0, -1.0]),
    "x and y": ("mirror image of its headings: y is", lambda q: q[:, [1, 0, 2]]),
    "90 degrees": ("drives -90° aside", lambda q: q - [0.0, 0.0, -0.5 * np.pi]),
    "-30 degrees": ("drives 30° aside", lambda q: q - [0.0, 0.0, np.pi / 6.0]),
}


@pytest.mark.parametrize("wrong", WRONG)
@pytest.mark.parametrize("start", [0.0, 1.0, 2.5])
def test_headings_that_do_not_fit_the_path_are_set_right(wrong: str, start: float) -> None:
    """The turning rates show whether y or the headings have the wrong sign, the speeds where the front is."""
    t = np.arange(0, 60, 0.1)
    speed, turn = 0.3 + 0.2 * np.cos(0.5 * t), 0.3 + 0.2 * np.sin(0.3 * t)
    speed[300:330] *= -1.0  # backward for three seconds
    pose = se2.compose(np.array([0.0, 0.0, start]), driven(speed[:-1], turn[:-1], 0.1))
    note, edit = WRONG[wrong]
    reading = read_wheels(odometry(t, edit(pose), speed, turn), WheelSettings())
    assert note in said_of(reading)
    assert ("mirror" in said_of(reading) or "aside" in said_of(reading)) == bool(note)
    assert final(reading)[:2] == pytest.approx(se2.between(pose[0], pose[-1])[:2], abs=0.05)


def test_a_body_that_drives_in_all_directions_is_left_as_it_is() -> None:
    t = np.arange(0, 60, 0.1)
    pose = np.stack((np.sin(0.2 * t), np.cos(0.3 * t), 0.1 * t), axis=-1)
    for speed in (np.zeros(len(t)), np.gradient(pose[:, 0], t)):
        values = np.column_stack((pose, speed, np.full(len(t), 0.1)))
        for sign in (1.0, -1.0):
            changed, notes = along_the_way(t, values * [1.0, sign, 1.0, 1.0, 1.0])
            assert notes == []
            np.testing.assert_array_equal(changed, values * [1.0, sign, 1.0, 1.0, 1.0])
    still, notes = along_the_way(t, np.zeros((len(t), 5)))
    assert not notes
    assert not still.any()


def test_a_twist_along_the_frame_is_known_though_every_other_stamp_is_late() -> None:
    """As in a bag whose stamps were repaired: a step is longer or shorter by its speed than by its pose."""
    t = np.arange(0, 60, 0.1)
    theta = np.pi * np.interp(t, [0, 15, 17, 45, 47, 60], [0, 0, 0.5, 0.5, 1, 1])  # along x, y, back along x
    pose = driven(np.full(len(t) - 1, 0.2), np.diff(theta) / 0.1, 0.1)
    speed, turn = 0.2 * np.cos(theta), np.gradient(theta, t)
    late = t + np.where(np.arange(len(t)) % 2 == 0, 0.05, 0.0)
    reading = read_wheels(odometry(late, pose, speed, turn), WheelSettings())
    assert reading.notes == ("its speeds are given along the axes of its poses, not of the body: not used",)
    travelled = se2.between(pose[0], pose[-1])
    assert final(reading)[:2] == pytest.approx(travelled[:2], abs=0.06)


@pytest.mark.parametrize(
    ("wrong", "blind"), [(1.0, False), (-1.0, True), (40.0, True)], ids=["it backs up", "other sign", "other unit"]
)
def test_a_pose_that_backs_up_or_that_the_twist_disagrees_with_is_left_alone(wrong: float, blind: bool) -> None:
    t, speed, turn = way()
    pose = driven(np.abs(speed[:-1]) if blind else speed[:-1], turn[:-1], 0.1)
    reading = read_wheels(odometry(t, pose, wrong * speed, turn), WheelSettings())
    np.testing.assert_allclose(final(reading)[:2], pose[-1, :2], atol=1e-9)


def test_an_odometry_that_starts_anew_or_spikes_is_mended() -> None:
    t, speed, turn = way()
    pose = driven(speed[:-1], turn[:-1], 0.1)
    anew, spiked = pose.copy(), pose.copy()
    anew[150:, :2] -= anew[150, :2]
    spiked[200:202, 0] += 30.0
    for wrong, dropped in ((anew, {}), (spiked, {"spike": 2})):
        reading = read_wheels(odometry(t, wrong, speed, turn), WheelSettings())
        assert reading.dropped == dropped
        assert ("jumped once" in said_of(reading)) is (wrong is anew)
        np.testing.assert_allclose(final(reading)[:2], pose[-1, :2], atol=0.02)


@pytest.mark.skipif(not os.environ.get("LOCFUSE_DATA"), reason="LOCFUSE_DATA is not set: no real logs to try")
def test_turning_the_reverse_driving_of_fr079_round_brings_its_short_relations_to_33_mm() -> None:
    from locfuse.formats.logs.log import open_log

    folder = Path(os.environ["LOCFUSE_DATA"]) / "fr079"
    stream = open_log([folder / "fr079.mcap"]).stream("/odom")
    relations = np.loadtxt(folder / "fr079.relations")
    relations[:, :2] += 1e9 - 0.13  # log stamps; the relations hold at the scans, which are 0.13 s older
    short = np.diff(relations[:, :2], axis=1)[:, 0] < 20.0
    mean = {}
    for by_twist in (False, True):
        reading = read_wheels(stream, WheelSettings(reverse_by_twist=by_twist))
        when = relations[short, :2] - reading.epoch_ns * 1e-9
        t, pose = reading.wheels.t, reading.wheels.pose
        a, b = (np.stack([np.interp(when[:, i], t, c) for c in pose.T], axis=-1) for i in (0, 1))
        found = se2.between(a, b)[:, :2]
        error = np.hypot(*(found - relations[short][:, 2:4]).T)  # the length of its difference, whatever the frame
        mean[by_twist] = float(error.mean())
    assert mean[False] == pytest.approx(0.0537, abs=0.0005)
    assert mean[True] == pytest.approx(0.0330, abs=0.0005)


def test_the_bad_electronics_of_the_simulator_cost_less_than_a_millimetre() -> None:
    found = {}
    for name, faults in (("bad", ()), ("good", ("faults=[]",))):
        found[name], _ = simulated("bad_electronics", (*QUIET, *faults), 1).measured()
    bad, good = found["bad"].wheels, found["good"].wheels
    np.testing.assert_allclose(bad.pose[-1], good.pose[-1], atol=1e-3)
    assert found["bad"].dropped["wheels"] == {"spike": 2}
    assert sum("rolled over" in note for note in found["bad"].notes) == 2
    assert found["good"].notes == ()


def test_too_few_readings_and_missing_geometry_are_one_line() -> None:
    with pytest.raises(LocfuseError, match="two are the least"):
        read(T[:1], ANGLE[:1])
    with pytest.raises(LocfuseError, match=r"--set wheels\.radius=<metres>"):
        read_wheels(joints(T, ANGLE), WheelSettings())
