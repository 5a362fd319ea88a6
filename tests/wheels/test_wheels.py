"""Wheels of every kind: whatever counts the turns and whatever happens to the counter, the way is the same."""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import refused, reported
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
from worlds import joints, stream

from benchmarks.experiment import simulated
from locfuse.fusion import se2
from locfuse.fusion.data import Array, ArrayStream, Column, LocfuseError, Ragged
from locfuse.fusion.measure import measure
from locfuse.fusion.robot import Robot, WheelSettings
from locfuse.fusion.wheels.odometry import along_the_way
from locfuse.fusion.wheels.read import WheelReading, read_wheels
from locfuse.fusion.wheels.repairs import unrolled

QUIET = tuple(f"{sensor}.enabled=false" for sensor in ("camera", "lrf", "compass"))


def settings(**keys: Any) -> WheelSettings:
    return WheelSettings(**{"radius": RADIUS, "track": TRACK, **keys})


def read(t: Array, angle: Array, **keys: Any) -> WheelReading:
    return read_wheels(joints(t, angle), settings(**keys))


def final(reading: WheelReading) -> Array:
    pose: Array = reading.wheels.pose[-1]
    return pose


def words(reading: WheelReading) -> str:
    return " | ".join(reading.notes)


@pytest.fixture(scope="module")
def truth() -> tuple[Array, Array]:
    return angles()


@pytest.mark.parametrize("first", [0.0, np.array([813.2, -77.1])], ids=["from zero", "from anywhere"])
def test_clean_angles_give_the_plain_sum_of_arcs_and_no_words(truth: tuple[Array, Array], first: Any) -> None:
    t, angle = truth
    reading = read(t, angle + first)
    np.testing.assert_allclose(final(reading), pose_of(angle), atol=1e-9)
    assert reading.notes == ()
    assert reading.dropped == {}


@pytest.mark.parametrize(
    ("unit", "low", "modulus"),
    [
        pytest.param(1.0, -np.pi, 2 * np.pi, id="angle wrapped to +-pi"),
        pytest.param(1.0, 0.0, 2 * np.pi, id="angle wrapped to 0..2 pi"),
        pytest.param(2 * np.pi / 4000, -128 * 2 * np.pi / 4000, 256 * 2 * np.pi / 4000, id="8-bit angle of ticks"),
        pytest.param(2 * np.pi / 4096, -(2**15) * 2 * np.pi / 4096, 2**16 * 2 * np.pi / 4096, id="16-bit angle"),
    ],
)
def test_a_rollover_is_counted_on(truth: tuple[Array, Array], unit: float, low: float, modulus: float) -> None:
    t, angle = truth
    whole = np.round(angle * 1.0 / unit) * unit if unit != 1.0 else angle
    published = (whole + 0.98 * modulus / 2 - low) % modulus + low
    reading = read(t, published)
    np.testing.assert_allclose(final(reading), pose_of(whole), atol=1e-9)
    assert "rolled over" in words(reading)
    assert "wheels.rollover" in words(reading)


def test_rollover_can_be_set_and_switched_off(truth: tuple[Array, Array]) -> None:
    t, angle = truth
    published = angle % 7.0
    reading = read(t, published, rollover=7.0)
    np.testing.assert_allclose(final(reading), pose_of(angle), atol=1e-9)
    off = read(t, (angle + 3.0) % (2 * np.pi), rollover=0)
    assert "rolled over" not in words(off)
    assert "started anew" in words(off)


@pytest.mark.parametrize("length", [1, 3, 8])
@pytest.mark.parametrize("size", [-1e6, 15.7, 0.8 / RADIUS])
def test_a_spike_that_returns_is_dropped_and_counted(truth: tuple[Array, Array], length: int, size: float) -> None:
    t, angle = truth
    published = angle.copy()
    published[300 : 300 + length, 1] += size
    reading = read(t, published)
    assert reading.dropped == {"spike": length}
    assert "jumped away and returned" in words(reading)
    np.testing.assert_allclose(final(reading)[:2], pose_of(angle)[:2], atol=2e-3)


