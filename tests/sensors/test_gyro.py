"""The gyro: turns against a kept heading, held to a batch solution of the same measurements."""

import math
from typing import Any

import numpy as np
import pytest
from pose_streams import reckoned
from rows import one_by_one, readings, said, step
from worlds import EPOCH, joints, stream

from locfuse.cli.analysis.robot_tables import make_robot
from locfuse.fusion.data import Array, ArrayStream, Column, Drive, LocfuseError, Measurements
from locfuse.fusion.ekf.belief_arrays import JointBelief
from locfuse.fusion.fuse import fuse
from locfuse.fusion.measure import measure
from locfuse.fusion.robot import Robot
from locfuse.fusion.se2 import rotation_3d
from locfuse.fusion.sensor import Block
from locfuse.fusion.sensors.gyro import BEFORE, BIAS, Gyro, GyroSettings
from locfuse.fusion.wheels.motion import Wheels
from locfuse.fusion.whole_drive.smooth import fuse_and_smooth

RADIUS, TRACK, NOISE = 0.05, 0.4, 1e-3
IMU = "sensor_msgs/msg/Imu"


def way(duration: float = 30.0, rate: float = 50.0) -> tuple[Array, Array, Array]:
    """Times (n,), true headings (n,) and speeds (n,): two seconds of standing, then wide curves."""
    t = np.arange(0.0, duration, 1.0 / rate)
    speed = np.interp(t, [0, 2, 3, duration], [0, 0, 0.4, 0.4])
    turning = np.where(t < 2.5, 0.0, 0.5 * np.sin(0.7 * (t - 2.5)))
    theta = np.concatenate(([0.0], np.cumsum(0.5 * (turning[1:] + turning[:-1]) / rate)))
    return t, theta, speed


def wheels(
    t: Array, theta: Array, speed: Array, rng: np.random.Generator, slip: Array | None = None
) -> ArrayStream:
    ds = 0.5 * (speed[1:] + speed[:-1]) * np.diff(t)
    turn = np.diff(theta)
    sides = np.stack((ds - 0.5 * TRACK * turn, ds + 0.5 * TRACK * turn), axis=-1)
    sides = sides + np.sqrt(NOISE * np.abs(sides)) * rng.normal(size=sides.shape)
    if slip is not None:
        sides[:, 0] += slip
    return joints(t, np.concatenate((np.zeros((1, 2)), np.cumsum(sides, axis=0))) / RADIUS)


def imu(
    t: Array,
    theta: Array,
    rng: np.random.Generator,
    bias: float = 0.0,
    walk: float = 0.0,
    mount: Array | None = None,
    **columns: Any,
) -> ArrayStream:
    """Rates whose trapezoids are the true turns, plus a bias [rad/s] and white noise [rad/sqrt(s)]."""
    turn = np.diff(theta) / np.diff(t)
    rate = np.concatenate((turn[:1], turn))
    rate = np.interp(t, t, rate) + bias + walk / math.sqrt(float(np.diff(t)[0])) * rng.normal(size=len(t))
    up = np.array([0.0, 0.0, 1.0]) if mount is None else mount[2]
    data: dict[str, Column] = {f"angular_velocity.{a}": rate * up[i] for i, a in enumerate("xyz")}
    data["angular_velocity_covariance"] = np.zeros((len(t), 9))
    return stream("/imu", IMU, t, {**data, **columns})


def robot(gyro: dict[str, Any] | None = None, **tables: Any) -> Robot:
    return make_robot({"wheels": {"radius": RADIUS, "track": TRACK, "noise": NOISE}, "gyro": gyro or {}, **tables})


def compass(t: Array, theta: Array, rng: np.random.Generator, sigma: float) -> ArrayStream:
    return stream("/heading", "std_msgs/msg/Float64", t, {"data": theta + sigma * rng.normal(size=len(t))})


def drive_with_all(seed: int) -> tuple[Drive, Robot]:
    rng = np.random.default_rng(seed)
    t, theta, speed = way(12.0)
    at = np.arange(0.203, 11.5, 0.37)  # never at the gyro's instants
    described = robot(
        {"sigma_deg": 0.2, "sigma_scale": 0.0, "bias_drift_deg": 0.0},
        compass={"sigma_deg": 2.0, "offset_deg": 0.0},
        start={"sigma_theta_deg": 1.0},
    )
    streams = {
        "wheels": wheels(t, theta, speed, rng),
        "gyro": imu(t, theta, rng, math.radians(0.7), math.radians(0.2)),
        "compass": compass(at, np.interp(at, t, theta), rng, math.radians(2.0)),
    }
    return measure(streams, described), described


