"""Write a large log for timing: python -m benchmarks.make_log OUT.mcap --minutes 60.

A robot drives laps along a rounded rectangle, counter-clockwise at constant speed, in a room with plates on its
walls. Encoders, a compass, a laser and, on request, a camera are recorded with consistent noise: closed forms, and
messages that are written as NumPy rows, many at a time. What is drawn depends on --seed alone.
"""

from __future__ import annotations

import math
import struct
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import click
import cv2
import numpy as np
import tomli_w
from mcap.writer import CompressionType, Writer
from numpy.typing import NDArray

from locfuse.formats.container.mcap_write import StandardMessages

Array = NDArray[np.float64]
Source = Callable[[Array], list[bytes]]  # times (n,) s -> messages as CDR

WIDTH, HEIGHT = 10.0, 8.0  # m, the room
PLATE_M = 0.8  # how far a plate stands out from its wall
MARGIN, CORNER = 2.0, 0.8  # m between the way and the walls; radius of the way's corners
SPEED = 0.4  # m/s
LANDMARK = (5.0, 4.0)  # m: in the middle, the laser does not see it
TRACK, RADIUS, SLIP = 0.6, 0.05, 4e-4  # m, m, m: variance per metre that a wheel rolls
SIGMA_RANGE, SIGMA_ANGLE, SIGMA_COMPASS = 0.03, math.radians(0.08), math.radians(1.0)
FIELD, FIELD_DIRECTION = 3e-5, 0.4  # T, rad in the map
EPOCH_NS = 1_700_000_000_000_000_000
LATENCY_NS = 2_000_000  # from a reading's stamp to the recorder
BLOCK_S = 30.0  # of the log in memory at a time

# --- the drive and the room


def pose_of(t: Array) -> Array:
    """Return the pose (..., 3) at t (...,) [s]; the heading counts whole turns."""
    arc, sides = CORNER * math.pi / 2, (WIDTH - 2 * (MARGIN + CORNER), HEIGHT - 2 * (MARGIN + CORNER))
    length = np.array([sides[0], arc, sides[1], arc] * 2)  # m of the eight pieces of a lap
    curvature = np.array([0.0, 1.0 / CORNER] * 4)  # 1/m
    corners, ends = [np.array([MARGIN + CORNER, MARGIN, 0.0])], np.cumsum(length)
    for piece in range(7):
        corners.append(_along(corners[-1], length[piece], curvature[piece]))
    lap, s = np.divmod(SPEED * t, ends[-1])
    at = np.minimum(np.searchsorted(ends, s, side="right"), 7)
    pose = _along(np.array(corners)[at], s - (ends - length)[at], curvature[at])
    pose[..., 2] += 2 * np.pi * lap
    return pose


def _along(pose: Array, way: Array, curvature: Array) -> Array:
    """Return the poses (..., 3) after arcs of some way [m] and curvature [1/m]."""
    turn = curvature * way
    chord, heading = way * np.sinc(turn / (2 * np.pi)), pose[..., 2] + turn / 2
    x, y = pose[..., 0] + chord * np.cos(heading), pose[..., 1] + chord * np.sin(heading)
    return np.stack((x, y, pose[..., 2] + turn), axis=-1)


def walls(count: int) -> Array:
    """Return the room's four walls and count - 4 plates on them, (count, 4) x0, y0, x1, y1 [m]."""
    corners = np.array([(0, 0), (WIDTH, 0), (WIDTH, HEIGHT), (0, HEIGHT), (0, 0)], float)
    room = np.concatenate((corners[:-1], corners[1:]), axis=1)
    plates = []
    for s in (np.arange(count - 4) + 0.6) / max(count - 4, 1) * 2 * (WIDTH + HEIGHT):
        side = int(np.searchsorted(np.cumsum([WIDTH, HEIGHT, WIDTH, HEIGHT]), s))
        along = (corners[side + 1] - corners[side]) / np.linalg.norm(corners[side + 1] - corners[side])
        foot = corners[side] + along * (s - (0.0, WIDTH, WIDTH + HEIGHT, 2 * WIDTH + HEIGHT)[side])
        plates.append([*foot, *(foot + PLATE_M * np.array([-along[1], along[0]]))])
    return np.concatenate((room, np.array(plates).reshape(-1, 4)))


def ranges(segments: Array, poses: Array, angles: Array) -> Array:
    """Return how far the beams go, (n, b) m: from poses (n, 3) or (n, b, 3) along angles (b,) or (n, b)."""
    pose = poses if poses.ndim == 3 else poses[:, None]
    x, y = pose[..., 0], pose[..., 1]
    c, s = np.cos(pose[..., 2] + angles), np.sin(pose[..., 2] + angles)
    nearest = np.full(c.shape, np.inf)
    for x0, y0, x1, y1 in segments:
        dx, dy = x1 - x0, y1 - y0
        with np.errstate(divide="ignore", invalid="ignore"):
            inverse = 1.0 / (c * dy - s * dx)
            distance = ((x0 - x) * dy - (y0 - y) * dx) * inverse
            share = ((x0 - x) * s - (y0 - y) * c) * inverse
        hit = (distance > 0) & (share >= 0) & (share <= 1) & (distance < nearest)
        nearest[hit] = distance[hit]
    return nearest


