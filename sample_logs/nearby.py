"""Fast ray casting in a large plan: objects are tested only against rays that may hit them.

The rays of one scan begin close together, so the bearing of an object is nearly the same for all of them. Only
pairs of ray and object without a possible hit are left out; the others are computed exactly.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from locfuse.fusion.data import Array

from .world import Plan, hit_circles, hit_segments

Indices = NDArray[np.intp]
FULL_TURN_RAD = 2 * np.pi
ROUNDING_SLACK = 1e-6  # rad and m, against rounding errors


class Fan(NamedTuple):
    """Rays of one scan, sorted by direction."""

    origin: Array  # (n, 2) m, map frame
    angle: Array  # (n,) rad, map frame
    direction: Array  # (n, 2) unit length
    middle: Array  # (2,) m: every origin lies within `spread` of it
    spread: float  # m
    order: Indices  # (n,) the rays by increasing bearing
    bearing: Array  # (2 n,) rad, bearings in this order, then again + 2 pi


def cast_near(plan: Plan, origin: Array, angle: Array, reach: float) -> Array:
    """Return the distance of each ray's first hit, (n,) [m], inf without a hit within `reach` [m].

    Args:
        plan: segments and circles; circles may not move.
        origin: (n, 2) m, map frame; the rays of one scan begin close together.
        angle: (n,) rad, map frame.
        reach: m.
    """
    rays = fan(origin, angle)
    nearest = np.full(len(angle), np.inf)
    for ray, way in (_segments(plan.segments, rays, reach), _circles(plan.circles, rays, reach)):
        np.minimum.at(nearest, ray, way)
    return np.where(nearest <= reach, nearest, np.inf)


def fan(origin: Array, angle: Array) -> Fan:
    """Return the rays from origins (n, 2) [m] in directions `angle` (n,) [rad], both in the map frame."""
    low, high = origin.min(axis=0), origin.max(axis=0)
    bearing = angle % FULL_TURN_RAD
    order = np.argsort(bearing)
    twice = np.concatenate((bearing[order], bearing[order] + FULL_TURN_RAD))
    direction = np.stack((np.cos(angle), np.sin(angle)), axis=-1)
    return Fan(origin, angle, direction, (low + high) / 2, float(np.hypot(*(high - low))) / 2, order, twice)


def _segments(segments: Array, rays: Fan, reach: float) -> tuple[Indices, Array]:
    """Return the rays (p,) that may hit a segment, and the distances (p,) [m], inf for a miss."""
    a, b = segments[:, :2] - rays.middle, segments[:, 2:] - rays.middle
    gap = _gap(a, b)
    kept = np.flatnonzero(gap <= reach + rays.spread + ROUNDING_SLACK)
    a, b, gap = a[kept], b[kept], gap[kept]
    turn = np.arctan2(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0], (a * b).sum(axis=1))
    centre = np.arctan2(a[:, 1], a[:, 0]) + turn / 2
    ray, thing = _pairs(rays, centre, np.abs(turn) / 2, gap)
    return ray, hit_segments(segments[kept[thing]], rays.origin[ray], rays.direction[ray])


def _circles(circles: Array, rays: Fan, reach: float) -> tuple[Indices, Array]:
    """Return the rays (p,) that may hit a circle, and the distances (p,) [m], inf for a miss."""
    to = circles[:, :2] - rays.middle
    distance = np.hypot(to[:, 0], to[:, 1])
    kept = np.flatnonzero(distance - circles[:, 2] <= reach + rays.spread + ROUNDING_SLACK)
    to, distance, radius = to[kept], distance[kept], circles[kept, 2]
    width = np.arcsin(np.minimum(radius / np.maximum(distance, radius), 1.0))
    ray, thing = _pairs(rays, np.arctan2(to[:, 1], to[:, 0]), width, distance - radius)
    return ray, hit_circles(circles[kept[thing]], rays.origin[ray], rays.direction[ray])


def _gap(a: Array, b: Array) -> Array:
    """Return the distances (m,) [m] of segments, from a (m, 2) to b (m, 2), from the origin."""
    along = b - a
    share = np.clip(-(a * along).sum(axis=1) / np.maximum((along * along).sum(axis=1), ROUNDING_SLACK**2), 0, 1)
    nearest = a + share[:, None] * along
    return np.asarray(np.hypot(nearest[:, 0], nearest[:, 1]))


def _pairs(rays: Fan, centre: Array, width: Array, gap: Array) -> tuple[Indices, Indices]:
    """Return pairs (p,) of ray and object where the ray may hit the object.

    Args:
        rays: n rays.
        centre: (m,) rad, bearing of each object from the middle of the fan.
        width: (m,) rad, half the angle that the object covers.
        gap: (m,) m, distance of the object; the bearing of a near object depends on the origin of the ray.
    """
    n = len(rays.order)
    parallax = np.where(
        gap > rays.spread, np.arcsin(np.minimum(rays.spread / np.maximum(gap, ROUNDING_SLACK), 1.0)), np.pi
    )
    half = width + parallax + ROUNDING_SLACK
    first_bearing = (centre - half) % FULL_TURN_RAD
    first = np.searchsorted(rays.bearing, first_bearing, side="left")
    last = np.searchsorted(rays.bearing, first_bearing + 2 * half, side="right")
    count = np.where(half >= np.pi, n, np.minimum(last - first, n))
    thing = np.repeat(np.arange(len(centre)), count)
    within = np.arange(len(thing)) - np.repeat(np.cumsum(count) - count, count)
    return rays.order[(first[thing] + within) % n], thing
