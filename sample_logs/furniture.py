"""Furniture in plan: the outlines of boxes and the legs of tables at the height of a sensor."""

from __future__ import annotations

import math

import numpy as np

from locfuse.fusion.data import Array

from .building import Box, Furniture, LeggedTable, SwivelChair

CORNERS = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) / 2


def outlines(pieces: tuple[Furniture, ...], z: float) -> Array:
    """Return the sides of all boxes that reach the height z [m], (4 k, 4) m, map frame."""
    return closed([corners(p) for p in pieces if isinstance(p, Box) and z < p.height])


def legs(pieces: tuple[Furniture, ...], z: float) -> Array:
    """Return all round legs at the height z [m] as circles (k, 3): x, y, radius, m, map frame."""
    found = []
    for p in pieces:
        if isinstance(p, SwivelChair) and z < p.height:
            found.append((*p.at, p.radius))
        elif isinstance(p, LeggedTable) and z < p.height:
            found += [(x, y, p.leg) for x, y in corners(p, inset=2 * p.leg).tolist()]
    return np.array(found, float).reshape(-1, 3)


def corners(piece: Box | LeggedTable, inset: float = 0.0) -> Array:
    """Return the four corners of a piece, counter-clockwise, `inset` m inside its sides, (4, 2) m, map frame."""
    c, s = math.cos(math.radians(piece.turn_deg)), math.sin(math.radians(piece.turn_deg))
    return np.asarray(CORNERS * (np.array(piece.size) - 2 * inset) @ np.array([[c, s], [-s, c]]) + piece.at)


def closed(polygons: list[Array]) -> Array:
    """Return the sides of closed polygons (k, 2) as segments, (m, 4) m."""
    sides = [np.concatenate((p, np.roll(p, -1, axis=0)), axis=1) for p in polygons]
    return np.concatenate(sides) if sides else np.zeros((0, 4))
