"""Compass checks: unit and convention of bare headings, tilt of an IMU or magnetometer, iron."""

from __future__ import annotations

import math
from collections.abc import Mapping
from contextlib import suppress
from typing import cast

import msgspec
import numpy as np

from locfuse.fusion import se2
from locfuse.fusion.data import Array, Drive, Estimates, Ints, LocfuseError, Stream
from locfuse.fusion.robot import Robot
from locfuse.fusion.se2 import rotation_3d
from locfuse.fusion.sensors.compass import CompassSettings, from_number
from locfuse.fusion.sensors.magnetic import (
    ACCELERATIONS,
    FIELD,
    IMU,
    MAX_MISSING_ARC_RAD,
    Iron,
    fit_iron,
    iron_error_deg,
    plausible,
)
from locfuse.fusion.statistics import MAD_OF_NORMAL, jackknife, part_of, robust, robust_sigma
from locfuse.fusion.streams import numbers

from .finding import Finding
from .turning import Headings, Turnings, explain

MAX_HEADING_RAD = 4.0 * math.pi  # a heading beyond two turns is in degrees


def of_convention(drive: Drive, robot: Robot, streams: Mapping[str, Stream]) -> list[Finding]:
    """Return a finding on the unit and sense of turning of headings that are bare numbers; [] if both are right.

    The unit follows from the largest value, the sense from a comparison with the wheels' turns.
    """
    stream = streams.get("compass")
    if stream is None or "compass" in drive.measurements or not stream.msgtype.startswith("std_msgs/"):
        return []
    columns = {"data": np.asarray(cast("Array", stream.columns("data")["data"]), dtype=np.float64)}
    largest = np.nanmax(np.abs(np.where(np.isfinite(columns["data"]), columns["data"], 0.0)), initial=0.0)
    unit = "deg" if largest > MAX_HEADING_RAD else "rad"
    settings = msgspec.structs.replace(robot.settings("compass"), convention=f"enu_{unit}")
    heading, _ = from_number(columns, settings, stream.topic)
    good = np.isfinite(heading)
    t = (stream.t_ns - drive.epoch_ns) * 1e-9 + settings.time_offset
    turning = explain(Headings(t[good], np.unwrap(heading[good])), drive.wheels)
    if turning is None:
        return []
    clockwise = turning.a < 0.0 < turning.b
    sense = "clockwise (0 is north)" if clockwise else "counter-clockwise (0 is east)"
    whole = "degrees" if unit == "deg" else "radians"
    words = f"{stream.topic} reaches {largest:.0f}, so it is in {whole}, and by the wheels it grows {sense}"
    fix = f"compass.convention={'compass' if clockwise else 'enu'}_{unit}"
    return [Finding("compass", "convention", words, (fix,), True)]


GRAVITY_RANGE_MPS2 = (9.0, 10.6)  # m/s^2
MIN_TILT_RAD = math.radians(25.0)
MIN_FIELD_ARC_RAD = math.radians(120.0)  # a shorter arc of the field does not determine a plane
MIN_PLANE_RATIO = 10.0  # smallest ratio of the field's squares within its plane and across it
MAGNETIC_FIELDS = tuple(f"magnetic_field.{a}" for a in "xyz")


def tilted(
    drive: Drive,
    robot: Robot,
    streams: Mapping[str, Stream],
    by_wheels: bool = True,
    by_sensor: Turnings | None = None,
) -> list[Finding]:
    """Return findings on wrong roll and pitch of compass and gyro, by gravity or by the rotating magnetic field.

    If gravity points up but the gyro turns with the wheels, the accelerations have the opposite sign.
    """
    found = []
    for name in ("compass", "gyro"):
        stream = streams.get(name)
        if stream is None:
            continue
        settings = robot.settings(name)
        configured = rotation_3d(settings.roll_deg, settings.pitch_deg, 0.0)[2]
        up, by = None, "gravity"
        if stream.msgtype == IMU:
            up = by_gravity(numbers(stream, *ACCELERATIONS))
        elif stream.msgtype == FIELD and by_wheels:
            up, by = by_field(stream, drive, settings.time_offset), "the plane in which the field turns"
        if up is None or _apart(up, configured) < MIN_TILT_RAD:
            continue
        turning = (by_sensor or {}).get(name)
        agrees = turning is not None and turning.a > 0.0 > turning.b
        if name == "gyro" and agrees and _apart(-up, configured) < MIN_TILT_RAD:
            words = (
                f"{stream.topic} gives gravity with the other sign (down, not up): its turning fits the wheels'"
            )
            found.append(Finding(name, "gravity", words))
            continue
        roll, pitch = angles(up)
        if name == "compass" and by == "gravity":
            # the heading by orientation does not depend on roll about the x axis
            ahead = rotation_3d(settings.roll_deg, settings.pitch_deg, settings.yaw_deg)[0]
            if _apart(ahead, rotation_3d(roll, pitch, settings.yaw_deg)[0]) < MIN_TILT_RAD:
                continue
        words = f"{by} says that it is mounted at roll {roll} deg, pitch {pitch} deg"
        fixes = (f"{name}.roll_deg={roll}", f"{name}.pitch_deg={pitch}")
        found.append(Finding(name, "tilt", words, fixes, True))
    return found


