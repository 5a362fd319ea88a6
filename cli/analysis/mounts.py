"""Mounts of sensors on the base by /tf_static or /tf, with tilt, as tables of robot.toml."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from itertools import permutations
from typing import Any

import numpy as np
from msgspec.structs import replace

from locfuse.formats.logs.log import Log
from locfuse.formats.messages.schema import CAMERA_MATRIX
from locfuse.formats.robot.transforms import FrameMount, StaticTransforms, planar_mount
from locfuse.fusion.data import Array, LocfuseError, Stream
from locfuse.fusion.mount import MAX_MOUNT_M
from locfuse.fusion.robot import Robot
from locfuse.fusion.se2 import rotation_3d
from locfuse.fusion.sensors.magnetic import FIELD, IMU, LevelledField, tilt_of
from locfuse.fusion.sensors.registry import REGISTRY
from locfuse.fusion.wheels.odometry import ODOMETRY

from .topics import filled

TILT_KEYS = ("roll_deg", "pitch_deg")
CHILD_FRAME = "child_frame_id"
MAX_TILT_RAD = math.radians(30.0)  # of an odometry's body, whose heading is then still that of the base
MIN_MOUNT = 1e-6  # m or degrees: less is rounding
MAX_VERTICAL = 0.7  # largest vertical part of an optical frame's z axis (unit vector)
CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
BASE_FRAMES = ("base_link", "base_footprint", "base")
ODOMETRY_WORD = "odom"
ROOM_FRAMES = ("map", "world", "earth", "utm")  # last words of the names of map frames


def transforms_of(log: Log, frames: Iterable[str]) -> StaticTransforms:
    """Return the transforms of /tf_static; if a frame is missing, also those of /tf that are constant.

    ROS 1 publishes mounts on /tf. /tf is read only if needed, since this takes time. If no frame is named like a
    base, /tf also shows the base: the frame that moves in odom, else in map or world.
    """
    static = log.static_transforms()
    if all(is_base(frame) or mount_of(static, frame) is not None for frame in frames if frame):
        return static
    edges = [edge for topic in log.transform_topics for edge in log.frames(topic).values() if edge.moves]
    bodies = [e for e in edges if not is_fixed(e.child)]
    bases = [e.child for e in bodies if is_odometry(e.parent)] or [e.child for e in bodies if is_room(e.parent)]
    return replace(log.all_mounts(), bases=tuple(bases), moving=tuple(log.moving_transforms()))


def is_base(frame: str) -> bool:
    """Return whether a frame is named like a robot's base: base_link or robot1/base_link."""
    return last_word(frame) in BASE_FRAMES


def is_odometry(frame: str) -> bool:
    """Return whether a frame is named like an odometry frame: odom, odom_combined."""
    word = last_word(frame)
    return word.startswith(ODOMETRY_WORD) or word.endswith(ODOMETRY_WORD)


def is_room(frame: str) -> bool:
    """Return whether a frame is named like a frame fixed in the world: map, world, earth, utm."""
    return last_word(frame) in ROOM_FRAMES


def is_fixed(frame: str) -> bool:
    """Return whether a frame is named like an odometry frame or a map frame."""
    return is_odometry(frame) or is_room(frame)


def last_word(frame: str) -> str:
    """Return a frame's name in lower case without the robot's name: "/robot1/base_link" is base_link."""
    return frame.rpartition("/")[2].lower()


def mount_tables(
    transforms: StaticTransforms, streams: Mapping[str, Sequence[Stream]], given: Mapping[str, Any]
) -> dict[str, Any]:
    """Return the sensors' mounts, by the frames of their streams, as tables with the keys of their settings.

    Raises LocfuseError as `refuse_far`; `given` are the configured tables.
    """
    tables: dict[str, Any] = {}
    for sensor, parts in streams.items():
        keys = set(REGISTRY[sensor].Settings.__struct_fields__)
        mounts = {part.topic: m for part in parts if (m := mount_of(transforms, part.frame_id)) is not None}
        views = {topic: _view(m) if "fx" in keys else {} for topic, m in mounts.items()}
        placed = {topic: _table(m) | views[topic] for topic, m in mounts.items()}
        if "mounts" in keys and (len(parts) > 1 or "x" not in keys):
            shown = {topic: ("x", "y", *(view or ("yaw_deg",))) for topic, view in views.items()}
            tables[sensor] = {"mounts": {t: [placed[t][key] for key in of] for t, of in shown.items()}}
        elif parts[0].topic in mounts:
            tables[sensor] = {k: v for k, v in placed[parts[0].topic].items() if k in keys}
    refuse_far(tables, given)
    return tables


