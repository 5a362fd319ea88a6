"""Physical model of the robot: motors with PID control, encoders, wheels on a floor, true path.

Within a step both wheels turn at constant speed, so the path is a circular arc, and poses between two knots are
exact points on that arc. Sensors read their poses with `Trail.pose`.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from locfuse.fusion import se2
from locfuse.fusion.data import Array, Ints, Mask

from .faults import Displaced, GroundFault, Kidnap
from .scenario import Motor, Scenario, WheelsSpec
from .table import Pose, Streams

SIDES = ("left", "right")

STEPS_PER_TICK = 4  # physics steps per encoder tick
KNOTS = np.arange(STEPS_PER_TICK + 1)  # ends of these steps
COUNTS_PER_SLOT = 4
MISSED = 2
# STEP[4 * previous + now] with state = 2 A + B
STEP = np.array(
    [
        *(0, -1, +1, MISSED),  # from 00: to 01 backward, to 10 forward
        *(+1, 0, MISSED, -1),  # from 01
        *(-1, MISSED, 0, +1),  # from 10
        *(MISSED, +1, -1, 0),  # from 11
    ],
    dtype=np.int64,
)


class Counted(NamedTuple):
    """Counts of a quadrature decoder."""

    counts: Ints  # (..., n - 1) count change from sample to sample
    missed: Mask  # (..., n - 1) both phases changed at once: two counts are lost, or more


def phases(angle: Array, slots: int) -> tuple[Mask, Mask]:
    """Return the two phases A and B of an encoder disc with `slots` slots at wheel angles [rad]."""
    quarter = np.floor(angle * (slots * COUNTS_PER_SLOT / (2 * np.pi))).astype(np.int64) % COUNTS_PER_SLOT
    return (quarter == 1) | (quarter == 2), quarter >= 2


def decode(a: Mask, b: Mask) -> Counted:
    """Return the counts for phase samples (..., n) of a quadrature encoder with x4 decoding (paper fig. 2).

    A and B are two square waves a quarter slot apart. A rises first when the wheel turns forward, so the four
    states have the Gray-code order 00, 10, 11, 01. Each edge is one count; the last state gives the direction.
    If the sampling is too slow, both phases change at once: the direction is unknown and the transition is missed.
    """
    state = 2 * a.astype(np.int64) + b
    step = STEP[4 * state[..., :-1] + state[..., 1:]]
    missed = step == MISSED
    return Counted(np.where(missed, 0, step), missed)


class Trail:
    """True path of the robot: poses at knots every `step` seconds, with arcs between them."""

    def __init__(self, step: float, start: Pose) -> None:
        self.step = step
        self.count = 0  # steps made
        self._pose = np.zeros((1024, 3))
        self._twist = np.zeros((1024, 3))
        self._pose[0] = start

    @property
    def end(self) -> float:
        """Time of the last knot [s]."""
        return self.count * self.step

    def extend(self, twist: Array) -> None:
        """Append steps of constant twist (k, 3): forward, left [m], turn [rad] per step, in the body frame."""
        need = self.count + len(twist) + 1
        if need > len(self._pose):
            self._pose = np.concatenate((self._pose, np.zeros_like(self._pose)))
            self._twist = np.concatenate((self._twist, np.zeros_like(self._twist)))
        self._twist[self.count : need - 1] = twist
        moves = se2.exp(twist)
        x, y, theta = self._pose[self.count].tolist()
        headings = np.cumsum((theta, *moves[:, 2]))
        cos, sin = np.cos(headings).tolist(), np.sin(headings).tolist()
        poses = []
        for (ahead, left, _), c, s, heading in zip(moves.tolist(), cos, sin, headings[1:].tolist(), strict=False):
            x, y = x + c * ahead - s * left, y + s * ahead + c * left
            poses.append((x, y, heading))
        self._pose[self.count + 1 : need] = poses
        self.count = need - 1

    def knots(self) -> Array:
        """Return the poses at all knots, (n, 3)."""
        return self._pose[: self.count + 1]

    def steps(self) -> Array:
        """Return the twists of all steps, (n - 1, 3): forward, left [m], turn [rad], in the body frame."""
        return self._twist[: self.count]

    def pose(self, t: Array) -> Array:
        """Return the poses (n, 3) at times t (n,) [s] within [0, end], on the exact arcs."""
        i = np.clip((t / self.step).astype(np.int64), 0, max(self.count - 1, 0))
        share = t / self.step - i
        return se2.compose(self._pose[i], se2.exp(self._twist[i] * share[:, None]))


class Tick(NamedTuple):
    """Values of the motor controllers at one tick of their counters."""

    t: float  # s
    counts: tuple[int, int]  # left, right
    speed: tuple[float, float]  # rad/s, from the counts since the last tick
    set_point: tuple[float, float]  # rad/s, mean since the last tick


class Wheel:
    """One motor with its PID controller and its encoder, in plain floats for speed."""

    def __init__(self, wheels: WheelsSpec, motor: Motor, side: int, rng: np.random.Generator) -> None:
        self.motor = motor
        self.gain = motor.no_load * (1 + motor.gain_error[side])
        self.radius = wheels.radius * (1 + wheels.radius_error[side])
        self.dt = 1 / wheels.rate
        self.step = self.dt / STEPS_PER_TICK
        self.slots = wheels.slots
        self.rad_per_count = 2 * math.pi / (wheels.slots * COUNTS_PER_SLOT)
        self.counts_per_rad = wheels.slots * COUNTS_PER_SLOT / (2 * math.pi)
        self.looks = np.linspace(0, STEPS_PER_TICK, max(1, round(self.dt * wheels.sampling)) + 1)  # steps
        self.rng = rng
        self.angle = rng.uniform(0, self.rad_per_count)  # rad, true; the disc starts at a random angle
        self.speed = 0.0  # rad/s, true
        self.load = 0.0  # share of the voltage lost to the load
        self.counts = 0
        self.measured = 0.0  # rad/s, from the counts of the last tick
        self.missed = 0
        self.set_point = 0.0  # rad/s, mean of the last tick
        self._reached = 0.0  # rad/s, end of the set point's ramp
        self._integral = 0.0
        self._error = 0.0

    def turn(self, target: float) -> list[float]:
        """Run controller and motor for one tick; return the angle [rad] turned in each physics step."""
        voltage = self._control(target)
        turned, angles = [], [self.angle]
        decay = math.exp(-self.step / self.motor.time_constant)
        keep = math.exp(-self.step / self.motor.load_time)
        for gauss in self.rng.standard_normal(STEPS_PER_TICK).tolist():
            self.load = keep * self.load + self.motor.load * math.sqrt(1 - keep * keep) * gauss
            goal = self.gain * voltage * (1 - self.load)
            self.speed = goal + decay * (self.speed - goal)
            turned.append(self.speed * self.step)
            self.angle += turned[-1]
            angles.append(self.angle)
        self._count(angles)
        return turned

    def _control(self, target: float) -> float:
        """Return the voltage (-1 to 1): PID of the speed error, feed-forward of the set point."""
        m = self.motor
        limit = m.acceleration / self.radius * self.dt
        error = self.set_point - self.measured
        self._integral += error * self.dt
        slope, self._error = (error - self._error) / self.dt, error
        goal = self._reached + min(max(target - self._reached, -limit), limit)
        ramp = (goal - self._reached) / -math.expm1(-self.dt / m.time_constant)
        forward = (self._reached + ramp) / m.no_load
        self.set_point, self._reached = (self._reached + goal) / 2, goal
        return min(max(forward + m.kp * error + m.ki * self._integral + m.kd * slope, -1.0), 1.0)

    def _count(self, angles: list[float]) -> None:
        steepest = max(abs(b - a) for a, b in pairwise(angles))  # rad per physics step
        if steepest * STEPS_PER_TICK < 0.99 * self.rad_per_count * (len(self.looks) - 1):
            # less than one count between samples: only the first and the last angle matter
            begin, end = (math.floor(angle * self.counts_per_rad) for angle in (angles[0], angles[-1]))
            change = end - begin
        else:
            seen = decode(*phases(np.interp(self.looks, KNOTS, angles), self.slots))
            change = int(seen.counts.sum())
            self.missed += int(seen.missed.sum())
        self.counts += change
        self.measured = change * self.rad_per_count / self.dt


class SimulatedRobot:
    """Robot with two wheels on a floor that adds noise, with faults."""

    def __init__(self, scenario: Scenario, start: Pose, streams: Streams) -> None:
        self.wheels = tuple(
            Wheel(scenario.wheels, scenario.motor, i, streams(f"{side} motor")) for i, side in enumerate(SIDES)
        )
        self.track = scenario.wheels.track * (1 + scenario.wheels.track_error)
        self.noise = scenario.wheels.noise
        self.faults = scenario.faults
        self.rng = streams("ground")
        self.trail = Trail(self.wheels[0].step, start)
        self.ticks: list[Tick] = [self._tick()]

    def drive(self, targets: tuple[float, float]) -> None:
        """Simulate one tick with the commanded wheel speeds `targets` [rad/s]."""
        t = self.trail.end
        rolled = np.array([w.radius * np.array(w.turn(s)) for w, s in zip(self.wheels, targets, strict=True)])
        ways = np.concatenate((rolled, np.zeros_like(rolled[:1])))
        for fault in self.faults:
            if isinstance(fault, GroundFault) and fault.active(t):
                ways = fault.moved(ways, float(self.trail.knots()[-1, 2]))
        left, right = ways[:2] + np.sqrt(self.noise * np.abs(rolled)) * self.rng.standard_normal(rolled.shape)
        twist = np.stack(((left + right) / 2, ways[2], (right - left) / self.track), axis=-1)
        lifted = next((f for f in self.faults if isinstance(f, Kidnap) and f.active(t)), None)
        if lifted is not None:  # a person carries the robot
            share = self.trail.step / (lifted.end - lifted.start)
            move = share * np.array([lifted.x, lifted.y, math.radians(lifted.theta_deg)])
            poses = self.trail.knots()[-1] + np.arange(len(twist) + 1)[:, None] * move
            twist = se2.log(se2.between(poses[:-1], poses[1:]))
        self.trail.extend(twist)
        self.ticks.append(self._tick())

    def sensor_pose(self, sensor: str, t: Array, mount: Array | None = None) -> Array:
        """Return the true poses (n, 3) of a sensor in the map frame at times t (n,) [s].

        Args:
            sensor: its name in faults.
            t: s.
            mount: (3,) pose on the robot: m, m, rad; None: the middle of the axle.
        """
        offset = np.zeros(3) if mount is None else mount
        for fault in self.faults:
            if isinstance(fault, Displaced) and fault.sensor == sensor:
                offset = offset + fault.shift(t)
        return se2.compose(self.trail.pose(t), offset)

    def _tick(self) -> Tick:
        left, right = self.wheels
        return Tick(
            self.trail.end,
            (left.counts, right.counts),
            (left.measured, right.measured),
            (left.set_point, right.set_point),
        )
