"""Small worlds for tests: a robot on an arc among straight walls, its readings as in-memory streams."""

import math
from collections.abc import Iterator
from typing import Any, cast

import msgspec
import numpy as np
from msgspec import field
from numpy.typing import NDArray
from pose_streams import pose_stream
from rooms import scan

from locfuse.fusion.data import Array, ArrayStream, Drive, Ragged, Stream
from locfuse.fusion.fuse import Filter, due_readings, steps_of
from locfuse.fusion.measure import measure
from locfuse.fusion.robot import Robot, StartSettings, WheelSettings
from locfuse.fusion.sensors.registry import REGISTRY

ROOM = ((0, 0, 8, 0), (8, 0, 8, 6), (8, 6, 0, 6), (0, 6, 0, 0))
PLATES = ((3, 0, 3, 1), (5, 6, 5, 4.8), (8, 3, 7, 3), (0, 4, 0.8, 4))
EPOCH = 1_700_000_000_000_000_000


class World(msgspec.Struct):
    """A drive with constant wheel speeds from `start`, 50 Hz wheels, 10 Hz scans, 20 Hz compass, 25 Hz truth."""

    seconds: float = 20.0
    speed: float = 0.3  # m/s
    turning: float = 0.12  # rad/s
    start: tuple[float, float, float] = (1.5, 1.5, 0.0)
    walls: tuple[tuple[float, ...], ...] = (*ROOM, *PLATES)
    beams: int = 181
    mount: tuple[float, float, float] = (0.2, 0.05, 0.1)
    sigma_range: float = 0.03
    compass_offset: float = 0.7
    compass_sigma: float = math.radians(1.0)
    wheel_noise: float = 4e-4
    track: float = 0.6
    radius: float = 0.05
    truth_shift: float = 0.0  # s by which the truth's stamps are moved along the same arc
    seed: int = 0
    wheels: dict[str, Any] = field(default_factory=dict)
    settings: dict[str, dict[str, Any]] = field(default_factory=dict)

    def pose(self, t: Array, x0: tuple[float, float, float] | None = None) -> Array:
        """The arc in closed form, (n, 3)."""
        x, y, a = x0 or self.start
        theta = a + self.turning * t
        if abs(self.turning) < 1e-12:
            return np.stack((x + self.speed * t * math.cos(a), y + self.speed * t * math.sin(a), theta), axis=-1)
        r = self.speed / self.turning
        return np.stack(
            (x + r * (np.sin(theta) - math.sin(a)), y - r * (np.cos(theta) - math.cos(a)), theta), axis=-1
        )

    def streams(self) -> dict[str, ArrayStream]:
        rng = np.random.default_rng(self.seed)
        return {
            "wheels": self._wheels(rng),
            "compass": self._compass(rng),
            "lrf": self._scans(rng),
            "truth": self._truth(),
        }

    def _wheels(self, rng: np.random.Generator) -> ArrayStream:
        t = np.arange(0.0, self.seconds + 1e-9, 0.02)
        rolled = []
        for side in (-1, 1):
            rate = self.speed + side * self.turning * self.track / 2
            steps = np.full(len(t) - 1, rate * 0.02)
            rolled.append(
                np.append(
                    0.0, np.cumsum(steps + np.sqrt(self.wheel_noise * np.abs(steps)) * rng.normal(size=len(steps)))
                )
            )
        return joints(t, np.stack(rolled, axis=-1) / self.radius)

    def _compass(self, rng: np.random.Generator) -> ArrayStream:
        t = np.arange(0.013, self.seconds, 0.05)
        heading = self.pose(t)[:, 2] + self.compass_offset + self.compass_sigma * rng.normal(size=len(t))
        return stream(
            "/compass",
            "sensor_msgs/msg/MagneticField",
            t,
            {"magnetic_field.x": 2e-5 * np.cos(heading), "magnetic_field.y": -2e-5 * np.sin(heading)},
        )

    def _scans(self, rng: np.random.Generator) -> ArrayStream:
        t = np.arange(0.04, self.seconds, 0.1)
        angles = np.linspace(-math.pi / 2, math.pi / 2, self.beams)
        walls = np.array(self.walls, float)
        lx, ly, yaw = self.mount
        ranges = []
        for x, y, a in self.pose(t):
            c, s = math.cos(a), math.sin(a)
            eye = np.array([x + c * lx - s * ly, y + s * lx + c * ly, a + yaw])
            ranges.append(scan(walls, eye, angles) + self.sigma_range * rng.normal(size=self.beams))
        n = len(t)
        return stream(
            "/scan",
            "sensor_msgs/msg/LaserScan",
            t,
            {
                "angle_min": np.full(n, angles[0]),
                "angle_increment": np.full(n, angles[1] - angles[0]),
                "time_increment": np.zeros(n),
                "range_min": np.full(n, 0.04),
                "range_max": np.full(n, 80.0),
                "ranges": Ragged(np.concatenate(ranges), np.arange(n + 1) * self.beams),
            },
        )

    def _truth(self) -> ArrayStream:
        t = np.arange(0.0, self.seconds - 0.05, 0.04) + self.truth_shift
        return pose_stream("/ground_truth", stamps(t), self.pose(t))

    def robot(self) -> Robot:
        lx, ly, yaw = self.mount
        given: dict[str, dict[str, Any]] = {
            "lrf": {
                "x": lx,
                "y": ly,
                "yaw_deg": math.degrees(yaw),
                "sigma_range": max(self.sigma_range, 1e-3),
                "sigma_angle_deg": 0.05,
                **dict.fromkeys(("sigma_x", "sigma_y", "sigma_yaw_deg"), 0.0),  # it sits exactly there
            },
            "compass": {"sigma_deg": max(math.degrees(self.compass_sigma), 0.1)},
        }
        sensors = {
            name: sensor.Settings(**{**given.get(name, {}), **self.settings.get(name, {})})
            for name, sensor in REGISTRY.items()
        }
        x, y, a = self.start
        wheels = WheelSettings(
            **{"radius": self.radius, "track": self.track, "noise": max(self.wheel_noise, 1e-7), **self.wheels}
        )
        return Robot(wheels=wheels, start=StartSettings(x=x, y=y, theta_deg=math.degrees(a)), sensors=sensors)

    def measured(self) -> tuple[Drive, Robot]:
        """The drive as it is measured, and its robot."""
        robot = self.robot()
        return measure(cast("dict[str, Stream]", self.streams()), robot), robot


def instants(run: Filter, drive: Drive, *sensors: str) -> Iterator[int]:
    """Let a filter run through a drive; yield every instant once it is done."""
    steps = steps_of(drive)
    for k, due in enumerate(due_readings(drive, sensors)):
        run.advance(k, steps, due, drive.measurements)
        yield k


def stamps(t: Array) -> NDArray[np.int64]:
    return EPOCH + np.rint(t * 1e9).astype(np.int64)


def stream(topic: str, msgtype: str, t: Array, data: dict[str, Any]) -> ArrayStream:
    return ArrayStream(topic, msgtype, stamps(t), data)


def joints(t: Array, angle: Array) -> ArrayStream:
    """Angles (n, 2) of a left and a right wheel."""
    data = {
        "name": [("left_wheel_joint", "right_wheel_joint")] * len(t),
        "position": Ragged(angle.ravel(), np.arange(len(t) + 1) * 2),
    }
    return stream("/joint_states", "sensor_msgs/msg/JointState", t, data)
