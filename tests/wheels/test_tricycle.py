"""A tricycle by a traction counter that rolls over and an absolute steering encoder, calibrated by truth."""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bags import Said, real_log
from commands import locfuse, ok, refused, reported
from msgspec.structs import replace
from present import present
from small_drive import drive, robot
from wheel_bags import log_of, messages, numbers, odometry, poses_in

from locfuse.fusion import se2
from locfuse.fusion.checks.finding import Finding
from locfuse.fusion.checks.steering import STEERING, ZERO as ZERO_MOVES, of_steering
from locfuse.fusion.checks.turning import MIRROR
from locfuse.fusion.data import Array, ArrayStream, LocfuseError, Truth
from locfuse.fusion.robot import WheelSettings
from locfuse.fusion.streams import MergedStream
from locfuse.fusion.wheels.calibrate_tricycle import (
    ReferenceMotion,
    TricycleCalibration,
    calibrate_tricycle,
    nominal,
    of_truth,
)
from locfuse.fusion.wheels.read import read_wheels
from locfuse.fusion.wheels.steered import read_encoders

RADIUS, TICKS, TURN, BASE, ZERO = 0.1, 5000.0, 8192, 1.2, 300.0  # m, ticks a turn, of the steering, m, ticks
GAIN = TURN / (2.0 * np.pi)  # ticks per radian
T = np.arange(0.0, 120.0, 0.04)
ANGLE = 0.6 * np.sin(0.11 * T) + 0.2 * np.sin(0.37 * T)


def encoders() -> MergedStream:
    """Both counters in closed form but for rounding: the traction rolls over at 2^32, the steering at 8192."""
    way = 0.6 * T - 1.5 * (np.cos(0.2 * T) - 1.0)
    traction = (np.rint(way * TICKS / (2.0 * np.pi * RADIUS)) + 2**32 - 20_000) % 2**32
    steering = np.rint(ANGLE * GAIN + ZERO) % TURN
    stamps = np.rint((T + 1e9) * 1e9).astype(np.int64)
    kind = "std_msgs/msg/Int64"
    parts = [
        ArrayStream(topic, kind, stamps, {"data": values})
        for topic, values in (("/traction_ticks", traction), ("/steering_ticks", steering))
    ]
    return MergedStream(tuple(parts))


def true_path() -> Array:
    """The poses (n, 3) by small steps of the textbook's kinematics, ten between two readings."""
    fine = np.linspace(0.0, T[-1], 10 * (len(T) - 1) + 1)
    speed, angle = 0.6 + 0.3 * np.sin(0.2 * fine), 0.6 * np.sin(0.11 * fine) + 0.2 * np.sin(0.37 * fine)
    dt = fine[1]
    theta = np.append(0.0, np.cumsum(speed * np.sin(angle) / BASE * dt)[:-1])
    x = np.append(0.0, np.cumsum(speed * np.cos(angle) * np.cos(theta) * dt)[:-1])
    y = np.append(0.0, np.cumsum(speed * np.cos(angle) * np.sin(theta) * dt)[:-1])
    return np.stack((x, y, theta), axis=-1)[::10]


def tracked(path: Array, x: float = 0.0, y: float = 0.0) -> Truth:
    """Every fifth of the poses (n, 3), as a tracker sees them of a point (x, y) on the robot."""
    seen = se2.compose(path, np.broadcast_to([x, y, 0.0], path.shape))[::5]
    return Truth("/tracker", T[::5], seen[:, :2], seen[:, 2], (0.0, 0.0))


def settings(**given: Any) -> WheelSettings:
    told: dict[str, Any] = {"servo_gain": GAIN, "servo_offset": ZERO, "wheelbase": BASE, **given}
    return WheelSettings(radius=RADIUS, ticks_per_revolution=TICKS, **told)


