"""Walls of an occupancy grid as map lines: contours are split at bends, and a line is fitted to each piece.

A contour is a chain of sides between occupied and free cells, with the free cell at its left.

Thick walls, as in a drawn plan, have their surface on the border of the cells. Walls of a single cell come from a
mapping program: the scanned surface lies in the middle of the cell.

The offset of a wall parallel to the grid is rounded to cells: it has one error of up to half a cell along the
whole wall. This is the covariance of these lines. They are considered states, so their covariance does not
decrease.
"""

from __future__ import annotations

import math
from collections import defaultdict

import msgspec
import numpy as np
from numpy.typing import NDArray

from locfuse.fusion import se2
from locfuse.fusion.data import Array, Ints, LocfuseError, MapLine

Mask = NDArray[np.bool_]


class Grid(msgspec.Struct, frozen=True):
    """Occupancy grid (rows, columns) with row 0, column 0 at the origin; a cell is occupied, free, or unknown."""

    occupied: Mask
    free: Mask
    cell: float  # m
    origin: Array  # (3,) x, y [m], yaw [rad] of the lower left corner of the first cell, map frame

    def to_map(self, places: Array) -> Array:
        """Convert points (n, 2), x and y in cells from the lower left corner, to the map frame [m]."""
        return np.asarray(se2.transform(self.origin, self.cell * places))


# for each side of an occupied cell: the step to the free neighbour (rows, columns), then start and end of the side
# (x, y) in cells; the free neighbour is at the left of the direction from start to end
CELL_SIDES = (
    ((0, 1), (1, 1), (1, 0)),
    ((0, -1), (0, 0), (0, 1)),
    ((1, 0), (0, 1), (1, 1)),
    ((-1, 0), (1, 0), (0, 0)),
)
MAX_SIDES = 1_000_000  # between occupied and free cells: 50 km in cells of 5 cm; each takes 10 us and 0.4 kB


def _sides(grid: Grid) -> tuple[Ints, Ints, Array, Mask]:
    """Return the cell sides between occupied and free cells, in cells: start, end and middle, (m, 2) each.

    Also return whether the wall is thin there (m,): no occupied cell lies behind the side's cell. Raises
    LocfuseError for more than MAX_SIDES.
    """
    starts, ends, points, thin, count = [], [], [], [], 0
    for (rows, columns), a, b in CELL_SIDES:
        border = grid.occupied & _shifted(grid.free, rows, columns)
        count += int(np.count_nonzero(border))
        if count > MAX_SIDES:
            words = f"walls have more than {MAX_SIDES} sides of cells next to free cells: no map but noise"
            raise LocfuseError(words, role="map")
        j, i = np.nonzero(border)
        at = np.stack((i, j), axis=-1)
        starts.append(at + np.array(a))
        ends.append(at + np.array(b))
        points.append(at + 0.5 + 0.5 * np.array([columns, rows]))
        thin.append(~_shifted(grid.occupied, -rows, -columns)[j, i])
    return np.concatenate(starts), np.concatenate(ends), np.concatenate(points), np.concatenate(thin)


def _shifted(cells: Mask, rows: int, columns: int) -> Mask:
    """Return for every cell the value of its neighbour at an offset; False outside the grid."""
    n, m = cells.shape
    return np.pad(cells, 1)[1 + rows : 1 + rows + n, 1 + columns : 1 + columns + m]


def _chains(starts: Ints, ends: Ints) -> list[list[int]]:
    """Return chains of connected sides (indices); where cells touch at a corner, a chain follows the wall."""
    width = int(max(starts.max(initial=0), ends.max(initial=0))) + 2
    of_start, of_end = (corner[:, 1] * width + corner[:, 0] for corner in (starts, ends))
    leaving: dict[int, list[int]] = defaultdict(list)
    for side, corner in enumerate(of_start.tolist()):
        leaving[corner].append(side)
    arriving = set(of_end.tolist())
    begins = [side for side, corner in enumerate(of_start.tolist()) if corner not in arriving]
    direction, target = (ends - starts).tolist(), of_end.tolist()
    used = np.zeros(len(starts), dtype=bool)
    found = []
    for first in (*begins, *range(len(starts))):
        chain, side = [], first
        while not used[side]:
            used[side] = True
            chain.append(side)
            onward = [other for other in leaving[target[side]] if not used[other]]
            if not onward:
                break
            dx, dy = direction[side]
            # with the free cell at the left, the sharpest right turn stays at this cell
            side = min(onward, key=lambda o: dx * direction[o][1] - dy * direction[o][0])
        if chain:
            found.append(chain)
    return found


