"""Estimates as ROS 2 messages in one MCAP, for Foxglove, rosbag2 and whatever else reads topics.

Per configuration /locfuse/<name>/odometry (a row of the .tum each, with covariance), /locfuse/<name>/path, and its
frame on /tf; the truth; optionally every message of the log itself, with its bytes and times as they were.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np

from locfuse.formats.container.mcap_write import LATCHED, Block, ColumnWriter
from locfuse.formats.logs.log import TF_TYPES, Log
from locfuse.fusion.data import Array, Drive, Estimates, Ints, LocfuseError, Truth

from .recovered_log import copy_messages
from .ros_messages import PATH, Series, odometry, path, points, poses, transforms
from .template import MESSAGES
from .trajectory import stamps, with_truth_rows

BASE = "base_link"
CHUNK_BYTES = 1 << 20  # bytes before compression
FIRST_STAMP, LAST_STAMP = -(2**31), 2**31 - 1  # s: a ROS stamp counts its seconds in 32 bits


class Export(msgspec.Struct, frozen=True):
    """What goes into one file."""

    drive: Drive
    estimates: Sequence[Estimates]
    twist: Array  # (n, 3) body twist by the wheels in the interval that ends at each instant [m/s, m/s, rad/s]
    robot_toml: bytes
    clock_ns: int = 0  # recording clock minus stamps, where the log keeps two clocks
    log: Log | None = None  # its messages are copied

    def write(self, file: Path) -> None:
        """Write the file. Raises LocfuseError where its times do not fit a ROS stamp."""
        self._check("the drive", self.drive.t)
        if self.drive.truth is not None:
            self._check("the truth", self.drive.truth.t)
        with file.open("wb") as opened:
            writer = ColumnWriter(opened)
            writer.attach(
                "robot.toml", self.robot_toml, "application/toml", max(self.drive.epoch_ns + self.clock_ns, 0)
            )
            topics = _Topics(writer, self.clock_ns)
            for e in self.estimates:
                self._estimates(topics, e)
            if self.drive.truth is not None:
                _truth(topics, self.drive.truth, self.drive.epoch_ns)
            topics.write()
            if self.log is not None:
                copy_messages(writer, self.log)
            writer.finish()

    def _check(self, what: str, t: Array) -> None:
        """Raise LocfuseError where times (n,) do not fit a ROS stamp."""
        for does, at in (("begins", t[:1]), ("ends", t[-1:])):
            for seconds in (self.drive.epoch_ns + (at * 1e9).astype(np.int64)) // 10**9:
                if not FIRST_STAMP <= seconds <= LAST_STAMP:
                    raise LocfuseError(
                        f"--export: {what} {does} {seconds} s after 1970, and a ROS stamp ends in January 2038; "
                        "leave mcap and log out of --export, or try --order stamp"
                    )

    def _estimates(self, topics: _Topics, e: Estimates) -> None:
        name = ros_name(e.name)
        t, pose, triangles = with_truth_rows(self.drive, e)
        t_ns = np.array(stamps(self.drive.epoch_ns, t), np.int64)
        twist = self.twist[np.minimum(np.searchsorted(e.t, t), len(e.t) - 1)]
        topics.add(f"/locfuse/{name}/odometry", odometry(t_ns, pose, triangles, twist, f"{name}/{BASE}"))
        topics.once(f"/locfuse/{name}/path", t_ns, pose)
        topics.add("/tf", transforms(t_ns, pose, f"{name}/{BASE}"))
        if e is self.estimates[-1] and self._base_is_free():
            topics.add("/tf", transforms(t_ns, pose, BASE))

    def _base_is_free(self) -> bool:
        """Whether the last configuration may say where the robot itself is: a frame has one parent."""
        topics = self.log.topics if self.log is not None else {}
        return not any(t.msgtype in TF_TYPES and not name.endswith("tf_static") for name, t in topics.items())


def _truth(topics: _Topics, truth: Truth, epoch_ns: int) -> None:
    t_ns = np.array(stamps(epoch_ns, truth.t), np.int64)
    if truth.theta is None:
        topics.add("/locfuse/truth/point", points(t_ns, truth.xy))
        return
    pose = np.column_stack((truth.xy, truth.theta))
    topics.add("/locfuse/truth/pose", poses(t_ns, pose))
    topics.once("/locfuse/truth/path", t_ns, pose)


class _Part(NamedTuple):
    channel: int
    series: Series


class _Topics:
    """Channels by topic, and the series of messages that go there."""

    def __init__(self, writer: ColumnWriter, clock_ns: int) -> None:
        self._writer, self._clock_ns = writer, clock_ns
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        self._parts: list[_Part] = []

    def add(self, topic: str, series: Series) -> None:
        """Take a series of messages for a topic."""
        self._parts.append(_Part(self._channel(topic, series.msgtype), series))

    def once(self, topic: str, t_ns: Ints, pose: Array) -> None:
        """Write a path at the beginning, latched."""
        block = Block(
            self._channel(topic, PATH, LATCHED), self._recorded(t_ns[:1]), np.ones(1, np.int64), path(t_ns, pose)
        )
        self._writer.chunk([block])

    def _recorded(self, t_ns: Ints) -> Ints:
        """Return recording times (n,) of stamps (n,): an MCAP has none before the recording clock's zero."""
        return np.maximum(t_ns + self._clock_ns, 0)

    def _channel(self, topic: str, msgtype: str, profile: str = "") -> int:
        if msgtype not in self._schemas:
            text = MESSAGES.schema(msgtype).encode()
            self._schemas[msgtype] = self._writer.schema(msgtype, "ros2msg", text)
        if topic not in self._channels:
            metadata = {"offered_qos_profiles": profile}
            self._channels[topic] = self._writer.channel(topic, "cdr", self._schemas[msgtype], metadata)
        return self._channels[topic]

    def write(self) -> None:
        """Write all series in chunks that hold the same stretch of time of each."""
        t = np.sort(np.concatenate([part.series.t_ns for part in self._parts]))
        size = sum(part.series.messages(slice(1)).size * len(part.series.t_ns) for part in self._parts)
        number = -(-size // CHUNK_BYTES)
        cuts = t[np.linspace(0, len(t) - 1, number + 1).astype(np.int64)[1:-1]]
        ends = [[0, *np.searchsorted(s.t_ns, cuts).tolist(), len(s.t_ns)] for _, s in self._parts]
        for i in range(number):
            rows = [slice(e[i], e[i + 1]) for e in ends]
            self._writer.chunk([self._block(part, r) for part, r in zip(self._parts, rows, strict=True)])

    def _block(self, part: _Part, rows: slice) -> Block:
        t_ns = part.series.t_ns[rows]
        sequence = np.arange(rows.start + 1, rows.stop + 1)
        return Block(part.channel, self._recorded(t_ns), sequence, part.series.messages(rows))


def ros_name(configuration: str) -> str:
    """Return a configuration's name with nothing but what ROS allows in a topic: compass+lrf -> compass_lrf."""
    return re.sub(r"[^A-Za-z0-9_]+", "_", configuration)
