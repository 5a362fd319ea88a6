"""A magnetometer on a robot that tilts: levelled, its heading is the yaw; a robot on a floor stays as it is."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bags import T0, S, Said, cdr, header
from commands import locfuse
from landmark_drive import path_of
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from wheel_bags import GEOMETRY, angles, joint_states, log_of

from locfuse.fusion.data import ArrayStream, Measurements
from locfuse.fusion.mount import rotation
from locfuse.fusion.sensors.compass import Compass, CompassSettings
from locfuse.fusion.sensors.level import LevelledField, tilt_of
from locfuse.fusion.wheels.motion import Wheels

Array = NDArray[np.float64]
FIELD = np.array([0.0, 18e-6, -42e-6])  # T, east, north, up: it dips by 67 degrees
G = 9.81
IMU, MAG = "sensor_msgs/msg/Imu", "sensor_msgs/msg/MagneticField"
T = np.arange(0.0, 60.0, 0.02)


def attitude(tilt_deg: float, yaw: Array, t: Array = T) -> Rotation:
    """From the base's axes to the world's: the robot rocks and stands on slopes."""
    roll = math.radians(tilt_deg) * np.sin(0.5 * t)
    pitch = math.radians(tilt_deg) * np.cos(0.31 * t + 1.0)
    return Rotation.from_euler("ZYX", np.stack((yaw, pitch, roll), axis=-1))


def imu_of(
    body: Rotation, mount: Rotation, t: Array = T, *, orientation: bool, noise: float = 0.0
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


def streams(data: dict[str, Any], field: Array, t: Array = T) -> tuple[ArrayStream, ArrayStream]:
    t_ns = T0 + np.round(t * S).astype(np.int64)
    axes: dict[str, Any] = {f"magnetic_field.{a}": column for a, column in zip("xyz", field.T, strict=True)}
    return ArrayStream("/imu", IMU, t_ns, data), ArrayStream("/mag", MAG, t_ns, axes)


def headings(field: Any, **settings: Any) -> Measurements:
    wheels = Wheels.from_wheels(np.array([0.0, 100.0]), np.zeros(2), np.zeros(2), 0.5, 1e-4)
    return Compass().measure(field, CompassSettings(**settings), wheels, T0)


def error_deg(m: Measurements, yaw: Array) -> float:
    """The worst deviation of the headings from the yaw: north is +y, so that yaw 0 is heading -90 degrees."""
    off = np.angle(np.exp(1j * (m.z[:, 0] - yaw + math.pi / 2)))
    return math.degrees(float(np.abs(off).max()))


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_by_the_orientation_the_heading_is_the_yaw_whatever_roll_and_pitch(sign: float) -> None:
    """An IMU yawed and rolled on the base, iron on the robot; with the world's z axis up, and down (NED)."""
    yaw = 0.3 * T
    body = attitude(12.0, yaw)
    mount = rotation(180.0, 3.0, 40.0)
    data = imu_of(body, Rotation.from_matrix(mount), orientation=True)
    if sign < 0.0:  # seen from a world whose z axis is down
        world = Rotation.from_euler("x", 180, degrees=True) * body * Rotation.from_matrix(mount)
        data |= {f"orientation.{a}": column for a, column in zip("xyzw", world.as_quat().T, strict=True)}
    iron = np.array([5e-6, -3e-6, 0.0])
    imu, field = streams(data, body.inv().apply(FIELD) + iron)
    assert error_deg(headings(field, hard_iron=(5e-6, -3e-6)), yaw) > 20.0
    tilt = tilt_of(imu, mount)
    assert tilt is not None
    levelled = LevelledField(field, tilt)
    assert error_deg(headings(levelled, hard_iron=(5e-6, -3e-6)), yaw) < 1e-6
    assert "by the orientation of /imu" in levelled.note


@pytest.mark.parametrize("unit", [1.0, -1.0, 1.0 / G])
def test_gravity_and_rates_do_where_no_orientation_is_said(unit: float) -> None:
    """Gravity of either sign, or in g; accelerometer noise of 0.3 m/s^2."""
    yaw = 0.3 * T
    body = attitude(12.0, yaw)
    data = imu_of(body, Rotation.identity(), orientation=False, noise=0.3)
    for a in "xyz":
        data[f"linear_acceleration.{a}"] = unit * data[f"linear_acceleration.{a}"]
    imu, field = streams(data, body.inv().apply(FIELD))
    tilt = tilt_of(imu, np.eye(3))
    assert tilt is not None
    assert error_deg(headings(field), yaw) > 20.0
    assert error_deg(headings(LevelledField(field, tilt)), yaw) < 4.0


