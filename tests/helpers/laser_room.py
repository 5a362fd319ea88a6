"""Scans of a laser that drives through a room of three boxes, as a bag holds them."""

from collections.abc import Sequence

import numpy as np
from bags import Said, cdr, header
from ring_drive import box, scan
from wheel_bags import on_circle, stamps

from locfuse.fusion.data import Array, ArrayStream, Column, Ragged

SCAN = "sensor_msgs/msg/LaserScan"
BEAMS, PERIOD = 120, 0.2  # of ring_drive's laser; s
ROOM = np.array(box(-4.0, -3.0, 4.5, 3.5) + box(1.0, 2.6, 2.2, 3.5) + box(-4.0, -3.0, -3.2, -1.0))


def circle(duration: float = 12.0, radius: float = 1.2, rate: float = 0.35) -> tuple[Array, Array]:
    """Stamps (n,) and true poses (n, 3) along a circle, in closed form."""
    t = np.arange(0.0, duration, PERIOD)
    return t, on_circle(rate * t, radius)


def ranges_of(pose: Array, segments: Array, rng: np.random.Generator) -> Array:
    """The ranges (BEAMS,) from a pose, inf without a return: ring_drive's ray caster in the form of a message."""
    points = scan(pose, segments, rng)
    beam = np.round((np.arctan2(points[:, 1], points[:, 0]) + np.pi) * BEAMS / (2.0 * np.pi)).astype(int) % BEAMS
    out = np.full(BEAMS, np.inf)
    out[beam] = np.hypot(*points.T)
    return out


def scans_of(t: Array, poses: Array, segments: Array = ROOM, frame: str = "laser") -> list[Said]:
    """What the laser sees from poses (n, 3) at times t (n,)."""
    rng = np.random.default_rng(3)
    said = []
    for ns, pose in zip(stamps(t), poses, strict=True):
        message = cdr(
            SCAN,
            header=header(ns, frame),
            angle_min=-np.pi,
            angle_max=np.pi,
            angle_increment=2.0 * np.pi / BEAMS,
            range_min=0.05,
            range_max=12.0,
            ranges=ranges_of(pose, segments, rng).astype(np.float32),
        )
        said.append(Said("/scan", SCAN, message, ns))
    return said


# --- a stream of laser scans, each of one turn, as a log holds them


def scan_stream(t_ns: Sequence[int], ranges: Array) -> ArrayStream:
    """Return scans of `ranges` (k, beams) [m] that begin behind the laser and turn to the left."""
    n, beams = ranges.shape
    data: dict[str, Column] = {
        "angle_min": np.full(n, -np.pi),
        "angle_increment": np.full(n, 2.0 * np.pi / beams),
        "time_increment": np.zeros(n),
        "range_min": np.full(n, 0.05),
        "range_max": np.full(n, 12.0),
        "ranges": Ragged(ranges.ravel(), np.arange(n + 1) * beams),
    }
    return ArrayStream("/scan", SCAN, np.array(t_ns), data)
