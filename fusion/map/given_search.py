"""Where in a given map did a drive begin? Every free place and heading is tried against the first seconds.

The first scan leaves many places: corridors and rooms look alike. Each is kept, moved on by the wheels, and held
against the later scans; what agrees with all of them, and clearly better than every other place, is the answer
(multi-hypothesis localisation; the score is the likelihood field of Thrun, Burgard and Fox 2005, 6.4, as a share
of the beams, of those only that go through free cells). Where no place agrees, the map is of another building.
"""

from __future__ import annotations

import math
from itertools import product
from typing import NamedTuple

import numpy as np

from locfuse.fusion import se2
from locfuse.fusion.data import Array, Ints, LocfuseError, Points
from locfuse.fusion.wheels.motion import Wheels

from .given_walls import Grid

SPACING_M, HEADING_COUNT = 0.3, 72  # of the places and headings that are tried first
MAX_TRIED = 10_000_000  # places times headings: a free floor of 100 m x 100 m in cells of 5 cm has 8 million
MAX_BEAMS, FIRST_BEAMS = 60, 30  # of a scan, evenly taken; where every place is tried
NEAR_M, FAR_M = 0.15, 0.5  # a beam ends at a wall: within the first surely, beyond the second surely not
FIRST_PLACES, MIN_PLACES = 2000, 200  # places after the first scan, and later: half of them go with every scan
STRIDE_M, TURN_RAD = 0.4, math.radians(20.0)  # between two scans that are used
DRIVING_S = 30.0  # s of driving that decide
CLEAR_AT = (0.35, 0.75)  # shares of a beam where it must be in a free cell
MIN_SCANS = 5
# share of the beams that end at walls, on the mean of all scans: people and furniture take the rest
MIN_SHARE = 0.85
# scans in all, and share on the mean, by which no other place comes near
MIN_LEAD_SCANS, MIN_LEAD_SHARE = 0.35, 0.02
APART_M, APART_RAD = 0.5, math.radians(20.0)  # places further apart are different
SAME_M, SAME_RAD = 0.15, math.radians(4.0)  # places closer together are one
MOVE_DIRECTIONS = np.array(list(product((-1.0, 0.0, 1.0), repeat=3)))  # in which a place is moved to fit better
MOVES_M_RAD = ((0.1, math.radians(2.0)), (0.05, math.radians(1.0)))  # m, rad of such moves
ROUNDS_PER_SIZE = 2  # of moves of one size
MIN_SPEED = 1e-3  # m/s, rad/s
SAY_START = "say where the drive begins: " + " ".join(
    f"--set start.{key}" for key in ("x=...", "y=...", "theta_deg=...", "sigma_xy=0.5")
)


class Start(NamedTuple):
    """The pose of a robot at its first scan, and the share of beams that fit it."""

    pose: Array  # (3,) at time `t`, map frame
    t: float  # s: of the first scan
    until: float  # s: of the last scan that was looked at
    share: float  # of the beams that end at walls there


def find_start(grid: Grid, t: Array, points: Points, wheels: Wheels) -> Start:
    """Return where the robot was at the first scan, by DRIVING_S seconds of driving; t (n,) are the scans' times.

    Raises LocfuseError where no place fits, several do as well, or there are more to try than MAX_TRIED.
    """
    places, seen = _Places(grid), list[int]()
    rows = _rows(t, wheels)
    for row, scan in zip(rows.tolist(), points.read(rows), strict=True):
        if len(scan) < FIRST_BEAMS:
            continue
        places.look(scan, wheels.relative(t[[seen[-1]]], t[[row]])[0] if seen else None)
        seen.append(row)
    if places.decided():
        return Start(places.pose(), float(t[seen[0]]), float(t[seen[-1]]), places.best)
    raise LocfuseError(_no_place(places, float(t[rows[-1]]) if len(rows) else 0.0), role="map")