@pytest.mark.parametrize("at", [0, -1])
@pytest.mark.parametrize("size", [1e30, 1e305, 50.0])
def test_a_first_or_last_reading_that_is_absurd_does_not_carry_the_robot_off(
    truth: tuple[Array, Array], at: int, size: float
) -> None:
    t, angle = truth
    published = angle.copy()
    published[at, 1] += size
    reading = read(t, published)
    assert "started anew" in words(reading)
    np.testing.assert_allclose(final(reading)[:2], pose_of(angle)[:2], atol=2e-3)
    motions = reading.wheels.between(t[:-1], t[1:])
    assert np.isfinite(motions.u).all()
    assert np.isfinite(motions.Q).all()


@pytest.mark.parametrize("length", [1, 40])
def test_zeros_in_place_of_both_counters_are_no_readings(truth: tuple[Array, Array], length: int) -> None:
    t, angle = truth
    published = angle + 500.0
    published[300 : 300 + length] = 0.0
    reading = read(t, published)
    assert (reading.dropped, reading.notes) == ({"zeros": length}, ())
    np.testing.assert_allclose(final(reading)[:2], pose_of(angle)[:2], atol=2e-3)
    # a wheel that rocks about zero has such values of its own
    rocking = np.where(np.arange(len(t)) % 5 == 0, 0.01, 0.0)[:, None] * np.ones(2)
    assert read(t, rocking).dropped == {}


def test_counters_that_stand_still_and_catch_up_lose_no_way(truth: tuple[Array, Array]) -> None:
    t, angle = truth
    published = angle.copy()
    published[300:380] = angle[300]
    reading = read(t, published)
    assert words(reading).count("caught up (from 6.0 s to 7.6 s): its 79 equal readings are not used") == 2
    np.testing.assert_allclose(reading.wheels.rolled.sum(axis=0), (angle[-1] - angle[0]) * RADIUS, atol=2e-3)
    # a robot that stands while its counters start anew has not driven that way
    standing = np.concatenate((angle[:300], np.repeat(angle[300:301], 80, axis=0), angle[300:500] - angle[300]))
    found = read(np.arange(580) * np.float64(0.02), standing)
    assert "started anew" in words(found)
    np.testing.assert_allclose(final(found)[:2], pose_of(angle[:500])[:2], atol=0.02)


@pytest.mark.parametrize("side", [0, 1])
def test_an_encoder_that_starts_anew_loses_one_step_and_says_so(truth: tuple[Array, Array], side: int) -> None:
    t, angle = truth
    published = angle + 500.0
    published[330:, side] -= published[330, side]
    reading = read(t, published)
    np.testing.assert_allclose(final(reading), pose_of(angle), atol=2e-3)
    assert "started anew once" in words(reading)
    assert "wheels.max_speed" in words(reading)
    assert reading.dropped == {}


@pytest.mark.parametrize("factor", [0.1, 0.5, 1.2])
def test_a_highest_speed_below_usual_ones_is_refused_with_the_speed(
    truth: tuple[Array, Array], factor: float
) -> None:
    t, angle = truth[0][::10], truth[1][::10]  # steps beside which the slack of 2 cm is short
    fastest = RADIUS * float(np.abs(np.diff(angle, axis=0)).max() / (t[1] - t[0]))
    if factor > 1.0:
        np.testing.assert_array_equal(final(read(t, angle, max_speed=factor * fastest)), final(read(t, angle)))
    else:
        with pytest.raises(
            LocfuseError, match=rf"faster than wheels.max_speed={factor * fastest:g} m/s.*90% .* m/s"
        ):
            read(t, angle, max_speed=factor * fastest)


