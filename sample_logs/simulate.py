"""Simulated drive: the robot follows a path by its own pose estimate while its sensors are recorded."""

from __future__ import annotations

import heapq
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np
import tomli_w

from locfuse.formats.container.mcap_write import LogWriter, log_writer
from locfuse.fusion.data import Array, ArrayStream, Column, Ints, LocfuseError, Ragged

from .building_scene import scene_of
from .faults import ClockOffset, Dates, Fault, MessageFault, label
from .paths import Follower, LegFollower, PathFollower, Steering, polygon, tour, waypoints
from .robot import SimulatedRobot
from .scenario import Legs, Polygon, Scenario, Waypoints, dumps
from .sensors import SimulatedSensor, robot_tables, sensors, stated_start, static_transforms
from .table import Emit, Estimator, Pose, RawMessage, Streams, streams
from .world import World, clearance

EPOCH_NS = 1_700_000_000_000_000_000  # start of every simulated drive, so that logs do not depend on the date
OBSTACLE_HEIGHT = 0.25  # m: height of the plan for collisions
MIN_WHEEL_RATE = 1.2  # rad/s (0.06 m/s): of a slower wheel, one count is more than 2.5 % of a window


@dataclass(frozen=True)
class Outcome:
    """Truth of a simulated drive: true poses, encoder counts and set points."""

    truth_t: Array  # (n,) s since EPOCH_NS
    truth: Array  # (n, 3) pose at every physics step
    ticks_t: Array  # (k,) s, times of the motor controllers
    counts: Array  # (k, 2) encoder counters, left and right
    set_points: Array  # (k, 2) rad/s, set points between the last tick and this one
    rad_per_count: float
    radius: float  # m, nominal
    missed: int  # encoder transitions with unknown direction

    @property
    def duration(self) -> float:
        """Duration of the drive [s]."""
        return float(self.truth_t[-1])

    @property
    def way(self) -> float:
        """Distance rolled [m], mean of both wheels."""
        return float(np.abs(np.diff(self.counts, axis=0)).sum() / 2 * self.rad_per_count * self.radius)


class Simulation:
    """Scenario with drawn path and start pose, ready to run."""

    def __init__(self, scenario: Scenario, seed: int) -> None:
        self.scenario = scenario
        self.scene = scene_of(scenario, seed)
        self.streams = streams(seed)
        self.start, self.follower = plan_way(scenario, self.scene, self.streams)
        self.obstacles = self.scene.obstacles(OBSTACLE_HEIGHT)

    @property
    def robot_tables(self) -> dict[str, dict[str, Any]]:
        """Tables of the robot.toml that a user of this robot would write."""
        stated = stated_start(self.scenario, self.start, self.streams)
        return robot_tables(self.scenario, stated)

    def run(self, estimator: Estimator | None, emit: Emit) -> Outcome:
        """Simulate the drive and call `emit` with each message in order of arrival.

        Args:
            estimator: the robot's localisation; None: the robot steers by its true pose.
            emit: receives the messages.

        Raises:
            LocfuseError: the robot collides, or exceeds the time limit.
        """
        robot = SimulatedRobot(self.scenario, self.start, self.streams)
        carried = sensors(self.scenario, self.scene, robot, self.streams)
        recorder = Recorder(carried, self.scenario.faults, self.streams)
        steering = Steering(self.scenario, self.follower())
        emit(static_transforms(self.scenario, EPOCH_NS))
        ticks = max(1, round(self.scenario.control.period * self.scenario.wheels.rate))
        while not steering.finished:
            now = robot.trail.end
            arrived = recorder.until(now)
            for message in arrived:
                emit(message)
            pose = _pose(robot) if estimator is None else estimator(arrived)
            targets = steering.wheel_speeds(now, pose)
            for _ in range(ticks):
                robot.drive(targets)
            x, y, _ = _pose(robot)
            gap, control = float(clearance(self.obstacles, np.array([[x, y]]))[0]), self.scenario.control
            if gap < control.clearance:
                raise LocfuseError(
                    f"the robot hits something after {robot.trail.end:.1f} s: at ({x:.2f}, {y:.2f}) it is "
                    f"{gap:.2f} m away, and it is {2 * control.clearance:g} m wide; it steers on "
                    f"control.estimator = {control.estimator}; try another --seed, or "
                    "--set control.estimator=truth"
                )
        for message in recorder.until(robot.trail.end):
            emit(message)
        truth = robot.trail.knots().copy()
        return Outcome(
            truth_t=np.linspace(0, robot.trail.end, len(truth)),
            truth=truth,
            ticks_t=np.array([tick.t for tick in robot.ticks]),
            counts=np.array([tick.counts for tick in robot.ticks], float),
            set_points=np.array([tick.set_point for tick in robot.ticks]),
            rad_per_count=robot.wheels[0].rad_per_count,
            radius=self.scenario.wheels.radius,
            missed=sum(w.missed for w in robot.wheels),
        )