def assert_wheels(found: TricycleCalibration, off: float, zero: float | None = None) -> None:
    """Gain and wheelbase are right but for a share `off`, and the steering's zero but for so many ticks."""
    assert found.wheels["servo_gain"].value == pytest.approx(GAIN, rel=off)
    assert found.wheels["wheelbase"].value == pytest.approx(BASE, rel=off)
    assert zero is None or found.wheels["servo_offset"].value == pytest.approx(ZERO, abs=zero)


def test_both_encoders_drive_the_path_of_the_kinematics_over_their_ends() -> None:
    reading = read_wheels(encoders(), settings())
    np.testing.assert_allclose(reading.wheels.pose[-1], true_path()[-1], atol=0.05)
    assert any("rolled over" in note for note in reading.notes)


@pytest.mark.parametrize("missing", ["radius", "servo_gain", "wheelbase"])
def test_what_is_not_known_of_the_encoders_is_asked_for(missing: str) -> None:
    told: dict[str, Any] = {"radius": RADIUS, "ticks_per_revolution": TICKS, "servo_gain": GAIN, "wheelbase": BASE}
    with pytest.raises(LocfuseError) as error:
        read_wheels(encoders(), WheelSettings(**{**told, missing: None}))
    assert f"wheels.{missing}" in error.value.hint


def test_a_truth_tells_a_tricycle_of_which_nothing_is_known() -> None:
    path = true_path()
    turned = se2.compose(np.broadcast_to([2.0, -1.0, 0.7], path.shape), path)
    truth = of_truth(tracked(turned, 0.9, 0.1))
    start = nominal(encoders(), WheelSettings(), truth, 0.0)
    found = calibrate_tricycle(read_encoders(encoders(), start), start, truth, 0.0)
    assert found.rms < 0.02
    assert not found.breaks
    radius = found.wheels["radius"].value * TICKS / present(start.ticks_per_revolution)
    assert radius == pytest.approx(RADIUS, rel=0.01)  # only the way per tick can be seen
    assert_wheels(found, 0.01)
    assert [found.mount[key].value for key in "xy"] == pytest.approx([0.9, 0.1], abs=0.03)


@pytest.mark.parametrize(("broken", "middle"), [("truth", 60.0), ("counter", 41.5)])
def test_a_truth_that_jumps_or_a_counter_that_stands_for_3_s_is_left_out(broken: str, middle: float) -> None:
    jump = np.where((broken == "truth") & (T > 60.0), 0.5, 0.0)
    truth = of_truth(tracked(true_path() + jump[:, None] * [1.0, 0.0, 0.0], 0.9, 0.1))
    nominal = settings(servo_gain=3.0 * GAIN, servo_offset=0.0, wheelbase=1.0)
    found = read_encoders(encoders(), nominal)
    if broken == "counter":
        stands = (T[:-1] > 40.0) & (T[:-1] < 43.0)
        steps = np.where(stands, 0.0, np.diff(found.rolled))
        found = found._replace(rolled=np.append(0.0, np.cumsum(steps)))
    calibrated = calibrate_tricycle(found, nominal, truth, 0.0)
    assert calibrated.rms < 0.02
    assert calibrated.wheels["radius"].value == pytest.approx(RADIUS, rel=0.01)
    assert_wheels(calibrated, 0.015)
    ((begin, end),) = calibrated.breaks
    assert begin < middle < end


def findings(told: WheelSettings, path: Array, stream: MergedStream) -> list[Finding]:
    """What the truth shows of the steering of encoders that are read with these settings."""
    described = replace(robot(), wheels=replace(told, max_speed=5.0))
    reading = read_wheels(stream, described.wheels)
    one = replace(drive(0, robot(), ()), wheels=reading.wheels, truth=tracked(path), epoch_ns=reading.epoch_ns)
    return list(of_steering(one, described, stream))