def _apart(a: Array, b: Array) -> float:
    return math.acos(float(np.clip(a @ b, -1.0, 1.0)))


def by_gravity(acceleration: Array) -> Array | None:
    """Return the vertical direction (3,) in the sensor frame by accelerations (n, 3); None without gravity."""
    finite = acceleration[np.isfinite(acceleration).all(axis=1)]
    if not len(finite):
        return None
    mean = np.median(finite, axis=0)
    g = float(np.linalg.norm(mean))
    return mean / g if GRAVITY_RANGE_MPS2[0] < g < GRAVITY_RANGE_MPS2[1] else None


def by_field(stream: Stream, drive: Drive, time_offset: float) -> Array | None:
    """Return the axis (3,), in the sensor frame, about which a magnetometer's field turns as the robot turns.

    It points up if the robot is level. None if there are too few readings or turns, or the axis is not clear.
    """
    t = (stream.t_ns - drive.epoch_ns) * 1e-9 + time_offset  # s
    inside = (t >= drive.wheels.t[0]) & (t <= drive.wheels.t[-1])
    field = numbers(stream, *MAGNETIC_FIELDS)
    good = inside & plausible(field)
    field, t = field[good], t[good]
    if len(t) < 20:
        return None
    theta = drive.wheels.at(t)[2][:, 2]
    if np.ptp(theta) < MIN_FIELD_ARC_RAD:
        return None
    centred = field - field.mean(axis=0)
    values, axes = np.linalg.eigh(centred.T @ centred)
    if values[1] < MIN_PLANE_RATIO * values[0] or values[1] <= 0.0:
        return None
    axis: Array = axes[:, 0]
    # in the robot's frame the field turns opposite to the robot
    swept = float((np.cross(centred[:-1], centred[1:]) @ axis * np.diff(theta)).sum())
    return axis if swept < 0.0 else -axis


def angles(up: Array) -> tuple[int, int]:
    """Return roll and pitch [deg] of a mount; `up` (3,) is the vertical in the sensor frame (last row of R)."""
    x, y, z = (float(v) for v in up)
    pitch = math.degrees(-math.asin(max(-1.0, min(1.0, x))))
    roll = math.degrees(math.atan2(y, z)) if math.hypot(y, z) > 1e-3 else 0.0
    return (180 if round(roll) == -180 else round(roll)), round(pitch)


MIN_ERROR_DEG, SEVERE_ERROR_DEG = 1.0, 5.0  # rms over a turn; the first also of an offset that moves
MIN_FITTED, PARTS = 50, 8  # readings that are fitted by the truth; parts of the jackknife
MIN_SIGMAS = 5.0  # standard errors of the circle's centre
ROOM, TOLERANCE = "iron in the room", 0.05  # code of the finding; its value for compass.field_tolerance
MIN_DISTURBED = 0.12  # relative deviation of the field's strength near iron in the room
MIN_READINGS, MAX_PLACE_M = 10, 1.5  # disturbed readings; m, median distance from their median position


