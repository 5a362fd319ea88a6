"""The compass: conventions, offset, disturbance."""

import math
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bags import T0, S
from commands import locfuse
from landmark_drive import compared, sets, slipping, truth_file
from present import present
from scipy.spatial.transform import Rotation
from wheel_bags import GEOMETRY, joint_states, log_of, messages
from worlds import World, stream

from locfuse.fusion import se2
from locfuse.fusion.data import VERDICTS, Array, ArrayStream, LocfuseError, Measurements
from locfuse.fusion.ekf.belief_arrays import JointBelief
from locfuse.fusion.fuse import fuse
from locfuse.fusion.measure import measure
from locfuse.fusion.se2 import rotation_3d
from locfuse.fusion.sensors.compass import Compass, CompassModel, CompassSettings
from locfuse.fusion.sensors.magnetic import Iron, LevelledField, fit_iron, iron_error_deg, plausible, tilt_of
from locfuse.fusion.wheels.motion import Wheels

STILL = Wheels.from_wheels(np.array([0.0, 100.0]), np.zeros(2), np.zeros(2), 0.5, 1e-4)
T: Any = np.arange(5) * 0.1


def measured(s: ArrayStream, **settings: Any) -> Measurements:
    return Compass().measure(s, CompassSettings(**settings), STILL, int(s.t_ns[0]))


@pytest.mark.parametrize(
    ("convention", "value", "theta"),  # compass: north is +y and east +x
    [
        ("enu_rad", 0.3, 0.3),
        ("enu_deg", 30.0, math.radians(30)),
        ("compass_deg", 0.0, math.pi / 2),
        ("compass_deg", 90.0, 0.0),
        ("compass_rad", math.pi, -math.pi / 2),
    ],
)
def test_heading_numbers_follow_their_convention(convention: str, value: float, theta: float) -> None:
    m = measured(stream("/heading", "std_msgs/msg/Float64", T, {"data": np.full(5, value)}), convention=convention)
    np.testing.assert_allclose(m.z[:, 0], theta, atol=1e-12)


def test_degrees_read_as_radians_are_refused_and_nan_is_left_out() -> None:
    s = stream("/heading", "std_msgs/msg/Float64", T, {"data": np.array([1.0, 2.0, 270.0, 3.0, 4.0])})
    with pytest.raises(LocfuseError, match=r"compass\.convention=enu_deg"):
        measured(s)
    values = np.array([0.1, np.nan, 0.2, np.inf, 0.3])
    m = measured(stream("/heading", "std_msgs/msg/Float64", T, {"data": values}))
    assert len(m.t) == 3
    assert m.dropped == {"not_finite": 2}


@pytest.mark.parametrize("theta", [0.0, 1.0, 3.1, -3.1])
def test_a_field_to_the_north_gives_the_heading_and_iron_is_taken_out(theta: float) -> None:
    north = np.array([0.0, 2e-5])
    c, s = math.cos(theta), math.sin(theta)
    field = np.array([[c, s], [-s, c]]) @ north  # the field in the robot's frame
    soft = np.array([[1.1, 0.1], [0.2, 0.9]])
    raw = np.linalg.solve(soft, field) + np.array((3e-6, -1e-6))
    axes = {"magnetic_field.x": np.full(5, raw[0]), "magnetic_field.y": np.full(5, raw[1])}
    iron: dict[str, Any] = {"hard_iron": (3e-6, -1e-6), "soft_iron": (1.1, 0.1, 0.2, 0.9)}
    m = measured(stream("/mag", "sensor_msgs/msg/MagneticField", T, axes), **iron)
    np.testing.assert_allclose(np.cos(m.z[:, 0] + math.pi / 2 - theta), 1.0, atol=1e-12)


def oriented(q: Any) -> ArrayStream:
    """An IMU that says quaternions (4,) or (4, 5)."""
    columns = np.broadcast_to(np.array(q).reshape(4, -1), (4, 5)).copy()
    data = dict(zip((f"orientation.{a}" for a in "xyzw"), columns, strict=True))
    return stream("/imu", "sensor_msgs/msg/Imu", T, {**data, "orientation_covariance": np.zeros((5, 9))})