MAX_DEVIATION_CELLS = 1.0  # cells: the rasterised line of a straight wall deviates by less
MIN_LENGTH_M, MIN_CELLS = 0.3, 5
OFFSET_FLOOR_M, ANGLE_FLOOR_RAD = 0.01, math.radians(0.1)  # least sigmas of a line: no plan is more exact


def walls_of(grid: Grid) -> list[MapLine]:
    """Return the map lines of all walls long enough, with normals that point away from the free side.

    Raises LocfuseError if there are too many cell sides.
    """
    least = max(MIN_LENGTH_M / grid.cell, float(MIN_CELLS))
    starts, ends, points, thin = _sides(grid)
    found: list[MapLine] = []
    for chain in _chains(starts, ends):
        for first, last in _straight(points[chain]):
            piece = chain[first : last + 1]
            if np.hypot(*(points[piece[-1]] - points[piece[0]])) + 1.0 >= least:
                found.append(_fitted(len(found), grid, points[piece], thin[piece]))
    return found


def _straight(chain: Array) -> list[tuple[int, int]]:
    """Return first and last index of the pieces of a chain (n, 2) that deviate less than MAX_DEVIATION_CELLS."""
    if len(chain) > 2 and np.hypot(*(chain[-1] - chain[0])) < 2.0:  # closed: split at the furthest point
        far = int(np.argmax(np.hypot(*(chain - chain[0]).T)))
        return [*_split(chain, 0, far), *_split(chain, far, len(chain) - 1)]
    return _split(chain, 0, len(chain) - 1)


def _split(chain: Array, first: int, last: int) -> list[tuple[int, int]]:
    """Split a chain recursively at the point furthest from the chord (Ramer 1972; Douglas and Peucker 1973)."""
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
        if away[k] <= MAX_DEVIATION_CELLS or k in {0, b - a}:
            done.append((a, b))
        else:
            todo += [(a + k, b), (a, a + k)]
    return done


def _fitted(number: int, grid: Grid, points: Array, thin: Mask) -> MapLine:
    """Return the map line fitted to cell sides (n, 2), without those at the ends, which belong to corners.

    Its covariance follows from the size of a cell and the scatter of the sides about the line. `thin` (n,) is
    whether the wall is a single cell thick.
    """
    inner = points[1:-1] if len(points) > 2 * MIN_CELLS else points
    middle = inner.mean(axis=0)
    values, vectors = np.linalg.eigh(np.cov((inner - middle).T))
    along = vectors[:, 1] if float(vectors[:, 1] @ (points[-1] - points[0])) > 0.0 else -vectors[:, 1]
    if 2 * np.count_nonzero(thin) > len(thin):  # to the middle of the cells; less for an oblique wall
        middle = middle + 0.5 / np.abs(along).sum() * np.array([along[1], -along[0]])
    ends = grid.to_map(np.stack([middle + ((p - middle) @ along) * along for p in (points[0], points[-1])]))
    scatter, rounding = grid.cell * math.sqrt(max(float(values[0]), 0.0)), grid.cell / math.sqrt(12.0)
    (dx, dy), length = ends[1] - ends[0], float(np.hypot(*(ends[1] - ends[0])))
    c, s = dy / length, -dx / length  # the normal points to the right: away from the free side
    lo, hi = (float(c * y - s * x) for x, y in ends)
    offset = math.hypot(rounding, OFFSET_FLOOR_M)
    angle = math.hypot(max(scatter, rounding) * math.sqrt(12.0) / length / 2.0, ANGLE_FLOOR_RAD)
    G = np.array([[1.0, 0.5 * (lo + hi)], [0.0, 1.0]])  # covariance about the middle -> about the map's origin
    P = G @ np.diag([offset**2, angle**2]) @ G.T
    return MapLine(number, float(c * ends[0, 0] + s * ends[0, 1]), math.atan2(s, c), (lo, hi), P, 0)