def of_iron(drive: Drive, robot: Robot, streams: Mapping[str, Stream]) -> list[Finding]:
    """Return findings on iron near a level magnetometer: on the robot (with a fix), or in the room."""
    stream, settings = streams.get("compass"), cast(CompassSettings, robot.settings("compass"))
    if stream is None or stream.msgtype != FIELD or settings.roll_deg or settings.pitch_deg:
        return []
    field = numbers(stream, *MAGNETIC_FIELDS[:2])
    t = (stream.t_ns - drive.epoch_ns) * 1e-9 + settings.time_offset
    inside = plausible(field) & (t >= drive.wheels.t[0]) & (t <= drive.wheels.t[-1])
    # about a wrong centre the angle of the field turns too far, so the robot's heading is used
    whole = inside.any() and np.ptp(drive.wheels.heading(t[inside])) >= 2.0 * math.pi - MAX_MISSING_ARC_RAD
    iron = None
    with suppress(LocfuseError):  # no full turn
        iron = fit_iron(field[inside]) if whole else None
    iron = iron or _iron_by_truth(field[inside], t[inside], drive)
    if iron is None:
        return []
    return [*_on_robot(iron, settings), *_in_room(iron, field[inside], t[inside], drive, robot)]


def _iron_by_truth(field: Array, t: Array, drive: Drive) -> Iron | None:
    """Fit iron to field readings (n, 2) at times t (n,) [s] by the truth's headings; None if these are few.

    With complex numbers any ellipse is m = c + a e^(i theta) + b e^(-i theta). No full turn is needed.
    """
    truth = drive.truth
    if truth is None or truth.theta is None:
        return None
    inside = truth.spans(t)
    theta, m = np.interp(t[inside], truth.t, np.unwrap(truth.theta)), field[inside] @ (1.0, 1.0j)
    if len(m) < MIN_FITTED or np.ptp(theta) < MIN_FIELD_ARC_RAD:
        return None
    unit = float(np.abs(m).max()) or 1.0
    A, m = np.stack((np.ones(len(m)), np.exp(1.0j * theta), np.exp(-1.0j * theta)), axis=-1), m / unit

    def fitted(some: Ints) -> Array:
        c, a, b = robust(A[some], m[some])[0].tolist()
        raw = np.array([[a.real + b.real, b.imag - a.imag], [a.imag + b.imag, a.real - b.real]])
        values, axes = np.linalg.eigh(raw @ raw.T)
        size = math.sqrt(math.sqrt(max(float(values.prod()), 1e-30)))
        soft = axes @ np.diag(size / np.sqrt(np.maximum(values, 1e-15))) @ axes.T
        return np.array([c.real, c.imag, *soft.ravel(), size])

    found, errors = fitted(np.arange(len(m))), jackknife(fitted, len(m), PARTS)
    hard, soft, size = found[:2], found[2:6].reshape(2, 2), float(found[6])
    there = (m - complex(*hard)).view(np.float64).reshape(-1, 2) @ soft
    rest = np.abs(np.hypot(*there.T) / size - 1.0)
    return Iron(
        hard=unit * hard,
        soft=soft,
        hard_sigma=unit * errors[:2],
        soft_sigma=errors[2:6].reshape(2, 2),
        strength=unit * size,
        scatter=float(np.median(rest)) / MAD_OF_NORMAL,
        error_before_deg=iron_error_deg(hard, np.eye(2) / size),
        gap_deg=0.0,
        readings=len(m),
    )


MOVES = "offset moves"  # code of the finding
MOVERS = "iron, its mount, or the gyro in it"  # which move an offset
PART_COUNT, WANDER_S = 8, 2.0  # parts of the drive; s over which errors are correlated
MIN_IN_PART = 10  # readings
MOVE_SIGMAS = 4.0  # standard errors of the change of the offset


