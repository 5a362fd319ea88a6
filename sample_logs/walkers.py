"""People who walk up and down their paths, as moving circles: two legs and a body."""

from __future__ import annotations

import math

import numpy as np

from locfuse.fusion.data import Array

from .building import Walker

STRIDE_M = 0.7  # m, of one step
HIP_HEIGHT_M = 0.8  # m: two legs below, a body above
LEG_RADIUS_M, BODY_RADIUS_M, HEAD_HEIGHT_M = 0.07, 0.2, 1.7  # m: radii, and the height of the head
LEG_OFFSET_M = 0.1  # m, distance of a leg from the middle
MIN_PERSON_RANGE_M = 0.75  # m, smallest distance of a person from the robot's laser


class Walk:
    """Walk of one person along a path and back, with pauses at both ends."""

    def __init__(self, walker: Walker, rng: np.random.Generator) -> None:
        self.path = np.array(walker.path, float)
        step = np.diff(self.path, axis=0)
        length = np.hypot(step[:, 0], step[:, 1])
        self.gone = np.concatenate(([0.0], np.cumsum(length)))
        self.ahead = step / length[:, None]
        self.speed = walker.speed * rng.uniform(0.8, 1.2)
        self.pause = walker.pause * rng.uniform(0.5, 1.5)
        self.once = float(self.gone[-1]) / self.speed  # s to walk the path once
        self.start = rng.uniform(0, 2 * (self.once + self.pause))

    def way(self, t: Array) -> Array:
        """Return the person's distances (n,) [m] along the path at times t (n,) [s]."""
        phase = (t + self.start) % (2 * (self.once + self.pause))
        there = np.minimum(phase, self.once)
        back = np.clip(phase - self.once - self.pause, 0, self.once)
        return np.asarray(self.speed * (there - back))

    def place(self, t: Array) -> tuple[Array, Array]:
        """Return positions (n, 2) [m, map frame] and directions of motion (n, 2) of the person, at t (n,) [s]."""
        way = self.way(t)
        i = np.clip(np.searchsorted(self.gone, way, side="right") - 1, 0, len(self.ahead) - 1)
        return self.path[i] + (way - self.gone[i])[:, None] * self.ahead[i], self.ahead[i]

    def circles(self, t: Array, z: float, robot: Array) -> Array:
        """Return the person's circles at height z [m] and times t (n,) [s], (n, k, 3): x, y, radius [m].

        Args:
            t: s of the drive.
            z: m.
            robot: (n, 2) m, position of the robot, for which the person steps aside.
        """
        middle, ahead = self.place(t)
        middle = stepped_aside(middle, robot)
        if z >= HIP_HEIGHT_M:
            return np.concatenate((middle, np.full((len(t), 1), BODY_RADIUS_M)), axis=1)[:, None]
        swing = STRIDE_M / 2 * np.sin(math.pi * self.way(t) / STRIDE_M)[:, None]
        left = np.stack((-ahead[:, 1], ahead[:, 0]), axis=-1)
        foot = np.stack([middle + side * (swing * ahead + LEG_OFFSET_M * left) for side in (-1, 1)], axis=1)
        return np.concatenate((foot, np.full((len(t), 2, 1), LEG_RADIUS_M)), axis=2)


def stepped_aside(middle: Array, robot: Array) -> Array:
    """Return a person's positions (n, 2) [m], at least MIN_PERSON_RANGE_M away from the robot."""
    gap = middle - robot
    distance = np.maximum(np.hypot(gap[:, 0], gap[:, 1]), 1e-9)[:, None]
    return np.where(distance < MIN_PERSON_RANGE_M, robot + MIN_PERSON_RANGE_M * gap / distance, middle)


def circles(walks: list[Walk], t: Array, z: float, robot: Array) -> Array:
    """Return the circles of all people at height z [m] for each ray, (n, k, 3): x, y, radius [m, map frame].

    Positions are interpolated between the times of the first and the last ray.

    Args:
        walks: the people.
        t: (n,) s of the drive, increasing.
        z: m.
        robot: (n, 2) m, origin of each ray.
    """
    if not walks or z >= HEAD_HEIGHT_M:
        return np.zeros((len(t), 0, 3))
    both = [0, -1]
    begin, end = np.concatenate([w.circles(t[both], z, robot[both]) for w in walks], axis=1)
    share = (t - t[0]) / max(t[-1] - t[0], 1e-9)
    return np.asarray(begin + share[:, None, None] * (end - begin))
