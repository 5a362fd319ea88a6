"""The IMU by which a magnetometer's field is levelled: of its frame, or the only one."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from locfuse.formats.robot.transforms import StaticTransforms
from locfuse.fusion.data import Array, LocfuseError, Stream
from locfuse.fusion.mount import rotation
from locfuse.fusion.robot import Robot
from locfuse.fusion.sensors.level import FIELD, IMU, LevelledField, tilt_of

from .mounts import mount_of
from .topics import of_type

if TYPE_CHECKING:
    from locfuse.formats.logs.log import Log


def level_compass(
    log: Log, streams: Mapping[str, Any], robot: Robot, transforms: StaticTransforms
) -> dict[str, Any]:
    """Return the streams, a magnetometer's with the tilt of the robot where an IMU says that there is any."""
    field = streams.get("compass")
    if field is None or field.msgtype != FIELD or not robot.settings("compass").level:
        return dict(streams)
    imu = _imu(log, robot, field)
    tilt = tilt_of(imu, _turn(imu, field, streams, robot, transforms)) if imu is not None else None
    return dict(streams) if tilt is None else {**streams, "compass": LevelledField(field, tilt)}


def _imu(log: Log, robot: Robot, field: Stream) -> Stream | None:
    """Return the IMU of the magnetometer's frame, else the only one; None where that is not clear."""
    topics = [t for t in of_type(log, (IMU,)) if log.topics[t].count]
    try:
        found = [log.stream(t, robot.order) for t in topics]
        beside = [imu for imu in found if field.frame_id and imu.frame_id == field.frame_id]
    except LocfuseError:  # a topic that cannot be read says so elsewhere
        return None
    return beside[0] if beside else found[0] if len(found) == 1 else None


def _turn(
    imu: Stream, field: Stream, streams: Mapping[str, Any], robot: Robot, transforms: StaticTransforms
) -> Array:
    """Return the rotation (3, 3) from the IMU's axes to the base's: as configured, else as /tf_static says."""
    gyro = streams.get("gyro")
    mount = mount_of(transforms, imu.frame_id)
    roll, pitch, yaw = (
        (math.degrees(a) for a in (mount.roll, mount.pitch, mount.yaw)) if mount else (0.0, 0.0, 0.0)
    )
    if imu.frame_id and imu.frame_id == field.frame_id:
        compass = robot.settings("compass")
        roll, pitch, yaw = compass.roll_deg, compass.pitch_deg, compass.yaw_deg
    elif gyro is not None and gyro.topic == imu.topic:
        settings = robot.settings("gyro")
        roll, pitch = settings.roll_deg, settings.pitch_deg
    return rotation(roll, pitch, yaw)