def batch(drive: Drive, robot: Robot) -> tuple[Array, Array]:
    """Headings at all instants and the bias, and their covariance, by least squares of everything at once."""
    n = len(drive.t)
    rows: list[Array] = []
    values: list[float] = []

    def add(entries: dict[int, float], value: float, variance: float) -> None:
        row = np.zeros(n + 1)
        for k, v in entries.items():
            row[k] += v
        rows.append(row / math.sqrt(variance))
        values.append(value / math.sqrt(variance))

    add({0: 1.0}, 0.0, math.radians(robot.start.sigma_theta_deg) ** 2)
    add({n: 1.0}, 0.0, math.radians(robot.settings("gyro").sigma_bias_deg) ** 2)
    for k in range(1, n):
        # where the wheels stand still they are certain: a variance of nothing, within double precision
        add({k: 1.0, k - 1: -1.0}, float(drive.motions.u[k, 2]), max(float(drive.motions.Q[k, 2, 2]), 1e-14))
    c, at = drive.measurements["compass"], drive.instant["compass"]
    for i, k in enumerate(at.tolist()):
        add({k: 1.0}, float(c.z[i, 0]), float(c.R[i, 0, 0]))
    g, at = drive.measurements["gyro"], drive.instant["gyro"]
    for i in range(1, len(g.t)):
        dt = float(g.t[i] - g.t[i - 1])
        value, variance = float(g.z[i, 0] - g.z[i - 1, 0]), g.scale**2 * dt
        add({int(at[i]): 1.0, int(at[i - 1]): -1.0, n: dt}, value, variance)
    A = np.array(rows)
    information = A.T @ A
    P = np.asarray(np.linalg.inv(information), np.float64)
    return P @ (A.T @ np.array(values)), P


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_filter_and_smoother_with_a_kept_heading_are_the_batch_solution(seed: int) -> None:
    drive, described = drive_with_all(seed)
    filtered, smoothed = fuse_and_smooth(drive, described, ("compass", "gyro"))
    x, P = batch(drive, described)
    assert filtered.pose[-1, 2] == pytest.approx(x[-2], abs=1e-7)
    assert filtered.P[-1, 2, 2] == pytest.approx(P[-2, -2], rel=1e-5)
    assert filtered.blocks["gyro_bias"][-1, 0] == pytest.approx(x[-1], abs=1e-7)
    assert filtered.block_sigmas["gyro_bias"][-1, 0] == pytest.approx(math.sqrt(P[-1, -1]), rel=1e-5)
    np.testing.assert_allclose(smoothed.pose[:, 2], x[:-1], atol=1e-6)
    np.testing.assert_allclose(smoothed.P[:, 2, 2], np.diag(P)[:-1], rtol=1e-3)


def test_the_bias_is_found_while_standing_and_the_heading_beats_the_wheels() -> None:
    rng = np.random.default_rng(4)
    t, theta, speed = way(60.0)
    described = robot()
    streams = {"wheels": wheels(t, theta, speed, rng), "gyro": imu(t, theta, rng, math.radians(-1.1), 1e-4)}
    drive = measure(streams, described)
    with_gyro, odometry = fuse(drive, described, ("gyro",)), fuse(drive, described, ())
    standing = int(np.searchsorted(drive.t, 1.9))
    assert math.degrees(with_gyro.blocks["gyro_bias"][standing, 0]) == pytest.approx(-1.1, abs=0.1)
    wanted = np.interp(drive.t, t, theta)
    error = {e.name: np.sqrt(((e.pose[:, 2] - wanted) ** 2).mean()) for e in (with_gyro, odometry)}
    assert error["gyro"] < 0.25 * error["odometry"]
    nees = (with_gyro.pose[:, 2] - wanted) ** 2 / np.maximum(with_gyro.P[:, 2, 2], 1e-12)
    assert nees[standing + 50 :].mean() < 6.0