# --- messages


FRAMES = {
    "sensor_msgs/msg/JointState": "",
    "sensor_msgs/msg/MagneticField": "base_link",
    "sensor_msgs/msg/LaserScan": "laser",
    "sensor_msgs/msg/CompressedImage": "omni_camera",
    "sensor_msgs/msg/Image": "front_camera",
    "geometry_msgs/msg/PoseStamped": "map",
}


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


def nanoseconds(t: Array) -> NDArray[np.int64]:
    """Return times [s] of the drive as integer nanoseconds."""
    return EPOCH_NS + np.round(t * 1e9).astype(np.int64)


def stamps(t: Array) -> NDArray[np.uint8]:
    """Return times (n,) as the 8 bytes of a header's stamp, (n, 8)."""
    parts = np.stack(np.divmod(nanoseconds(t), 1_000_000_000), axis=1)
    return parts.astype("<u4").view(np.uint8)


class Template:
    """Messages of one type that differ in some numbers only: written as NumPy rows, not one by one."""

    def __init__(self, msgtype: str, fixed: Mapping[str, Any], varying: Mapping[str, tuple[str, int]]) -> None:
        """`varying` names the fields that differ: path -> (dtype, how many; 0 for a single number)."""
        rng = np.random.default_rng(0)
        marks = {path: rng.random(max(size, 1)).astype(dtype) for path, (dtype, size) in varying.items()}
        values = {path: mark if varying[path][1] else mark[0].item() for path, mark in marks.items()}
        self.cdr = cdr(msgtype, {**fixed, **values})
        self.at = {path: (self.cdr.index(mark.tobytes()), mark.dtype) for path, mark in marks.items()}

    def fill(self, t: Array, *values: Array) -> list[bytes]:
        """Return the messages stamped t (n,), with the values of what varies, (n,) or (n, k) each."""
        rows = np.tile(np.frombuffer(self.cdr, np.uint8), (len(t), 1))
        rows[:, 4:12] = stamps(t)
        for (start, dtype), value in zip(self.at.values(), values, strict=True):
            column = np.ascontiguousarray(value, dtype).reshape(len(t), -1).view(np.uint8)
            rows[:, start : start + column.shape[1]] = column
        return [row.tobytes() for row in rows]


def with_data(empty: bytes, t: Array, pictures: Iterable[bytes]) -> list[bytes]:
    """Return messages whose last field is data, stamped t (n,) [s]; `empty` is one without data."""
    head = empty[:4], empty[12:-4]  # before and behind the stamp, less the length of the data
    both = zip(stamps(t), pictures, strict=True)
    return [head[0] + at.tobytes() + head[1] + struct.pack("<I", len(data)) + data for at, data in both]


# --- sensors


def encoders(rng: np.random.Generator) -> Source:
    """Wheel angles of the exact drive plus the slip that the robot cannot see, a random walk."""
    names, numbers = ["wheel_left_joint", "wheel_right_joint"], {"position": ("f8", 2), "velocity": ("f8", 2)}
    template = Template("sensor_msgs/msg/JointState", {"name": names}, numbers)
    last, end = np.zeros(2), np.zeros(2)  # m rolled so far without slip, rad with it

    def messages(t: Array) -> list[bytes]:
        nonlocal last, end
        rolled = SPEED * t[:, None] + np.array([-1.0, 1.0]) * (0.5 * TRACK * pose_of(t)[:, 2:])
        steps = np.diff(rolled, axis=0, prepend=last[None])
        slip = np.sqrt(SLIP * np.abs(steps)) * rng.standard_normal(steps.shape)
        position = end + np.cumsum((steps + slip) / RADIUS, axis=0)
        velocity = np.diff(position, axis=0, prepend=end[None])
        last, end = rolled[-1], position[-1]
        return template.fill(t, position, velocity)

    return messages


def compass(rng: np.random.Generator) -> Source:
    """A magnetometer on the level: the map's field seen from the robot."""
    axes = {f"magnetic_field.{axis}": ("f8", 0) for axis in "xy"}
    template = Template("sensor_msgs/msg/MagneticField", {"magnetic_field.z": -4e-5}, axes)

    def messages(t: Array) -> list[bytes]:
        angle = FIELD_DIRECTION - pose_of(t)[:, 2]
        noise = FIELD * SIGMA_COMPASS * rng.standard_normal((2, len(t)))
        return template.fill(t, FIELD * np.cos(angle) + noise[0], FIELD * np.sin(angle) + noise[1])

    return messages


