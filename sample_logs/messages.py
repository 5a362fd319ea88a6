"""Types of a simulated drive: raw messages, pose estimates, and named random streams."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np


class RawMessage(NamedTuple):
    """One message of a simulated sensor: ROS 2 type, values by dotted field path."""

    topic: str
    msgtype: str
    log_ns: int  # time of arrival
    stamp_ns: int  # time of the reading by the sensor's own clock (header.stamp)
    frame_id: str
    fields: dict[str, Any]


Emit = Callable[[RawMessage], None]
Pose = tuple[float, float, float]  # x [m], y [m], theta [rad], map frame
# The robot's localisation: messages since the last call -> estimated pose.
Estimator = Callable[[list[RawMessage]], Pose]
# Name of a random stream -> its generator; streams are independent.
Streams = Callable[[str], np.random.Generator]


def streams(seed: int) -> Streams:
    """Return the function that gives the named random streams of one drive."""

    def stream(name: str) -> np.random.Generator:
        return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(zlib.crc32(name.encode()),)))

    return stream