def test_nan_and_repeats_and_two_values_with_one_stamp_are_counted(truth: tuple[Array, Array]) -> None:
    t, angle = (a.copy() for a in truth)
    angle[100, 0] = np.nan
    angle[101, 1] = np.inf
    t[200] = t[201]
    angle[300], t[300] = angle[301], t[301]
    reading = read(t, angle)
    assert reading.dropped == {"not_finite": 2, "same_stamp": 1, "repeat": 1}
    np.testing.assert_allclose(final(reading), pose_of(truth[1]), atol=2e-3)


def test_gaps_bursts_of_messages_and_bursts_of_speed_are_no_faults(truth: tuple[Array, Array]) -> None:
    t, angle = truth
    keep = (t < 4.0) | (t > 6.5)
    reading = read(t[keep], angle[keep])
    assert reading.notes == ()
    assert final(reading)[2] == pytest.approx(pose_of(angle)[2], abs=1e-9)
    t, angle = truth
    n = np.arange(len(t))
    bursts = n // 10 * 0.2 + 1e-4 * (n % 10)  # ten messages within a millisecond
    reading = read(bursts, angle)
    assert reading.notes == ()
    assert not reading.dropped
    t = np.arange(0, 20, 0.05)
    speed = np.interp(t, [0, 9.5, 10.0, 10.5, 11.0, 20], [1.0, 1.0, 18.0, 18.0, 1.0, 1.0])
    angle = np.stack((np.cumsum(speed) * 0.05, np.cumsum(speed) * 0.05), axis=-1)
    reading = read(t, angle)
    np.testing.assert_allclose(final(reading), pose_of(angle), atol=1e-9)
    assert not reading.dropped


@pytest.mark.parametrize(("mirrored", "sides"), [("left", (-1, 1)), ("right", (1, -1)), ("both", (-1, -1))])
def test_mirrored_turns_wheels_round(truth: tuple[Array, Array], mirrored: str, sides: tuple[int, int]) -> None:
    t, angle = truth
    assert abs(final(read(t, angle * sides)) - pose_of(angle)).max() > 0.1
    np.testing.assert_allclose(final(read(t, angle * sides, mirrored=mirrored)), pose_of(angle), atol=1e-9)


def test_an_arm_on_the_same_topic_is_set_aside(truth: tuple[Array, Array]) -> None:
    t, angle = truth
    n = len(t)
    both = np.repeat(t, 2) + np.tile([0.0, 0.004], n)
    names = [("left_wheel", "right_wheel"), ("shoulder", "elbow", "wrist")] * n
    values = np.concatenate([[*row, 0.1, 0.2, 0.3] for row in angle.tolist()])
    first = np.concatenate(([0], np.cumsum([2, 3] * n)))
    data: dict[str, Column] = {"name": names, "position": Ragged(values, first)}
    reading = read_wheels(stream("/joint_states", "sensor_msgs/msg/JointState", both, data), settings())
    np.testing.assert_allclose(final(reading), pose_of(angle), atol=1e-9)
    assert reading.dropped == {"other_joints": n}


