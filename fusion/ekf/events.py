"""Events of one run of the filter, in order, for the smoother and the tuner.

The verbs of the belief write this list. The smoother (whole_drive) goes through it backward: an event is undone
by before = c + G after + an independent rest of covariance D (Rauch, Tung, Striebel 1965), and a correction only
adds knowledge. The tuner (fusion.tune) goes through it forward with other noise, on the deviations from the run.
Walls and offsets do not move, so only the rows of what does are kept: a few times n numbers an instant.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from locfuse.fusion import se2
from locfuse.fusion.data import Array, Ints

from .equations import eq6_noise, eq7_A
from .map_frame import Pose

RIDGE = 1e-12  # of a covariance with a unit diagonal: an eigenvalue far below it has no extent
RIDGE_ROUNDS = 3  # in which 97 % is put back at an eigenvalue of twice the ridge, all at a hundred times
MAX_REST = 1e-13  # of the largest number on the right: what a solution may leave
Source = tuple[str, int, int]  # sensor, row in its measurements, numbers; ("", -1, numbers): no sensor's


class Undone(NamedTuple):
    """The inverse of an event: x[rows] before = c + G x after + noise of covariance D."""

    rows: Ints  # (r,)
    c: Array  # (r,)
    G: Array  # (r, n)
    D: Array  # (r, r)


class Moved(NamedTuple):
    """The wheels' motion to the next instant."""

    start: Pose  # the local pose before
    end: Pose
    Q: Array  # (3, 3) noise, in the map's axes
    coupling: Array | None  # (3, p) by the wheel parameters
    back: Undone | None

    @property
    def turned(self) -> float:
        """By how much it turned [rad]."""
        return self.end[2] - self.start[2]

    @property
    def driven(self) -> float:
        """Length of the motion's chord [m]."""
        return math.hypot(self.end[0] - self.start[0], self.end[1] - self.start[1])


class Corrected(NamedTuple):
    """A correction, y = H dx + noise of covariance R; recorded only for replay in forward order."""

    y: Array  # (m,)
    columns: Ints  # (c,)
    H: Array  # (m, c)
    R: Array  # (m, m)
    sources: tuple[Source, ...]  # in the order of y
    step: Array  # (n,) by what the state moved


class FrameTurned(NamedTuple):
    """The map frame was corrected by (dx, dy), and its covariance was changed with it (State.turn_frame)."""

    first: int  # column of the frame
    dx: float  # m
    dy: float
    back: Undone | None


class Loosened(NamedTuple):
    """States became less certain by independent variances."""

    columns: Ints  # (k,)
    variance: Array  # (k,)
    back: Undone | None


class Added(NamedTuple):
    """States were appended."""

    before: int  # number of states until then
    states: int
    frame: bool = False  # the map frame, a copy of the pose: from here on the pose is local


class Dropped(NamedTuple):
    """States were removed; `back` gives them from the states that remained (rows in the layout before)."""

    columns: Ints  # (k,) in the layout before
    before: int  # number of states until then
    back: Undone | None


class Changed(NamedTuple):
    """States became functions of states: x[rows] after = by (r, n) x before + noise of covariance (r, r)."""

    rows: Ints
    by: Array
    noise: Array
    back: Undone | None


class FrameMoved(NamedTuple):
    """From here on, the map frame is that of a new map."""


Event = Moved | Corrected | FrameTurned | Loosened | Added | Dropped | Changed | FrameMoved


class Before(NamedTuple):
    """The state as it was before an event."""

    x: Array  # (n,)
    P: Array  # (n, n)


class Events:
    """The events of one run; `backward`: replayed from the end, so the inverse of each is recorded."""

    def __init__(self, backward: bool) -> None:
        self.backward = backward
        self.list: list[Event] = []
        self.start: Before | None = None  # the state when the list begins
        self.final: Before | None = None  # and when it ends
        self.columns: dict[str, int] = {}  # block -> its first column
        self.drifts: dict[str, tuple[Ints, Array]] = {}  # block -> columns, variance per s
        self.wheels: slice | None = None  # columns of the wheel parameters

    def add(self, event: Event) -> None:
        """Append an event."""
        self.list.append(event)