def laser(rng: np.random.Generator, segments: Array, beams: int, sweep: float) -> Source:
    """A laser range finder on the base's origin, looking ahead over 180 degrees."""
    angles, times = np.linspace(-math.pi / 2, math.pi / 2, beams), np.arange(beams) * sweep / beams
    fixed = {
        "angle_min": -math.pi / 2,
        "angle_max": math.pi / 2,
        "angle_increment": math.pi / (beams - 1),
        "time_increment": sweep / beams,
        "range_min": 0.04,
        "range_max": 80.0,
    }
    template = Template("sensor_msgs/msg/LaserScan", fixed, {"ranges": ("f4", beams)})

    def messages(t: Array) -> list[bytes]:
        pose, size = pose_of(t[:, None] + times if sweep else t), (len(t), beams)
        d = ranges(segments, pose, angles + SIGMA_ANGLE * rng.standard_normal(size))
        return template.fill(t, d + SIGMA_RANGE * rng.standard_normal(size))

    return messages


def optics(size: tuple[int, int]) -> dict[str, Any]:
    """Return where an omni-directional camera's mirror is in its picture of width x height [px]."""
    outer = 0.48 * min(size)
    return {"centre": [size[0] / 2, size[1] / 2], "inner": 0.25 * outer, "outer": outer}


def camera(rng: np.random.Generator, size: tuple[int, int]) -> Source:
    """JPEG pictures of a red post on a grey floor: a radial bar towards the landmark; straight down is ahead."""
    centre, outer = optics(size)["centre"], optics(size)["outer"]
    grey = np.clip(rng.normal(120.0, 20.0, size[::-1]), 0, 255).astype(np.uint8)
    background = cv2.cvtColor(cv2.GaussianBlur(grey, (0, 0), 0.8), cv2.COLOR_GRAY2BGR)
    empty = cdr("sensor_msgs/msg/CompressedImage", {"format": "jpeg", "data": b""})

    def jpeg(pose: Array) -> bytes:
        dx, dy = LANDMARK[0] - pose[0], LANDMARK[1] - pose[1]
        bearing, half = math.atan2(dy, dx) - pose[2], 0.06 / math.hypot(dx, dy)
        ends = [(0.4 * outer, half), (0.9 * outer, half), (0.9 * outer, -half), (0.4 * outer, -half)]
        bar = [(centre[0] + r * math.sin(bearing + a), centre[1] + r * math.cos(bearing + a)) for r, a in ends]
        picture, points = background.copy(), np.round(np.array(bar) * 16).astype(np.int32)
        cv2.fillPoly(picture, [points], (30, 30, 200), lineType=cv2.LINE_AA, shift=4)
        return bytes(cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, 85])[1])

    return lambda t: with_data(empty, t, map(jpeg, pose_of(t)))


def raw_pictures(rng: np.random.Generator, size: tuple[int, int]) -> Source:
    """Pictures as a driver sends them, uncompressed: nothing reads them, and they are nearly all of a log."""
    pixels = rng.integers(0, 256, 3 * size[0] * size[1], np.uint8).tobytes()
    shape = {"height": size[1], "width": size[0], "encoding": "rgb8", "is_bigendian": 0, "step": 3 * size[0]}
    empty = cdr("sensor_msgs/msg/Image", {**shape, "data": b""})
    return lambda t: with_data(empty, t, [pixels] * len(t))


def truth(t: Array) -> list[bytes]:
    """Return the exact poses."""
    paths = ("pose.position.x", "pose.position.y", "pose.orientation.z", "pose.orientation.w")
    x, y, theta = pose_of(t).T
    template = Template("geometry_msgs/msg/PoseStamped", {}, dict.fromkeys(paths, ("f8", 0)))
    return template.fill(t, x, y, np.sin(theta / 2), np.cos(theta / 2))


# --- the log


class Topic(NamedTuple):
    """One topic: when it is read and what its messages are."""

    name: str
    msgtype: str
    rate: float  # Hz
    messages: Source


def robot_toml(size: tuple[int, int] | None) -> bytes:
    """Return what a user of this robot would write; `size` is that of the camera's pictures, None without one."""
    x, y, theta = pose_of(np.zeros(1))[0].tolist()
    tables: dict[str, Any] = {
        "wheels": {"radius": RADIUS, "track": TRACK, "noise": SLIP},
        "start": {"x": x, "y": y, "theta_deg": math.degrees(theta)},
        "compass": {"sigma_deg": math.degrees(SIGMA_COMPASS)},
        "lrf": {"sigma_range": SIGMA_RANGE, "sigma_angle_deg": math.degrees(SIGMA_ANGLE)},
    }
    if size is not None:
        tables["camera"] = {"landmark": list(LANDMARK), **optics(size), "sigma_deg": 0.3}
    return tomli_w.dumps(tables).encode()


