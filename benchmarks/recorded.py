"""What the robot of a timing log records: messages of standard types, written with NumPy, many at a time."""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from benchmarks.loop_drive import Array, Loop, OmniView, ranges
from locfuse.formats.container.mcap_write import StandardMessages

EPOCH_NS = 1_700_000_000_000_000_000
TRACK, RADIUS, SLIP = 0.6, 0.05, 4e-4  # m, m, m: variance per metre that a wheel rolls
SIGMA_RANGE, SIGMA_ANGLE = 0.03, math.radians(0.08)
SIGMA_COMPASS = math.radians(1.0)
FIELD, FIELD_DIRECTION = 3e-5, 0.4  # T, rad in the map


class Template:
    """Messages of one type that differ in some numbers only: written as NumPy rows, not one by one."""

    def __init__(self, msgtype: str, fixed: Mapping[str, Any], varying: Mapping[str, tuple[str, int]]) -> None:
        """`varying` names the fields that differ: path -> (dtype, how many; 0 for a single number)."""
        self.msgtype = msgtype
        rng = np.random.default_rng(0)
        marks = {path: rng.random(max(size, 1)).astype(dtype) for path, (dtype, size) in varying.items()}
        values = {path: mark if varying[path][1] else mark[0].item() for path, mark in marks.items()}
        self.cdr = cdr(msgtype, {**fixed, **values})
        self.at = {path: (self.cdr.index(mark.tobytes()), mark.dtype) for path, mark in marks.items()}

    def fill(self, t: Array, values: Mapping[str, Array]) -> list[bytes]:
        """Return the messages stamped t (n,) with their values, (n,) or (n, k)."""
        rows = np.tile(np.frombuffer(self.cdr, np.uint8), (len(t), 1))
        rows[:, 4:12] = stamps(t)
        for path, (start, dtype) in self.at.items():
            column = np.ascontiguousarray(values[path], dtype).reshape(len(t), -1).view(np.uint8)
            rows[:, start : start + column.shape[1]] = column
        return [row.tobytes() for row in rows]


def cdr(msgtype: str, fields: Mapping[str, Any]) -> bytes:
    """Return a message with a header as CDR; fields by dotted path."""
    tree: dict[str, Any] = {"header": {"frame_id": FRAMES[msgtype]}}
    for path, value in fields.items():
        *parents, leaf = path.split(".")
        node = tree
        for name in parents:
            node = node.setdefault(name, {})
        node[leaf] = value
    return StandardMessages().cdr(msgtype, tree)


FRAMES = {
    "sensor_msgs/msg/JointState": "",
    "sensor_msgs/msg/MagneticField": "base_link",
    "sensor_msgs/msg/LaserScan": "laser",
    "sensor_msgs/msg/CompressedImage": "omni_camera",
    "sensor_msgs/msg/Image": "front_camera",
    "geometry_msgs/msg/PoseStamped": "map",
}


def nanoseconds(t: Array) -> np.ndarray[Any, np.dtype[np.int64]]:
    """Return times [s] of the drive as integer nanoseconds."""
    return EPOCH_NS + np.round(t * 1e9).astype(np.int64)


def stamps(t: Array) -> np.ndarray[Any, np.dtype[np.uint8]]:
    """Return times (n,) as the 8 bytes of a header's stamp, (n, 8)."""
    parts = np.stack(np.divmod(nanoseconds(t), 1_000_000_000), axis=1)
    return parts.astype("<u4").view(np.uint8)


class Encoders:
    """Wheel angles of the exact drive plus the slip that the robot cannot see, a random walk."""

    def __init__(self, drive: Loop, rng: np.random.Generator) -> None:
        self.drive, self.rng, self.end = drive, rng, np.zeros(2)
        self.last = np.zeros(2)  # m rolled so far, without slip
        self.template = Template(
            "sensor_msgs/msg/JointState",
            {"name": ["wheel_left_joint", "wheel_right_joint"]},
            {"position": ("f8", 2), "velocity": ("f8", 2)},
        )

    def messages(self, t: Array) -> list[bytes]:
        """Return the joint states at t (n,) [s] as CDR."""
        half = 0.5 * TRACK * self.drive.pose(t)[:, 2:]
        rolled = self.drive.way(t)[:, None] + np.array([-1.0, 1.0]) * half
        steps = np.diff(rolled, axis=0, prepend=self.last[None])
        slip = np.sqrt(SLIP * np.abs(steps)) * self.rng.standard_normal(steps.shape)
        position = self.end + np.cumsum((steps + slip) / RADIUS, axis=0)
        velocity = np.diff(position, axis=0, prepend=self.end[None])
        self.last, self.end = rolled[-1], position[-1]
        return self.template.fill(t, {"position": position, "velocity": velocity})


