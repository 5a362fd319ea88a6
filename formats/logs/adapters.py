"""Message types that are read as another one: what they are presented as, by whom, and what it takes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

from locfuse.fusion.data import Column

from .as_joints import (
    DYNAMIC,
    FEEDBACK,
    FOXGLOVE_JOINTS,
    JOINTS,
    OF_DYNAMIC,
    OF_FEEDBACK,
    OF_FOXGLOVE_JOINTS,
    as_joints,
    joints_of_feedback,
    joints_of_foxglove,
)
from .as_odometry import (
    FOXGLOVE_ODOMETRY,
    OF_FOXGLOVE_ODOMETRY,
    OF_SPORT_STATE,
    SPORT_STATE,
    odometry_of_foxglove,
    odometry_of_sport_state,
)
from .as_px4 import (
    IMU,
    LOCAL_POSITION,
    ODOMETRY,
    OF_ODOMETRY,
    OF_POSITION,
    OF_SENSOR,
    SENSOR_COMBINED,
    VEHICLE_ODOMETRY,
    imu_of_sensor,
    odometry_of_position,
    odometry_of_vehicle,
)
from .as_scan import (
    CLOUD,
    ECHOES,
    FOXGLOVE,
    FOXGLOVE_CLOUD,
    OF_CLOUD,
    OF_ECHOES,
    OF_FOXGLOVE,
    OF_FOXGLOVE_CLOUD,
    SCAN,
    cloud_as_scans,
    echoes_as_scans,
    foxglove_as_scans,
    foxglove_clouds_as_scans,
    level_frame,
)

PATH, POSE = "nav_msgs/msg/Path", "geometry_msgs/msg/PoseStamped"
OF_PATH = (
    "poses.header.stamp",
    *(f"poses.pose.position.{axis}" for axis in "xy"),
    *(f"poses.pose.orientation.{axis}" for axis in "xyzw"),
)


class Presented(NamedTuple):
    """How the messages of a type become those of another."""

    msgtype: str  # what they become
    suffix: str  # the topic is called "/source:suffix"
    fields: tuple[str, ...]  # of the source
    # columns, fields, frame id -> columns; None where the last message holds all rows (log.stream.PathStream)
    make: Callable[[Mapping[str, Column], tuple[str, ...], str], dict[str, Column]] | None
    frame: Callable[[str], str] = str


PRESENTED: Mapping[str, Presented] = {
    CLOUD: Presented(SCAN, "scan", OF_CLOUD, cloud_as_scans, frame=level_frame),
    ECHOES: Presented(SCAN, "scan", OF_ECHOES, echoes_as_scans),
    **dict.fromkeys(FOXGLOVE, Presented(SCAN, "scan", OF_FOXGLOVE, foxglove_as_scans)),
    **dict.fromkeys(FOXGLOVE_CLOUD, Presented(SCAN, "scan", OF_FOXGLOVE_CLOUD, foxglove_clouds_as_scans)),
    **dict.fromkeys(
        FOXGLOVE_ODOMETRY, Presented(ODOMETRY, "odometry", OF_FOXGLOVE_ODOMETRY, odometry_of_foxglove)
    ),
    SPORT_STATE: Presented(ODOMETRY, "odometry", OF_SPORT_STATE, odometry_of_sport_state, frame=lambda _: "odom"),
    **dict.fromkeys(FOXGLOVE_JOINTS, Presented(JOINTS, "joints", OF_FOXGLOVE_JOINTS, joints_of_foxglove)),
    **dict.fromkeys(FEEDBACK, Presented(JOINTS, "joints", OF_FEEDBACK, joints_of_feedback)),
    VEHICLE_ODOMETRY: Presented(ODOMETRY, "odometry", OF_ODOMETRY, odometry_of_vehicle, frame=lambda _: "odom"),
    LOCAL_POSITION: Presented(ODOMETRY, "odometry", OF_POSITION, odometry_of_position, frame=lambda _: "odom"),
    SENSOR_COMBINED: Presented(IMU, "imu", OF_SENSOR, imu_of_sensor),
    PATH: Presented(POSE, "poses", OF_PATH, None),
    DYNAMIC: Presented(JOINTS, "joints", OF_DYNAMIC, as_joints),
}


def presented_name(name: str, msgtype: str) -> str | None:
    """Return the name under which a topic of this type is presented as another, None for any other type."""
    kind = PRESENTED.get(msgtype)
    return f"{name}:{kind.suffix}" if kind is not None else None
