"""The room in plan: segments and circles, and exact ray casting against them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..fusion.data import Array
from .scenario import Room


class Plan(NamedTuple):
    """What a horizontal ray can hit."""

    segments: Array  # (m, 4) x1, y1, x2, y2 [m], map frame
    circles: Array  # (k, 3) x, y, radius [m], or (n, k, 3) where they move from ray to ray


def walls(room: Room) -> Array:
    """Return the outer walls, (m, 4)."""
    if room.walls is not None:
        return np.array(room.walls, float).reshape(-1, 4)
    w, h = room.size
    return np.array([(0, 0, w, 0), (w, 0, w, h), (w, h, 0, h), (0, h, 0, 0)], float)


def plates(room: Room) -> Array:
    """Return the plates inside the room, (m, 4)."""
    return np.array(room.plates, float).reshape(-1, 4)


def cast(plan: Plan, origin: Array, angle: Array) -> Array:
    """Return how far each ray goes, (n,) m, inf where it hits nothing.

    Args:
        plan: segments and circles.
        origin: (n, 2) m, map frame.
        angle: (n,) rad, map frame.
    """
    direction = np.stack((np.cos(angle), np.sin(angle)), axis=-1)
    hits = np.concatenate(
        (
            hit_segments(plan.segments, origin, direction),
            hit_circles(plan.circles, origin, direction),
            np.full((len(angle), 1), np.inf),
        ),
        axis=1,
    )
    return np.asarray(hits.min(axis=1))


def hit_segments(segments: Array, origin: Array, direction: Array) -> Array:
    """Return the distance from every ray (n,) to every segment (m,), (n, m) m, inf for a miss."""
    a, along = segments[:, :2], segments[:, 2:] - segments[:, :2]
    w = a[None] - origin[:, None]  # (n, m, 2)
    d = direction[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        denominator = d[..., 0] * along[:, 1] - d[..., 1] * along[:, 0]
        distance = (w[..., 0] * along[:, 1] - w[..., 1] * along[:, 0]) / denominator
        share = (w[..., 0] * d[..., 1] - w[..., 1] * d[..., 0]) / denominator
        hit = (distance > 0) & (share >= 0) & (share <= 1)
    return np.where(hit, distance, np.inf)


def hit_circles(circles: Array, origin: Array, direction: Array) -> Array:
    """Return the distance from every ray (n,) to every circle (k,), (n, k) m, inf for a miss."""
    w = circles[..., :2] - origin[:, None]  # (n, k, 2)
    ahead = (w * direction[:, None]).sum(axis=-1)
    square = circles[..., 2] ** 2 - (w * w).sum(axis=-1) + ahead**2
    with np.errstate(invalid="ignore"):
        distance = ahead - np.sqrt(square)
        hit = (square >= 0) & (distance > 0)
    return np.where(hit, distance, np.inf)


def clearance(segments: Array, points: Array) -> Array:
    """Return the distance of every point (n, 2) from the nearest segment, (n,) m."""
    a, along = segments[:, :2], segments[:, 2:] - segments[:, :2]
    w = points[:, None] - a[None]
    share = np.clip((w * along).sum(axis=-1) / (along * along).sum(axis=-1), 0, 1)
    gap = w - share[..., None] * along
    return np.asarray(np.sqrt((gap * gap).sum(axis=-1)).min(axis=1))
