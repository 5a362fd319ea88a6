"""The walls of a building: the faces of a solid block after its spaces and openings are removed."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from locfuse.fusion.data import Array

from .building import Building, Opening, Space
from .table import Point, Segment

GRID = 1e-6  # m: coordinates closer than this are the same
Mask = NDArray[np.bool_]


def straight_walls(building: Building, size: Point) -> Array:
    """Return all wall faces as axis-parallel segments, (m, 4) m, map frame.

    A face ends where the wall turns or opens; it runs in the direction of increasing x or y.

    Args:
        building: its spaces and openings.
        size: m, between the centre lines of the outer walls, along x and y.
    """
    half = building.wall / 2
    outer: Segment = (-half, -half, size[0] + half, size[1] + half)
    rectangles = np.round(np.array([outer, *hollows(building)], float) / GRID) * GRID
    x, y = (np.unique(rectangles[:, [i, i + 2]]) for i in (0, 1))
    solid = _inside(rectangles[:1], x, y) & ~_inside(rectangles[1:], x, y)
    return np.array([*_faces(solid, x, y), *(s[[1, 0, 3, 2]] for s in _faces(solid.T, y, x))]).reshape(-1, 4)


def hollows(building: Building) -> list[Segment]:
    """Return the empty rectangles (west, south, east, north) of all spaces and openings."""
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
    """Return the rectangle of an opening: through the wall, or of a closed door its outer half."""
    at, inward = ends(space, opening)
    inner = at + (0.0 if opening.kind == "closed" else half) * inward
    corners = np.concatenate((inner, at - half * inward))
    (west, south), (east, north) = corners.min(axis=0).tolist(), corners.max(axis=0).tolist()
    return west, south, east, north


def _inside(rectangles: Array, x: Array, y: Array) -> Mask:
    """Return which cells of the grid of all coordinates lie in a rectangle, with a rim of outside cells."""
    mask = np.zeros((len(x) + 1, len(y) + 1), bool)
    for west, south, east, north in rectangles:
        i, j = np.searchsorted(x, (west, east)), np.searchsorted(y, (south, north))
        mask[i[0] + 1 : i[1] + 1, j[0] + 1 : j[1] + 1] = True
    return mask


def _faces(solid: Mask, x: Array, y: Array) -> list[Array]:
    """Return the faces parallel to y: runs of cell borders between solid and hollow."""
    found = []
    for i, between in enumerate(solid[1:] != solid[:-1]):
        # a face ends where solid and hollow change sides
        side = np.where(between, np.where(solid[i], 1, -1), 0)
        change = np.flatnonzero(np.diff(side))
        for first, last in pairwise(change):
            if side[last]:
                found.append(np.array([x[i], y[first], x[i], y[last]]))
    return found
