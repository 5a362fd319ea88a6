"""Dead reckoning, and poses as streams in memory."""

import numpy as np
from numpy.typing import NDArray

from locfuse.fusion.data import Array, ArrayStream, Column


def reckoned(steps: Array, start: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Array:
    """Poses (n + 1, 3) of steps (n, 2): a way [m] along the middle of the headings, and a turn [rad]."""
    way, turn = steps.T
    theta = start[2] + np.concatenate(([0.0], np.cumsum(turn)))
    middle = theta[:-1] + 0.5 * turn
    x, y = (np.concatenate(([0.0], np.cumsum(way * f(middle)))) for f in (np.cos, np.sin))
    return np.column_stack((start[0] + x, start[1] + y, theta))


def slipping(steps: Array, track: float, noise: float, rng: np.random.Generator) -> Array:
    """The same steps by wheels whose ways have so much variance per metre."""
    sides = steps[:, :1] + 0.5 * track * steps[:, 1:] * [-1.0, 1.0]
    sides = sides + np.sqrt(noise * np.abs(sides)) * rng.normal(size=sides.shape)
    return np.column_stack((sides.mean(axis=1), np.diff(sides, axis=1)[:, 0] / track))


def pose_columns(pose: Array, prefix: str = "pose") -> dict[str, Column]:
    """Poses (n, 3) as columns of a message."""
    zero, half = np.zeros(len(pose)), 0.5 * pose[:, 2]
    places = {"x": pose[:, 0], "y": pose[:, 1]}
    turns = {"x": zero, "y": zero, "z": np.sin(half), "w": np.cos(half)}
    found: dict[str, Column] = {f"{prefix}.position.{axis}": column for axis, column in places.items()}
    return found | {f"{prefix}.orientation.{axis}": column for axis, column in turns.items()}


def pose_stream(topic: str, t_ns: NDArray[np.int64], pose: Array) -> ArrayStream:
    """Poses (n, 3) as stamped messages."""
    return ArrayStream(topic, "geometry_msgs/msg/PoseStamped", t_ns, pose_columns(pose))


def odometry_stream(
    t_ns: NDArray[np.int64], pose: Array, speed: Array | None = None, turn: Array | None = None
) -> ArrayStream:
    """Poses (n, 3) as an odometry says them, whose twist is zero unless it is given."""
    zero = np.zeros(len(pose))
    twist = {"linear.x": zero if speed is None else speed, "angular.z": zero if turn is None else turn}
    data = pose_columns(pose, "pose.pose") | {f"twist.twist.{name}": column for name, column in twist.items()}
    return ArrayStream("/odom", "nav_msgs/msg/Odometry", t_ns, data)
