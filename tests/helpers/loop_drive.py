"""A robot that drives round in a wide loop by noisy wheels, with its true poses: for sensors that see no walls."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from locfuse.fusion.data import ArrayStream, Column

Array = NDArray[np.float64]
T0 = 1_700_000_000_000_000_000
TRACK, NOISE = 0.5, 4e-4  # m, m
PERIOD = 0.1  # s
START = (2.0, -1.0, 0.4)
TABLES: dict[str, Any] = {
    "wheels": {"track": TRACK, "noise": NOISE},
    "start": {"x": START[0], "y": START[1], "theta_deg": math.degrees(START[2])},
}


def path(seconds: float = 80.0, speed: float = 0.5) -> tuple[Array, Array]:
    """Times (n,) and true poses (n, 3): forward all the time, turning left more than right."""
    t = np.arange(0.0, seconds, PERIOD)
    turn = (0.10 + 0.25 * np.sin(t / 7.0)) * PERIOD
    theta = START[2] + np.concatenate(([0.0], np.cumsum(turn[:-1])))
    middle = theta[:-1] + 0.5 * turn[:-1]
    chord = speed * PERIOD * np.sinc(0.5 * turn[:-1] / np.pi)
    x, y = (np.concatenate(([0.0], np.cumsum(chord * f(middle)))) for f in (np.cos, np.sin))
    return t, np.column_stack((START[0] + x, START[1] + y, theta))


def ns(t: Array) -> NDArray[np.int64]:
    """Stamps (n,) of times t (n,) [s]."""
    return T0 + np.rint(t * 1e9).astype(np.int64)


def quaternion(prefix: str, theta: Array) -> dict[str, Column]:
    """Columns of a turn by theta (n,) about the vertical axis."""
    zero = np.zeros(len(theta))
    parts = {"x": zero, "y": zero, "z": np.sin(0.5 * theta), "w": np.cos(0.5 * theta)}
    return {f"{prefix}.{axis}": column for axis, column in parts.items()}


def wheels(t: Array, pose: Array, rng: np.random.Generator) -> ArrayStream:
    """Odometry whose wheels roll with the noise that TABLES tell, from (0, 0, 0)."""
    turn = np.diff(pose[:, 2])
    ds = np.hypot(*np.diff(pose[:, :2], axis=0).T) / np.sinc(0.5 * turn / np.pi)
    sides = np.stack((ds - 0.5 * TRACK * turn, ds + 0.5 * TRACK * turn), axis=-1)
    sides += np.sqrt(NOISE * np.abs(sides)) * rng.normal(size=sides.shape)
    ds, turn = sides.mean(axis=1), np.diff(sides, axis=1)[:, 0] / TRACK
    theta = np.concatenate(([0.0], np.cumsum(turn)))
    middle, chord = theta[:-1] + 0.5 * turn, ds * np.sinc(0.5 * turn / np.pi)
    x, y = (np.concatenate(([0.0], np.cumsum(chord * f(middle)))) for f in (np.cos, np.sin))
    zero = np.zeros(len(t))
    data: dict[str, Column] = {
        "pose.pose.position.x": x,
        "pose.pose.position.y": y,
        **quaternion("pose.pose.orientation", theta),
        "twist.twist.linear.x": zero,
        "twist.twist.angular.z": zero,
    }
    return ArrayStream("/odom", "nav_msgs/msg/Odometry", ns(t), data)


def truth(t: Array, pose: Array) -> ArrayStream:
    """The true poses as a reference topic."""
    data: dict[str, Column] = {"pose.position.x": pose[:, 0], "pose.position.y": pose[:, 1]}
    data |= quaternion("pose.orientation", pose[:, 2])
    return ArrayStream("/ground_truth", "geometry_msgs/msg/PoseStamped", ns(t), data)