def batches(topics: list[Topic], seconds: float) -> Iterator[list[tuple[int, int, int, bytes]]]:
    """Yield (log time, stamp, topic number, CDR) of all topics, block by block, in the order of the log."""
    for begin in np.arange(0.0, seconds, BLOCK_S):
        rows: list[tuple[int, int, int, bytes]] = []
        for i, topic in enumerate(topics):
            span = np.ceil(np.array([begin, min(begin + BLOCK_S, seconds)]) * topic.rate - 1e-9)
            t = np.arange(*span) / topic.rate
            if len(t):
                when = nanoseconds(t)
                columns = (when + LATENCY_NS).tolist(), when.tolist(), [i] * len(t), topic.messages(t)
                rows += zip(*columns, strict=True)
        yield sorted(rows, key=lambda row: row[:3])


def size(_context: click.Context, _option: click.Parameter, text: str) -> tuple[int, int]:
    """Read 640x480."""
    width, _, height = text.partition("x")
    if not (width.isdigit() and height.isdigit()):
        raise click.BadParameter(f"{text!r} is not WIDTHxHEIGHT, such as 640x480")
    return int(width), int(height)


@click.command()
@click.argument("out", type=click.Path(dir_okay=False, path_type=Path))
@click.option("--minutes", default=1.0, show_default=True)
@click.option("--encoder-hz", default=50.0, show_default=True)
@click.option("--compass-hz", default=20.0, show_default=True)
@click.option("--scan-hz", default=10.0, show_default=True)
@click.option("--truth-hz", default=10.0, show_default=True)
@click.option("--image-hz", default=0.0, show_default=True)
@click.option("--image-size", "shape", default="640x480", callback=size, show_default=True)
@click.option("--raw-image-hz", default=0.0, show_default=True, help="Uncompressed pictures that nothing reads.")
@click.option("--beams", default=361, show_default=True)
@click.option("--sweep", default=0.0, show_default=True, help="Seconds from a scan's first beam to its last.")
@click.option("--walls", "count", default=12, type=click.IntRange(4, 64), show_default=True)
@click.option("--chunk-size", default=1 << 20, show_default=True, help="Bytes before compression.")
@click.option("--compression", default="zstd", type=click.Choice(["none", "lz4", "zstd"]), show_default=True)
@click.option("--seed", default=0, show_default=True)
def main(out: Path, minutes: float, shape: tuple[int, int], chunk_size: int, compression: str, **o: Any) -> None:
    """Write the log OUT. A rate of 0 leaves a topic out."""
    rng = [np.random.default_rng(s) for s in np.random.SeedSequence(o["seed"]).spawn(4)]
    scans = laser(rng[0], walls(o["count"]), o["beams"], o["sweep"])
    every = [
        Topic("/joint_states", "sensor_msgs/msg/JointState", o["encoder_hz"], encoders(rng[2])),
        Topic("/magnetic_field", "sensor_msgs/msg/MagneticField", o["compass_hz"], compass(rng[3])),
        Topic("/scan", "sensor_msgs/msg/LaserScan", o["scan_hz"], scans),
        Topic("/ground_truth", "geometry_msgs/msg/PoseStamped", o["truth_hz"], truth),
    ]
    pictures = {
        "image_hz": ("/omni/image/compressed", "sensor_msgs/msg/CompressedImage", camera),
        "raw_image_hz": ("/front/image_raw", "sensor_msgs/msg/Image", raw_pictures),
    }
    every += [Topic(n, kind, o[key], of(rng[1], shape)) for key, (n, kind, of) in pictures.items() if o[key]]
    topics = [topic for topic in every if topic.rate > 0]
    store, count, seconds = StandardMessages(), 0, 60.0 * minutes
    robot = robot_toml(shape if o["image_hz"] else None)
    with out.open("wb") as file:
        writer: Any = Writer(file, chunk_size=chunk_size, compression=CompressionType[compression.upper()])
        writer.start(profile="ros2", library="locfuse make_log")
        writer.add_attachment(EPOCH_NS, EPOCH_NS, "robot.toml", "application/toml", robot)
        channels = []
        for topic in topics:
            schema = writer.register_schema(topic.msgtype, "ros2msg", store.schema(topic.msgtype).encode())
            channels.append(writer.register_channel(topic.name, "cdr", schema))
        for rows in batches(topics, seconds):
            for sequence, (log_time, stamp, i, data) in enumerate(rows, count):
                writer.add_message(channels[i], log_time, data, stamp, sequence)
            count += len(rows)
        writer.finish()
    click.echo(f"{out}: {count} messages, {seconds:g} s, {out.stat().st_size / 1e6:.1f} MB", err=True)


if __name__ == "__main__":
    sys.exit(main())
