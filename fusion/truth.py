"""Reading truth: reference poses or points of ROS' usual messages. Used to judge, never to estimate."""

from __future__ import annotations

from collections.abc import Mapping
from typing import cast

import numpy as np

from locfuse.fusion.wheels.jumps import limits, spikes
from locfuse.fusion.wheels.odometry import POSE

from . import se2
from .data import Array, LocfuseError, Stream, Truth
from .robot import TruthSettings

TRUTH_READS: Mapping[str, tuple[str, ...]] = {
    **POSE,
    "geometry_msgs/msg/PointStamped": ("point.x", "point.y"),
}
TRUTH_NAMES = (
    "ground_truth",
    "groundtruth",
    "gt",
    "mocap",
    "vicon",
    "optitrack",
)  # never /odom, never /amcl_pose


def looks_like_truth(topic: str) -> bool:
    """Return whether a topic's name says that it is a reference."""
    parts = topic.lower().strip("/").replace("-", "_").split("/")
    return any(name == part or (name != "gt" and name in part) for part in parts for name in TRUTH_NAMES)


def read_truth(stream: Stream, settings: TruthSettings, epoch_ns: int) -> tuple[Truth, dict[str, int]]:
    """Return the truth in strictly increasing time, and what was dropped by reason."""
    columns = cast("dict[str, Array]", stream.columns(*TRUTH_READS[stream.msgtype]))
    fields = list(columns.values())
    values = np.stack([f.astype(np.float64) for f in fields], axis=-1) if fields else np.zeros((0, 2))
    dropped = dict(stream.dropped)
    finite = np.isfinite(values).all(axis=1)
    if not finite.all():
        dropped["not_finite"] = int((~finite).sum())
    rows = np.flatnonzero(finite)
    later = np.diff(stream.t_ns[rows], prepend=-1) > 0
    if not later.all():
        dropped["repeat"] = int((~later).sum())
    rows = rows[later]
    if settings.max_speed is not None and len(rows) > 2:
        t = (stream.t_ns[rows] - stream.t_ns[rows[0]]) * np.float64(1e-9)
        xy = values[rows, :2]
        away = spikes(t, xy, limits(t, np.hypot(*np.diff(xy, axis=0).T), settings.max_speed))
        if away.any():
            dropped["jump"] = int(away.sum())
        rows = rows[~away]
    if len(rows) == 0:
        raise LocfuseError(f"{stream.topic} has no usable reading of {len(stream.t_ns)}", role="truth")
    theta = _yaw(values[rows, 2:]) if values.shape[1] == 6 else None
    return (
        Truth(
            topic=stream.topic,
            t=(stream.t_ns[rows] - epoch_ns) * np.float64(1e-9) + settings.time_offset,
            xy=values[rows, :2],
            theta=theta,
            point=(settings.x, settings.y),
            sigma=settings.sigma,
        ),
        dropped,
    )


def _yaw(q: Array) -> Array | None:
    """Yaw of quaternions (n, 4) x, y, z, w; None where no heading was recorded (all zero)."""
    x, y, z, w = q.T
    if not q.any():
        return None
    return se2.yaw(x, y, z, w)
