"""Scene of a building: bent walls, walking people (two legs and a body), and ray casting through glass.

Rays are cast fast in a large plan: the rays of one scan begin close together, so the bearing of an object is
nearly the same for all of them. Only pairs of ray and object without a possible hit are left out; the others are
computed exactly.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable
from functools import cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from locfuse.fusion.data import Array, Mask

from .scenario import Box, Building, Furniture, LeggedTable, Opening, Scenario, Space, SwivelChair, Walker
from .table import Point, Streams, streams
from .world import Plan, World, cast, hit_circles, hit_segments

SAME_PLACE_M = 1e-6  # m, largest difference of equal coordinates
MAX_PIECE_M = 0.6  # m, longest segment of a bent face
WAVELENGTHS_M = np.geomspace(4.0, 40.0, 7)  # m, wavelengths of a deviation
BOW_LENGTH_M = 100.0  # m, length of wall on which a deviation is at most the bow
CORNERS = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) / 2

Deviation = Callable[[Array], Array]


def straight_walls(building: Building, size: Point) -> Array:
    """Return all wall faces as axis-parallel segments, (m, 4) [m, map frame].

    A face ends at corners and openings; its direction is that of increasing x or y.

    Args:
        building: spaces and openings.
        size: m, between the centre lines of the outer walls, along x and y.
    """
    half = building.wall / 2
    parts = [(-half, -half, size[0] + half, size[1] + half)]  # the block, then all that is empty
    for space in building.spaces:
        west, south, east, north = space.area
        parts.append((west + half, south + half, east - half, north - half))
        for opening in space.openings:  # through the whole wall, of a closed door its outer half
            at, inward = ends(space, opening)
            inner = at + (0.0 if opening.kind == "closed" else half) * inward
            corners = np.concatenate((inner, at - half * inward))
            (west, south), (east, north) = corners.min(axis=0).tolist(), corners.max(axis=0).tolist()
            parts.append((west, south, east, north))
    rectangles = np.round(np.array(parts, float) / SAME_PLACE_M) * SAME_PLACE_M
    x, y = (np.unique(rectangles[:, [i, i + 2]]) for i in (0, 1))
    solid = _inside(rectangles[:1], x, y) & ~_inside(rectangles[1:], x, y)
    return np.array([*_faces(solid, x, y), *(s[[1, 0, 3, 2]] for s in _faces(solid.T, y, x))]).reshape(-1, 4)


def ends(space: Space, opening: Opening) -> tuple[Array, Array]:
    """Return both ends of an opening on the centre line of its wall, and the unit vector into the space.

    Returns:
        (2, 2) m and (2,), map frame.
    """
    west, south, east, north = space.area
    along = opening.at + opening.width / 2 * np.array([-1.0, 1.0])
    if opening.side in {"south", "north"}:
        y = south if opening.side == "south" else north
        inward = 1.0 if opening.side == "south" else -1.0
        return np.stack((along, np.full(2, y)), axis=-1), np.array([0.0, inward])
    x = west if opening.side == "west" else east
    return np.stack((np.full(2, x), along), axis=-1), np.array([1.0 if opening.side == "west" else -1.0, 0.0])


def _inside(rectangles: Array, x: Array, y: Array) -> Mask:
    """Return the mask (len(x) + 1, len(y) + 1) of grid cells that lie in a rectangle.

    The grid lines are at the sorted coordinates x and y; the outer cells of the mask are outside the grid.
    """
    mask = np.zeros((len(x) + 1, len(y) + 1), bool)
    for west, south, east, north in rectangles:
        i, j = np.searchsorted(x, (west, east)), np.searchsorted(y, (south, north))
        mask[i[0] + 1 : i[1] + 1, j[0] + 1 : j[1] + 1] = True
    return mask


def _faces(solid: Mask, x: Array, y: Array) -> list[Array]:
    """Return the wall faces parallel to y: runs of cell borders between solid and empty cells."""
    found = []
    for i, between in enumerate(solid[1:] != solid[:-1]):
        # a face ends where solid and empty change sides
        side = np.where(between, np.where(solid[i], 1, -1), 0)
        change = np.flatnonzero(np.diff(side))
        for first, last in pairwise(change):
            if side[last]:
                found.append(np.array([x[i], y[first], x[i], y[last]]))
    return found


def bent(faces: Array, bow: float, streams: Streams) -> Array:
    """Replace straight faces (m, 4) by chains of short segments (k, 4) [m] that deviate smoothly from each face.

    Args:
        faces: m, map frame.
        bow: m, how far a face may deviate from its line.
        streams: random streams; each line has its own.
    """
    if bow == 0.0 or not len(faces):
        return faces

    @cache
    def line(axis: int, offset: float) -> Deviation:  # the deviation of the line x (axis 0) or y (axis 1) = offset
        return deviation(bow, streams(f"wall {'xy'[axis]} = {offset:.6f}"))

    return np.concatenate([_chain(face, line) for face in faces])


def deviation(bow: float, rng: np.random.Generator) -> Deviation:
    """Return a random smooth function from position along a wall [m] to deviation [m], at most `bow`."""
    amplitude = np.sqrt(WAVELENGTHS_M) * rng.standard_normal(len(WAVELENGTHS_M))
    phase = rng.uniform(0, 2 * np.pi, len(WAVELENGTHS_M))

    def waves(s: Array) -> Array:
        return np.asarray(np.sin(2 * np.pi * s[:, None] / WAVELENGTHS_M + phase) @ amplitude)

    most = np.abs(waves(np.arange(-1.0, BOW_LENGTH_M, 0.1))).max()
    scale = bow * rng.uniform(0.5, 1.0) / most
    return lambda s: scale * waves(s)


def _chain(face: Array, line: Callable[[int, float], Deviation]) -> Array:
    """Return a face as a chain of segments, (k, 4); its ends stay on the deviating lines of both walls."""
    across = 0 if face[0] == face[2] else 1  # the coordinate that is constant
    along = 1 - across
    offset, begin, end = float(face[across]), float(face[along]), float(face[along + 2])
    s = np.linspace(begin, end, max(1, int(np.ceil((end - begin) / MAX_PIECE_M))) + 1)
    points = np.empty((len(s), 2))
    points[:, across] = offset + line(across, round(offset, 6))(s)
    points[:, along] = s
    for i, at in ((0, begin), (-1, end)):
        points[i, along] += line(along, round(at, 6))(np.array([offset]))[0]
    return np.concatenate((points[:-1], points[1:]), axis=1)


def legs(pieces: tuple[Furniture, ...], z: float) -> Array:
    """Return the round legs at height z [m] as circles (k, 3): x, y, radius [m, map frame]."""
    found = []
    for p in pieces:
        if isinstance(p, SwivelChair) and z < p.height:
            found.append((*p.at, p.radius))
        elif isinstance(p, LeggedTable) and z < p.height:
            found += [(x, y, p.leg) for x, y in corners(p, inset=2 * p.leg).tolist()]
    return np.array(found, float).reshape(-1, 3)


def corners(piece: Box | LeggedTable, inset: float = 0.0) -> Array:
    """Return the corners (4, 2) [m, map frame] of a piece, counter-clockwise, `inset` [m] inside its sides."""
    c, s = math.cos(math.radians(piece.turn_deg)), math.sin(math.radians(piece.turn_deg))
    return np.asarray(CORNERS * (np.array(piece.size) - 2 * inset) @ np.array([[c, s], [-s, c]]) + piece.at)


def closed(polygons: list[Array]) -> Array:
    """Return the sides of closed polygons (k, 2) [m] as segments, (m, 4) [m]."""
    sides = [np.concatenate((p, np.roll(p, -1, axis=0)), axis=1) for p in polygons]
    return np.concatenate(sides) if sides else np.zeros((0, 4))


def leaves(building: Building) -> Array:
    """Return the open door leaves, (k, 4) [m, map frame], hinged at the lower end of the opening."""
    found = []
    for space in building.spaces:
        for opening in (o for o in space.openings if o.kind == "door" and o.leaf_deg):
            (low, high), inward = ends(space, opening)
            hinge = low + building.wall / 2 * inward
            closed_leaf, angle = high - low, math.radians(opening.leaf_deg)
            tip = hinge + math.cos(angle) * closed_leaf + math.sin(angle) * opening.width * inward
            found.append(np.concatenate((hinge, tip)))
    return np.array(found).reshape(-1, 4)


def panes(building: Building) -> Array:
    """Return the panes of all glass openings, (g, 4) [m, map frame]; both ends are inside the walls."""
    found = []
    for wall in glass_walls(building):
        along = (wall[1] - wall[0]) / np.hypot(*(wall[1] - wall[0]))
        found.append(np.concatenate((wall[0] - building.bow * along, wall[1] + building.bow * along)))
    return np.array(found).reshape(-1, 4)


def posts(building: Building) -> Array:
    """Return the sides of the square posts between panes, (4 k, 4) [m]."""
    squares = []
    for begin, end in glass_walls(building):
        n = math.ceil(float(np.hypot(*(end - begin))) / building.glass.post_every)
        middles = [begin + (end - begin) * i / n for i in range(1, n)]
        squares += [building.glass.post * CORNERS + middle for middle in middles]
    return closed(squares)


def glass_walls(building: Building) -> list[Array]:
    """Return the two ends of each glass opening, (2, 2) [m, map frame]."""
    return [ends(s, o)[0] for s in building.spaces for o in s.openings if o.kind == "glass"]


# --- Walking people, and ray casting

Indices = NDArray[np.intp]
FULL_TURN_RAD = 2 * np.pi
ROUNDING_SLACK = 1e-6  # rad and m, against rounding errors


def cast_near(plan: Plan, origin: Array, angle: Array, reach: float) -> Array:
    """Return the distance of each ray's first hit, (n,) [m], inf without a hit within `reach` [m].

    Args:
        plan: segments and circles; circles may not move.
        origin: (n, 2) m, map frame; the rays of one scan begin close together.
        angle: (n,) rad, map frame.
        reach: m.
    """
    low, high = origin.min(axis=0), origin.max(axis=0)
    middle, spread = (low + high) / 2, float(np.hypot(*(high - low))) / 2  # every origin lies within `spread`
    a, b = plan.segments[:, :2] - middle, plan.segments[:, 2:] - middle
    along = b - a
    share = np.clip(-(a * along).sum(axis=1) / np.maximum((along * along).sum(axis=1), ROUNDING_SLACK**2), 0, 1)
    nearest = a + share[:, None] * along
    turn = np.arctan2(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0], (a * b).sum(axis=1))
    to, radius = plan.circles[:, :2] - middle, plan.circles[:, 2]
    distance = np.hypot(to[:, 0], to[:, 1])
    # of every segment and circle: its distance, the bearing of its middle, half the angle that it covers
    gap = np.concatenate((np.hypot(nearest[:, 0], nearest[:, 1]), distance - radius))
    centre = np.concatenate((np.arctan2(a[:, 1], a[:, 0]) + turn / 2, np.arctan2(to[:, 1], to[:, 0])))
    width = np.concatenate((np.abs(turn) / 2, np.arcsin(np.minimum(radius / np.maximum(distance, radius), 1.0))))
    near = np.flatnonzero(gap <= reach + spread + ROUNDING_SLACK)
    ray, pair = _pairs(angle, centre[near], width[near], gap[near], spread)
    thing, direction = near[pair], np.stack((np.cos(angle), np.sin(angle)), axis=-1)
    found = np.full(len(angle), np.inf)
    straight = thing < len(a)
    for some, hit, shapes in ((straight, hit_segments, plan.segments), (~straight, hit_circles, plan.circles)):
        rows = thing[some] - (0 if hit is hit_segments else len(a))
        np.minimum.at(found, ray[some], hit(shapes[rows], origin[ray[some]], direction[ray[some]]))
    return np.where(found <= reach, found, np.inf)


def _pairs(angle: Array, centre: Array, width: Array, gap: Array, spread: float) -> tuple[Indices, Indices]:
    """Return pairs (p,) of ray and object where the ray may hit the object.

    Args:
        angle: (n,) rad, of the rays.
        centre: (m,) rad, bearing of each object from the middle of the origins.
        width: (m,) rad, half the angle that the object covers.
        gap: (m,) m, distance of the object; the bearing of a near object depends on the origin of the ray.
        spread: m, largest distance of an origin from the middle.
    """
    n, order = len(angle), np.argsort(angle % FULL_TURN_RAD)
    bearing = (angle % FULL_TURN_RAD)[order]
    twice = np.concatenate((bearing, bearing + FULL_TURN_RAD))
    parallax = np.where(gap > spread, np.arcsin(np.minimum(spread / np.maximum(gap, ROUNDING_SLACK), 1.0)), np.pi)
    half = width + parallax + ROUNDING_SLACK
    first_bearing = (centre - half) % FULL_TURN_RAD
    first = np.searchsorted(twice, first_bearing, side="left")
    last = np.searchsorted(twice, first_bearing + 2 * half, side="right")
    count = np.where(half >= np.pi, n, np.minimum(last - first, n))
    thing = np.repeat(np.arange(len(centre)), count)
    within = np.arange(len(thing)) - np.repeat(np.cumsum(count) - count, count)
    return order[(first[thing] + within) % n], thing


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
        straight = straight_walls(building, self.room.size)
        self.faces = bent(straight, building.bow, chance)  # (m, 4) m
        self.walks = [Walk(w, chance(f"walker {i}")) for i, w in enumerate(building.people)]
        self.panes = panes(building)  # (g, 4) m, map frame
        self._solid: dict[float, Plan] = {}

    def solid(self, z: float) -> Plan:
        """Return the static parts of the building at height z [m], without glass."""
        if z not in self._solid:
            pieces = tuple(p for space in self.building.spaces for p in space.furniture)
            boxes = [corners(p) for p in pieces if isinstance(p, Box) and z < p.height]
            still = (
                self.faces,
                posts(self.building),
                leaves(self.building),
                np.array(self.building.screens if z < SCREEN_HEIGHT_M else (), float).reshape(-1, 4),
                closed(boxes),
            )
            self._solid[z] = Plan(np.concatenate(still), legs(pieces, z))
        return self._solid[z]

    def obstacles(self, z: float) -> Plan:
        """Return the objects that a robot can hit at height z [m], with glass but without people."""
        opaque, lasting = self.solid(z), self.plan(z)
        segments = np.concatenate((opaque.segments, self.panes, lasting.segments))
        return Plan(segments, np.concatenate((opaque.circles, lasting.circles)))

    def see(self, z: float, times: Array, origin: Array, angle: Array, reach: float) -> Array:
        """Return the distance of each ray's first hit, (n,) [m], inf without a hit within about `reach`."""
        moving = Plan(NO_SEGMENTS, circles(self.walks, times, z, origin[: len(times)]))
        echoes = (
            cast_near(self.solid(z), origin, angle, reach),
            cast(moving, origin, angle),
            cast(self.plan(z, times), origin, angle),
            self._through_glass(float(times[0]), origin, angle),
        )
        return np.asarray(np.min(echoes, axis=0))

    def _through_glass(self, t: float, origin: Array, angle: Array) -> Array:
        """Return the distances at which panes reflect rays, (n,) [m], inf for none; random for each time t [s]."""
        panes, glass = self.panes, self.building.glass
        direction = np.stack((np.cos(angle), np.sin(angle)), axis=-1)
        distance = hit_segments(panes, origin[:, None], direction[:, None])
        name = zlib.crc32(b"glass"), round(t * 1e9)
        chance = np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=name)).random(distance.shape)
        along = panes[:, 2:] - panes[:, :2]
        normal = np.stack((-along[:, 1], along[:, 0]), axis=-1) / np.hypot(along[:, 0], along[:, 1])[:, None]
        steep = np.abs(direction @ normal.T) >= math.cos(math.radians(glass.within_deg))
        echoes = np.where(steep & (chance < glass.returns), distance, np.inf)
        return np.asarray(echoes.min(axis=1, initial=np.inf))
