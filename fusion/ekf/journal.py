"""A journal of one run of the filter: how the state before follows from the state after, change by change.

A prediction is undone by before = c + G after + an independent rest of covariance D, which is all that a smoother
must know (Rauch, Tung, Striebel 1965). A correction only adds knowledge and needs no note. Walls and offsets do
not move, so only the rows of what does (pose, drifting blocks) are kept: a few times n numbers an instant, never
n x n.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from locfuse.fusion import se2
from locfuse.fusion.data import Array, Ints
from locfuse.fusion.sensor import Block

from .belief_arrays import POSE, JointBelief
from .equations import eq6_noise, eq7_A
from .map_frame import Pose, Triangle

MAX_REST = 1e-9  # of the largest number on the right: what a solution may leave
RANK = 1e-12  # relative eigenvalue below which a covariance has no extent


class Step(NamedTuple):
    """A motion undone: x[rows] = c + G x + noise of covariance D."""

    rows: Ints  # (r,) pose, then drifting states
    c: Array  # (r,)
    G: Array  # (r, n)
    D: Array  # (r, r)
    instant: bool = True  # led to the next instant; else the pose was shifted or set within one


class Birth(NamedTuple):
    """New states were appended."""

    before: int  # number of states until then
    frame: bool = False  # the map frame: from here on the pose is local


class Drop(NamedTuple):
    """States were dropped. They follow from those that stayed: dropped = c + G stayed + noise of covariance D."""

    columns: Ints  # (k,) in the layout before the drop
    c: Array  # (k,)
    G: Array  # (k, n after)
    D: Array  # (k, k)


class Swung(NamedTuple):
    """The map frame was corrected by (dx, dy), and the uncertainty of its place followed (JointBelief._swing)."""

    undone: Step
    dx: float  # m
    dy: float


class FrameMoved(NamedTuple):
    """From here on the map frame is another one: that of a new map."""


Event = Step | Birth | Drop | Swung | FrameMoved


class Journal:
    """What the smoother must know of one run of the filter; `belief_of` makes the belief that writes it."""

    def __init__(self) -> None:
        self.events: list[Event] = []
        self.starts: list[Pose] = []  # of every motion: the local pose at the end of the instant before
        self.belief: JointBelief | None = None

    def belief_of(self, pose: Pose, P: Triangle, blocks: Sequence[Block] = ()) -> JointBelief:
        """Return a belief that writes this journal."""
        self.belief = belief = NotedJoint(pose, P, blocks)
        belief.events, belief.starts = self.events, self.starts
        return belief

    def final(self) -> tuple[Array, Array]:
        """Return copies of the last state (n,) and covariance (n, n)."""
        if self.belief is None:
            raise ValueError("no filter has written this journal")
        return self.belief.state.copy(), self.belief.covariance.copy()


class NotedJoint(JointBelief):
    """A joint belief that notes its predictions, births and drops."""

    events: list[Event]
    starts: list[Pose]

    def predict(self, u: Sequence[float], Q: Sequence[float], dt: float = 0.0, J: Array | None = None) -> None:
        """Predict as ever, and note how to go back."""
        self.starts.append(self.pose())
        x, P = self.state.copy(), self.covariance.copy()
        super().predict(u, Q, dt, J)
        theta = float(x[2])
        rows = np.concatenate((np.arange(3), *(columns for columns, _ in self._drift))).astype(np.int64)
        noise = np.zeros((len(rows), len(rows)))
        noise[:3, :3] = in_map(Q, theta)
        np.fill_diagonal(noise[3:, 3:], dt * np.concatenate([np.zeros(0), *(drift for _, drift in self._drift)]))
        coupling = None
        if self._motion_block is not None and J is not None:
            coupling = np.zeros((3, self.n))
            coupling[:, self._motion_block] = se2.rotation(np.array(theta)) @ J
        self.events.append(undone(x, P, self.state, self.covariance, rows, noise, coupling))

    def _shift(self, turn: float, xy: float, theta: float) -> None:
        """Shift as ever, and note how to go back."""
        x, P = self.state.copy(), self.covariance.copy()
        super()._shift(turn, xy, theta)
        step = undone(x, P, self.state, self.covariance, POSE, np.diag((xy, xy, theta)))
        self.events.append(step._replace(instant=False))

    def _place(self, pose: Pose, xy: float, theta: float) -> None:
        """Place as ever, and note what the map alone says of the pose before."""
        G = np.zeros((3, self.n))
        c, G[:, 3:], D = self._given_others(POSE)
        self.events.append(Step(POSE, c, G, D, instant=False))
        super()._place(pose, xy, theta)

    def clone_heading(self, column: int, behind: float = 0.0) -> None:
        """Clone as ever, and note what the others say of the heading that is given up."""
        G = np.zeros((1, self.n))
        others = np.setdiff1d(np.arange(self.n), (column,))
        c, G[:, others], D = self._given_others(np.array([column]))
        self.events.append(Step(np.array([column]), c, G, D, instant=False))
        super().clone_heading(column, behind)

    def clone_pose(self, column: int, behind: Array | None = None) -> None:
        """Clone as ever, and note what the others say of the pose that is given up."""
        at = np.arange(column, column + 3)
        G = np.zeros((3, self.n))
        c, G[:, np.setdiff1d(np.arange(self.n), at)], D = self._given_others(at)
        self.events.append(Step(at, c, G, D, instant=False))
        super().clone_pose(column, behind)

    def transform(self, columns: Ints, values: Array, G: Array) -> None:
        """Transform as ever, and note the way back."""
        back = np.zeros((len(columns), self.n))
        back[:, columns] = np.linalg.inv(G)
        before = self.state[columns].copy()
        super().transform(columns, values, G)
        none = np.zeros((len(columns), len(columns)))
        self.events.append(Step(np.asarray(columns), before - back @ self.state, back, none, instant=False))

    def loosen(self, columns: Ints, variance: Array) -> None:
        """Loosen as ever, and note how to go back."""
        x, P = self.state.copy(), self.covariance.copy()
        super().loosen(columns, variance)
        step = undone(
            x, P, x, self.covariance, np.concatenate((POSE, columns)), np.diag(np.append(np.zeros(3), variance))
        )
        self.events.append(step._replace(instant=False))

    def augment(self, values: Array, G: Array, noise: Array, columns: Sequence[int] = ()) -> int:
        """Append states as ever, and note that they are new."""
        self.events.append(Birth(self.n))
        return super().augment(values, G, noise, columns)

    def _clone_pose(self) -> int:
        """Append the map frame as ever, and note that the pose is local from here on."""
        column = super()._clone_pose()
        self.events[-1] = Birth(column, frame=True)
        return column

    def _move_frame(self) -> None:
        """Move the map frame as ever, and note that it is another one."""
        self.events.append(FrameMoved())
        super()._move_frame()

    def _forget_pose(self, first: bool) -> None:
        """Begin the local frame as ever, and note where the pose went: into the map frame."""
        G = np.zeros((3, self.n))
        if first:
            G[POSE, self._frame_columns()] = 1.0
            c, D = np.zeros(3), np.zeros((3, 3))
        else:
            c, G[:, 3:], D = self._given_others(POSE)
        self.events.append(Step(POSE, c, G, D, instant=False))
        super()._forget_pose(first)

    def _swing(self, dx: float, dy: float) -> None:
        """Swing as ever, and note the way back."""
        super()._swing(dx, dy)
        first = self.frame or 0
        rows = np.array((first, first + 1))
        back = np.zeros((2, self.n))
        back[(0, 1), rows] = 1.0
        back[:, first + 2] = dy, -dx
        c = self.state[rows] - back @ self.state
        self.events.append(Swung(Step(rows, c, back, np.zeros((2, 2)), instant=False), dx, dy))

    def remove(self, columns: Ints) -> None:
        """Drop states as ever, and note what the others say of them."""
        self.events.append(Drop(np.asarray(columns), *self._given_others(columns)))
        super().remove(columns)

    def _given_others(self, columns: Ints) -> tuple[Array, Array, Array]:
        """Return c, G, D with which these states follow from all others: c + G others + noise of covariance D."""
        stay = np.setdiff1d(np.arange(self.n), columns)
        x, P = self.state, self.covariance
        G = _solved(P[np.ix_(stay, stay)], P[np.ix_(stay, columns)]).T
        rest = np.zeros((len(columns), self.n))
        rest[np.arange(len(columns)), columns] = 1.0
        rest[:, stay] = -G
        return rest @ x, G, rest @ P @ rest.T


def undone(
    x: Array, P: Array, x_next: Array, P_next: Array, rows: Ints, noise: Array, coupling: Array | None = None
) -> Step:
    """Return the backward step of the prediction x_next = F x + noise, which acts on `rows` only (r,).

    x, P and x_next, P_next are (n,), (n, n); `coupling` (3, n) is how static states enter the pose's motion.
    Gain P F' P_next^-1 (Särkkä 2013, eq. 8.6); D = (1 - G F) P (1 - G F)' + G Q G' stays positive and is blind to
    rounding in G, which matters after an exact start, where P_next is singular.
    """
    n, r = len(x), len(rows)
    A = eq7_A(x[:3], x_next[:3])
    unit = np.zeros((r, n))
    unit[np.arange(r), rows] = 1.0
    if not noise.any():
        G = unit if coupling is None else unit - np.vstack((coupling, np.zeros((r - 3, n))))
        G[:3] = np.linalg.inv(A) @ G[:3]
        return Step(rows, x[rows] - G @ x_next, G, noise)
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
    return Step(rows, x[rows] - G @ x_next, G, D)


def _solved(P: Array, B: Array) -> Array:
    """Return P^-1 B; where P is singular (an exact start, a frame that just began), the least of all solutions.

    Rounding hides a singular P from the solver, whose solution is then of 1e16 and does not even solve: its rest
    tells.

    Scaled to a unit diagonal: a pose whose frame just began has 1e-14 m^2 beside states of 1. A variance that
    rounding took below zero (-1e-35 m^2) is zero.
    """
    scale = np.sqrt(np.maximum(np.diagonal(P), 0.0))
    scale = np.divide(1.0, scale, out=np.ones_like(scale), where=scale > 0.0)
    unit, right = scale[:, None] * P * scale, scale[:, None] * B
    try:
        solved = np.linalg.solve(unit, right)
    except np.linalg.LinAlgError:
        solved = np.full_like(right, np.inf)
    with np.errstate(invalid="ignore"):
        rest = np.abs(unit @ solved - right).max(initial=0.0)
    if not rest <= MAX_REST * np.abs(right).max(initial=0.0):
        solved = np.linalg.pinv(unit, rcond=RANK, hermitian=True) @ right
    return np.asarray(scale[:, None] * solved, np.float64)


def in_map(Q: Sequence[float], theta: float) -> Array:
    """Turn a motion's covariance triangle from the frame of its start into the map, (3, 3)."""
    xx, xy, xt, yy, yt, tt = Q
    return eq6_noise(se2.rotation(np.array(theta)), np.array(((xx, xy, xt), (xy, yy, yt), (xt, yt, tt))))
