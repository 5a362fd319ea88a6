"""Readings as raw messages, and where they may go: a log file or columns in memory."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple


class RawMessage(NamedTuple):
    """One message as a recorder gets it: standard ROS 2 type, values by dotted field path."""

    topic: str
    msgtype: str
    log_ns: int  # when it arrived
    stamp_ns: int  # when the reading was taken, by the sensor's own clock (header.stamp)
    frame_id: str
    fields: dict[str, Any]


Emit = Callable[[RawMessage], None]
Pose = tuple[float, float, float]  # x [m], y [m], theta [rad], map frame
# The robot's localisation: the messages that arrived since the last call -> where it believes to be now.
Estimator = Callable[[list[RawMessage]], Pose]
