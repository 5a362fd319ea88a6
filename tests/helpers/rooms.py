"""Rooms of straight walls, seen by a plain ray caster: what a laser must find is known exactly."""

import math

import numpy as np

from locfuse.fusion.data import Array

Segments = Array  # (q, 4) x0, y0, x1, y1 [m]

# the paper's arena as the sketches had it: a room of 8 x 6 m with four wooden plates
ARENA: Segments = np.array(
    [
        (0.0, 0.0, 8.0, 0.0),
        (8.0, 0.0, 8.0, 6.0),
        (8.0, 6.0, 0.0, 6.0),
        (0.0, 6.0, 0.0, 0.0),
        (3.0, 0.0, 3.0, 1.0),
        (5.0, 6.0, 5.0, 4.8),
        (8.0, 3.0, 7.0, 3.0),
        (0.0, 4.0, 0.8, 4.0),
    ]
)


def ring(corners: Array) -> Segments:
    """The walls of a closed way through corners (q, 2)."""
    return np.hstack((corners, np.roll(corners, -1, axis=0)))


def box(x0: float, y0: float, x1: float, y1: float) -> Segments:
    """The four walls of a rectangle."""
    return ring(np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)]))


def pole(x: float, y: float, radius: float) -> Segments:
    """A round pole, as a polygon of 60 sides."""
    a = np.linspace(0.0, 2.0 * math.pi, 60, endpoint=False)
    return ring(np.stack((x + radius * np.cos(a), y + radius * np.sin(a)), axis=1))


def ranges(walls: Segments, origins: Array, angle: Array) -> Array:
    """Return the distance from each origin (b, 2) along each angle (b,) to the nearest wall, inf for none."""
    c, s = np.cos(angle)[:, None], np.sin(angle)[:, None]
    x0, y0, x1, y1 = walls.T
    qx, qy = x0 - origins[:, :1], y0 - origins[:, 1:]
    across = c * (y1 - y0) - s * (x1 - x0)
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = (qx * (y1 - y0) - qy * (x1 - x0)) / across
        along = (qx * s - qy * c) / across
    hit = (distance > 0.0) & (along >= 0.0) & (along <= 1.0)
    return np.asarray(np.where(hit, distance, np.inf).min(axis=1))


def scan(walls: Segments, pose: Array, angles: Array) -> Array:
    """Return the ranges (b,) a laser at pose (x, y, theta) sees along its angles (b,)."""
    return ranges(walls, np.broadcast_to(pose[:2], (len(angles), 2)), angles + pose[2])


def poses(rng: np.random.Generator, n: int, walls: Segments = ARENA, clearance: float = 0.3) -> Array:
    """Return n random poses (n, 3) inside the room, none nearer to a wall than `clearance` [m]."""
    found: list[Array] = []
    low, high = walls[:, :2].min(axis=0), walls[:, :2].max(axis=0)
    start, along = walls[:, :2], walls[:, 2:] - walls[:, :2]
    while len(found) < n:
        p = rng.uniform(low, high)
        t = np.clip(((p - start) * along).sum(axis=1) / (along**2).sum(axis=1), 0.0, 1.0)
        if np.hypot(*(start + t[:, None] * along - p).T).min() > clearance:
            found.append(np.array([*p, rng.uniform(-math.pi, math.pi)]))
    return np.array(found)


def wall_lines(walls: Segments, pose: Array) -> Array:
    """Return the walls' (r, psi) seen from a pose, (q, 2), r >= 0."""
    dx, dy = walls[:, 2] - walls[:, 0], walls[:, 3] - walls[:, 1]
    length = np.hypot(dx, dy)
    nx, ny = -dy / length, dx / length
    r = nx * (walls[:, 0] - pose[0]) + ny * (walls[:, 1] - pose[1])
    flip = np.where(r < 0.0, -1.0, 1.0)
    return np.stack((r * flip, np.arctan2(ny * flip, nx * flip) - pose[2]), axis=1)
