"""Types of a simulated drive: tables of a scenario, raw messages, pose estimates, named random streams."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from typing import Annotated, Any, NamedTuple

import msgspec
import numpy as np

Positive = Annotated[float, msgspec.Meta(gt=0)]
NotNegative = Annotated[float, msgspec.Meta(ge=0)]
Share = Annotated[float, msgspec.Meta(ge=0, le=1)]
Percent = Annotated[int, msgspec.Meta(ge=1, le=100)]
Count = Annotated[int, msgspec.Meta(ge=2)]
Point = tuple[float, float]  # m, map frame
Segment = tuple[float, float, float, float]  # x1, y1, x2, y2 [m], map frame
Colour = tuple[int, int, int]  # red, green, blue, 0..255

RED: Colour = (200, 20, 30)


class ScenarioTable(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """TOML table of a scenario; unknown keys are errors."""


class Pillar(ScenarioTable, frozen=True):
    """Vertical cylinder, such as a landmark or a leg."""

    x: float  # m, map frame
    y: float
    radius: Positive = 0.06
    bottom: float = 0.0
    top: float = 1.6
    colour: Colour = RED


# --- Messages of a simulated drive, pose estimates, and named random streams


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
