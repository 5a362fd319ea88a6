"""A given map: walls of an occupancy grid as map lines, and the start pose of a drive in it.

Contours of the grid are split at bends, and a line is fitted to each piece.

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
from itertools import product
from typing import NamedTuple

import msgspec
import numpy as np

from locfuse.fusion import se2
from locfuse.fusion.data import Array, Ints, LocfuseError, MapLine, Mask, Points, evenly, totals
from locfuse.fusion.wheels.motion import Wheels


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


# ---- start pose: all free positions and headings are compared with the first scans of a drive ----
#
# After the first scan many poses are possible, since corridors and rooms are similar. Each pose is moved by wheel
# odometry and compared with the later scans. The start is found if one pose matches all scans clearly better than
# every other pose (multi-hypothesis localisation; the score is the likelihood field of Thrun, Burgard and Fox
# 2005, 6.4, as a share of the beams; only beams through free cells count). If no pose matches, the map is of
# another building.

SPACING_M, HEADING_COUNT = 0.3, 72  # grid of the poses tried with the first scan
MAX_TRIED = 10_000_000  # poses (positions times headings): a free floor of 100 m x 100 m has 8 million
MAX_BEAMS, FIRST_BEAMS = 60, 30  # evenly spaced beams of a scan; the same for the first scan
NEAR_M, FAR_M = 0.15, 0.5  # distance from the nearest wall at which a beam counts fully, and not at all
# poses kept after the first scan, and least number kept: each further scan removes half of them
FIRST_PLACES, MIN_PLACES = 2000, 200
STRIDE_M, TURN_RAD = 0.4, math.radians(20.0)  # between two used scans
DRIVING_S = 30.0  # s of driving that are used
CLEAR_AT = (0.35, 0.75)  # at these shares of its length a beam must be in a free cell
MIN_SCANS = 5
# least mean share of the beams that end at walls: other beams hit people and furniture
MIN_SHARE = 0.85
# least difference of the best pose's share to all others: sum over all scans, and mean
MIN_LEAD_SCANS, MIN_LEAD_SHARE = 0.35, 0.02
APART_M, APART_RAD = 0.5, math.radians(20.0)  # poses further apart are different
SAME_M, SAME_RAD = 0.15, math.radians(4.0)  # poses closer together are equal
MOVE_DIRECTIONS = np.array(list(product((-1.0, 0.0, 1.0), repeat=3)))  # of the steps that refine a pose
MOVES_M_RAD = ((0.1, math.radians(2.0)), (0.05, math.radians(1.0)))  # step sizes
ROUNDS_PER_SIZE = 2  # steps of each size
MIN_SPEED = 1e-3  # m/s, rad/s
START_HINT = "say where the drive begins: --set start.x=... --set start.y=... --set start.theta_deg=... "
START_HINT += "--set start.sigma_xy=0.5"


class StartPose(NamedTuple):
    """Pose of the robot at its first scan, and the share of beams that match the map there."""

    pose: Array  # (3,) at time `t`, map frame
    t: float  # s: of the first scan
    until: float  # s: of the last used scan
    share: float  # of the beams that end at walls


def find_start(grid: Grid, t: Array, points: Points, wheels: Wheels) -> StartPose:
    """Return the pose at the first scan, from the scans at times t (n,) in the first DRIVING_S s of driving.

    Raises LocfuseError if no pose matches, if several match, or if there are more than MAX_TRIED poses to try.
    """
    places, seen = _Places(grid), list[int]()
    rows = _rows(t, wheels)
    for row, scan in zip(rows.tolist(), points.read(rows), strict=True):
        if len(scan) < FIRST_BEAMS:
            continue
        places.look(scan, wheels.relative(t[[seen[-1]]], t[[row]])[0] if seen else None)
        seen.append(row)
    if places.is_decided():
        return StartPose(places.pose(), float(t[seen[0]]), float(t[seen[-1]]), places.best)
    raise LocfuseError(_no_place(places, float(t[rows[-1]]) if len(rows) else 0.0), role="map")


def at_start(found: StartPose, wheels: Wheels) -> Array:
    """Convert a pose at the first scan to the pose (3,) at the first wheel reading."""
    back = wheels.relative(np.array([found.t]), wheels.t[:1])[0]
    return np.asarray(se2.compose(found.pose, back))


class _Places:
    """Candidate poses in the grid's frame: positions in cells, headings in rad."""

    def __init__(self, grid: Grid) -> None:
        self.seen = 0  # number of scans
        self.best = self.other = 0.0  # mean share of the best pose, and of the best different pose
        self._grid = grid
        self._lattice = _lattice(grid)
        self._field = _field(grid)
        self._free = grid.free.copy()
        self._free[0, 0] = False
        self._poses, self._sums = np.zeros((0, 3)), np.zeros(0)
        self._first = self._poses  # the candidates' poses at the first scan

    def look(self, scan: Array, step: Array | None) -> None:
        """Score all candidates with a scan (k, 2) [m], after a wheel-odometry motion (3,) since the last scan."""
        cell = self._grid.cell
        if step is None:
            self._begin(scan[evenly(len(scan), FIRST_BEAMS)] / cell)
        else:
            self._poses = se2.compose(self._poses, np.broadcast_to(step / (cell, cell, 1.0), self._poses.shape))
        share = self._improve(scan[evenly(len(scan), MAX_BEAMS)] / cell)
        if step is None:
            self._first = self._poses
        self._sums, self.seen = self._sums + share, self.seen + 1
        self._thin()
        self._rank()

    def is_decided(self) -> bool:
        """Return whether one candidate matches clearly better than every different one."""
        ahead = self.best - self.other
        clear = ahead >= MIN_LEAD_SHARE and ahead * self.seen >= MIN_LEAD_SCANS
        return clear and self.seen >= MIN_SCANS and self.best >= MIN_SHARE

    def pose(self) -> Array:
        """Return the pose (3,) of the best candidate at the first scan, in the map frame."""
        x, y, theta = self._first[int(np.argmax(self._sums))].tolist()
        place = self._grid.to_map(np.array([[x, y]]))[0]
        return np.array([*place, se2.wrap(theta + float(self._grid.origin[2]))])

    def _begin(self, beams: Array) -> None:
        """Score all free positions and headings, and keep the FIRST_PLACES best."""
        places = self._lattice
        headings = np.arange(HEADING_COUNT) * (math.tau / HEADING_COUNT)
        tried = (np.column_stack((places, np.full(len(places), a))) for a in headings.tolist())
        share = np.stack([self._share(poses, beams) for poses in tried])
        best = np.argsort(-share, axis=None, kind="stable")[:FIRST_PLACES]
        heading, place = np.unravel_index(best, share.shape)
        self._poses = np.column_stack((places[place], headings[heading]))
        self._sums = np.zeros(len(self._poses))

    def _share(self, poses: Array, beams: Array) -> Array:
        """Return for each pose (h, 3) the share (h,) of beams (k, 2) that end at walls and cross free cells."""
        c, s = np.cos(poses[:, 2, None]), np.sin(poses[:, 2, None])
        dx, dy = c * beams[:, 0] - s * beams[:, 1], s * beams[:, 0] + c * beams[:, 1]
        found = self._field[self._cells(poses, dx, dy)]
        for share in CLEAR_AT:
            found = found * self._free[self._cells(poses, share * dx, share * dy)]
        return np.asarray(found.mean(axis=1), np.float64)

    def _cells(self, poses: Array, dx: Array, dy: Array) -> tuple[Ints, Ints]:
        """Return rows and columns (h, k) of the cells at (dx, dy) from poses (h, 3); (0, 0) outside the grid."""
        i = np.floor(poses[:, 0, None] + dx).astype(np.int64)
        j = np.floor(poses[:, 1, None] + dy).astype(np.int64)
        rows, columns = self._field.shape
        outside = (i < 0) | (j < 0) | (i >= columns) | (j >= rows)
        i[outside] = j[outside] = 0  # cell (0, 0) counts as not free and far from walls
        return j, i

    def _improve(self, beams: Array) -> Array:
        """Refine all candidates in steps; return their shares (h,) of matched beams."""
        share = self._share(self._poses, beams)
        for metres, turn in MOVES_M_RAD:
            for _ in range(ROUNDS_PER_SIZE):
                cells = metres / self._grid.cell
                tried = self._poses + MOVE_DIRECTIONS[:, None] * (cells, cells, turn)
                shares = np.stack([self._share(one, beams) for one in tried])
                best = shares.argmax(axis=0)
                better = shares.max(axis=0) > share + 1e-9
                self._poses = np.where(better[:, None], tried[best, np.arange(len(share))], self._poses)
                share = np.maximum(share, shares.max(axis=0))
        return share

    def _thin(self) -> None:
        """Remove equal candidates, then the worse half."""
        order = np.argsort(-self._sums, kind="stable")
        same = SAME_M / self._grid.cell
        turned = self._poses[order, 2] % math.tau
        cells = np.floor(np.column_stack((self._poses[order, :2] / same, turned / SAME_RAD)))
        first = np.sort(np.unique(cells, axis=0, return_index=True)[1])
        kept = order[first][: max(MIN_PLACES, len(first) // 2)]
        self._poses, self._sums, self._first = self._poses[kept], self._sums[kept], self._first[kept]

    def _rank(self) -> None:
        share, best = self._sums / self.seen, int(np.argmax(self._sums))
        off = self._poses - self._poses[best]
        away = np.hypot(off[:, 0], off[:, 1]) * self._grid.cell > APART_M
        away |= np.abs(se2.wrap_all(off[:, 2])) > APART_RAD
        self.best, self.other = float(share[best]), float(share[away].max(initial=0.0))


def _no_place(places: _Places, until: float) -> str:
    """Return the error message of a failed search for the start pose; the scans used end at time `until` [s]."""
    if places.seen < MIN_SCANS:
        return f"too little is seen before {until:.0f} s to tell where in the map the drive began"
    if places.best < MIN_SHARE:
        return (
            f"no place in the map fits the first {until:.0f} s: at the best {places.best:.0%} of the beams end "
            f"at walls ({MIN_SHARE:.0%} are the least). Is it a map of this building?"
        )
    return (
        f"several places in the map fit the first {until:.0f} s ({places.best:.0%} and {places.other:.0%} of the "
        f"beams end at walls): {START_HINT}"
    )


def _lattice(grid: Grid) -> Array:
    """Return free positions (n, 2) in cells, SPACING_M apart. Raises LocfuseError if there are too many to try."""
    every = max(1, round(SPACING_M / grid.cell))
    half = every // 2
    free = grid.free[half::every, half::every]
    tried = int(np.count_nonzero(free)) * HEADING_COUNT
    if tried > MAX_TRIED:
        raise LocfuseError(
            f"the start cannot be looked for in all of the map: {tried // HEADING_COUNT} free places x "
            f"{HEADING_COUNT} headings are {tried}, more than the cap of {MAX_TRIED}: {START_HINT}; "
            "or cut the map",
            role="map",
        )
    j, i = np.nonzero(free)
    return np.asarray(np.stack((i, j), axis=-1) * every + half + 0.5, np.float64)


def _field(grid: Grid) -> Array:
    """Return the likelihood field: 1 near walls, 0 far from walls and in cell (0, 0), which stands for outside."""
    from scipy.ndimage import distance_transform_edt

    away: Array = distance_transform_edt(~grid.occupied) * grid.cell
    field: Array = np.clip((FAR_M - away) / (FAR_M - NEAR_M), 0.0, 1.0).astype(np.float32)
    field[0, 0] = 0.0
    return field


def _rows(t: Array, wheels: Wheels) -> Ints:
    """Return the indices of the used scans: STRIDE_M or TURN_RAD apart, within DRIVING_S seconds of driving."""
    moving = np.hypot(*wheels.twist[:, :2].T) + np.abs(wheels.twist[:, 2]) > MIN_SPEED * np.diff(wheels.t)
    driven = totals(np.where(moving, np.diff(wheels.t), 0.0))
    pose = wheels.at(t)[2]
    inside = np.flatnonzero(np.interp(t, wheels.t, driven) <= DRIVING_S)
    rows: list[int] = []
    for row in inside.tolist():
        step = se2.between(pose[rows[-1]], pose[row]) if rows else None
        if step is None or math.hypot(step[0], step[1]) >= STRIDE_M or abs(se2.wrap(float(step[2]))) >= TURN_RAD:
            rows.append(row)
    return np.array(rows, np.int64)