def test_readings_are_scaled_and_summed_so_that_their_rate_costs_nothing() -> None:
    rng = np.random.default_rng(6)
    t, theta, speed = way(20.0, rate=200.0)
    drive = measure({"wheels": wheels(t, theta, speed, rng), "gyro": imu(t, theta, rng)}, robot({"scale": 1.02}))
    m = drive.measurements["gyro"]
    assert 195 <= len(m.t) <= 201
    true = np.interp(m.t, t, theta)
    np.testing.assert_allclose(m.z[:, 0] - m.z[0, 0], 1.02 * (true - true[0]), atol=2e-3)


@pytest.mark.parametrize("turned", [(180.0, 0.0), (90.0, 0.0), (-90.0, 0.0), (0.0, 90.0), (30.0, -50.0)])
def test_an_imu_mounted_at_any_angle_measures_the_same_turn(turned: tuple[float, float]) -> None:
    rng = np.random.default_rng(9)
    t, theta, speed = way()
    mounted = imu(t, theta, rng, mount=rotation_3d(*turned, 17.0))
    streams = {"wheels": wheels(t, theta, speed, rng), "gyro": mounted}
    drive = measure(streams, robot({"roll_deg": turned[0], "pitch_deg": turned[1]}))
    m = drive.measurements["gyro"]
    true = np.interp(m.t, t, theta)
    np.testing.assert_allclose(m.z[:, 0] - m.z[0, 0], true - true[0], atol=5e-3)


def test_an_imu_without_angular_velocity_is_no_gyro() -> None:
    rng = np.random.default_rng(11)
    t, theta, speed = way()
    n = len(t)
    none = np.tile(np.array([-1.0, 0, 0, 0, 0, 0, 0, 0, 0]), (n, 1))
    for rates, word in (
        (imu(t, theta, rng, angular_velocity_covariance=none), "covariance"),
        (imu(t, 0.0 * theta, rng), f"/imu says 0 in all {n} messages"),
        (imu(t, np.nan * theta, rng), f"/imu has no finite angular velocity in all {n} messages"),
    ):
        drive = measure({"wheels": wheels(t, theta, speed, rng), "gyro": rates}, robot())
        assert word in drive.absent["gyro"]
        with pytest.raises(LocfuseError, match="gyro"):
            fuse(drive, robot(), ("gyro",))


