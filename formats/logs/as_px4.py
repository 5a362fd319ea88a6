"""PX4's messages as those of ROS: poses in north, east, down become east, north, up; the body's axes likewise.

PX4 gives the world in north, east, down and the body in forward, right, down; ROS in east, north, up and forward,
left, up (REP 103). Headings then turn the other way, from east: yaw = pi / 2 - yaw of PX4.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import cast

import numpy as np

from locfuse.formats.geometry import headings, quaternions
from locfuse.fusion.data import Array, Column

ODOMETRY, IMU = "nav_msgs/msg/Odometry", "sensor_msgs/msg/Imu"
VEHICLE_ODOMETRY = "px4_msgs/msg/VehicleOdometry"
LOCAL_POSITION = "px4_msgs/msg/VehicleLocalPosition"
SENSOR_COMBINED = "px4_msgs/msg/SensorCombined"
OF_ODOMETRY = ("position", "q", "velocity_frame", "velocity", "angular_velocity")
OF_POSITION = ("x", "y", "heading", "vx", "vy")
OF_SENSOR = ("gyro_rad", "accelerometer_m_s2")
BODY_FRAME = 3  # of velocity_frame: forward, right, down


def odometry_of_vehicle(
    columns: Mapping[str, Column], fields: tuple[str, ...], frame_id: str
) -> dict[str, Column]:
    """Return fields of Odometry made of k VehicleOdometry messages; `columns` are OF_ODOMETRY."""
    place, q, velocity, rates = (_numbers(columns[k]) for k in ("position", "q", "velocity", "angular_velocity"))
    w, x, y, z = q.T
    yaw = headings(x, y, z, w)
    along = velocity[:, 0] * np.cos(yaw) + velocity[:, 1] * np.sin(yaw)
    ahead = np.where(_numbers(columns["velocity_frame"]) == BODY_FRAME, velocity[:, 0], along)
    return _odometry(place[:, 0], place[:, 1], yaw, ahead, -rates[:, 2], fields)


def odometry_of_position(
    columns: Mapping[str, Column], fields: tuple[str, ...], frame_id: str
) -> dict[str, Column]:
    """Return fields of Odometry made of k VehicleLocalPosition messages; `columns` are OF_POSITION."""
    north, east, yaw, vx, vy = (_numbers(columns[name]) for name in OF_POSITION)
    return _odometry(north, east, yaw, vx * np.cos(yaw) + vy * np.sin(yaw), np.zeros(len(yaw)), fields)


def imu_of_sensor(columns: Mapping[str, Column], fields: tuple[str, ...], frame_id: str) -> dict[str, Column]:
    """Return fields of Imu without an orientation, made of k SensorCombined messages; `columns` are OF_SENSOR."""
    rates, accelerations = (_numbers(columns[name]) for name in OF_SENSOR)
    n = len(rates)
    turned = np.array([1.0, -1.0, -1.0])
    none = np.zeros((n, 9))
    made: dict[str, Column] = {"angular_velocity_covariance": none, "linear_acceleration_covariance": none}
    made["orientation_covariance"] = np.where(np.arange(9) == 0, -1.0, none)
    for name, values in (("angular_velocity", rates * turned), ("linear_acceleration", accelerations * turned)):
        made |= {f"{name}.{axis}": values[:, k] for k, axis in enumerate("xyz")}
    made |= {f"orientation.{axis}": np.zeros(n) for axis in "xyzw"}
    return {name: made[name] for name in fields}


def _numbers(column: Column) -> Array:
    return np.asarray(cast("Array", column), np.float64)


def _odometry(
    north: Array, east: Array, yaw: Array, ahead: Array, rate: Array, fields: tuple[str, ...]
) -> dict[str, Column]:
    turned = quaternions(0.5 * np.pi - yaw)
    made: dict[str, Column] = {
        "pose.pose.position.x": east,
        "pose.pose.position.y": north,
        **{f"pose.pose.orientation.{axis}": turned[:, k] for k, axis in enumerate("xyzw")},
        "twist.twist.linear.x": ahead,
        "twist.twist.angular.z": rate,
        **{f"{part}.covariance": np.zeros((len(yaw), 36)) for part in ("pose", "twist")},
    }
    return {name: made[name] for name in fields}
