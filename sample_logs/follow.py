"""Path following: from the estimated pose to wheel speeds, until the end of the path."""

from __future__ import annotations

import math
from typing import NamedTuple, Protocol

import numpy as np

from locfuse.fusion.data import LocfuseError
from locfuse.fusion.se2 import wrap

from .messages import Pose
from .paths import SPACING_M, Sampled
from .scenario import Control, Leg, Scenario

LATERAL_GAIN = 2.0  # 1/m^2, feedback of the distance from the path
HEADING_GAIN = 2.5  # 1/m, feedback of the heading error
BRAKING_M_S2 = 0.5  # m/s^2 at the rim, towards the end of a leg
RESOLUTION_RAD_S = 1e-3  # rad/s, resolution of the set points, which motor controllers take as integers


class Command(NamedTuple):
    """Commanded forward speed and turning rate."""

    v: float  # m/s
    omega: float  # rad/s


STOP = Command(0.0, 0.0)


class Follower(Protocol):
    """Path follower: computes commands from pose estimates."""

    def command(self, now: float, pose: Pose) -> Command | None:
        """Return the command at time `now` [s] and this pose; None after the end of the path."""


class PathFollower:
    """Follower of a sampled path: feed-forward of curvature, feedback of lateral and heading error."""

    AHEAD = 100  # number of points searched for the nearest one; few, since the path may cross itself
    SLOWING = 30  # points before a curve at which the robot begins to slow down

    def __init__(self, path: Sampled, speed: float, turning: float = math.inf) -> None:
        self.path = path
        self.speed = speed  # m/s
        self.turning = turning  # rad/s, largest turning rate: in narrow curves the robot is slower
        self.at = 0

    def command(self, now: float, pose: Pose) -> Command | None:
        """Return the command at this pose; None at the end of the path."""
        near = self.path.pose[self.at : self.at + self.AHEAD, :2]
        self.at += int(np.argmin(((near - pose[:2]) ** 2).sum(axis=1)))
        if self.at >= len(self.path.pose) - 1:
            return None
        x, y, theta = self.path.pose[self.at].tolist()
        sharpest = float(np.abs(self.path.curvature[self.at : self.at + self.SLOWING]).max())
        speed = self.speed if self.speed * sharpest <= self.turning else self.turning / sharpest
        ahead = self.at + round(0.1 * speed / SPACING_M)
        curvature = float(self.path.curvature[min(ahead, len(self.path.curvature) - 1)])
        lateral, error = off_line(pose, (x, y, theta))
        omega = curvature - LATERAL_GAIN * lateral - HEADING_GAIN * error
        return Command(speed, speed * omega)


class LegFollower:
    """Follower of straight runs and turns on the spot; each leg begins where the previous one ended."""

    def __init__(self, legs: tuple[Leg, ...], track: float) -> None:
        self.legs = list(legs)
        self.track = track
        self.start: Pose | None = None  # of the current leg
        self.turned = 0.0
        self.last_heading = 0.0
        self.pause_until = -math.inf

    def command(self, now: float, pose: Pose) -> Command | None:
        """Return the command at time `now` [s] and this pose; None after the last leg."""
        if now < self.pause_until - 1e-9:
            return STOP
        if not self.legs:
            return None
        if self.start is None:
            self.start, self.turned, self.last_heading = pose, 0.0, pose[2]
        leg = self.legs[0]
        command = self._turn(leg, pose) if leg.turn_deg else self._forward(leg, pose, self.start)
        if command is None:
            self.legs.pop(0)
            self.start, self.pause_until = None, now + leg.pause
            return STOP
        return command

    def _turn(self, leg: Leg, pose: Pose) -> Command | None:
        self.turned += wrap(pose[2] - self.last_heading)
        self.last_heading = pose[2]
        left = abs(math.radians(leg.turn_deg)) - math.copysign(1, leg.turn_deg) * self.turned
        if left <= 0:
            return None
        rim = _braked(leg.speed, left * self.track / 2)
        return Command(0.0, math.copysign(2 * rim / self.track, leg.turn_deg))

    def _forward(self, leg: Leg, pose: Pose, start: Pose) -> Command | None:
        way = (pose[0] - start[0]) * math.cos(start[2]) + (pose[1] - start[1]) * math.sin(start[2])
        left = abs(leg.forward) - math.copysign(1, leg.forward) * way
        if left <= 0:
            return None
        v = math.copysign(_braked(leg.speed, left), leg.forward)
        lateral, error = off_line(pose, start)
        return Command(v, -LATERAL_GAIN * v * lateral - HEADING_GAIN * abs(v) * error)


def off_line(pose: Pose, line: Pose) -> tuple[float, float]:
    """Return the lateral error [m, left of the directed line] and the heading error [rad] of a pose."""
    x, y, theta = line
    lateral = -math.sin(theta) * (pose[0] - x) + math.cos(theta) * (pose[1] - y)
    return lateral, wrap(pose[2] - theta)


def _braked(speed: float, left: float) -> float:
    return max(0.02, min(speed, math.sqrt(2 * BRAKING_M_S2 * left)))


class Steering:
    """Control of a drive: wait, follow the path, wait."""

    def __init__(self, scenario: Scenario, follower: Follower) -> None:
        self.control: Control = scenario.control
        self.radius, self.track = scenario.wheels.radius, scenario.wheels.track
        self.follower = follower
        self.done_at: float | None = None
        self.finished = False

    def wheel_speeds(self, now: float, pose: Pose) -> tuple[float, float]:
        """Return the set points of left and right wheel [rad/s] for the next control period."""
        command = self._command(now, pose)
        half = command.omega * self.track / 2
        speeds = ((command.v + way) / self.radius for way in (-half, half))
        left, right = (round(speed / RESOLUTION_RAD_S) * RESOLUTION_RAD_S for speed in speeds)
        return left, right

    def _command(self, now: float, pose: Pose) -> Command:
        if now >= self.control.time_limit:
            raise LocfuseError(
                f"the way is not done after control.time_limit = {self.control.time_limit:g} s: "
                "raise it, or control.speed"
            )
        if now < self.control.wait - 1e-9:
            return STOP
        if self.done_at is None:
            command = self.follower.command(now, pose)
            if command is not None:
                return command
            self.done_at = now
        self.finished = now >= self.done_at + self.control.wait - 1e-9
        return STOP