@pytest.mark.parametrize("theta", [0.0, math.pi, -math.pi + 1e-9, 12.0])
def test_the_innovation_wraps_and_its_jacobian_is_one(theta: float) -> None:
    settings = CompassSettings(offset_deg=10.0, sigma_deg=1.0)
    h = 1e-6
    y = []
    for d in (-h, h):
        heading = {"data": np.full(5, math.remainder(theta + 0.2, math.tau))}
        m = measured(stream("/heading", "std_msgs/msg/Float64", T, heading))
        belief = JointBelief((0.0, 0.0, theta + d), (0, 0, 0, 0, 0, 0.01))
        y.append(CompassModel(settings).innovations(m, 0, belief)[0].y[0])
    assert y[0] == pytest.approx(0.2 - math.radians(10), abs=1e-5)
    assert (y[1] - y[0]) / (2 * h) == pytest.approx(-1.0, abs=1e-6)  # y = z - h(x), H = +1


def test_a_field_of_the_wrong_strength_is_disturbed_and_not_used() -> None:
    world = World()
    streams = world.streams()
    columns: Any = streams["compass"].data
    columns["magnetic_field.x"][100:140] += 3e-5
    robot = world.robot()
    drive = measure(streams, robot)
    audit = fuse(drive, robot, ["compass"]).audits["compass"]
    disturbed = audit.row[audit.verdict == VERDICTS.index("disturbed")]
    assert len(disturbed) >= 35
    assert set(disturbed.tolist()) <= set(range(100, 140))


def test_a_field_that_is_a_little_too_strong_is_a_heading_that_may_be_off_by_as_much() -> None:
    """Strengths of 1.02 and 1.1 among many of 1, told 1 degree (1.7 %): the last is 4.8 % beyond three sigmas."""
    field = np.full(20, 2e-5)
    field[[7, 12]] *= 1.02, 1.1
    axes = {"magnetic_field.x": field, "magnetic_field.y": np.zeros(20)}
    t: Any = np.arange(20) * 0.1
    m = measured(stream("/mag", "sensor_msgs/msg/MagneticField", t, axes), sigma_deg=1.0)
    sigma = math.radians(1.0)
    expected = np.full(20, sigma**2)
    expected[12] += (0.1 - 3 * sigma) ** 2
    np.testing.assert_allclose(m.R[:, 0, 0], expected, rtol=1e-9)


@pytest.mark.parametrize("convention", ["enu_rad", "compass_rad"])
@pytest.mark.parametrize("theta", [0.3, 2.0, -1.5])
def test_an_orientation_is_the_yaw_of_an_enu_or_a_ned_world(convention: str, theta: float) -> None:
    turns = {"enu_rad": np.eye(3), "compass_rad": np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])}
    q = Rotation.from_matrix(turns[convention] @ Rotation.from_euler("z", theta).as_matrix()).as_quat()
    np.testing.assert_allclose(measured(oriented(q), convention=convention).z[:, 0], theta, atol=1e-12)


@pytest.mark.parametrize(("length", "good"), [(0.45, False), (0.55, True), (1.0, True)])
def test_an_orientation_of_less_than_half_the_length_is_none(length: float, good: bool) -> None:
    q = np.outer([0.0, 0.0, 0.0, 1.0], [1.0, *[length] * 4])  # one reading that is good
    assert len(measured(oriented(q)).z) == (5 if good else 1)


@pytest.mark.parametrize(("turn_deg", "refused"), [(15.0, False), (25.0, True)])
def test_a_heading_that_never_changes_is_refused_where_the_robot_turned(turn_deg: float, refused: bool) -> None:
    t = np.arange(12) * np.float64(0.1)
    theta = np.radians(turn_deg) * t / t[-1]
    wheels = Wheels.from_wheels(t, -0.25 * theta, 0.25 * theta, 0.5, 1e-4)
    s = stream("/heading", "std_msgs/msg/Float64", t, {"data": np.full(12, 0.4)})
    why = r"says 22\.9 deg in all 12 readings .* by up to 25 deg"
    with pytest.raises(LocfuseError, match=why) if refused else nullcontext():
        assert len(Compass().measure(s, CompassSettings(), wheels, int(s.t_ns[0])).z) == 12


