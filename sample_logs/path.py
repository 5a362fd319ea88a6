"""Where the robot should go, and how it steers: a polygon with rounded corners, followed by its own pose."""

from __future__ import annotations

import math
from typing import NamedTuple, Protocol

import numpy as np

from ..fusion.data import Array, LocfuseError
from ..fusion.se2 import wrap
from .messages import Pose
from .scenario import Path, Point

SPACING = 0.01  # m between the points of a sampled path


class Command(NamedTuple):
    """What the follower asks of the robot."""

    v: float  # m/s
    omega: float  # rad/s


class Follower(Protocol):
    """Turns pose estimates into commands, until the path is done (None)."""

    def command(self, pose: Pose) -> Command | None:
        """Return what to do at this pose."""


class Sampled(NamedTuple):
    """A path as points every centimetre."""

    pose: Array  # (n, 3)
    curvature: Array  # (n,) 1/m


def rounded(vertices: tuple[Point, ...], radius: float) -> Sampled:
    """Return the closed polygon with its corners rounded, starting on its first straight."""
    p = np.array(vertices, float)
    edge = np.roll(p, -1, axis=0) - p
    heading = np.arctan2(edge[:, 1], edge[:, 0])
    turn = np.array([wrap(b - a) for a, b in zip(heading, np.roll(heading, -1), strict=True)])
    cut = radius * np.tan(np.abs(turn) / 2)  # taken from both edges at the corner after edge i
    straight = np.hypot(edge[:, 0], edge[:, 1]) - cut - np.roll(cut, 1)
    if (straight < 0).any():
        raise LocfuseError(
            f"path.radius = {radius} m does not fit: the edge after vertex {int(straight.argmin())} "
            f"is {-straight.min():.2f} m too short"
        )
    pieces = [(length, 0.0) for length in straight]
    arcs = [(radius * abs(a), math.copysign(1 / radius, a)) for a in turn]
    start = p[0] + np.roll(cut, 1)[0] * np.array([math.cos(heading[0]), math.sin(heading[0])])
    order = [piece for pair in zip(pieces, arcs, strict=True) for piece in pair]
    return _sample((start[0], start[1], heading[0]), order)


def _sample(start: Pose, pieces: list[tuple[float, float]]) -> Sampled:
    """Lay pieces of (length, curvature) end to end."""
    poses, curvatures = [], []
    x, y, theta = start
    for length, curvature in pieces:
        n = max(1, round(length / SPACING))
        s = np.linspace(0, length, n, endpoint=False)
        poses.append(_along(x, y, theta, s, curvature))
        curvatures.append(np.full(n, curvature))
        x, y, theta = _along(x, y, theta, np.array([length]), curvature)[0]
    return Sampled(np.concatenate(poses), np.concatenate(curvatures))


def _along(x: float, y: float, theta: float, s: Array, curvature: float) -> Array:
    turn = curvature * s
    chord = s * np.sinc(turn / (2 * np.pi))
    return np.stack(
        (x + chord * np.cos(theta + turn / 2), y + chord * np.sin(theta + turn / 2), theta + turn), axis=-1
    )


class PathFollower:
    """Feed-forward of the path's curvature plus feedback of lateral and heading error."""

    LATERAL = 2.0  # 1/m^2
    HEADING = 2.5  # 1/m
    AHEAD = 100  # points searched for the nearest one: the path may cross itself

    def __init__(self, path: Path, speed: float) -> None:
        self.path = rounded(path.vertices, path.radius)
        self.speed = speed
        self.last = round(path.laps * len(self.path.pose))  # index, counted over laps
        self.at = 0

    @property
    def start(self) -> Pose:
        """Return the pose at the path's beginning."""
        x, y, theta = self.path.pose[0].tolist()
        return x, y, theta

    def command(self, pose: Pose) -> Command | None:
        """Return the command at this pose, None at the end of the path."""
        self._advance(pose)
        if self.at >= self.last:
            return None
        x, y, theta = self.path.pose[self.at % len(self.path.pose)]
        dx, dy = pose[0] - x, pose[1] - y
        lateral = -math.sin(theta) * dx + math.cos(theta) * dy
        error = wrap(pose[2] - theta)
        ahead = self.path.curvature[(self.at + round(0.1 * self.speed / SPACING)) % len(self.path.pose)]
        omega = self.speed * (float(ahead) - self.LATERAL * lateral - self.HEADING * error)
        return Command(self.speed, omega)

    def _advance(self, pose: Pose) -> None:
        ahead = np.arange(self.at, min(self.at + self.AHEAD, self.last) + 1)
        points = self.path.pose[ahead % len(self.path.pose), :2]
        self.at = int(ahead[np.argmin(((points - pose[:2]) ** 2).sum(axis=1))])
