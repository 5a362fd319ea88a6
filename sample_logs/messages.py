"""Data of a simulated drive: raw messages, pose estimates, and named random sources."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np


class RawMessage(NamedTuple):
    """One message for a recorder: standard ROS 2 type, values by dotted field path."""

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
# The generator of a named source of chance; no source can shift another's numbers.
Streams = Callable[[str], np.random.Generator]


def streams(seed: int) -> Streams:
    """Return the named random sources of one drive."""

    def stream(name: str) -> np.random.Generator:
        return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(zlib.crc32(name.encode()),)))

    return stream
