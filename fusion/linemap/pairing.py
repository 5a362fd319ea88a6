"""Which map lines may a measured line be? Candidate pairs with their innovations, by `core.pairs`."""

from __future__ import annotations

import math
from typing import Any

import msgspec
import numpy as np

from locfuse.fusion.core import pairs as interpreted
from locfuse.fusion.core.room import Room
from locfuse.fusion.data import Array, Ints
from locfuse.fusion.ekf.belief_arrays import JointBelief

from .laser_mount import Seat
from .line_map import LineMap
from .scan import Scan

MAX_PAIR_ANGLE_RAD = math.radians(25.0)  # pairs further apart are not looked at
MAX_PAIR_OFFSET_M = 1.0  # m
PAIR_SIGMAS = 6.0  # added to both
PAIR = 19  # columns of a pair, by core.pairs


class Pair(msgspec.Struct, frozen=True, gc=False):
    """A measured line that may be a map line. Symmetric 2 x 2 matrices are (00, 01, 11)."""

    line: int  # of the scan
    which: int  # position in the map
    column: int  # of the map line in the state, -1: frozen
    y: tuple[float, float]  # innovation, after flipping where the sign demands it
    R: tuple[float, float, float]  # of what is independent of the state: the map's covariance is, where it is none
    S: tuple[float, float, float]
    d2: float
    score: float  # d2 + ln det S
    lo: float  # m, ends of the measured segment along the map line
    hi: float
    overlap: float  # m, negative where the segments are apart
    cos: float  # of the map line's beta
    sin: float
    u: float  # dr/dbeta
    psi: float  # rad, measured, base frame, as the map line's psi is predicted: not wrapped


class Candidates(msgspec.Struct, frozen=True, gc=False):
    """The pairs of one scan, line by line, as the core wants them."""

    room: Room
    rows: Any  # (lines, 7) flat: measured lines
    lines: int
    places: int  # map lines
    columns: Ints  # (places,) first column of every map line in the state, -1: frozen
    mount: Any  # by `_mount`
    numbers: Any  # (found, 19) flat
    found: int

    def pair(self, p: int) -> Pair:
        """Return one of them."""
        at = PAIR * p
        i, j, offset, turn, r00, r01, r11, s00, s01, s11, d2, score, lo, hi, overlap, c, s, u, psi = (
            self.room.listed(self.numbers[at : at + PAIR], PAIR)
        )
        which = int(j)
        y, R, S = (offset, turn), (r00, r01, r11), (s00, s01, s11)
        return Pair(int(i), which, int(self.columns[which]), y, R, S, d2, score, lo, hi, overlap, c, s, u, psi)

    def pairs(self) -> list[Pair]:
        """Return them all."""
        return [self.pair(p) for p in range(self.found)]


def candidate_pairs(
    scan: Scan, lines: LineMap, belief: JointBelief, limit: float, room: Room | None = None
) -> Candidates:
    """Return the pairs on the right face whose squared distance is at most `limit`, measured line by line.

    `room`, where it is not this process' own form of the core: for tests.
    """
    room = room or Room.here(interpreted)
    rows, (pose, triangle), places = scan.rows(), belief.located(), len(lines)
    walls, width, states = lines.walls(belief, scan.seat, room)
    out = room.floats(PAIR * len(rows) * places)
    measured, mount = room.given(rows), room.given(_mount(scan.seat, belief, room))
    found = room.functions.pairs(
        measured,
        len(rows),
        walls,
        width,
        room.given(lines.lo),
        room.given(lines.hi),
        places,
        states,
        room.flat([pose]),
        room.flat([triangle]),
        mount,
        0 if scan.seat is None else len(scan.seat.free),
        MAX_PAIR_ANGLE_RAD,
        MAX_PAIR_OFFSET_M,
        PAIR_SIGMAS,
        limit,
        room.floats(4 * places),
        out,
    )
    return Candidates(room, measured, len(rows), places, lines.column, mount, out, found)


def _mount(seat: Seat | None, belief: JointBelief, room: Room) -> Array:
    """Return the laser's mount as core.pairs wants it: place, which of x, y, yaw are free, their covariances."""
    if seat is None:
        return np.zeros(2)
    at, free = np.array(seat.columns, np.intp), len(seat.free)
    mount = np.array((seat.x, seat.y, *seat.free, *(0.0,) * (free * (3 + free))))
    room.on_arrays.gather_mount(belief.arrays[1], at, free, mount)
    return mount