class Recorder:
    """Reads the sensors at their times and returns messages in order of arrival."""

    def __init__(self, sensors: list[SimulatedSensor], faults: tuple[Fault, ...], streams: Streams) -> None:
        self.sensors = sensors
        self.read = [0] * len(sensors)  # readings taken
        self.last = [0] * len(sensors)  # ns, latest arrival: messages of one sensor keep their order
        self.dated = [0] * len(sensors)  # ns, latest stamp
        self.jitter = [streams(f"arrival of {s.topic}") for s in sensors]
        self.chance = [streams(f"clock of {s.topic}") for s in sensors]
        self.faults = [f for f in faults if isinstance(f, MessageFault)]
        self.waiting: list[tuple[int, int, RawMessage]] = []
        self.issued = 0
        for fault in faults:
            for event, t in (("begin", fault.start), ("end", fault.end)):
                if np.isfinite(t):
                    ns, fields = nanoseconds(t), {"data": label(fault, event)}
                    self._queue(RawMessage("/faults", "std_msgs/msg/String", ns, ns, "", fields))

    def until(self, now: float) -> list[RawMessage]:
        """Return the messages that arrived since the last call, until `now` [s]."""
        for i, sensor in enumerate(self.sensors):
            while (t := sensor.phase + self.read[i] * sensor.period) + sensor.duration <= now + 1e-9:
                self._receive(i, t)
        arrived = []
        while self.waiting and self.waiting[0][0] <= nanoseconds(now):
            arrived.append(heapq.heappop(self.waiting)[2])
        return arrived

    def _receive(self, i: int, t: float) -> None:
        sensor = self.sensors[i]
        self.read[i] += 1
        fields = sensor.read(t)
        delay = sensor.duration + sensor.latency * (1 + 0.5 * self.jitter[i].random())
        dates: Dates | None = Dates(t, t, t + delay)
        active = [f for f in self.faults if f.sensor == sensor.name and f.active(t)]
        for fault in active:
            dates = dates and fault.dated(dates, self.chance[i])
        if dates is None:
            return
        self.last[i] = max(nanoseconds(dates.arrival), self.last[i] + 1)
        stamp_ns = nanoseconds(dates.stamp)
        if any(isinstance(f, ClockOffset) and f.jitter for f in active):  # stamps keep their order
            stamp_ns = max(stamp_ns, self.dated[i] + 1)
        self.dated[i] = stamp_ns
        self._queue(RawMessage(sensor.topic, sensor.msgtype, self.last[i], stamp_ns, sensor.frame_id, fields))

    def _queue(self, message: RawMessage) -> None:
        heapq.heappush(self.waiting, (message.log_ns, self.issued, message))
        self.issued += 1


def nanoseconds(t: float) -> int:
    """Return the time t [s] of a drive as a stamp of the log [ns]."""
    return EPOCH_NS + round(t * 1e9)


def plan_way(scenario: Scenario, scene: World, streams: Streams) -> tuple[Pose, Callable[[], Follower]]:
    """Return the robot's start pose, and a function that creates its path follower."""
    path, speed = scenario.path, scenario.control.speed
    if isinstance(path, Legs):
        start = (path.x, path.y, float(np.radians(path.theta_deg)))
        return start, lambda: LegFollower(path.legs, scenario.wheels.track)
    if isinstance(path, Waypoints):
        sampled = waypoints(path)
        return sampled.start, lambda: PathFollower(sampled, speed, path.turning)
    if isinstance(path, Polygon):
        sampled = polygon(path)
    else:
        sampled = tour(path, scene.obstacles(OBSTACLE_HEIGHT), scenario.room.size, streams("tour"))
    return sampled.start, lambda: PathFollower(sampled, speed)


