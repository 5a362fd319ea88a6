"""Events of one filter run, in order of time, for the smoother and for noise tuning.

The methods of the belief record this list. The smoother (whole_drive) processes it backward: the state before an
event is c + G x (state after it) + independent noise of covariance D (Rauch, Tung, Striebel 1965); corrections
need no inverse. The tuner (fusion.tune) processes it forward with other noise, for deviations from the run. Walls
and offsets are static, so only rows of moving states are stored: a few times n numbers per update.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from locfuse.fusion.data import Array, Ints

from .equations import eq7_A
from .map_frame import Pose

RIDGE_VARIANCE = 1e-12  # added to a unit diagonal; much smaller eigenvalues then count as zero
RIDGE_ROUNDS = 3  # iterations that correct the effect of the ridge: by 97 % at an eigenvalue of twice the ridge
MAX_REST = 1e-13  # largest residual of a solution / largest number on the right side
Source = tuple[str, int, int]  # sensor, row in its measurements, number of components; ("", -1, number): no sensor


class Undone(NamedTuple):
    """Inverse of an event: x[rows] before = c + G x after + noise of covariance D."""

    rows: Ints  # (r,)
    c: Array  # (r,)
    G: Array  # (r, n)
    D: Array  # (r, r)


class Moved(NamedTuple):
    """Event: wheel motion to the next update time."""

    start: Pose  # local pose before the motion
    end: Pose
    Q: Array  # (3, 3) covariance of the motion noise, in the axes of the map
    coupling: Array | None  # (3, p) derivative of the motion by the wheel parameters
    back: Undone | None

    @property
    def turned(self) -> float:
        """Return the turn of the motion [rad]."""
        return self.end[2] - self.start[2]

    @property
    def driven(self) -> float:
        """Return the chord length of the motion [m]."""
        return math.hypot(self.end[0] - self.start[0], self.end[1] - self.start[1])


class Corrected(NamedTuple):
    """Event: correction by y = H dx + noise of covariance R; only recorded for the tuner."""

    y: Array  # (m,)
    columns: Ints  # (c,)
    H: Array  # (m, c)
    R: Array  # (m, m)
    sources: tuple[Source, ...]  # in the order of y
    step: Array  # (n,) change of the state


class FrameTurned(NamedTuple):
    """Event: correction of the map frame by (dx, dy), with a change of its covariance (State.turn_frame)."""

    first: int  # first column of the frame
    dx: float  # m
    dy: float
    back: Undone | None


class VarianceAdded(NamedTuple):
    """Event: independent variances were added to states."""

    columns: Ints  # (k,)
    variance: Array  # (k,)
    back: Undone | None


class Added(NamedTuple):
    """Event: states were appended."""

    before: int  # number of states before
    states: int  # number of appended states
    frame: bool = False  # whether the states are the map frame: a copy of the pose, which then becomes local


class Dropped(NamedTuple):
    """Event: states were removed; `back` computes them from the remaining states."""

    columns: Ints  # (k,) before the removal
    before: int  # number of states before
    back: Undone | None


class Changed(NamedTuple):
    """Event: states became functions of states: x[rows] after = by (r, n) x before + noise (r, r)."""

    rows: Ints
    by: Array
    noise: Array
    back: Undone | None


class FrameMoved(NamedTuple):
    """Event: the local frame changes, at a new submap or a return to one; so does its pose G in the map."""


Event = Moved | Corrected | FrameTurned | VarianceAdded | Added | Dropped | Changed | FrameMoved


class Before(NamedTuple):
    """State and covariance before an event."""

    x: Array  # (n,)
    P: Array  # (n, n)


class Events:
    """Events of one run: if `backward`, with their inverses (smoother), else with the corrections (tuner)."""

    def __init__(self, backward: bool) -> None:
        self.backward = backward
        self.list: list[Event] = []
        self.start: Before | None = None  # state before the first event
        self.final: Before | None = None  # state after the last event
        self.columns: dict[str, int] = {}  # block -> its first column
        self.drifts: dict[str, tuple[Ints, Array]] = {}  # block -> columns, variance per second
        self.wheels: slice | None = None  # columns of the wheel parameters

    def add(self, event: Event) -> None:
        """Append an event."""
        self.list.append(event)


def undone(before: Before, after: Before, rows: Ints, noise: Array, coupling: Array | None = None) -> Undone:
    """Return the inverse of a prediction, x after = F x before + noise, that changes only the states `rows` (r,).

    `coupling` (3, n) is the derivative of the motion by static states. The gain is P F' P_next^-1 (Särkkä 2013,
    eq. 8.6). D = (1 - G F) P (1 - G F)' + G Q G' stays positive for any rounding errors in G; they are large after
    an exact start, when P_next is singular.
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
    """Return the states `rows` as linear functions of all other states, for the inverse of an event.

    G has a column for each state before the event, with zeros at `rows`; with `dropped`, these columns are left
    out.
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
    """Return P^-1 B; if P is singular (exact start, new frame, clones), nearly the minimum-norm solution.

    A small ridge avoids division by rounding errors, which differ between processors. Its effect on the solution
    is corrected by iteration (iterated Tikhonov regularisation, Golub and Van Loan 2013, 6.1.4). P is scaled to a
    unit diagonal first, since a pose in a new frame has 1e-14 m^2 and other states have 1. Variances slightly
    below zero by rounding (-1e-35 m^2) count as zero.
    """
    scale = np.sqrt(np.maximum(np.diagonal(P), 0.0))
    scale = np.divide(1.0, scale, out=np.ones_like(scale), where=scale > 0.0)
    unit, right = scale[:, None] * P * scale, scale[:, None] * B
    ridged = unit + RIDGE_VARIANCE * np.eye(len(unit))
    solved = rest = np.linalg.solve(ridged, right)
    for _ in range(RIDGE_ROUNDS):
        rest = right - unit @ solved
        if np.abs(rest).max(initial=0.0) <= MAX_REST * np.abs(right).max(initial=0.0):
            break
        solved = solved + np.linalg.solve(ridged, rest)
    return np.asarray(scale[:, None] * solved, np.float64)
