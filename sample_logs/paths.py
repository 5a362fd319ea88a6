"""Planned paths (polygons with rounded corners, given or random), and how the robot follows them."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from locfuse.fusion.data import Array, LocfuseError
from locfuse.fusion.se2 import wrap, wrap_all

from .scenario import Control, Leg, Polygon, Scenario, Tour, Waypoints
from .table import Pose
from .world import Plan, clearance

SPACING_M = 0.01  # m between the points of a sampled path
WALK_COUNT, CORNER_COUNT = 30, 600  # random walks, and random corners in each
MAX_TURN_RAD = math.radians(110)  # largest turn of a random tour


class Sampled(NamedTuple):
    """Path sampled every centimetre."""

    pose: Array  # (n, 3)
    curvature: Array  # (n,) 1/m

    @property
    def start(self) -> Pose:
        """Return the first pose of the path."""
        x, y, theta = self.pose[0].tolist()
        return x, y, theta


def polygon(path: Polygon) -> Sampled:
    """Return `laps` rounds of a closed polygon with rounded corners, from its first straight on."""
    if len(path.vertices) < 3:
        raise LocfuseError(f"path.vertices holds {len(path.vertices)} points: a closed path needs at least three")
    lap = _rounded(np.array(path.vertices, float), path.radius, closed=True)
    n, times = round(path.laps * len(lap.pose)), math.ceil(path.laps)
    return Sampled(np.tile(lap.pose, (times, 1))[:n], np.tile(lap.curvature, times)[:n])


def waypoints(path: Waypoints) -> Sampled:
    """Return an open path through given points, with rounded corners."""
    if len(path.points) < 2:
        raise LocfuseError(f"path.points holds {len(path.points)} points: a path needs at least two")
    return _rounded(np.array(path.points, float), path.radius)


def tour(path: Tour, plan: Plan, size: tuple[float, float], rng: np.random.Generator) -> Sampled:
    """Return a random path with rounded corners in a room of `size` [m], clear of the objects in the plan."""
    if path.legs[0] < 2 * path.radius * math.tan(MAX_TURN_RAD / 2):
        raise LocfuseError(
            f"path.legs = {list(path.legs)} m leave no room for corners of radius {path.radius} m: "
            f"the shortest must be at least {2 * path.radius * math.tan(MAX_TURN_RAD / 2):.2f} m"
        )
    for _ in range(WALK_COUNT):
        corners = _walk(path, plan, size, rng)
        if corners is not None:
            return _rounded(corners, path.radius)
    raise LocfuseError(
        f"no tour of {path.length} m found in this room: lower path.clearance ({path.clearance} m) or path.legs"
    )


def _walk(path: Tour, plan: Plan, size: tuple[float, float], rng: np.random.Generator) -> Array | None:
    corners: list[Array] = []
    length, heading = 0.0, None
    for _ in range(CORNER_COUNT):
        candidate = rng.uniform((0, 0), size)
        if not corners:
            if clearance(plan, candidate[None])[0] >= path.clearance:
                corners.append(candidate)
            continue
        step = candidate - corners[-1]
        way, direction = math.hypot(*step), math.atan2(step[1], step[0])
        if not path.legs[0] <= way <= path.legs[1]:
            continue
        if heading is not None and abs(wrap(direction - heading)) > MAX_TURN_RAD:
            continue
        between = corners[-1] + np.linspace(0, 1, max(2, round(way / 0.05)))[:, None] * step
        if clearance(plan, between).min() < path.clearance:
            continue
        corners.append(candidate)
        length, heading = length + way, direction
        if length >= path.length:
            return np.array(corners)
    return None


def _rounded(corners: Array, radius: float, closed: bool = False) -> Sampled:
    """Return the path through corners (k, 2) [m] with rounded corners, back to the first one if it is `closed`."""
    following = np.roll(corners, -1, axis=0) if closed else corners[1:]
    edges = following - corners[: len(following)]
    headings = np.arctan2(edges[:, 1], edges[:, 0])
    turns = wrap_all(np.diff(headings, append=headings[:1]))
    if not closed:
        turns[-1] = 0.0
    cuts = radius * np.tan(np.abs(turns) / 2)  # length of each edge that its rounded corner replaces
    before = np.roll(cuts, 1)
    straight = np.hypot(*edges.T) - before - cuts
    if (straight < 0).any():
        raise LocfuseError(
            f"path.radius = {radius} m does not fit: the edge after vertex {int(straight.argmin()) + 1} "
            f"is {-straight.min():.2f} m too short"
        )
    arcs = [(radius * abs(turn), math.copysign(1 / radius, turn)) for turn in turns.tolist()]
    pairs = zip(straight.tolist(), arcs, strict=True)
    pieces = [piece for way, arc in pairs for piece in ((way, 0.0), arc) if piece[0] > 0]
    heading = float(headings[0])
    x, y = corners[0] + before[0] * np.array([math.cos(heading), math.sin(heading)])
    return _lay((float(x), float(y), heading), pieces)


def _lay(start: Pose, pieces: list[tuple[float, float]]) -> Sampled:
    """Return the path of consecutive pieces (length [m], curvature [1/m]) from a start pose."""
    poses, curvatures = [], []
    for length, curvature in pieces:
        n = max(1, round(length / SPACING_M))
        poses.append(_along(start, np.linspace(0, length, n, endpoint=False), curvature))
        curvatures.append(np.full(n, curvature))
        x, y, theta = _along(start, np.array([length]), curvature)[0].tolist()
        start = (x, y, theta)
    return Sampled(np.concatenate(poses), np.concatenate(curvatures))


def _along(start: Pose, s: Array, curvature: float) -> Array:
    """Return the poses (n, 3) at distances s (n,) [m] along an arc from a start pose."""
    x, y, theta = start
    turn = curvature * s
    chord = s * np.sinc(turn / (2 * np.pi))
    middle = theta + turn / 2
    return np.stack((x + chord * np.cos(middle), y + chord * np.sin(middle), theta + turn), axis=-1)


LATERAL_GAIN = 2.0  # 1/m^2, feedback of the distance from the path
HEADING_GAIN = 2.5  # 1/m, feedback of the heading error
BRAKING_M_S2 = 0.5  # m/s^2 at the rim, towards the end of a leg
RESOLUTION_RAD_S = 1e-3  # rad/s, resolution of the set points, which motor controllers take as integers


class Command(NamedTuple):
    """Commanded forward speed and turning rate."""

    v: float  # m/s
    omega: float  # rad/s


STOP = Command(0.0, 0.0)


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


Follower = PathFollower | LegFollower


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
        if now >= self.control.time_limit:
            raise LocfuseError(
                f"the way is not done after control.time_limit = {self.control.time_limit:g} s: "
                "raise it, or control.speed"
            )
        command: Command | None = STOP
        if self.done_at is None and now >= self.control.wait - 1e-9:
            command = self.follower.command(now, pose)
            if command is None:
                self.done_at = now
        if self.done_at is not None:
            self.finished = now >= self.done_at + self.control.wait - 1e-9
        v, omega = command or STOP
        speeds = ((v + way) / self.radius for way in (-omega * self.track / 2, omega * self.track / 2))
        left, right = (round(speed / RESOLUTION_RAD_S) * RESOLUTION_RAD_S for speed in speeds)
        return left, right