class Compass:
    """A magnetometer on the level: the map's field seen from the robot."""

    def __init__(self, drive: Loop, rng: np.random.Generator) -> None:
        self.drive, self.rng = drive, rng
        axes = {f"magnetic_field.{axis}": ("f8", 0) for axis in "xy"}
        self.template = Template("sensor_msgs/msg/MagneticField", {"magnetic_field.z": -4e-5}, axes)

    def messages(self, t: Array) -> list[bytes]:
        """Return the magnetic fields at t (n,) [s] as CDR."""
        angle = FIELD_DIRECTION - self.drive.pose(t)[:, 2]
        noise = FIELD * SIGMA_COMPASS * self.rng.standard_normal((2, len(t)))
        x, y = FIELD * np.cos(angle) + noise[0], FIELD * np.sin(angle) + noise[1]
        return self.template.fill(t, {"magnetic_field.x": x, "magnetic_field.y": y})


class Laser:
    """A laser range finder on the base's origin, looking ahead over 180 degrees."""

    def __init__(self, drive: Loop, rng: np.random.Generator, segments: Array, beams: int, sweep: float) -> None:
        self.drive, self.rng, self.walls = drive, rng, segments
        self.angles = np.linspace(-math.pi / 2, math.pi / 2, beams)
        self.times = np.arange(beams) * sweep / beams
        fixed = {
            "angle_min": -math.pi / 2,
            "angle_max": math.pi / 2,
            "angle_increment": math.pi / (beams - 1),
            "time_increment": sweep / beams,
            "range_min": 0.04,
            "range_max": 80.0,
        }
        self.template = Template("sensor_msgs/msg/LaserScan", fixed, {"ranges": ("f4", beams)})

    def messages(self, t: Array) -> list[bytes]:
        """Return the scans that begin at t (n,) [s] as CDR."""
        pose = self.drive.pose(t if self.times[-1] == 0 else t[:, None] + self.times)
        size = (len(t), len(self.angles))
        d = ranges(self.walls, pose, self.angles + SIGMA_ANGLE * self.rng.standard_normal(size))
        return self.template.fill(t, {"ranges": d + SIGMA_RANGE * self.rng.standard_normal(size)})


class Camera:
    """Pictures of the landmark, as JPEG."""

    def __init__(self, drive: Loop, rng: np.random.Generator, size: tuple[int, int]) -> None:
        self.drive, self.view = drive, OmniView(size, rng)
        self.empty = cdr("sensor_msgs/msg/CompressedImage", {"format": "jpeg", "data": b""})

    def messages(self, t: Array) -> list[bytes]:
        """Return the pictures at t (n,) [s] as CDR."""
        return with_data(self.empty, t, (self.view.jpeg(pose) for pose in self.drive.pose(t)))


class RawPictures:
    """Pictures as a driver sends them, uncompressed: nothing reads them, and they are nearly all of a log."""

    def __init__(self, rng: np.random.Generator, size: tuple[int, int]) -> None:
        width, height = size
        self.pixels = rng.integers(0, 256, 3 * width * height, np.uint8).tobytes()
        shape = {"height": height, "width": width, "encoding": "rgb8", "is_bigendian": 0, "step": 3 * width}
        self.empty = cdr("sensor_msgs/msg/Image", {**shape, "data": b""})

    def messages(self, t: Array) -> list[bytes]:
        """Return a picture at each t (n,) [s] as CDR."""
        return with_data(self.empty, t, [self.pixels] * len(t))


def with_data(empty: bytes, t: Array, pictures: Iterable[bytes]) -> list[bytes]:
    """Return messages whose last field is data, stamped t (n,) [s]; `empty` is one without data."""
    head = empty[:4], empty[12:-4]  # before and behind the stamp, less the length of the data
    both = zip(stamps(t), pictures, strict=True)
    return [head[0] + at.tobytes() + head[1] + struct.pack("<I", len(data)) + data for at, data in both]


class Truth:
    """The exact pose."""

    def __init__(self, drive: Loop) -> None:
        self.drive = drive
        paths = ("pose.position.x", "pose.position.y", "pose.orientation.z", "pose.orientation.w")
        self.template = Template("geometry_msgs/msg/PoseStamped", {}, dict.fromkeys(paths, ("f8", 0)))

    def messages(self, t: Array) -> list[bytes]:
        """Return the poses at t (n,) [s] as CDR."""
        x, y, theta = self.drive.pose(t).T
        values = (x, y, np.sin(theta / 2), np.cos(theta / 2))
        return self.template.fill(t, dict(zip(self.template.at, values, strict=True)))
