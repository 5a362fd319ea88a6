"""Room in plan over time: its objects, and exact ray casting."""

from __future__ import annotations

from typing import NamedTuple

import msgspec
import numpy as np

from locfuse.fusion.data import Array

from .faults import HiddenLandmark, Magnetic, People, RedObject
from .scenario import Scenario
from .table import Pillar


class Plan(NamedTuple):
    """Objects that horizontal rays at one height can hit."""

    segments: Array  # (m, 4) x1, y1, x2, y2 [m], map frame
    circles: Array  # (k, 3) x, y, radius [m, map frame], or (n, k, 3) if they move between the n rays
    rings: Array = np.zeros((0, 3))  # (l, 3) x, y, radius [m, map frame] of round walls, seen from inside


class World:
    """Room with its landmark, plates, pillars and faults over time."""

    def __init__(self, scenario: Scenario) -> None:
        self.room = scenario.room
        self.landmark = scenario.landmark
        self.faults = scenario.faults
        (w, h), radius, given = self.room.size, self.room.radius, self.room.walls
        if given is None:
            given = () if radius is not None else ((0, 0, w, 0), (w, 0, w, h), (w, h, 0, h), (0, h, 0, 0))
        self.walls = np.array(given, float).reshape(-1, 4)  # m, map frame
        rings = [] if radius is None else [(w / 2, h / 2, radius)]
        self.rings = np.array(rings, float).reshape(-1, 3)  # x, y, radius [m, map frame] of round walls
        self.plates = np.array(self.room.plates, float).reshape(-1, 4)

    def pillars(self, t: float) -> tuple[Pillar, ...]:
        """Return all cylinders at t [s], the landmark first."""
        cloth = next((f for f in self.faults if isinstance(f, HiddenLandmark) and f.active(t)), None)
        landmark = self.landmark if cloth is None else msgspec.structs.replace(self.landmark, colour=cloth.colour)
        return (landmark, *self.room.pillars, *self._red_objects(t), *self._people(t, t))

    def plan(self, z: float, times: Array | None = None) -> Plan:
        """Return the objects at height z [m]: only static ones, or with ray times (n,) [s] also moving ones."""
        standing = [(self.walls, self.room.height), (self.plates, self.room.plate_height)]
        segments = np.concatenate([part for part, height in standing if z < height] or [np.zeros((0, 4))])
        round_walls = self.rings if z < self.room.height else self.rings[:0]
        lasting: tuple[Pillar, ...] = (self.landmark, *self.room.pillars)
        if times is None:
            return Plan(segments, _circles(lasting, z), round_walls)
        begin, end = float(times[0]), float(times[-1])
        lasting += self._red_objects(begin)
        now, then = (_circles((*lasting, *self._people(begin, t)), z) for t in (begin, end))
        if not self._people(begin, begin) or end == begin:
            return Plan(segments, now, round_walls)
        share = (times - begin) / (end - begin)
        return Plan(segments, now + share[:, None, None] * (then - now), round_walls)

    def obstacles(self, z: float) -> Plan:
        """Return the objects that a robot can hit at height z [m]."""
        return self.plan(z)

    def see(self, z: float, times: Array, origin: Array, angle: Array, reach: float) -> Array:
        """Return the distance of each ray's first hit, (n,) [m], inf without a hit within about `reach`.

        Args:
            z: m, height of the rays.
            times: (n,) s of the drive, increasing, or (1,) for all rays.
            origin: (n, 2) m, map frame.
            angle: (n,) rad, map frame.
            reach: m.
        """
        return cast(self.plan(z, times), origin, angle)

    def magnetic(self, t: float, at: Array) -> Array:
        """Return the field (n, 2) [T] of active magnets at time t [s] and points (n, 2) [m, map frame]."""
        field = np.zeros_like(at)
        for fault in self.faults:
            if isinstance(fault, Magnetic) and fault.active(t):
                field = field + fault.field(at)
        return field

    def _red_objects(self, t: float) -> tuple[Pillar, ...]:
        return tuple(f.pillar() for f in self.faults if isinstance(f, RedObject) and f.active(t))

    def _people(self, present: float, t: float) -> tuple[Pillar, ...]:
        """Return legs and bodies of people at t [s], for faults that are active at time `present` [s]."""
        found = [f for f in self.faults if isinstance(f, People) and f.active(present)]
        return tuple(solid for person in found for solid in person.solids(t))