def stopping(bias_deg: float, stop: tuple[float, float], seed: int = 3) -> tuple[Drive, Array, Robot]:
    """A wide curve that begins in motion, with a stop from stop[0] to stop[1] s; the true places."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, stop[1] + 5.0, 0.02)
    moves = (t < stop[0]) | (t > stop[1])
    speed, turning = np.where(moves, 0.5, 0.0), np.where(moves, 0.1, 0.0)
    rates = np.column_stack((speed, turning))
    pose = reckoned(0.5 * (rates[1:] + rates[:-1]) * 0.02)
    theta = pose[:, 2]
    described = robot({"sigma_scale": 0.0}, wheels={"radius": RADIUS, "track": TRACK, "noise": 0.3})
    slipping = wheels(t, theta, speed, np.random.default_rng(seed + 1))
    drive = measure({"wheels": slipping, "gyro": imu(t, theta, rng, math.radians(bias_deg), 1e-4)}, described)
    at = np.stack([np.interp(drive.t, t, pose[:, i]) for i in (0, 1)], axis=-1)
    return drive, at, described


def test_a_robot_that_stops_is_not_thrown_about_by_a_bias_that_shows_only_there() -> None:
    """Wheels that say little of the turn, a bias that only the rest shows: no step of metres where it begins."""
    drive, places, described = stopping(1.5, (60.0, 70.0))
    run = fuse(drive, described, ("gyro",))
    standing = (drive.t > 60.0) & (drive.t < 70.0)
    steps = np.hypot(*np.diff(run.pose[standing, :2], axis=0).T)
    assert steps.max() < 0.01
    assert np.hypot(*(run.pose[:, :2] - places).T).max() < 4.0
    assert run.blocks["gyro_bias"][-1, 0] == pytest.approx(math.radians(1.5), abs=math.radians(0.05))
    assert any("bias at rest: 1." in note for note in run.notes)


# --- one reading, in closed form


def turned_twice(settings: GyroSettings, **extra: Array) -> Measurements:
    """The first reading, and half a radian two seconds later."""
    t, z = np.array([1.0, 3.0]), np.array([[0.2], [0.7]])
    return readings(t, z, math.radians(settings.sigma_deg), piece=np.zeros(2), **extra)


def with_bias(bias: float, variance: float) -> JointBelief:
    none = Block(BEFORE, np.zeros(1), np.zeros((1, 1)), np.zeros(1))
    own = Block(BIAS, np.array([bias]), np.array([[variance]]), np.zeros(1))
    return JointBelief((1.0, -2.0, 0.3), (0.01, 0.0, 0.0, 0.01, 0.0, 0.02), [none, own])


@pytest.mark.parametrize("given", [None, 2.0])
def test_a_turn_is_compared_with_the_belief_by_noise_of_time_and_scale(given: float | None) -> None:
    settings = GyroSettings(sigma_deg=0.4, sigma_scale=0.03, bias_deg=given)
    m, model, belief = turned_twice(settings), Gyro().model(settings), with_bias(0.03, 0.01)
    assert model.innovations(m, 0, belief) == []
    model.learn(m, 0, belief)
    belief.predict(step((0.1, 0.0, 0.45), (0.0, 0.0, 0.0, 0.0, 0.0, 0.001)), 0)
    (seen,) = one_by_one(model.innovations(m, 1, belief))
    bias = 0.03 if given is None else math.radians(given)
    assert seen.y[0] == pytest.approx(0.5 - bias * 2.0 - 0.45)
    columns, H, R = said(seen, belief)
    assert R[0, 0] == pytest.approx(math.radians(0.4) ** 2 * 2.0 + (0.03 * 0.5) ** 2)
    assert columns == ((3, 4) if given is None else (3,))
    assert H.tolist() == [[0.0, 0.0, 1.0, -1.0, 2.0][: 3 + len(columns)]]


def test_a_rest_measures_the_bias_as_a_scalar_filter_takes_it() -> None:
    settings = GyroSettings(sigma_deg=0.4, bias_drift_deg=0.3)
    rest = {"rest_begin": np.full(2, 1.0), "rest_end": np.full(2, 5.0), "rest_turned": np.full(2, 0.2)}
    m, model, belief = turned_twice(settings, **rest), Gyro().model(settings), with_bias(0.03, 0.001)
    model.learn(m, 0, belief)
    r = math.radians(0.4) ** 2 / 4.0 + math.radians(0.3) ** 2 * 2.0
    column, bias = belief.block(BIAS)
    assert bias[0] == pytest.approx((0.03 / 0.001 + 0.05 / r) / (1.0 / 0.001 + 1.0 / r))
    assert belief.covariance[column, column] == pytest.approx(1.0 / (1.0 / 0.001 + 1.0 / r))
    (seen,) = one_by_one(model.innovations(m, 1, belief))  # of the rest: it counted already
    assert seen.verdict != 0
    assert model.notes(belief) == ["bias at rest: 2.865°/s over 4.0 s, from 1.0 s on"]


@pytest.mark.parametrize(
    ("factor", "says"),
    [
        (1.0, None),
        (1.8, None),
        (0.56, None),
        (2.3, "2.3 times"),
        (0.4, "0.4 times"),
        (3.0, "check wheels"),
        (150.0, "check wheels"),
        (25.0, "check wheels"),
        (100.0, "in degrees"),
        (35.0, "in degrees"),
        (-1.0, "upside-down"),
        (-0.3, "upside-down"),
        (0.0, "never turns"),
    ],
)
def test_a_gyro_that_turns_by_another_factor_is_refused_with_a_reason(factor: float, says: str | None) -> None:
    t = np.arange(0.0, 20.0, 0.1)
    turning = 0.4 * np.sin(1.3 * t)
    turn = np.append(0.0, np.cumsum(0.5 * (turning[1:] + turning[:-1]) * np.diff(t)))
    wheels = Wheels.from_wheels(t, -0.5 * TRACK * turn, 0.5 * TRACK * turn, TRACK, 1e-6)
    rates = stream("/rate", "std_msgs/msg/Float64", t, {"data": factor * turning})
    if says is None:
        assert len(Gyro().measure(rates, GyroSettings(), wheels, EPOCH).z) > 100
        return
    with pytest.raises(LocfuseError, match=says) as raised:
        Gyro().measure(rates, GyroSettings(), wheels, EPOCH)
    assert ("in degrees" in str(raised.value)) is (says == "in degrees")