def odometry_mount(log: Log, topics: Sequence[str], transforms: StaticTransforms) -> dict[str, Any]:
    """Return the place on the base of the body whose poses an odometry has, by its child_frame_id.

    {} for a body at the base, and if no transform leads to it or it is tilted: only its heading would be read.
    """
    if len(topics) != 1 or log.topics[topics[0]].msgtype != ODOMETRY or not log.recorded(topics[0]):
        return {}
    _, first = next(log.stream(topics[0]).blocks(CHILD_FRAME, rows=1), ((), {CHILD_FRAME: [""]}))
    mount = mount_of(transforms, str(next(iter(first[CHILD_FRAME]), "")))
    if mount is None or max(abs(mount.roll), abs(mount.pitch)) > MAX_TILT_RAD:
        return {}
    placed = {key: value for key, value in _table(mount).items() if key in {"x", "y", "yaw_deg"}}
    return {"wheels": placed} if max(map(abs, placed.values())) > MIN_MOUNT else {}


def refuse_far(mounts: Mapping[str, Any], tables: Mapping[str, Any]) -> None:
    """Raise LocfuseError for a mount by transforms too far from the base, unless `tables` set its place."""
    for sensor, mount in mounts.items():
        place = {k: mount[k] for k in ("x", "y") if k in mount and k not in tables.get(sensor, {})}
        if any(abs(metres) > MAX_MOUNT_M for metres in place.values()):
            words = " and ".join(f"{key} = {metres:g} m" for key, metres in place.items())
            fixes = tuple(f"{sensor}.{key}={metres / 1000.0:g}" for key, metres in place.items())
            hint = f"Set it: {' '.join(f'--set {fix}' for fix in fixes)}"
            words = f"its frame is at {words} of the base by the log's transforms: in mm, as it seems."
            raise LocfuseError(words, role=sensor, fixes=fixes, hint=hint)


def _view(mount: FrameMount) -> dict[str, Any]:
    """Return yaw and pitch [deg] of an optical frame's view (REP 103: z ahead); {} if its z axis is vertical."""
    ahead = rotation_3d(*(math.degrees(angle) for angle in (mount.roll, mount.pitch, mount.yaw)))[:, 2]
    if abs(ahead[2]) > MAX_VERTICAL:
        return {}
    yaw, pitch = math.atan2(ahead[1], ahead[0]), math.asin(-ahead[2])
    return {"yaw_deg": math.degrees(yaw), "pitch_deg": math.degrees(pitch) + 0.0}


def on_moving_parts(
    transforms: StaticTransforms, streams: Mapping[str, Sequence[Stream]], tables: Mapping[str, Any]
) -> dict[str, str]:
    """Return {sensor: reason to leave it out} for sensors on moving parts that have no configured mount."""
    found = {}
    for sensor, parts in streams.items():
        keys = {"x", "y", "yaw_deg"} & set(REGISTRY[sensor].Settings.__struct_fields__)
        given = keys & set(tables.get(sensor, {}))
        if len(keys) == 3 and not given and (moves := moved_by(transforms, parts[0].frame_id)):
            found[sensor] = (
                f"{parts[0].frame_id} moves on the robot ({moves} by /tf), and only sensors bolted to its "
                f"base are read; if it stood still, say where: {sensor}.x, {sensor}.y, {sensor}.yaw_deg"
            )
    return found


def optics_tables(log: Log, streams: Mapping[str, Sequence[Stream]], tables: Mapping[str, Any]) -> dict[str, Any]:
    """Return fx and cx [px] of each sensor that has these settings, from the CameraInfo topic of its frame.

    If no CameraInfo topic has this frame, the log's only CameraInfo topic is used. A sensor with
    several topics gets {"optics": {topic: [fx, cx]}}. Sensors with a configured fx are omitted.
    """
    infos = filled(log, CAMERA_INFO)
    found: dict[str, Any] = {}
    for sensor, parts in streams.items():
        if "fx" not in REGISTRY[sensor].Settings.__struct_fields__ or "fx" in tables.get(sensor, {}):
            continue
        optics = {part.topic: _optics(log, infos, part.frame_id) for part in parts}
        known = {topic: [fx, cx] for topic, (fx, cx) in optics.items() if fx > 0.0}
        if len(parts) > 1:
            found[sensor] = {"optics": known}
        elif known:
            ((fx, cx),) = known.values()
            found[sensor] = {"fx": fx, "cx": cx}
    return found


def _optics(log: Log, infos: Sequence[str], frame: str) -> tuple[float, float]:
    """Return focal length and image centre (fx, cx) [px] of a frame by its CameraInfo; (0, 0) without one."""
    same = [t for t in infos if log.stream(t).frame_id == frame]
    for topic in same[:1] or (infos if len(infos) == 1 else []):
        matrix = np.asarray(log.stream(topic).columns(CAMERA_MATRIX)[CAMERA_MATRIX], np.float64).reshape(-1, 9)
        if len(matrix) and matrix[0, 0] > 0.0:
            return float(matrix[0, 0]), float(matrix[0, 2])
    return 0.0, 0.0