def test_names_decide_and_not_positions(truth: tuple[Array, Array]) -> None:
    t, angle = truth
    n = len(t)
    rows = [("rear", "right_wheel", "left_wheel"), ("left_wheel", "rear", "right_wheel")] * (n // 2)
    spot = {"rear": None, "left_wheel": 0, "right_wheel": 1}
    values = [9.9 if spot[j] is None else angle[i, int(spot[j] or 0)] for i, row in enumerate(rows) for j in row]
    data: dict[str, Column] = {"name": rows, "position": Ragged(np.array(values), np.arange(0, 3 * n + 1, 3))}
    reading = read_wheels(stream("/joint_states", "sensor_msgs/msg/JointState", t, data), settings())
    np.testing.assert_allclose(final(reading), pose_of(angle), atol=1e-9)


# --- a counter alone that rolled over, and one that did not

RANGE = 64.0


@pytest.mark.parametrize("top", [66.0, 90.0, 120.0])
@pytest.mark.parametrize("zero", [0.0, -50.0])
def test_values_that_span_more_than_one_range_never_rolled_over_it(top: float, zero: float) -> None:
    """A counter modulo 64 shows no 66: a fall by 63 is then a fault of the reading, however well it fits."""
    values = zero + np.concatenate((np.arange(0.0, top), np.arange(top - 64.0, top - 40.0)))
    steps = np.abs(np.diff(values))
    assert steps.max() == RANGE - 1.0
    assert values.max() - values.min() > RANGE
    found = unrolled(values, likely=(RANGE,))
    assert found.modulus is None
    np.testing.assert_array_equal(found.values, values)


@pytest.mark.parametrize(("left", "rolled"), [(9.0, True), (14.0, True), (20.0, False)])
def test_a_long_step_is_a_rollover_only_if_an_ordinary_one_is_left(left: float, rolled: bool) -> None:
    """Ordinary steps are of 10; what a fall leaves of the range may be one and a half of them."""
    values = np.array([0.0, 10.0, 20.0, 30.0, 40.0, 50.0, 60.0])
    after = values[-1] + left - RANGE + np.array([0.0, 10.0, 20.0])
    found = unrolled(np.concatenate((values, after)), likely=(RANGE,))
    assert (found.modulus == RANGE) is rolled


@pytest.mark.parametrize("unit", [1e-9, 1.0, 1e9])
@pytest.mark.parametrize("bits", [8, 10, 16])
def test_a_counter_of_so_many_bits_is_found_whatever_its_unit(bits: int, unit: float) -> None:
    true = np.arange(3 * 2**bits, step=2 ** (bits - 6)) * unit
    found = unrolled(true % (2**bits * unit))
    assert found.modulus == pytest.approx(2**bits * unit, rel=1e-9)
    np.testing.assert_allclose(found.values, true, rtol=1e-9)


def test_a_counter_whose_steps_are_all_long_is_found_by_their_common_divisor() -> None:
    """18, 43, 44 ... ticks at a time: the shortest step is no tick."""
    true = np.cumsum(np.resize([18.0, 43.0, 127.0, 44.0, 130.0, 95.0], 200))
    found = unrolled(true % 1024.0)
    assert found.modulus == 1024.0
    np.testing.assert_array_equal(found.values, true)


def test_a_wheel_at_rest_where_it_rolls_over_stays_and_ticks_may_come_three_at_a_time() -> None:
    """Nothing but rounding moves: 0 and a turn less a billionth are one place."""
    found = unrolled(np.array([0.0, 0.0, 360.0 - 1e-9, 0.0, 360.0 - 1e-9, 360.0 - 1e-9]))
    assert found.modulus == 360.0
    np.testing.assert_allclose(found.values, found.values[0], atol=2e-9)
    true = np.arange(0.0, 20000.0, 3.0)
    found = unrolled(true % 4096.0)
    assert found.modulus == 4096.0
    np.testing.assert_array_equal(found.values, true)


@pytest.mark.parametrize(("miss", "ticks"), [(0.01, True), (0.03, False)])
def test_steps_are_of_ticks_where_they_miss_whole_numbers_by_a_fiftieth_at_most(miss: float, ticks: bool) -> None:
    true = np.cumsum(np.tile([1.0, 2.0 + miss, 3.0 - miss], 100))
    assert (unrolled(true % 256.0).modulus is not None) is ticks


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
    tmp_path: Path,
    truth: tuple[Array, Array],
    kind: str,
    text: str,
    fields: tuple[str, str],
    a_turn: float,
    offset: int,
) -> None:
    t, angle = truth
    ticks = np.round(angle * a_turn / (2 * np.pi)).astype(np.int64) + offset
    wrapped = (ticks + 2**31) % 2**32 - 2**31
    rows = [dict(zip(fields, pair, strict=True)) for pair in wrapped.tolist()]
    log = custom(tmp_path / "ticks.mcap", "/ticks", kind, text, t, rows)
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
    tmp_path: Path, truth: tuple[Array, Array], kind: str, left: str, right: str, bits: int
) -> None:
    t, angle = truth
    late = t + 0.007  # the right wheel is read 7 ms later
    seen = np.stack((angle[:, 0], np.interp(late, t, angle[:, 1])), axis=-1)
    values: Any = seen.tolist()
    how: tuple[str, ...] = GEOMETRY
    if bits:
        ticks = np.round(seen * TICKS / (2 * np.pi)).astype(np.int64)
        if bits == 16:
            ticks = (ticks + 32_000 + 2**15) % 2**16 - 2**15
        values = ticks.tolist()
        how = (*GEOMETRY, "--set", f"wheels.ticks_per_revolution={TICKS}")
    log = log_of(
        tmp_path / "pair.mcap",
        numbers(left, kind, t, [v[0] for v in values]),
        numbers(right, kind, late, [v[1] for v in values]),
    )
    report, pose, stderr = run(log, *how)
    assert_pose(pose, pose_of(angle), 2e-3)
    assert report["input"]["topics"]["wheels"] == left
    assert "not synchronised" in stderr