def undone(before: Before, after: Before, rows: Ints, noise: Array, coupling: Array | None = None) -> Undone:
    """Return the inverse of the prediction x after = F x before + noise, which acts on `rows` only (r,).

    `coupling` (3, n) is how static states enter the pose's motion. Gain P F' P_next^-1 (Särkkä 2013, eq. 8.6);
    D = (1 - G F) P (1 - G F)' + G Q G' stays positive and is blind to rounding in G, which matters after an exact
    start, where P_next is singular.
    """
    (x, P), (x_next, P_next) = before, after
    n, r = len(x), len(rows)
    A = eq7_A(x[:3], x_next[:3])
    unit = np.zeros((r, n))
    unit[np.arange(r), rows] = 1.0
    if not noise.any():
        G = unit if coupling is None else unit - np.vstack((coupling, np.zeros((r - 3, n))))
        G[:3] = np.linalg.inv(A) @ G[:3]
        return Undone(rows, x[rows] - G @ x_next, G, noise)
    cross = P[:, rows]
    pose = A @ cross[:3] if coupling is None else A @ cross[:3] + coupling @ cross
    cross[:3] = pose
    G = _solved(P_next, cross).T
    GF = G.copy()
    GF[:, :3] = G[:, :3] @ A
    if coupling is not None:
        GF += G[:, :3] @ coupling
    rest = unit - GF
    D = rest @ P @ rest.T + G[:, rows] @ noise @ G[:, rows].T
    return Undone(rows, x[rows] - G @ x_next, G, D)


def by_others(before: Before, rows: Ints, dropped: bool = False) -> Undone:
    """Return the states `rows` as linear functions of all others, to restore them when events are undone.

    G is in the layout of the state before, with zeros at `rows`; without these columns where they are `dropped`.
    """
    x, P = before
    n = len(x)
    stay = np.setdiff1d(np.arange(n), rows)
    G = _solved(P[np.ix_(stay, stay)], P[np.ix_(stay, rows)]).T
    rest = np.zeros((len(rows), n))
    rest[np.arange(len(rows)), rows] = 1.0
    rest[:, stay] = -G
    if not dropped:
        whole = np.zeros((len(rows), n))
        whole[:, stay] = G
        G = whole
    return Undone(rows, rest @ x, G, rest @ P @ rest.T)


def _solved(P: Array, B: Array) -> Array:
    """Return P^-1 B; for a singular P (an exact start, a new frame, clones), nearly the minimum-norm solution.

    A small ridge keeps the division from what rounding makes of a zero, which differs from processor to processor.
    What it takes from the solution is put back (iterated Tikhonov regularisation, Golub and Van Loan 2013, 6.1.4).

    Scaled to a unit diagonal: a pose whose frame just began has 1e-14 m^2 beside states of 1. A variance that
    rounding took below zero (-1e-35 m^2) is zero.
    """
    scale = np.sqrt(np.maximum(np.diagonal(P), 0.0))
    scale = np.divide(1.0, scale, out=np.ones_like(scale), where=scale > 0.0)
    unit, right = scale[:, None] * P * scale, scale[:, None] * B
    ridged = unit + RIDGE * np.eye(len(unit))
    solved = rest = np.linalg.solve(ridged, right)
    for _ in range(RIDGE_ROUNDS):
        rest = right - unit @ solved
        if np.abs(rest).max(initial=0.0) <= MAX_REST * np.abs(right).max(initial=0.0):
            break
        solved = solved + np.linalg.solve(ridged, rest)
    return np.asarray(scale[:, None] * solved, np.float64)


def in_map(Q: Array, theta: float) -> Array:
    """Turn a motion's covariance (3, 3) from the frame of its start into the map's axes."""
    return eq6_noise(se2.rotation(np.array(theta)), Q)
