"""Odometry out of other messages: Foxglove's, and the state that Unitree's legged robots publish."""

from __future__ import annotations

from collections.abc import Mapping
from typing import cast

import numpy as np

from locfuse.fusion.data import Array, Column, Ragged

FOXGLOVE_ODOMETRY = ("foxglove.Odometry", "foxglove_msgs/msg/Odometry")
SPORT_STATE = "unitree_go/msg/SportModeState"
PLACE = tuple(
    f"pose.{part}.{axis}" for part, axes in (("position", "xy"), ("orientation", "xyzw")) for axis in axes
)
SPEEDS = ("linear_velocity.x", "angular_velocity.z")  # of the body, in its own axes
COVARIANCES = ("pose_covariance", "velocity_covariance")
OF_FOXGLOVE_ODOMETRY = (*PLACE, *SPEEDS, *COVARIANCES)
OF_SPORT_STATE = ("position", "imu_state.quaternion")


def odometry_of_foxglove(
    columns: Mapping[str, Column], fields: tuple[str, ...], frame_id: str
) -> dict[str, Column]:
    """Return fields of Odometry made of k of Foxglove's, which may leave velocities out."""
    made: dict[str, Column] = {f"pose.{name}": columns[name] for name in PLACE}
    for name, speed in zip(("linear.x", "angular.z"), SPEEDS, strict=True):
        made[f"twist.twist.{name}"] = np.nan_to_num(_numbers(columns[speed]), nan=0.0)
    for name, of in zip(("pose", "twist"), COVARIANCES, strict=True):
        made[f"{name}.covariance"] = _six_by_six(columns[of])
    return {name: made[name] for name in fields}


def odometry_of_sport_state(
    columns: Mapping[str, Column], fields: tuple[str, ...], frame_id: str
) -> dict[str, Column]:
    """Return fields of Odometry made of k SportModeStates: their poses; `columns` are OF_SPORT_STATE."""
    place, (w, x, y, z) = _numbers(columns["position"]), _numbers(columns["imu_state.quaternion"]).T
    made: dict[str, Column] = {"pose.pose.position.x": place[:, 0], "pose.pose.position.y": place[:, 1]}
    made |= {f"pose.pose.orientation.{axis}": value for axis, value in zip("xyzw", (x, y, z, w), strict=True)}
    made |= {f"twist.twist.{name}": np.zeros(len(place)) for name in ("linear.x", "angular.z")}
    made |= {f"{name}.covariance": np.zeros((len(place), 36)) for name in ("pose", "twist")}
    return {name: made[name] for name in fields}


def _numbers(column: Column) -> Array:
    return np.asarray(cast("Array", column), np.float64)


def _six_by_six(column: Column) -> Array:
    """Return covariances as (n, 36); one of another length is none: zeros."""
    if not isinstance(column, Ragged):
        return _numbers(column).reshape(-1, 36)
    matrix = np.zeros((len(column), 36))
    whole = column.lengths == matrix.shape[1]
    matrix[whole] = column.values[column.first[:-1][whole][:, None] + np.arange(36)]
    return matrix
