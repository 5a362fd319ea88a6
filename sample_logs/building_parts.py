"""Static parts of a building in plan: bent walls, open doors, glass, furniture.

Walls are the faces of a solid block after its spaces and openings are removed. Every face deviates smoothly from
its straight line. All faces on one straight line share one smooth function, so that a wall is continuous across a
doorway. Faces become chains of short segments, which are closed at the corners.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import pairwise

import numpy as np

from locfuse.fusion.data import Array, Mask

from .building import Box, Building, Furniture, Glass, LeggedTable, Opening, Space, SwivelChair
from .messages import Streams
from .table import Point, Segment

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
    outer: Segment = (-half, -half, size[0] + half, size[1] + half)
    rectangles = np.round(np.array([outer, *hollows(building)], float) / SAME_PLACE_M) * SAME_PLACE_M
    x, y = (np.unique(rectangles[:, [i, i + 2]]) for i in (0, 1))
    solid = _inside(rectangles[:1], x, y) & ~_inside(rectangles[1:], x, y)
    return np.array([*_faces(solid, x, y), *(s[[1, 0, 3, 2]] for s in _faces(solid.T, y, x))]).reshape(-1, 4)


def hollows(building: Building) -> list[Segment]:
    """Return the empty rectangles (west, south, east, north) [m] of all spaces and openings."""
    half = building.wall / 2
    found = []
    for space in building.spaces:
        west, south, east, north = space.area
        found.append((west + half, south + half, east - half, north - half))
        found += [_hole(space, opening, half) for opening in space.openings]
    return found


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


def _hole(space: Space, opening: Opening, half: float) -> Segment:
    """Return the rectangle of an opening: through the whole wall, or its outer half for a closed door."""
    at, inward = ends(space, opening)
    inner = at + (0.0 if opening.kind == "closed" else half) * inward
    corners = np.concatenate((inner, at - half * inward))
    (west, south), (east, north) = corners.min(axis=0).tolist(), corners.max(axis=0).tolist()
    return west, south, east, north


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
    lines = _Lines(bow, streams)
    return np.concatenate([_chain(face, lines) for face in faces])


def deviation(bow: float, rng: np.random.Generator) -> Deviation:
    """Return a random smooth function from position along a wall [m] to deviation [m], at most `bow`."""
    amplitude = np.sqrt(WAVELENGTHS_M) * rng.standard_normal(len(WAVELENGTHS_M))
    phase = rng.uniform(0, 2 * np.pi, len(WAVELENGTHS_M))

    def waves(s: Array) -> Array:
        return np.asarray(np.sin(2 * np.pi * s[:, None] / WAVELENGTHS_M + phase) @ amplitude)

    most = np.abs(waves(np.arange(-1.0, BOW_LENGTH_M, 0.1))).max()
    scale = bow * rng.uniform(0.5, 1.0) / most
    return lambda s: scale * waves(s)


class _Lines:
    """Random deviations of wall lines, drawn on first use."""

    def __init__(self, bow: float, streams: Streams) -> None:
        self.bow, self.streams = bow, streams
        self.known: dict[tuple[int, float], Deviation] = {}

    def off(self, axis: int, offset: float, s: Array) -> Array:
        """Return the deviations (n,) [m] of a wall line at positions s (n,) [m] along it.

        The undisturbed line is x = `offset` for axis 0 and y = `offset` for axis 1.
        """
        key = axis, round(offset, 6)
        if key not in self.known:
            name = f"wall {'xy'[axis]} = {key[1]:.6f}"
            self.known[key] = deviation(self.bow, self.streams(name))
        return self.known[key](s)


def _chain(face: Array, lines: _Lines) -> Array:
    """Return a face as a chain of segments, (k, 4); its ends stay on the deviating lines of both walls."""
    across = 0 if face[0] == face[2] else 1  # the coordinate that is constant
    along = 1 - across
    offset, begin, end = float(face[across]), float(face[along]), float(face[along + 2])
    s = np.linspace(begin, end, max(1, int(np.ceil((end - begin) / MAX_PIECE_M))) + 1)
    points = np.empty((len(s), 2))
    points[:, across] = offset + lines.off(across, offset, s)
    points[:, along] = s
    for i, at in ((0, begin), (-1, end)):
        points[i, along] += lines.off(along, at, np.array([offset]))[0]
    return np.concatenate((points[:-1], points[1:]), axis=1)


def outlines(pieces: tuple[Furniture, ...], z: float) -> Array:
    """Return the sides of all boxes that are higher than z [m], (4 k, 4) [m, map frame]."""
    return closed([corners(p) for p in pieces if isinstance(p, Box) and z < p.height])


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


def returned(distance: Array, pane: Array, direction: Array, glass: Glass, chance: Array) -> Array:
    """Return the distances (n, g) [m] at which panes reflect rays; inf where the beam passes.

    Args:
        distance: (n, g) m, of every ray to every pane, inf for a miss.
        pane: (g, 4) m, map frame.
        direction: (n, 2) of the rays, unit length.
        glass: largest angle to the normal, and probability of an echo.
        chance: (n, g) random numbers, uniform in [0, 1).
    """
    along = pane[:, 2:] - pane[:, :2]
    normal = np.stack((-along[:, 1], along[:, 0]), axis=-1) / np.hypot(along[:, 0], along[:, 1])[:, None]
    steep = np.abs(direction @ normal.T) >= math.cos(math.radians(glass.within_deg))
    return np.where(steep & (chance < glass.returns), distance, np.inf)