def of_moving_offset(drive: Drive, robot: Robot, path: Estimates | None = None) -> list[Finding]:
    """Return a finding if the compass offset moves or steps during the drive, by the truth's headings.

    Without truth the headings are those of `path`, the laser's own run.
    """
    m, truth, settings = drive.measurements.get("compass"), drive.truth, robot.settings("compass")
    if m is None or settings.offset_drift_deg:
        return []
    if truth is not None and truth.theta is not None:
        known, by, inside = Headings(truth.t, np.unwrap(truth.theta)), "truth", truth.spans(m.t)
    elif truth is None and path is not None:
        known, by = Headings(path.t, path.pose[:, 2]), "laser's path"
        inside = (m.t >= path.t[0]) & (m.t <= path.t[-1])
    else:
        return []
    t, theta = m.t[inside], np.interp(m.t[inside], known.t, known.angle)
    if len(t) < MIN_FITTED or t[-1] - t[0] < PART_COUNT * WANDER_S:
        return []
    off = np.unwrap(np.unwrap(m.z[inside, 0]) - theta)
    part = part_of(t, PART_COUNT)
    iron = [f(k * theta) for f in (np.cos, np.sin) for k in (1, 2)]
    A = np.column_stack((np.eye(PART_COUNT)[part], *iron))
    x, used = robust(A, off)
    length = float(t[-1] - t[0]) / PART_COUNT
    sigma = math.degrees(robust_sigma(off - A @ x)) / math.sqrt(length / WANDER_S)
    kept = np.flatnonzero(np.bincount(part[used], minlength=PART_COUNT) >= MIN_IN_PART)
    offsets = np.degrees(x[kept])
    steps, most = np.diff(offsets), float(np.ptp(offsets))
    if len(steps) == 0 or most < MIN_ERROR_DEG + MOVE_SIGMAS * sigma:
        return []
    i = int(np.argmax(np.abs(steps)))
    at = t[0] + kept[i + 1] * length
    when = f", most of it near {at:.0f} s" if abs(steps[i]) > 0.5 * most else ""
    words = f"by the {by} its offset moves by {most:.0f}° (1 sigma {sigma:.1g}°){when}: {MOVERS}"
    drift = math.sqrt(float(np.square(steps).mean()) / length)
    return [Finding("compass", MOVES, words, (f"compass.offset_drift_deg={drift:.2g}",))]


def _on_robot(iron: Iron, settings: CompassSettings) -> list[Finding]:
    hard, soft = np.array(settings.hard_iron), np.array(settings.soft_iron).reshape(2, 2)
    raw = np.linalg.inv(iron.soft) * iron.strength  # field = hard + raw times a unit vector
    left = soft @ raw
    error = iron_error_deg(soft @ (iron.hard - hard), np.linalg.inv(left))
    moved = (np.abs(iron.hard - hard) > MIN_SIGMAS * iron.hard_sigma).any()
    ellipse = (np.abs(iron.soft - soft) > MIN_SIGMAS * iron.soft_sigma).any()
    ellipse = ellipse and iron_error_deg(np.zeros(2), np.linalg.inv(left / iron.strength)) > MIN_ERROR_DEG
    if error < MIN_ERROR_DEG or not (moved or ellipse):
        return []
    parts, fixes = [], []
    if moved:
        size = np.linalg.norm(iron.hard - hard) / iron.strength
        parts.append(f"about a point beside zero, by {size:.0%} of its strength (hard iron)")
        fixes.append(f"compass.hard_iron=[{', '.join(f'{x:.4g}' for x in iron.hard.tolist())}]")
    if ellipse:
        parts.append(f"on an ellipse {np.linalg.cond(left):.2f} times as long as wide (soft iron)")
        fixes.append(f"compass.soft_iron=[{', '.join(f'{x:.5g}' for x in iron.soft.ravel().tolist())}]")
    words = f"the field turns {' and '.join(parts)}: iron on the robot turns headings by {error:.1f}° (rms)"
    return [Finding("compass", "iron", words, tuple(fixes), error > SEVERE_ERROR_DEG)]


def _in_room(iron: Iron, field: Array, t: Array, drive: Drive, robot: Robot) -> list[Finding]:
    """Return a finding on a place in the room where iron changes the field's strength.

    No calibration of the compass corrects that.
    """
    strength = np.linalg.norm((field - iron.hard) @ iron.soft.T, axis=1) / iron.strength
    off = np.abs(strength - 1.0) > max(MIN_DISTURBED, 5.0 * iron.scatter)
    if off.sum() < MIN_READINGS:
        return []
    place = se2.compose(np.array(robot.start.pose), drive.wheels.at(t[off])[2])[:, :2]
    middle = np.median(place, axis=0)
    if np.median(np.hypot(*(place - middle).T)) > MAX_PLACE_M:
        return []
    x, y = middle.tolist()
    most, count = np.abs(strength[off] - 1.0).max(), int(off.sum())
    first, last = t[off][[0, -1]]
    words = (
        f"iron near ({x:.1f}, {y:.1f}) m: the field's strength is off by up to {most:.0%} there, in {count} of "
        f"{len(off)} readings between {first:.1f} s and {last:.1f} s"
    )
    return [Finding("compass", ROOM, words, (f"compass.field_tolerance={TOLERANCE:g}",))]
