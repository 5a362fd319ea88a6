"""Scene of a building: bent walls, walking people (two legs and a body), and ray casting through glass.

Rays are cast fast in a large plan: the rays of one scan begin close together, so the bearing of an object is
nearly the same for all of them. Only pairs of ray and object without a possible hit are left out; the others are
computed exactly.
"""

from __future__ import annotations

import math
import zlib
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from locfuse.fusion.data import Array

from . import building_parts
from .building import Building, Walker
from .messages import streams
from .scenario import Scenario
from .world import Plan, World, cast, hit_circles, hit_segments

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


SCREEN_HEIGHT_M = 1.5  # m, height of a thin wall
NO_SEGMENTS = np.zeros((0, 4))


class Solid(NamedTuple):
    """Static parts of a building at one height."""

    opaque: Plan
    panes: Array  # (g, 4) m, map frame


def scene_of(scenario: Scenario, seed: int) -> World:
    """Return the scene of a scenario (room or building), with its random parts drawn from the seed."""
    if scenario.building is None:
        return World(scenario)
    return BuildingScene(scenario, scenario.building, seed)


class BuildingScene(World):
    """Scene with a building instead of the walls and plates of a room."""

    def __init__(self, scenario: Scenario, building: Building, seed: int) -> None:
        super().__init__(scenario)
        self.plates = NO_SEGMENTS
        self.building = building
        self.seed = seed if building.seed is None else building.seed
        chance = streams(self.seed)
        self.walls = NO_SEGMENTS  # of the room: none, so that `plan` returns the other objects
        straight = building_parts.straight_walls(building, self.room.size)
        self.faces = building_parts.bent(straight, building.bow, chance)  # (m, 4) m
        self.walks = [Walk(w, chance(f"walker {i}")) for i, w in enumerate(building.people)]
        self._solid: dict[float, Solid] = {}

    def solid(self, z: float) -> Solid:
        """Return the static parts of the building at height z [m]."""
        if z not in self._solid:
            self._solid[z] = self._cut(z)
        return self._solid[z]

    def obstacles(self, z: float) -> Plan:
        """Return the objects that a robot can hit at height z [m], with glass but without people."""
        opaque, panes = self.solid(z)
        lasting = self.plan(z)
        segments = np.concatenate((opaque.segments, panes, lasting.segments))
        return Plan(segments, np.concatenate((opaque.circles, lasting.circles)))

    def see(self, z: float, times: Array, origin: Array, angle: Array, reach: float) -> Array:
        """Return the distance of each ray's first hit, (n,) [m], inf without a hit within about `reach`."""
        moving = Plan(NO_SEGMENTS, circles(self.walks, times, z, origin[: len(times)]))
        echoes = (
            cast_near(self.solid(z).opaque, origin, angle, reach),
            cast(moving, origin, angle),
            cast(self.plan(z, times), origin, angle),
            self._through_glass(z, float(times[0]), origin, angle),
        )
        return np.asarray(np.min(echoes, axis=0))

    def _through_glass(self, z: float, t: float, origin: Array, angle: Array) -> Array:
        """Return the distances at which panes reflect rays, (n,) [m], inf for none; random for each time t [s]."""
        panes = self.solid(z).panes
        direction = np.stack((np.cos(angle), np.sin(angle)), axis=-1)
        distance = hit_segments(panes, origin[:, None], direction[:, None])
        name = zlib.crc32(b"glass"), round(t * 1e9)
        chance = np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=name)).random(distance.shape)
        echoes = building_parts.returned(distance, panes, direction, self.building.glass, chance)
        return np.asarray(echoes.min(axis=1, initial=np.inf))

    def _cut(self, z: float) -> Solid:
        pieces = tuple(p for space in self.building.spaces for p in space.furniture)
        screens = np.array(self.building.screens if z < SCREEN_HEIGHT_M else (), float).reshape(-1, 4)
        still = (
            self.faces,
            building_parts.posts(self.building),
            building_parts.leaves(self.building),
            screens,
            building_parts.outlines(pieces, z),
        )
        opaque = Plan(np.concatenate(still), building_parts.legs(pieces, z))
        return Solid(opaque, building_parts.panes(self.building))