def _circles(pillars: tuple[Pillar, ...], z: float) -> Array:
    cut = [(p.x, p.y, p.radius) for p in pillars if p.bottom <= z <= p.top]
    return np.array(cut, float).reshape(-1, 3)


def cast(plan: Plan, origin: Array, angle: Array) -> Array:
    """Return the distance of each ray's first hit, (n,) [m], inf without a hit.

    Args:
        plan: segments, circles and rings.
        origin: (n, 2) m, map frame.
        angle: (n,) rad, map frame.
    """
    direction = np.stack((np.cos(angle), np.sin(angle)), axis=-1)
    rays = origin[:, None], direction[:, None]
    hits = (hit_segments(plan.segments, *rays), hit_circles(plan.circles, *rays), hit_rings(plan.rings, *rays))
    return np.asarray(np.concatenate(hits, axis=1).min(axis=1, initial=np.inf))


def hit_segments(segments: Array, origin: Array, direction: Array) -> Array:
    """Return the distances (...) [m] along rays (..., 2) to segments (..., 4), inf for a miss."""
    along = segments[..., 2:] - segments[..., :2]
    w, d = segments[..., :2] - origin, direction
    with np.errstate(divide="ignore", invalid="ignore"):
        denominator = d[..., 0] * along[..., 1] - d[..., 1] * along[..., 0]
        distance = (w[..., 0] * along[..., 1] - w[..., 1] * along[..., 0]) / denominator
        share = (w[..., 0] * d[..., 1] - w[..., 1] * d[..., 0]) / denominator
        hit = (distance > 0) & (share >= 0) & (share <= 1)
    return np.where(hit, distance, np.inf)


def hit_circles(circles: Array, origin: Array, direction: Array) -> Array:
    """Return the distances (...) [m] along rays (..., 2) to circles (..., 3), inf for a miss."""
    w = circles[..., :2] - origin
    ahead = (w * direction).sum(axis=-1)
    square = circles[..., 2] ** 2 - (w * w).sum(axis=-1) + ahead**2
    with np.errstate(invalid="ignore"):
        distance = ahead - np.sqrt(square)
        hit = (square >= 0) & (distance > 0)
    return np.where(hit, distance, np.inf)


def hit_rings(rings: Array, origin: Array, direction: Array) -> Array:
    """Return the distances (...) [m] along rays (..., 2) to round walls (..., 3) from inside; inf from outside."""
    w = rings[..., :2] - origin
    ahead = (w * direction).sum(axis=-1)
    inside = rings[..., 2] ** 2 - (w * w).sum(axis=-1)  # m^2, the power of the point: positive inside
    distance = ahead + np.sqrt(np.maximum(inside, 0.0) + ahead**2)
    return np.where(inside > 0, distance, np.inf)


def clearance(plan: Plan, points: Array) -> Array:
    """Return the distance (n,) [m] of points (n, 2) from the nearest object in the plan."""
    ax, ay, ex, ey = plan.segments.T
    ux, uy = ex - ax, ey - ay
    wx, wy = points[:, :1] - ax, points[:, 1:] - ay
    share = np.clip((wx * ux + wy * uy) / (ux * ux + uy * uy), 0.0, 1.0)
    to_walls = (wx - share * ux) ** 2 + (wy - share * uy) ** 2  # m^2
    to_circles = points[:, None] - plan.circles[None, :, :2]
    to_rings = points[:, None] - plan.rings[None, :, :2]
    gaps = (
        np.sqrt(to_walls.min(axis=1, keepdims=True, initial=np.inf)),
        np.hypot(to_circles[..., 0], to_circles[..., 1]) - plan.circles[:, 2],
        plan.rings[:, 2] - np.hypot(to_rings[..., 0], to_rings[..., 1]),
    )
    return np.asarray(np.concatenate(gaps, axis=1).min(axis=1, initial=np.inf))
