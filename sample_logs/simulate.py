"""The simulated drive: the robot follows a path on its own pose estimate while its sensors are recorded."""

from __future__ import annotations

import heapq
import math
import zlib
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..fusion.data import Array, LocfuseError
from .messages import Emit, Estimator, Pose, RawMessage
from .path import Command, PathFollower
from .robot import Robot
from .scenario import Scenario
from .sensors import JOINTS, Sensor, build
from .world import clearance, plates, walls

EPOCH_NS = 1_700_000_000_000_000_000  # when every simulated drive begins: logs must not depend on today


@dataclass(frozen=True)
class Outcome:
    """What only the simulator knows of a drive."""

    duration: float  # s
    truth_t: Array  # (n,) s since EPOCH_NS
    truth: Array  # (n, 3) pose at every physics step
    ticks_t: Array  # (k,) s, instants of the motor controllers
    counts: Array  # (k, 2) encoder counters, left and right
    set_points: Array  # (k, 2) rad/s asked of the wheels in the tick that ended there
    missed: int  # encoder transitions whose direction was lost


def random_stream(seed: int, name: str) -> np.random.Generator:
    """Return the generator of one source of chance; no other source can shift its numbers."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(zlib.crc32(name.encode()),)))


class Recorder:
    """Lets the sensors read as time passes and hands their messages out in the order they arrive."""

    def __init__(self, sensors: list[Sensor], seed: int) -> None:
        self.sensors = sensors
        self.read = [0] * len(sensors)  # readings taken
        self.jitter = [random_stream(seed, f"arrival of {s.topic}") for s in sensors]
        self.waiting: list[tuple[int, int, RawMessage]] = []
        self.issued = 0

    def until(self, now: float) -> list[RawMessage]:
        """Return the messages that have arrived by `now` [s] and were not handed out before."""
        for i, sensor in enumerate(self.sensors):
            while (t := sensor.phase + self.read[i] * sensor.period) + sensor.duration <= now + 1e-9:
                self._receive(i, t)
        arrived = []
        limit = EPOCH_NS + round(now * 1e9)
        while self.waiting and self.waiting[0][0] <= limit:
            arrived.append(heapq.heappop(self.waiting)[2])
        return arrived

    def _receive(self, i: int, t: float) -> None:
        sensor = self.sensors[i]
        self.read[i] += 1
        delay = sensor.duration + sensor.latency * (1 + 0.5 * self.jitter[i].random())
        stamp, log = (EPOCH_NS + round(s * 1e9) for s in (t, t + delay))
        message = RawMessage(sensor.topic, sensor.msgtype, log, stamp, sensor.frame_id, sensor.read(t))
        heapq.heappush(self.waiting, (log, self.issued, message))
        self.issued += 1


def simulate(scenario: Scenario, seed: int, estimator: Estimator | None, emit: Emit) -> Outcome:
    """Drive the scenario once and `emit` every raw message in the order of its arrival.

    Args:
        scenario: what to drive, where, and with which sensors.
        seed: of all chance in it; each source draws its own stream.
        estimator: the robot's localisation; None lets it steer on the truth.
        emit: receives the messages.

    Raises:
        LocfuseError: the path does not fit the room, or the robot drives into a wall.
    """
    control = scenario.control
    follower = PathFollower(scenario.path, control.speed)
    robot = Robot(
        scenario.wheels,
        scenario.motor,
        follower.start,
        (random_stream(seed, "left motor"), random_stream(seed, "right motor")),
        random_stream(seed, "ground"),
    )
    rngs = {name: random_stream(seed, name) for name in ("compass", "lrf")}
    recorder = Recorder(build(scenario, robot, rngs), seed)
    steer = Steering(scenario, follower)
    emit(static_transforms(scenario))
    ticks = max(1, round(control.period * scenario.wheels.rate))
    while not steer.finished:
        now = robot.trail.end
        arrived = recorder.until(now)
        for message in arrived:
            emit(message)
        pose = estimator(arrived) if estimator else _tuple(robot.trail.knots()[-1])
        targets = steer.wheel_speeds(now, pose)
        for _ in range(ticks):
            robot.drive(targets)
        _check(scenario, robot, ticks)
    for message in recorder.until(robot.trail.end):
        emit(message)
    return _outcome(robot)


class Steering:
    """Waits, follows the path, waits again."""

    def __init__(self, scenario: Scenario, follower: PathFollower) -> None:
        self.control = scenario.control
        self.radius, self.track = scenario.wheels.radius, scenario.wheels.track
        self.follower = follower
        self.arrived_at: float | None = None
        self.finished = False

    def wheel_speeds(self, now: float, pose: Pose) -> tuple[float, float]:
        """Return the set points of the wheels [rad/s] for the next control period."""
        command = self._command(now, pose)
        half = command.omega * self.track / 2
        return (command.v - half) / self.radius, (command.v + half) / self.radius

    def _command(self, now: float, pose: Pose) -> Command:
        if now >= self.control.time_limit:
            raise LocfuseError(
                f"the path is not done after control.time_limit = {self.control.time_limit} s: "
                "raise it, or control.speed"
            )
        if now < self.control.wait - 1e-9:
            return Command(0, 0)
        if self.arrived_at is None:
            command = self.follower.command(pose)
            if command is not None:
                return command
            self.arrived_at = now
        self.finished = now >= self.arrived_at + self.control.wait - 1e-9
        return Command(0, 0)


def _tuple(pose: Array) -> Pose:
    x, y, theta = pose.tolist()
    return x, y, theta


def _check(scenario: Scenario, robot: Robot, ticks: int) -> None:
    obstacles = np.concatenate((walls(scenario.room), plates(scenario.room)))
    x, y, _ = robot.trail.knots()[-1]
    gap = clearance(obstacles, np.array([[x, y]]))[0]
    if gap < scenario.control.clearance:
        raise LocfuseError(
            f"the robot hits a wall after {robot.trail.end:.1f} s at ({x:.2f}, {y:.2f}): it steers on "
            f"control.estimator = {scenario.control.estimator!r}, which is {gap:.2f} m from it; "
            "try another --seed, or --set control.estimator=truth"
        )


def _outcome(robot: Robot) -> Outcome:
    truth = robot.trail.knots()
    return Outcome(
        duration=robot.trail.end,
        truth_t=np.linspace(0, robot.trail.end, len(truth)),
        truth=truth,
        ticks_t=np.array([tick.t for tick in robot.ticks]),
        counts=np.array([tick.counts for tick in robot.ticks]),
        set_points=np.array([tick.set_point for tick in robot.ticks]),
        missed=sum(w.missed for w in robot.wheels),
    )


def static_transforms(scenario: Scenario) -> RawMessage:
    """Return the /tf_static message: where the sensors sit on the robot."""
    lrf = scenario.lrf
    mounts = [("compass", 0.0, 0.0, 0.6, 0.0), ("laser", lrf.x, lrf.y, lrf.z, math.radians(lrf.yaw_deg))]
    stamp = {"sec": EPOCH_NS // 10**9, "nanosec": EPOCH_NS % 10**9}
    transforms = [
        {
            "header": {"stamp": stamp, "frame_id": "base_link"},
            "child_frame_id": child,
            "transform": {
                "translation": {"x": x, "y": y, "z": z},
                "rotation": {"x": 0.0, "y": 0.0, "z": math.sin(yaw / 2), "w": math.cos(yaw / 2)},
            },
        }
        for child, x, y, z, yaw in mounts
    ]
    fields = {"transforms": transforms}
    return RawMessage("/tf_static", "tf2_msgs/msg/TFMessage", EPOCH_NS, EPOCH_NS, "", fields)


def robot_tables(scenario: Scenario) -> dict[str, dict[str, Any]]:
    """Return the robot.toml that a user of this robot would write: nominal geometry, data-sheet accuracies."""
    x, y, theta = PathFollower(scenario.path, scenario.control.speed).start
    w, lrf = scenario.wheels, scenario.lrf
    tables: dict[str, dict[str, Any]] = {
        "wheels": {
            "topic": "/joint_states",
            "left": JOINTS[0],
            "right": JOINTS[1],
            "radius": w.radius,
            "track": w.track,
        },
        "start": {"x": x, "y": y, "theta_deg": math.degrees(theta)},
    }
    if scenario.compass.enabled:
        tables["compass"] = {"topic": "/compass", "sigma_deg": scenario.compass.sigma_deg}
    if lrf.enabled:
        tables["lrf"] = {
            "topic": "/scan",
            "x": lrf.x,
            "y": lrf.y,
            "yaw_deg": lrf.yaw_deg,
            "sigma_range": lrf.sigma_range,
            "sigma_angle_deg": lrf.sigma_angle_deg,
        }
    tables["truth"] = {"topic": "/ground_truth/pose", "x": 0.0, "y": 0.0}
    return tables