def test_a_pair_can_be_named_and_half_a_pair_is_one_clear_line(tmp_path: Path, truth: tuple[Array, Array]) -> None:
    t, angle = truth
    log = log_of(
        tmp_path / "odd.mcap",
        numbers("/m1", "Float64", t, angle[:, 0].tolist()),
        numbers("/m2", "Float64", t, angle[:, 1].tolist()),
    )
    words = ("run", log, *GEOMETRY, "-o", tmp_path / "a")
    refused(*words)
    assert "--set wheels.right_topic=" in refused(*words, "--set", "wheels.left_topic=/m1")
    assert "--set wheels.left_topic=/m1" in refused(*words, "--set", "wheels.topic=/m1")
    named = ("--set", "wheels.left_topic=/m1", "--set", "wheels.right_topic=/m2")
    _, pose, _ = run(log, *GEOMETRY, *named)
    assert_pose(pose, pose_of(angle), 1e-6)


def test_ticks_beat_the_joints_of_an_arm(tmp_path: Path, truth: tuple[Array, Array]) -> None:
    t, angle = truth
    ticks = np.round(angle * TICKS / (2 * np.pi)).astype(np.int64)
    log = log_of(
        tmp_path / "arm.mcap",
        joint_states(t, np.zeros_like(angle), ("left_shoulder", "elbow")),
        numbers("/left_ticks", "Int32", t, ticks[:, 0].tolist()),
        numbers("/right_ticks", "Int32", t, ticks[:, 1].tolist()),
    )
    report, pose, _ = run(log, *GEOMETRY, "--set", f"wheels.ticks_per_revolution={TICKS}")
    assert report["input"]["topics"]["wheels"] == "/left_ticks"
    assert_pose(pose, pose_of(ticks * 2 * np.pi / TICKS), 1e-6)


# --- other odometries


def odometry(t: Array, pose: Array, speed: Array, turn: Array) -> ArrayStream:
    return odometry_stream(np.rint(t * 1e9).astype(np.int64), pose, speed, turn)


def driven(speed: Array, turn: Array, dt: float) -> Array:
    return reckoned(np.column_stack((speed, turn)) * dt)


def way() -> tuple[Array, Array, Array]:
    t = np.arange(0, 30, 0.1)
    speed = np.interp(t, [0, 1, 9, 10, 11, 14, 15, 30], [0, 0.4, 0.4, 0, -0.3, -0.3, 0.4, 0.4])
    return t, speed, 0.3 * np.sin(t / 3)