def _pose(robot: SimulatedRobot) -> Pose:
    x, y, theta = robot.trail.knots()[-1].tolist()
    return x, y, theta


class Stability(NamedTuple):
    """Deviation of the mean wheel speed from its mean set point, over windows of one sampling period."""

    worst: float  # relative, of all windows
    rms: float
    within_5_percent: float  # share of windows


def speed_stability(outcome: Outcome) -> Stability:
    """Return the speed deviations of both wheels over windows of 0.1 s, without standstill."""
    per = max(1, round(0.1 / (outcome.ticks_t[1] - outcome.ticks_t[0])))
    n = (len(outcome.ticks_t) - 1) // per
    turned = np.diff(outcome.counts[: n * per + 1 : per], axis=0) * outcome.rad_per_count
    asked = outcome.set_points[1 : n * per + 1].reshape(n, per, 2).mean(axis=1)
    seconds = outcome.ticks_t[per] - outcome.ticks_t[0]
    moving = np.abs(asked) > MIN_WHEEL_RATE
    deviation = np.abs(turned[moving] / seconds / asked[moving] - 1)
    if len(deviation) == 0:
        return Stability(0.0, 0.0, 1.0)
    return Stability(
        float(deviation.max()), float(np.sqrt((deviation**2).mean())), float((deviation <= 0.05).mean())
    )


# --- Output to a log file, or to columns in memory

# Tables of robot.toml -> localisation; None: steer by the truth.
Localise = Callable[[dict[str, dict[str, Any]]], Estimator | None]


def on_truth(robot_tables: dict[str, dict[str, Any]]) -> None:
    """Return None in place of an estimator: the robot then steers by its true pose."""


def write_log(scenario: Scenario, seed: int, localise: Localise, path: Path) -> Outcome:
    """Simulate a drive into an MCAP log, with robot.toml and the scenario as attachments."""
    simulation = Simulation(scenario, seed)
    tables = simulation.robot_tables
    with log_writer(path) as log:
        log.attach("robot.toml", tomli_w.dumps(tables).encode())
        log.attach("scenario.toml", dumps(msgspec.structs.replace(scenario, seed=seed)).encode())
        return simulation.run(localise(tables), to_log(log))


def to_log(log: LogWriter) -> Emit:
    """Return a function that writes messages to a log."""

    def emit(m: RawMessage) -> None:
        log.write(
            m.topic,
            m.msgtype,
            m.fields,
            m.log_ns,
            stamp_ns=m.stamp_ns,
            frame_id=m.frame_id,
            latched=m.topic == "/tf_static",
        )

    return emit


def in_memory(
    scenario: Scenario, seed: int, localise: Localise = on_truth
) -> tuple[dict[str, ArrayStream], dict[str, dict[str, Any]], Outcome]:
    """Simulate a drive in memory; return streams by topic, the tables of robot.toml, and the outcome."""
    simulation = Simulation(scenario, seed)
    tables = simulation.robot_tables
    messages = defaultdict[str, list[RawMessage]](list)
    outcome = simulation.run(localise(tables), lambda message: messages[message.topic].append(message))
    return {topic: stream_of(some) for topic, some in messages.items()}, tables, outcome


def stream_of(messages: list[RawMessage]) -> ArrayStream:
    """Convert the messages of one topic to a stream; drop each message with a stamp earlier than one before it."""
    stamps: Ints = np.array([m.stamp_ns for m in messages], np.int64)
    in_order = stamps >= np.maximum.accumulate(stamps)
    kept = [m for m, keep in zip(messages, in_order.tolist(), strict=True) if keep]
    first = messages[0]
    data: dict[str, Column] = {}
    for name, value in first.fields.items():
        values = [m.fields[name] for m in kept]
        if isinstance(value, np.ndarray):
            ends = np.concatenate(([0], np.cumsum([len(v) for v in values])))
            data[name] = Ragged(np.concatenate(values), ends)
        else:
            data[name] = np.array(values) if isinstance(value, int | float) else values
    return ArrayStream(
        topic=first.topic,
        msgtype=first.msgtype,
        t_ns=stamps[in_order],
        data=data,
        frame_id=first.frame_id,
        dropped={} if in_order.all() else {"stamp runs backwards": int((~in_order).sum())},
    )