@pytest.mark.parametrize(
    ("wrong", "mirrored", "code"),
    [
        ({}, False, None),
        ({"servo_offset": ZERO + 300.0}, False, STEERING),
        ({"wheelbase": 2.0}, False, STEERING),
        ({"servo_gain": -GAIN, "servo_offset": -ZERO}, False, STEERING),
        ({}, True, MIRROR),
    ],
)
def test_wrong_steering_is_named_with_what_the_truth_shows(
    wrong: dict[str, float], mirrored: bool, code: str | None
) -> None:
    path = true_path() * ([1.0, -1.0, -1.0] if mirrored else 1.0)
    found = findings(settings(**wrong), path, encoders())
    assert [f.code for f in found] == ([] if code is None else [code])
    fixes = dict(fix.split("=") for f in found for fix in f.fixes)
    if code == STEERING:
        assert float(fixes["wheels.servo_gain"]) == pytest.approx(GAIN, rel=0.01)
        assert float(fixes["wheels.servo_offset"]) == pytest.approx(ZERO, abs=15.0)
        assert float(fixes["wheels.wheelbase"]) == pytest.approx(BASE, rel=0.01)
    else:
        assert not fixes


def test_a_zero_of_the_steering_that_moves_by_8_degrees_is_named_with_its_times() -> None:
    traction, steering = encoders().parts
    ticks = (np.asarray(steering.columns("data")["data"]) + np.where(T > 60.0, 180.0, 0.0)) % TURN
    moved = ArrayStream("/steering_ticks", steering.msgtype, steering.t_ns, {"data": ticks})
    slipped = MergedStream((traction, moved))
    (found,) = findings(settings(), true_path(), slipped)
    assert (found.code, found.fixes) == (ZERO_MOVES, ())
    off = [float(zero) for zero in re.findall(r"(-?[0-9.]+)° from", found.message)]
    assert off == pytest.approx([0.0, 0.0, -7.9, -7.9], abs=0.6)


def test_a_laser_that_drifts_and_is_late_tells_the_same_and_where_it_sits() -> None:
    mount, late = np.array([0.4, -0.1, 0.3]), 0.15  # m, m, rad; s
    path = true_path()
    step = se2.between(path[:-5:5], path[5::5])
    step += np.random.default_rng(1).normal(0.0, (0.002, 0.002, 0.002), step.shape)  # it drifts by some decimetres
    body = se2.chain(step)
    seen = se2.between(np.broadcast_to(mount, body.shape), se2.compose(body, np.broadcast_to(mount, body.shape)))
    nominal = replace(settings(servo_gain=3.0 * GAIN, servo_offset=0.0, wheelbase=1.0), radius=1.2 * RADIUS)
    reference = ReferenceMotion("lrf", T[::5][: len(seen)] + late, seen)
    found = calibrate_tricycle(read_encoders(encoders(), nominal), nominal, reference, 0.0)
    assert found.wheels["radius"].value == pytest.approx(RADIUS, rel=0.01)
    assert_wheels(found, 0.02, 20.0)
    values = [found.mount[key].value for key in ("x", "y", "yaw_deg", "time_offset")]
    assert values == pytest.approx([0.4, -0.1, np.degrees(0.3), -late], abs=0.05, rel=0.05)


def test_a_gyro_tells_steering_and_wheelbase_and_leaves_the_radius() -> None:
    late, bias = 0.1, 0.01
    heading = true_path()[:, 2] + bias * T + np.random.default_rng(2).normal(0.0, 0.001, len(T))
    reference = ReferenceMotion("gyro", T + late, np.column_stack((np.zeros((len(T), 2)), heading)))
    nominal = settings(servo_gain=2.5 * GAIN, servo_offset=0.0, wheelbase=0.9)
    found = calibrate_tricycle(read_encoders(encoders(), nominal), nominal, reference, 0.0)
    assert set(found.wheels) == {"servo_gain", "servo_offset", "wheelbase"}
    assert found.mount == {}
    assert_wheels(found, 0.03, 30.0)