def shared_turns(tables: Mapping[str, Any], streams: Mapping[str, Sequence[Stream]]) -> dict[str, Any]:
    """Return roll and pitch of sensors without these, from a sensor with the same topic or frame (one IMU)."""
    found: dict[str, Any] = {}
    turned = [s for s in streams if {*TILT_KEYS} <= set(REGISTRY[s].Settings.__struct_fields__)]
    for given, other in permutations(turned, 2):
        a, b = streams[given][0], streams[other][0]
        if a.topic != b.topic and not (a.frame_id and a.frame_id == b.frame_id):
            continue
        if not any(key in tables.get(other, {}) for key in TILT_KEYS):
            keys = {key: tables[given][key] for key in TILT_KEYS if key in tables.get(given, {})}
            found |= {other: keys} if keys else {}
    return found


def mount_of(transforms: StaticTransforms, frame: str) -> FrameMount | None:
    """Return a frame's mount on the base; None if no transform leads to the base."""
    return planar_mount(transforms, _bases_in(transforms), frame) if frame else None


def moved_by(transforms: StaticTransforms, frame: str) -> str:
    """Return the moving joint between base and frame, such as "pan_link in base_link"; "" without one."""
    if not frame or mount_of(transforms, frame) is not None:
        return ""
    parent = {edge.child: edge.parent for edge in (*transforms.edges, *transforms.moving)}
    moving, bodies = {edge.child for edge in transforms.moving}, set(_bases_in(transforms))
    way = [frame.lstrip("/")]
    while way[-1] in parent and way[-1] not in bodies and len(way) <= len(parent):  # limited: loops
        way.append(parent[way[-1]])
    found = [f"{child} in {parent[child]}" for child in way[:-1] if child in moving]
    return found[0] if found and way[-1] in bodies else ""


def _bases_in(transforms: StaticTransforms) -> list[str]:
    """Return possible base frames: usual names, with and without a robot's name, and frames that move in odom."""
    frames = dict.fromkeys(name for edge in transforms.edges for name in (edge.parent, edge.child))
    named = [frame for base in BASE_FRAMES for frame in frames if last_word(frame) == base]
    return [*BASE_FRAMES, *named, *transforms.bases]


def _table(mount: FrameMount) -> dict[str, Any]:
    degrees = {f"{angle}_deg": math.degrees(getattr(mount, angle)) for angle in ("roll", "pitch", "yaw")}
    return {"x": mount.x, "y": mount.y, **degrees, "flipped": mount.flipped}


def level_compass(
    log: Log, streams: Mapping[str, Any], robot: Robot, transforms: StaticTransforms
) -> dict[str, Any]:
    """Return the streams, the magnetometer's with the tilt by the IMU in its frame, else by the only IMU."""
    field = streams.get("compass")
    if field is None or field.msgtype != FIELD or not robot.settings("compass").level:
        return dict(streams)
    imu = _imu(log, robot, field)
    tilt = tilt_of(imu, _imu_rotation(imu, field, streams, robot, transforms)) if imu is not None else None
    return dict(streams) if tilt is None else {**streams, "compass": LevelledField(field, tilt)}


def _imu(log: Log, robot: Robot, field: Stream) -> Stream | None:
    """Return the IMU in the magnetometer's frame, else the only IMU; None without one or if several fit."""
    try:
        found = [log.stream(t, robot.order) for t in filled(log, IMU)]
        beside = [imu for imu in found if field.frame_id and imu.frame_id == field.frame_id]
    except LocfuseError:  # an unreadable topic is reported elsewhere
        return None
    return beside[0] if beside else found[0] if len(found) == 1 else None


def _imu_rotation(
    imu: Stream, field: Stream, streams: Mapping[str, Any], robot: Robot, transforms: StaticTransforms
) -> Array:
    """Return the rotation (3, 3) from IMU axes to base axes: as configured, else by /tf_static."""
    gyro = streams.get("gyro")
    mount = mount_of(transforms, imu.frame_id)
    angles = (mount.roll, mount.pitch, mount.yaw) if mount else (0.0, 0.0, 0.0)
    roll, pitch, yaw = map(math.degrees, angles)
    if imu.frame_id and imu.frame_id == field.frame_id:
        compass = robot.settings("compass")
        roll, pitch, yaw = compass.roll_deg, compass.pitch_deg, compass.yaw_deg
    elif gyro is not None and gyro.topic == imu.topic:
        settings = robot.settings("gyro")
        roll, pitch = settings.roll_deg, settings.pitch_deg
    return rotation_3d(roll, pitch, yaw)