def test_a_pose_that_cannot_back_up_is_turned_round_where_the_twist_says_so() -> None:
    t, speed, turn = way()
    right = driven(speed[:-1], turn[:-1], 0.1)
    blind = driven(np.abs(speed[:-1]), turn[:-1], 0.1)
    assert np.hypot(*(right[-1] - blind[-1])[:2]) > 1.0
    reading = read_wheels(odometry(t, blind, speed, turn), WheelSettings())
    assert "while its velocity says reverse" in words(reading)
    assert "wheels.reverse_by_twist=false" in words(reading)
    assert np.hypot(*(final(reading) - right[-1])[:2]) < 0.06
    left = read_wheels(odometry(t, blind, speed, turn), WheelSettings(reverse_by_twist=False))
    np.testing.assert_allclose(final(left)[:2], blind[-1, :2], atol=1e-9)
    assert left.notes == ()


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
    assert said == [
        "wheels: a gap of 5.2 s (9.9-15.1 s): the robot moved 1.56 m and 0° there, which is taken for one arc"
    ]


@pytest.mark.parametrize("start", [0.0, 1.0, 2.5, -2.0])
def test_a_twist_along_the_frame_of_the_poses_turns_nothing_round(start: float) -> None:
    """Simulators say how fast the body goes along x of the world: backward wherever it heads away from there."""
    t = np.arange(0, 60, 0.1)
    speed, turn = np.full(len(t), 0.4), np.full(len(t), 0.25)
    pose = driven(speed[:-1], turn[:-1], 0.1)
    c, s = np.cos(start), np.sin(start)
    turned = np.stack(
        (c * pose[:, 0] - s * pose[:, 1], s * pose[:, 0] + c * pose[:, 1], pose[:, 2] + start), axis=-1
    )
    jumped = turned + np.where(t[:, None] > 30.0, [50.0, 0.0, 0.0], 0.0)
    for told, notes in ((turned, 1), (jumped, 2)):
        reading = read_wheels(odometry(t, told, speed * np.cos(turned[:, 2]), turn), WheelSettings())
        assert "backward" not in words(reading)
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
    assert note in words(reading)
    assert ("mirror" in words(reading) or "aside" in words(reading)) == bool(note)
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
    anew = pose.copy()
    anew[150:, :2] -= anew[150, :2]
    reading = read_wheels(odometry(t, anew, speed, turn), WheelSettings())
    assert "jumped once" in words(reading)
    np.testing.assert_allclose(final(reading)[:2], pose[-1, :2], atol=0.02)
    spiked = pose.copy()
    spiked[200:202, 0] += 30.0
    reading = read_wheels(odometry(t, spiked, speed, turn), WheelSettings())
    assert reading.dropped == {"spike": 2}
    np.testing.assert_allclose(final(reading)[:2], pose[-1, :2], atol=0.02)


def test_an_odometry_far_from_zero_counts_by_increments_and_a_frozen_pose_by_twist() -> None:
    t, speed, turn = way()
    pose = driven(speed[:-1], turn[:-1], 0.1)
    moved = pose + np.array([1200.0, -35.0, 0.0])
    reading = read_wheels(odometry(t, moved, speed, turn), WheelSettings())
    np.testing.assert_allclose(final(reading)[:2], pose[-1, :2], atol=1e-8)
    reading = read_wheels(odometry(t, np.zeros_like(pose), speed, turn), WheelSettings())
    assert "its twist is used" in words(reading)
    np.testing.assert_allclose(final(reading)[:2], pose[-1, :2], atol=0.05)


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
        c, s = np.cos(a[:, 2]), np.sin(a[:, 2])
        dx, dy = (b - a)[:, 0], (b - a)[:, 1]
        found = np.stack((c * dx + s * dy, -s * dx + c * dy), axis=-1)
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
    t, angle = angles()
    with pytest.raises(LocfuseError, match="two are the least"):
        read(t[:1], angle[:1])
    with pytest.raises(LocfuseError, match=r"--set wheels\.radius=<metres>"):
        read_wheels(joints(t, angle), WheelSettings())