def at_start(found: Start, wheels: Wheels) -> Array:
    """Return the pose (3,) at the first wheel reading, from the pose found at the first scan."""
    back = wheels.relative(np.array([found.t]), wheels.t[:1])[0]
    return np.asarray(se2.compose(found.pose, back))


class _Places:
    """Candidate poses of the robot in the grid's frame: places in cells, headings in radians."""

    def __init__(self, grid: Grid) -> None:
        self.seen = 0  # scans
        self.best = self.other = 0.0  # share of the best place, and of the best one elsewhere
        self._grid = grid
        self._lattice = _lattice(grid)
        self._field = _field(grid)
        self._free = grid.free.copy()
        self._free[0, 0] = False
        self._poses, self._sums = np.zeros((0, 3)), np.zeros(0)
        self._first = self._poses  # where each of them was at the first scan

    def look(self, scan: Array, step: Array | None) -> None:
        """Compare every place with a scan (k, 2) [m], after a step (3,) by the wheels since the scan before."""
        cell = self._grid.cell
        if step is None:
            self._begin(_some(scan, FIRST_BEAMS) / cell)
        else:
            self._poses = se2.compose(self._poses, np.broadcast_to(step / (cell, cell, 1.0), self._poses.shape))
        share = self._improve(_some(scan, MAX_BEAMS) / cell)
        if step is None:
            self._first = self._poses
        self._sums, self.seen = self._sums + share, self.seen + 1
        self._thin()
        self._rank()

    def decided(self) -> bool:
        """Return whether one place fits clearly better than every other."""
        ahead = self.best - self.other
        clear = ahead >= MIN_LEAD_SHARE and ahead * self.seen >= MIN_LEAD_SCANS
        return clear and self.seen >= MIN_SCANS and self.best >= MIN_SHARE

    def pose(self) -> Array:
        """Return the pose in the map, at the first scan, of the best place (3,)."""
        x, y, theta = self._first[int(np.argmax(self._sums))].tolist()
        place = self._grid.to_map(np.array([[x, y]]))[0]
        return np.array([*place, se2.wrap(theta + float(self._grid.origin[2]))])

    def _begin(self, beams: Array) -> None:
        """Try all free places and headings, and keep the KEPT best."""
        places = self._lattice
        headings = np.arange(HEADING_COUNT) * (math.tau / HEADING_COUNT)
        share = np.stack(
            [self._share(np.column_stack((places, np.full(len(places), a))), beams) for a in headings.tolist()]
        )
        best = np.argsort(-share, axis=None, kind="stable")[:FIRST_PLACES]
        heading, place = np.unravel_index(best, share.shape)
        self._poses = np.column_stack((places[place], headings[heading]))
        self._sums = np.zeros(len(self._poses))

    def _share(self, poses: Array, beams: Array) -> Array:
        """Return for each pose (h, 3) the share (h,) of the beams (k, 2) that end at walls."""
        c, s = np.cos(poses[:, 2, None]), np.sin(poses[:, 2, None])
        dx, dy = c * beams[:, 0] - s * beams[:, 1], s * beams[:, 0] + c * beams[:, 1]
        found = self._field[self._cells(poses, dx, dy)]
        for share in CLEAR_AT:
            found = found * self._free[self._cells(poses, share * dx, share * dy)]
        return np.asarray(found.mean(axis=1), np.float64)

    def _cells(self, poses: Array, dx: Array, dy: Array) -> tuple[Ints, Ints]:
        """Return rows and columns (h, k) of points (dx, dy) (h, k) cells from poses (h, 3); outside: cell 0."""
        i = np.floor(poses[:, 0, None] + dx).astype(np.int64)
        j = np.floor(poses[:, 1, None] + dy).astype(np.int64)
        rows, columns = self._field.shape
        outside = (i < 0) | (j < 0) | (i >= columns) | (j >= rows)
        i[outside] = j[outside] = 0  # where no wall is near, and nothing is free
        return j, i

    def _improve(self, beams: Array) -> Array:
        """Move every place step by step to its best fit; return the shares (h,) there."""
        share = self._share(self._poses, beams)
        for metres, turn in MOVES_M_RAD:
            for _ in range(ROUNDS_PER_SIZE):
                tried = self._poses + MOVE_DIRECTIONS[:, None] * (
                    metres / self._grid.cell,
                    metres / self._grid.cell,
                    turn,
                )
                shares = np.stack([self._share(one, beams) for one in tried])
                best = shares.argmax(axis=0)
                better = shares.max(axis=0) > share + 1e-9
                self._poses = np.where(better[:, None], tried[best, np.arange(len(share))], self._poses)
                share = np.maximum(share, shares.max(axis=0))
        return share

    def _thin(self) -> None:
        """Keep one of equal places, then only the better half."""
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
    """Return why no place was found in the scans up to a time [s]."""
    if places.seen < MIN_SCANS:
        return f"too little is seen before {until:.0f} s to tell where in the map the drive began"
    if places.best < MIN_SHARE:
        return (
            f"no place in the map fits the first {until:.0f} s: at the best {places.best:.0%} of the beams end "
            f"at walls ({MIN_SHARE:.0%} are the least). Is it a map of this building?"
        )
    return (
        f"several places in the map fit the first {until:.0f} s ({places.best:.0%} and {places.other:.0%} of the "
        f"beams end at walls): {SAY_START}"
    )


