"""Walls of an occupancy grid as map lines: chains of cells are split where they bend, and each piece is fitted.

A face lies on the border of its cells where the wall is thick, as on a drawn plan. A wall of a single cell is what
a mapping program leaves of a surface that scans hit: it lies in the middle of that cell.

A wall along the grid is rounded to cells as a whole, so its offset is wrong by up to half a cell, the same one all
along. That is the covariance of these lines: they are considered, and never become better known.
"""

from __future__ import annotations

import math

import numpy as np

from locfuse.fusion.data import Array, MapLine

from .given_contours import Chain, contours
from .given_grid import Grid

BEND = 1.0  # cells: the staircase of a straight wall deviates by less
MIN_LENGTH_M, MIN_CELLS = 0.3, 5
OFFSET_FLOOR_M, ANGLE_FLOOR_RAD = 0.01, math.radians(0.1)  # nobody draws or builds better


def walls_of(grid: Grid) -> list[MapLine]:
    """Return the walls that are long enough to be seen as lines, their normals away from the free side."""
    least = max(MIN_LENGTH_M / grid.cell, float(MIN_CELLS))
    found: list[MapLine] = []
    for chain in contours(grid):
        for first, last in _straight(chain.points):
            piece = Chain(chain.points[first : last + 1], chain.thin[first : last + 1])
            if np.hypot(*(piece.points[-1] - piece.points[0])) + 1.0 >= least:
                found.append(_fitted(len(found), grid, piece))
    return found


def _straight(chain: Array) -> list[tuple[int, int]]:
    """Return first and last point of the pieces of a chain (n, 2) that leave their chord by less than BEND."""
    if len(chain) > 2 and np.hypot(*(chain[-1] - chain[0])) < 2.0:  # it closes: begin where it is furthest
        far = int(np.argmax(np.hypot(*(chain - chain[0]).T)))
        return [*_split(chain, 0, far), *_split(chain, far, len(chain) - 1)]
    return _split(chain, 0, len(chain) - 1)


def _split(chain: Array, first: int, last: int) -> list[tuple[int, int]]:
    """Split at the point furthest from the chord, as often as it takes (Ramer 1972; Douglas and Peucker 1973)."""
    todo, done = [(first, last)], []
    while todo:
        a, b = todo.pop()
        if b - a < 2:
            done.append((a, b))
            continue
        chord = chain[b] - chain[a]
        length = float(np.hypot(*chord))
        off = chain[a : b + 1] - chain[a]
        away = np.abs(off[:, 0] * chord[1] - off[:, 1] * chord[0]) / length if length > 0.0 else np.hypot(*off.T)
        k = int(np.argmax(away))
        if away[k] <= BEND or k in {0, b - a}:
            done.append((a, b))
        else:
            todo += [(a + k, b), (a, a + k)]
    return done


def _fitted(number: int, grid: Grid, piece: Chain) -> MapLine:
    """Return the line through a piece, its ends' cells left out: they belong to a corner."""
    points = piece.points
    inner = points[1:-1] if len(points) > 2 * MIN_CELLS else points
    middle = inner.mean(axis=0)
    values, vectors = np.linalg.eigh(np.cov((inner - middle).T))
    along = vectors[:, 1] if float(vectors[:, 1] @ (points[-1] - points[0])) > 0.0 else -vectors[:, 1]
    if 2 * np.count_nonzero(piece.thin) > len(piece.thin):  # half a cell; across the grid its sides lie nearer
        middle = middle + 0.5 / np.abs(along).sum() * np.array([along[1], -along[0]])
    ends = grid.to_map(np.stack([middle + ((p - middle) @ along) * along for p in (points[0], points[-1])]))
    scatter = grid.cell * math.sqrt(max(float(values[0]), 0.0))
    return _line(number, ends, grid.cell, scatter)


def _line(number: int, ends: Array, cell: float, scatter: float) -> MapLine:
    """Return the line between two ends (2, 2) [m], seen from its left, as uncertain as cells leave it."""
    (dx, dy), length = ends[1] - ends[0], float(np.hypot(*(ends[1] - ends[0])))
    c, s = dy / length, -dx / length  # the normal lies to the right of the way: away from the free side
    lo, hi = (float(c * y - s * x) for x, y in ends)
    offset = math.hypot(cell / math.sqrt(12.0), OFFSET_FLOOR_M)
    angle = math.hypot(max(scatter, cell / math.sqrt(12.0)) * math.sqrt(12.0) / length / 2.0, ANGLE_FLOOR_RAD)
    G = np.array([[1.0, 0.5 * (lo + hi)], [0.0, 1.0]])  # from the middle of the wall to the map's origin
    P = G @ np.diag([offset**2, angle**2]) @ G.T
    return MapLine(number, float(c * ends[0, 0] + s * ends[0, 1]), math.atan2(s, c), (lo, hi), P, 0)