def test_a_reference_that_hardly_turns_calibrates_nothing() -> None:
    reference = ReferenceMotion("gyro", T, np.zeros((len(T), 3)))
    with pytest.raises(LocfuseError, match="hardly a turn"):
        calibrate_tricycle(read_encoders(encoders(), settings()), settings(), reference, 0.0)


def tricycle_log(path: Path, gyro: bool, *more: list[Said]) -> Path:
    """Both counters, and perhaps an IMU of the same drive, as a bag."""
    counters = encoders()
    counted = ((p.topic, map(int, np.asarray(p.columns("data")["data"]))) for p in counters.parts)
    said = [*more, *(numbers(topic, "Int64", T, values) for topic, values in counted)]
    if gyro:
        rows = ({"angular_velocity": {"z": rate}} for rate in np.gradient(true_path()[:, 2], T).tolist())
        said.append(messages("/imu", "sensor_msgs/msg/Imu", T, rows, "imu"))
    return log_of(path, *said)


def test_calibrate_uses_a_gyro_where_a_tricycle_has_no_truth_and_asks_without_any(tmp_path: Path) -> None:
    known = {"radius": RADIUS, "ticks_per_revolution": TICKS, "servo_gain": 2.0 * GAIN, "wheelbase": 1.0}
    words = [word for key, value in known.items() for word in ("--set", f"wheels.{key}={value}")]
    done = ok("calibrate", tricycle_log(tmp_path / "gyro.mcap", True), *words, "--json")
    found = json.loads(done.stdout)
    assert found["tricycle"]["by"] == "gyro"
    assert found["robot"]["wheels"]["servo_gain"] == pytest.approx(GAIN, rel=0.03)
    assert "radius" not in found["robot"]["wheels"]
    info = locfuse("info", tricycle_log(tmp_path / "blind.mcap", False)).stdout
    assert "these are unknown: radius, servo gain, wheelbase, ticks per revolution" in " ".join(info.split())
    refusal = refused("calibrate", tmp_path / "blind.mcap", *words)
    assert "a steered tricycle is calibrated by one log with truth, laser or gyro" in refusal


@pytest.mark.parametrize(
    ("change", "says", "hint"),
    [
        ((1.0, 1.0, 1.0), "", ""),
        ((1.0, 1.0, 0.0), "the truth has no headings", "needs a truth with headings to find them"),
        (None, "x and y of the truth are exchanged", "finds them by the truth, or says why not"),
    ],
)
def test_init_says_why_a_truth_does_not_tell_a_tricycle(
    change: tuple[float, ...] | None, says: str, hint: str, tmp_path: Path
) -> None:
    path = true_path()
    seen = path[:, [1, 0, 2]] if change is None else path * change
    log = tricycle_log(tmp_path / "log.mcap", False, odometry(T, path), poses_in("map", T, seen, "/tracker"))
    words = ("--set", "truth.topic=/tracker")
    done = locfuse("init", log, *words, "-o", tmp_path / "robot.toml")
    assert says in done.stderr
    assert ("fill in wheels.radius" in done.stderr) == bool(says)
    if hint:
        found = ("--no-advice", "--no-smooth", "--write", "json", "-o", tmp_path / "out")
        assert hint in locfuse("compare", log, *words, *found).stdout


def test_what_init_writes_of_a_real_tricycle_leads_from_16_m_to_its_tracker(tmp_path: Path) -> None:
    log, named = real_log("tricycle/tricycle.mcap"), ("--set", "truth.topic=/tracker")
    headline = reported("compare", log, *named, "--no-advice").report["headline"]
    assert f"`locfuse init {log} --set truth.topic=/tracker -o robot.toml` finds them by the truth" in headline
    assert locfuse("init", log, *named, "-o", tmp_path / "robot.toml").exit_code == 0
    odometry = reported("compare", log, "--robot", tmp_path / "robot.toml", "--no-advice").rows["odometry"]
    assert odometry["position_rmse_m"] < 0.15
    assert 0.4 < odometry["anees"] < 2.0
