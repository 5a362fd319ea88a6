"""Start pose in a given map: all free positions and headings are compared with the first scans of a drive.

After the first scan many poses are possible, since corridors and rooms are similar. Each pose is moved by wheel
odometry and compared with the later scans. The start is found if one pose matches all scans clearly better than
every other pose (multi-hypothesis localisation; the score is the likelihood field of Thrun, Burgard and Fox 2005,
6.4, as a share of the beams; only beams through free cells count). If no pose matches, the map is of another
building.
"""

from __future__ import annotations

import math
from itertools import product
from typing import NamedTuple

import numpy as np

from locfuse.fusion import se2
from locfuse.fusion.data import Array, Ints, LocfuseError, Points, evenly, totals
from locfuse.fusion.wheels.motion import Wheels

from .given_walls import Grid

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
