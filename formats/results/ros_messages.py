"""Poses as ROS 2 messages, by the thousand: nav_msgs/Odometry, PoseStamped, PointStamped, Path, and /tf."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from locfuse.formats.container.mcap_write import nested, time_message
from locfuse.formats.geometry import quaternions
from locfuse.fusion.data import Array, Ints, matrices

from .template import MESSAGES, Columns, Template, stamps
from .trajectory import SIX

MAP = "map"
ODOMETRY, PATH, TF = "nav_msgs/msg/Odometry", "nav_msgs/msg/Path", "tf2_msgs/msg/TFMessage"
POSE, POINT = "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/PointStamped"
MAX_PATH_POSES = 2000  # of a path, which is to be looked at; every pose is on the odometry topic


class Series(msgspec.Struct, frozen=True, dict=True):
    """Messages of one type, stamped t_ns (n,), made when they are asked for."""

    msgtype: str
    t_ns: Ints
    constant: dict[str, Any]
    columns: Callable[[slice], Columns]  # of these rows

    @cached_property
    def _template(self) -> Template:
        return Template(self.msgtype, self.constant, self.columns(slice(1)).keys())

    def messages(self, rows: slice) -> NDArray[np.uint8]:
        """Return the given rows as CDR bytes (k, size)."""
        return self._template.filled(self.columns(rows))


def odometry(t_ns: Ints, pose: Array, triangles: Array, twist: Array, child: str) -> Series:
    """Return Odometry of poses (n, 3) with triangles of covariances (n, 6) and body twists (n, 3)."""

    def columns(rows: slice) -> Columns:
        covariance = np.zeros((len(t_ns[rows]), 6, 6))
        covariance[:, np.array(SIX)[:, None], SIX] = matrices(triangles[rows])
        return {
            **stamps("header.stamp", t_ns[rows]),
            **_pose("pose.pose", pose[rows]),
            "pose.covariance": covariance.reshape(-1, 36),
            "twist.twist.linear.x": twist[rows, 0],
            "twist.twist.linear.y": twist[rows, 1],
            "twist.twist.angular.z": twist[rows, 2],
        }

    return Series(ODOMETRY, t_ns, {"header.frame_id": MAP, "child_frame_id": child}, columns)


def poses(t_ns: Ints, pose: Array) -> Series:
    """Return PoseStamped of poses (n, 3)."""
    return Series(
        POSE,
        t_ns,
        {"header.frame_id": MAP},
        lambda rows: {**stamps("header.stamp", t_ns[rows]), **_pose("pose", pose[rows])},
    )


def points(t_ns: Ints, xy: Array) -> Series:
    """Return PointStamped of points (n, 2)."""
    return Series(
        POINT,
        t_ns,
        {"header.frame_id": MAP},
        lambda rows: {**stamps("header.stamp", t_ns[rows]), "point.x": xy[rows, 0], "point.y": xy[rows, 1]},
    )


def transforms(t_ns: Ints, pose: Array, child: str) -> Series:
    """Return TFMessage from the map to a frame at poses (n, 3)."""
    constant = {"transforms": [{"header": {"frame_id": MAP}, "child_frame_id": child}]}

    def columns(rows: slice) -> Columns:
        return {
            **stamps("transforms.header.stamp", t_ns[rows]),
            **_pose("transforms.transform", pose[rows], "translation", "rotation"),
        }

    return Series(TF, t_ns, constant, columns)


def path(t_ns: Ints, pose: Array) -> NDArray[np.uint8]:
    """Return one Path (1, size) through poses (n, 3), thinned to MAX_PATH_POSES."""
    rows = np.unique(np.linspace(0, len(t_ns) - 1, min(len(t_ns), MAX_PATH_POSES)).round().astype(np.int64))
    columns = {**stamps("header.stamp", t_ns[rows]), **_pose("pose", pose[rows])}
    values = zip(*(column.tolist() for column in columns.values()), strict=True)
    listed = [nested({"header.frame_id": MAP, **dict(zip(columns, one, strict=True))}) for one in values]
    header = {"stamp": time_message(int(t_ns[0])), "frame_id": MAP}
    return np.frombuffer(MESSAGES.cdr(PATH, {"header": header, "poses": listed}), np.uint8)[None]


def _pose(at: str, pose: Array, position: str = "position", orientation: str = "orientation") -> dict[str, Array]:
    turned = quaternions(pose[:, 2])
    return {
        f"{at}.{position}.x": pose[:, 0],
        f"{at}.{position}.y": pose[:, 1],
        f"{at}.{orientation}.z": turned[:, 2],
        f"{at}.{orientation}.w": turned[:, 3],
    }