def _lattice(grid: Grid) -> Array:
    """Return free places (n, 2) SPACING_M apart, in cells. Raises LocfuseError if there are too many to try."""
    every = max(1, round(SPACING_M / grid.cell))
    half = every // 2
    free = grid.free[half::every, half::every]
    tried = int(np.count_nonzero(free)) * HEADING_COUNT
    if tried > MAX_TRIED:
        raise LocfuseError(
            f"the start cannot be looked for in all of the map: {tried // HEADING_COUNT} free places x "
            f"{HEADING_COUNT} headings are {tried}, more than the cap of {MAX_TRIED}: {SAY_START}; or cut the map",
            role="map",
        )
    j, i = np.nonzero(free)
    return np.asarray(np.stack((i, j), axis=-1) * every + half + 0.5, np.float64)


def _field(grid: Grid) -> Array:
    """Return the likelihood field: 1 near a wall, 0 far from all and in cell (0, 0), which is outside."""
    from scipy.ndimage import distance_transform_edt

    away: Array = distance_transform_edt(~grid.occupied) * grid.cell
    field: Array = np.clip((FAR_M - away) / (FAR_M - NEAR_M), 0.0, 1.0).astype(np.float32)
    field[0, 0] = 0.0
    return field


def _rows(t: Array, wheels: Wheels) -> Ints:
    """Return the scans that are used: STRIDE_M apart, within DRIVING_S seconds of driving."""
    moving = np.hypot(*wheels.twist[:, :2].T) + np.abs(wheels.twist[:, 2]) > MIN_SPEED * np.diff(wheels.t)
    driven = np.concatenate(([0.0], np.cumsum(np.where(moving, np.diff(wheels.t), 0.0))))
    pose = wheels.at(t)[2]
    inside = np.flatnonzero(np.interp(t, wheels.t, driven) <= DRIVING_S)
    rows: list[int] = []
    for row in inside.tolist():
        step = se2.between(pose[rows[-1]], pose[row]) if rows else None
        if step is None or math.hypot(step[0], step[1]) >= STRIDE_M or abs(se2.wrap(float(step[2]))) >= TURN_RAD:
            rows.append(row)
    return np.array(rows, np.int64)


def _some(scan: Array, count: int) -> Array:
    """Return at most `count` points of a scan (k, 2), evenly spaced."""
    if len(scan) <= count:
        return scan
    return np.asarray(scan[np.linspace(0, len(scan) - 1, count).round().astype(np.int64)])
