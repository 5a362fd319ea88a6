"""Scene of a building: bent walls, walking people, and ray casting through glass."""

from __future__ import annotations

import zlib
from typing import NamedTuple

import numpy as np

from locfuse.fusion.data import Array

from . import building_parts, walkers
from .building import Building
from .messages import streams
from .nearby import cast_near
from .scenario import Scenario
from .world import Plan, World, cast, hit_segments

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
        self.walks = [walkers.Walk(w, chance(f"walker {i}")) for i, w in enumerate(building.people)]
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
        moving = Plan(NO_SEGMENTS, walkers.circles(self.walks, times, z, origin[: len(times)]))
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
