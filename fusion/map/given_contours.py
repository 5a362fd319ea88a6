"""Where occupied cells meet free ones: chains of points along the faces of walls, the free side at their left."""

from __future__ import annotations

from collections import defaultdict
from typing import NamedTuple

import numpy as np

from locfuse.fusion.data import Array, Ints, LocfuseError

from .given_grid import Grid, Mask

# of each side of an occupied cell: the step to the free neighbour (rows, columns), then start and end of the side
# (x, y) in cells, walked with the free neighbour at the left
SIDES = (
    ((0, 1), (1, 1), (1, 0)),
    ((0, -1), (0, 0), (0, 1)),
    ((1, 0), (0, 1), (1, 1)),
    ((-1, 0), (1, 0), (0, 0)),
)
MAX_SIDES = 1_000_000  # of cells at free ones: 50 km in cells of 5 cm; each takes 10 us and 0.4 kB


class Chain(NamedTuple):
    """The sides of cells along a wall, one after another."""

    points: Array  # (n, 2) their middles, in cells from the lower left corner
    thin: Mask  # (n,) whether the wall is a single cell thick there


def contours(grid: Grid) -> list[Chain]:
    """Return the chains of all walls. Raises LocfuseError where they are too many."""
    starts, ends, points, thin = _sides(grid)
    return [Chain(points[chain], thin[chain]) for chain in _chains(starts, ends)]


def _sides(grid: Grid) -> tuple[Ints, Ints, Array, Mask]:
    """Return the corners (m, 2) from and to which every side leads, its middle (m, 2), and Chain.thin (m,)."""
    starts, ends, points, thin, count = [], [], [], [], 0
    for (rows, columns), a, b in SIDES:
        border = grid.occupied & _shifted(grid.free, rows, columns)
        count += int(np.count_nonzero(border))
        if count > MAX_SIDES:
            raise LocfuseError(
                f"walls have more than {MAX_SIDES} sides of cells next to free cells: no map but noise", role="map"
            )
        j, i = np.nonzero(border)
        at = np.stack((i, j), axis=-1)
        starts.append(at + np.array(a))
        ends.append(at + np.array(b))
        points.append(at + 0.5 + 0.5 * np.array([columns, rows]))
        thin.append(~_shifted(grid.occupied, -rows, -columns)[j, i])
    return np.concatenate(starts), np.concatenate(ends), np.concatenate(points), np.concatenate(thin)


def _shifted(cells: Mask, rows: int, columns: int) -> Mask:
    """Return of every cell its neighbour's value; outside there is none."""
    out = np.zeros_like(cells)
    n, m = cells.shape
    to = (slice(max(0, -rows), n - max(0, rows)), slice(max(0, -columns), m - max(0, columns)))
    of = (slice(max(0, rows), n + min(0, rows)), slice(max(0, columns), m + min(0, columns)))
    out[to] = cells[of]
    return out


def _chains(starts: Ints, ends: Ints) -> list[list[int]]:
    """Return sides that lead from one to the next; where cells touch at a corner, a wall is followed round it."""
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
            # with the free side at the left, the sharpest turn to the right stays with this cell
            side = min(onward, key=lambda o: dx * direction[o][1] - dy * direction[o][0])
        if chain:
            found.append(chain)
    return found
