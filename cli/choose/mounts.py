"""Where /tf_static puts the sensors on the base, or /tf where nothing is static, as tables of robot.toml."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from itertools import permutations
from typing import TYPE_CHECKING, Any

from locfuse.formats.robot.transforms import Mount, StaticTransforms, planar_mount
from locfuse.fusion.data import Stream
from locfuse.fusion.sensors.registry import REGISTRY

if TYPE_CHECKING:
    from locfuse.formats.log.log import Log

TURNS = ("roll_deg", "pitch_deg")
BASE_FRAMES = ("base_link", "base_footprint", "base")


def transforms_of(log: Log, frames: Iterable[str]) -> StaticTransforms:
    """Return the transforms of /tf_static, and where they do not place all frames those of /tf that never change.

    ROS 1 publishes mounts on /tf. Reading it takes time, so it is asked only where something is missing.
    """
    static = log.static_transforms()
    if all(frame in BASE_FRAMES or mount_of(static, frame) is not None for frame in frames if frame):
        return static
    known = {edge.child for edge in static.edges}
    still = [edge for edge in log.still_transforms().edges if edge.child not in known]
    return StaticTransforms((*static.edges, *still), static.conflicts)


def mount_tables(transforms: StaticTransforms, streams: Mapping[str, Sequence[Stream]]) -> dict[str, Any]:
    """Return the mounts that /tf_static knows of sensors (name -> its topics' streams), for the keys they have."""
    tables: dict[str, Any] = {}
    for sensor, parts in streams.items():
        keys = set(REGISTRY[sensor].Settings.__struct_fields__)
        mounts = {part.topic: m for part in parts if (m := mount_of(transforms, part.frame_id)) is not None}
        if "mounts" in keys:
            tables[sensor] = {"mounts": {t: [m.x, m.y, math.degrees(m.yaw)] for t, m in mounts.items()}}
        elif parts[0].topic in mounts:
            tables[sensor] = {k: v for k, v in _table(mounts[parts[0].topic]).items() if k in keys}
    return tables


def shared_turns(tables: Mapping[str, Any], streams: Mapping[str, Sequence[Stream]]) -> dict[str, Any]:
    """Return roll and pitch that are given for one sensor and hold for another of the same topic or frame.

    An IMU is compass and gyro: it is bolted to the robot once.
    """
    found: dict[str, Any] = {}
    turned = [s for s in streams if {*TURNS} <= set(REGISTRY[s].Settings.__struct_fields__)]
    for given, other in permutations(turned, 2):
        a, b = streams[given][0], streams[other][0]
        if a.topic != b.topic and not (a.frame_id and a.frame_id == b.frame_id):
            continue
        if not any(key in tables.get(other, {}) for key in TURNS):
            keys = {key: tables[given][key] for key in TURNS if key in tables.get(given, {})}
            found |= {other: keys} if keys else {}
    return found


def mount_of(transforms: StaticTransforms, frame: str) -> Mount | None:
    """Return where a frame sits on the base, None where nothing says so."""
    return planar_mount(transforms, BASE_FRAMES, frame) if frame else None


def _table(mount: Mount) -> dict[str, Any]:
    return {
        "x": mount.x,
        "y": mount.y,
        "roll_deg": math.degrees(mount.roll),
        "pitch_deg": math.degrees(mount.pitch),
        "yaw_deg": math.degrees(mount.yaw),
        "flipped": mount.flipped,
    }