# --- hard and soft iron: drawn ellipses are found again, and what is no ellipse is refused with the reason

FIELD = 20e-6
CASES = [
    ((0.3e-6, -0.2e-6), (1.01, 0.99, 0.005)),
    ((12e-6, -9e-6), (1.3, 0.8, 0.1)),
    ((45e-6, 30e-6), (0.7, 1.1, -0.2)),  # the centre outside the circle
]


def field(
    hard: tuple[float, ...], soft: tuple[float, ...], angles: Array, noise: float = 0.0, seed: int = 0
) -> Array:
    """What two axes read while the robot has the headings `angles` in a field of 20 uT."""
    gain = np.array([[soft[0], soft[2]], [soft[2], soft[1]]])
    turned = np.stack((np.cos(angles), -np.sin(angles)), axis=-1)
    rng = np.random.default_rng(seed)
    read: Array = FIELD * turned @ gain.T + np.array(hard) + FIELD * noise * rng.normal(size=(len(angles), 2))
    return read


def corrected_headings(iron: Iron, read: Array) -> Array:
    corrected = (read - iron.hard) @ iron.soft.T
    return np.asarray(np.arctan2(corrected[:, 1], corrected[:, 0]))


@pytest.mark.parametrize(("hard", "soft"), CASES)
def test_an_ellipse_is_found_exactly_and_with_the_sigmas_of_many_draws(
    hard: tuple[float, ...], soft: tuple[float, ...]
) -> None:
    angles = np.linspace(0.0, math.tau, 300)
    iron = fit_iron(field(hard, soft, angles))
    np.testing.assert_allclose(iron.hard, hard, atol=1e-6 * FIELD)
    error = se2.wrap_all(-corrected_headings(iron, field(hard, soft, angles)) - angles)
    np.testing.assert_allclose(error, 0.0, atol=1e-6)
    assert np.linalg.det(iron.soft) == pytest.approx(1.0)
    angles = np.linspace(0.0, math.tau, 400)
    found = [fit_iron(field(hard, soft, angles, noise=0.01, seed=s)) for s in range(60)]
    spread = np.std([f.hard for f in found], axis=0)
    np.testing.assert_allclose(np.mean([f.hard_sigma for f in found], axis=0), spread, rtol=0.4)
    spread = np.std([f.soft for f in found], axis=0)
    np.testing.assert_allclose(np.mean([f.soft_sigma for f in found], axis=0), spread, rtol=0.4)


def test_a_motor_that_runs_for_a_fifth_of_the_time_changes_little() -> None:
    angles = np.linspace(0.0, 3 * math.tau, 1500)
    readings = field((3e-6, 2e-6), (1.05, 0.95, 0.02), angles, noise=0.005)
    readings[300:600] += np.array([6e-6, -8e-6])
    iron = fit_iron(readings)
    quiet = np.r_[0:300, 600:1500]
    error = se2.wrap_all(-corrected_headings(iron, readings[quiet]) - angles[quiet])
    assert math.degrees(np.sqrt((error**2).mean())) < 1.0


def test_the_error_that_iron_makes_is_its_closed_form_for_a_small_hard_iron() -> None:
    """A centre off by a share q of the field bends headings by q sin: q/sqrt(2) rms."""
    q = 0.05
    assert iron_error_deg(np.array([q, 0.0]), np.eye(2)) == pytest.approx(math.degrees(q / math.sqrt(2)), rel=0.01)


@pytest.mark.parametrize(
    ("angles", "says"),
    [
        (np.linspace(0.0, math.pi, 300), "of 360 degrees"),
        (np.zeros(300), "does not change"),
        (np.linspace(0.0, math.tau, 20), "at least 50"),
    ],
)
def test_what_shows_too_little_of_the_circle_is_refused(angles: Array, says: str) -> None:
    with pytest.raises(LocfuseError, match=says):
        fit_iron(field((1e-6, 0.0), (1.0, 1.0, 0.0), angles))


@pytest.mark.parametrize("seed", range(20))
def test_a_straight_run_shows_no_iron_whatever_its_noise(seed: int) -> None:
    """A cloud of noise about a short arc: the fit runs away, to NaN or to a line."""
    along = np.random.default_rng(seed).normal(0.3, 0.02, 3000)
    with pytest.raises(LocfuseError, match=r"ellipse|of 360 degrees"):
        fit_iron(field((3e-7, -2e-7), (1.0, 1.0, 0.0), along, noise=0.01, seed=seed))