def test_a_robot_on_a_floor_is_not_levelled() -> None:
    """Neither noise, nor starting and braking, nor an IMU that is mounted askew by 2 degrees is a tilt."""
    body = attitude(0.0, 0.3 * T)
    askew = Rotation.from_euler("xy", [2.0, 1.0], degrees=True)
    assert tilt_of(streams(imu_of(body, askew, orientation=True), np.zeros((len(T), 3)))[0], np.eye(3)) is None
    data = imu_of(body, askew, orientation=False, noise=0.3)
    data["linear_acceleration.x"] = data["linear_acceleration.x"] + np.sign(np.sin(1.5 * T))  # 1 m/s^2 for 2 s
    assert tilt_of(streams(data, np.zeros((len(T), 3)))[0], np.eye(3)) is None


def test_an_imu_on_end_that_nobody_configured_levels_nothing() -> None:
    data = imu_of(attitude(12.0, 0.3 * T), Rotation.from_euler("y", 90, degrees=True), orientation=True)
    assert tilt_of(streams(data, np.zeros((len(T), 3)))[0], np.eye(3)) is None


def recorded(folder: Path, tilt_deg: float, imu: bool = True, frame: str = "imu") -> tuple[Path, Path]:
    """A drive whose wheels slip, with a magnetometer and an IMU at 50 Hz; the log and the truth."""
    t, angle = angles(40.0)
    true = path_of(t, angle)
    slip = 0.1 * (angle[:, 1] - angle[:, 0]) / 2
    body = attitude(tilt_deg, true[:, 2], t)
    field = body.inv().apply(FIELD) + 2e-7 * np.random.default_rng(1).standard_normal((len(t), 3))
    data = imu_of(body, Rotation.identity(), t, orientation=True)
    said = joint_states(t, angle + np.stack((-slip, slip), axis=-1))
    for i, ns in enumerate((T0 + np.round(t * S).astype(np.int64)).tolist()):
        mag = cdr(MAG, header=header(ns, frame), magnetic_field=dict(zip("xyz", field[i].tolist(), strict=True)))
        said.append(Said("/mag", MAG, mag, ns + 1))
        q = {a: float(data[f"orientation.{a}"][i]) for a in "xyzw"}
        if imu:
            said.append(Said("/imu", IMU, cdr(IMU, header=header(ns, "imu"), orientation=q), ns + 2))
    log = log_of(folder / "x.mcap", said)
    rows = zip(t, true.tolist(), strict=True)
    truth = "".join(f"{T0 // S + s:.9f},{x!r},{y!r},{th!r}\n" for s, (x, y, th) in rows)
    (folder / "truth.csv").write_text(f"t,x,y,theta\n{truth}")
    return log, folder / "truth.csv"


SETS = ("--set", "compass.topic=/mag", "--set", "compass.sigma_deg=1")


def heading_rmse_deg(files: tuple[Path, Path], *words: str) -> tuple[float, str]:
    out = files[0].parent / "out"
    given = ("--truth", files[1], "--no-advice", "-o", out, "--write", "json", "--overwrite")
    done = locfuse("compare", files[0], *GEOMETRY, "-v", *SETS, *given, *words)
    assert done.exit_code == 0, done.stderr
    found = json.loads((out / "report.json").read_text())["configurations"]["compass"]
    return float(found["heading_rmse_deg"]), done.stdout + done.stderr


def test_compare_levels_the_field_of_a_robot_that_tilts_and_info_says_so(tmp_path: Path) -> None:
    files = recorded(tmp_path, 8.0)
    level, words = heading_rmse_deg(files)
    crooked, _ = heading_rmse_deg(files, "--set", "compass.level=false")
    assert level < 1.0
    assert crooked > 5.0 * level
    said = " ".join(locfuse("info", files[0], *GEOMETRY, *SETS).stdout.split())
    sentence = "compass: the robot tilts by up to 11° by the orientation of /imu: the field is levelled by that"
    assert sentence in said
    assert sentence in " ".join(words.split())
