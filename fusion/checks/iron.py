"""Checks of the iron about a magnetometer: on the robot, as a turn shows it, and in the room, with its place."""

from __future__ import annotations

from collections.abc import Mapping
from typing import cast

import numpy as np

from locfuse.fusion import se2
from locfuse.fusion.data import Array, Drive, LocfuseError, Stream
from locfuse.fusion.robot import Robot
from locfuse.fusion.sensors.compass import CompassSettings
from locfuse.fusion.sensors.iron import Iron, fit_iron, iron_error_deg, plausible

from .finding import Finding

FIELD_TYPE = "sensor_msgs/msg/MagneticField"
FIELDS = ("magnetic_field.x", "magnetic_field.y")
MIN_ERROR_DEG, SEVERE_ERROR_DEG = 1.0, 5.0  # rms over a turn
MIN_SIGMAS = 5.0  # standard errors of the circle's centre
ROOM, TOLERANCE = "iron in the room", 0.05  # code; share by which the field's strength may differ then
MIN_DISTURBED = 0.12  # share by which the field's strength must differ beside iron in the room
MIN_READINGS, MAX_PLACE_M = 10, 1.5  # disturbed readings; m that most of them lie about their middle


def of_iron(drive: Drive, robot: Robot, streams: Mapping[str, Stream]) -> list[Finding]:
    """Return iron that turns a level magnetometer's headings: on the robot with its fix, in the room by place."""
    stream, settings = streams.get("compass"), cast(CompassSettings, robot.settings("compass"))
    if stream is None or stream.msgtype != FIELD_TYPE or settings.roll_deg or settings.pitch_deg:
        return []
    columns = cast("dict[str, Array]", stream.columns(*FIELDS))
    field = np.stack([columns[f].astype(np.float64) for f in FIELDS], axis=-1)
    t = (stream.t_ns - drive.epoch_ns) * 1e-9 + settings.time_offset
    inside = plausible(field) & (t >= drive.wheels.t[0]) & (t <= drive.wheels.t[-1])
    try:
        iron = fit_iron(field[inside])
    except LocfuseError:
        return []  # the robot did not turn once
    return [*_on_robot(iron, settings), *_in_room(iron, field[inside], t[inside], drive, robot)]


def _on_robot(iron: Iron, settings: CompassSettings) -> list[Finding]:
    hard, soft = np.array(settings.hard_iron), np.array(settings.soft_iron).reshape(2, 2)
    raw = np.linalg.inv(iron.soft) * iron.strength  # raw = hard + this times a unit vector
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
    """Return where and when the field's strength differs, which no calibration of the compass corrects."""
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