def test_readings_on_no_ellipse_are_refused_and_those_of_absurd_strength_left_out() -> None:
    noise = np.random.default_rng(1).uniform(-1.0, 1.0, (500, 2))
    with pytest.raises(LocfuseError, match="ellipse"):
        fit_iron(noise)
    good = np.column_stack((20e-6 * np.cos(np.arange(200.0)), 20e-6 * np.sin(np.arange(200.0))))
    readings = np.concatenate((good, [[1e200, 0.0], [math.nan, 1.0], [3e-3, 0.0]]))
    assert plausible(readings).tolist() == [True] * 200 + [False] * 3
    assert fit_iron(readings).readings == 200


# --- a magnetometer on a robot that tilts: levelled, its heading is the yaw; a robot on a floor stays as it is

DIPPING = np.array([0.0, 18e-6, -42e-6])  # T, east, north, up: it dips by 67 degrees
G = 9.81
IMU, MAG = "sensor_msgs/msg/Imu", "sensor_msgs/msg/MagneticField"
AT = np.arange(0.0, 60.0, 0.02)


def attitude(tilt_deg: float, yaw: Array, t: Array = AT) -> Rotation:
    """From the base's axes to the world's: the robot rocks and stands on slopes."""
    roll = math.radians(tilt_deg) * np.sin(0.5 * t)
    pitch = math.radians(tilt_deg) * np.cos(0.31 * t + 1.0)
    return Rotation.from_euler("ZYX", np.stack((yaw, pitch, roll), axis=-1))


def imu_of(
    body: Rotation, mount: Rotation, t: Array = AT, *, orientation: bool, noise: float = 0.0
) -> dict[str, Any]:
    """What an IMU measures whose axes `mount` turns into the base's; its rates have a bias."""
    world = body * mount
    rng = np.random.default_rng(0)
    turned = (world[:-1].inv() * world[1:]).as_rotvec() / np.diff(t)[:, None]
    rates = np.vstack((turned, turned[-1:])) + np.array([0.004, -0.003, 0.002])
    up = world.inv().apply([0.0, 0.0, G]) + noise * rng.standard_normal((len(t), 3))
    covariance = np.zeros((len(t), 9))
    covariance[:, 0] = 0.0 if orientation else -1.0
    return {
        **{f"orientation.{a}": column for a, column in zip("xyzw", world.as_quat().T, strict=True)},
        **{f"angular_velocity.{a}": column for a, column in zip("xyz", rates.T, strict=True)},
        **{f"linear_acceleration.{a}": column for a, column in zip("xyz", up.T, strict=True)},
        "orientation_covariance": covariance,
        "angular_velocity_covariance": np.zeros((len(t), 9)),
    }


def streams(data: dict[str, Any], field: Array, t: Array = AT) -> tuple[ArrayStream, ArrayStream]:
    t_ns = T0 + np.round(t * S).astype(np.int64)
    axes: dict[str, Any] = {f"magnetic_field.{a}": column for a, column in zip("xyz", field.T, strict=True)}
    return ArrayStream("/imu", IMU, t_ns, data), ArrayStream("/mag", MAG, t_ns, axes)


def headings(field: Any, **settings: Any) -> Measurements:
    return Compass().measure(field, CompassSettings(**settings), STILL, T0)


def error_deg(m: Measurements, yaw: Array) -> float:
    """The worst deviation of the headings from the yaw: north is +y, so that yaw 0 is heading -90 degrees."""
    off = np.angle(np.exp(1j * (m.z[:, 0] - yaw + math.pi / 2)))
    return math.degrees(float(np.abs(off).max()))


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_by_the_orientation_the_heading_is_the_yaw_whatever_roll_and_pitch(sign: float) -> None:
    """An IMU yawed and rolled on the base, iron on the robot; with the world's z axis up, and down (NED)."""
    yaw = 0.3 * AT
    body = attitude(12.0, yaw)
    mount = rotation_3d(180.0, 3.0, 40.0)
    data = imu_of(body, Rotation.from_matrix(mount), orientation=True)
    if sign < 0.0:  # seen from a world whose z axis is down
        world = Rotation.from_euler("x", 180, degrees=True) * body * Rotation.from_matrix(mount)
        data |= {f"orientation.{a}": column for a, column in zip("xyzw", world.as_quat().T, strict=True)}
    iron = np.array([5e-6, -3e-6, 0.0])
    imu, field = streams(data, body.inv().apply(DIPPING) + iron)
    assert error_deg(headings(field, hard_iron=(5e-6, -3e-6)), yaw) > 20.0
    tilt = present(tilt_of(imu, mount))
    levelled = LevelledField(field, tilt)
    assert error_deg(headings(levelled, hard_iron=(5e-6, -3e-6)), yaw) < 1e-6
    assert "by the orientation of /imu" in levelled.note


@pytest.mark.parametrize("unit", [1.0, -1.0, 1.0 / G])
def test_gravity_and_rates_do_where_no_orientation_is_said(unit: float) -> None:
    """Gravity of either sign, or in g; accelerometer noise of 0.3 m/s^2."""
    yaw = 0.3 * AT
    body = attitude(12.0, yaw)
    data = imu_of(body, Rotation.identity(), orientation=False, noise=0.3)
    for a in "xyz":
        data[f"linear_acceleration.{a}"] = unit * data[f"linear_acceleration.{a}"]
    imu, field = streams(data, body.inv().apply(DIPPING))
    tilt = present(tilt_of(imu, np.eye(3)))
    assert error_deg(headings(field), yaw) > 20.0
    assert error_deg(headings(LevelledField(field, tilt)), yaw) < 4.0


def test_a_robot_on_a_floor_is_not_levelled() -> None:
    """Neither noise, nor starting and braking, nor an IMU askew by 2 degrees is a tilt; one on end shows none."""
    body, none = attitude(0.0, 0.3 * AT), np.zeros((len(AT), 3))
    askew, on_end = Rotation.from_euler("xy", [2.0, 1.0], degrees=True), Rotation.from_euler("y", 90, degrees=True)
    braking = imu_of(body, askew, orientation=False, noise=0.3)
    braking["linear_acceleration.x"] = braking["linear_acceleration.x"] + np.sign(np.sin(1.5 * AT))  # m/s^2
    tilted = imu_of(attitude(12.0, 0.3 * AT), on_end, orientation=True)  # which nobody configured
    for data in (imu_of(body, askew, orientation=True), braking, tilted):
        assert tilt_of(streams(data, none)[0], np.eye(3)) is None


def recorded(folder: Path, tilt_deg: float) -> tuple[Path, Path]:
    """A drive whose wheels slip, with a magnetometer and an IMU at 50 Hz; the log and the truth."""
    t, counted, true = slipping(0.1, 40.0)
    body = attitude(tilt_deg, true[:, 2], t)
    field = body.inv().apply(DIPPING) + 2e-7 * np.random.default_rng(1).standard_normal((len(t), 3))
    fields = [{"magnetic_field": dict(zip("xyz", row, strict=True))} for row in field.tolist()]
    turns = [{"orientation": dict(zip("xyzw", row, strict=True))} for row in body.as_quat().tolist()]
    said = messages("/mag", MAG, t, fields, "imu") + messages("/imu", IMU, t, turns, "imu")
    return log_of(folder / "x.mcap", joint_states(t, counted), said), truth_file(folder, t, true)


def test_compare_levels_the_field_of_a_robot_that_tilts_and_info_says_so(tmp_path: Path) -> None:
    files, own = recorded(tmp_path, 8.0), sets("compass.topic=/mag", "compass.sigma_deg=1")
    (rows, words), (raw, _) = (compared(*files, *own, *more) for more in ((), sets("compass.level=false")))
    level, crooked = (found["compass"]["heading_rmse_deg"] for found in (rows, raw))
    assert level < 1.0
    assert crooked > 5.0 * level
    said = " ".join(locfuse("info", files[0], *GEOMETRY, *own).stdout.split())
    sentence = "compass: the robot tilts by up to 11° by the orientation of /imu: the field is levelled by that"
    assert sentence in said
    assert sentence in words
