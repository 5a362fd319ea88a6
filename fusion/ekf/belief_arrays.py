"""The extended Kalman filter: a pose, and any states beside it (map lines, offsets, mounts, wheel parameters).

The equations are the paper's (5, 6, 10-12) for the joint state, Schmidt's for what is considered, not estimated;
they stand in `core.filter`. P stays symmetric by construction, and a textbook filter agrees to 1e-9
(tests/ekf/test_ekf.py).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from locfuse.fusion import se2
from locfuse.fusion.core import filter as interpreted
from locfuse.fusion.core.room import Room
from locfuse.fusion.data import Array, Ints
from locfuse.fusion.sensor import Block, Innovation, Matrix, PoseRows, Reading, positive

from .map_frame import Pose, Together, Triangle, by_frame
from .rows import sparse_row, together

Rows = Sequence[Sequence[float]]
POSE = np.arange(3)
NONE_KEPT = np.zeros(1, np.intp)
NO_STATES = np.zeros((1, 1))  # J of a motion that no state corrects
AT_ONCE = 4  # rows of a correction that core.filter takes together


class JointBelief:
    """Pose, sensor-owned blocks, map frame and map lines in one state vector (n,) with one covariance (n, n).

    Where a local frame has begun (map_frame), x, y, theta, pose(), matrix() and the lines are local; InMap is not.
    """

    def __init__(self, pose: Pose, P: Triangle, blocks: Sequence[Block] = (), room: Room | None = None) -> None:
        """`room`, where it is not this process' own form of the core: for tests."""
        xx, xy, xt, yy, yt, tt = P
        self._room = room or Room.here(interpreted)
        self.n = 3
        self._x = np.zeros(16)
        self._P = np.zeros((16, 16))
        self._x[:3] = pose
        self._P[:3, :3] = ((xx, xy, xt), (xy, yy, yt), (xt, yt, tt))
        self._slices: dict[str, slice] = {}
        self._drift: list[tuple[Ints, Array]] = []
        self._considered: Ints = np.zeros(0, dtype=np.int64)  # columns that count but are never updated
        self._motion_block: slice | None = None
        self._clones: set[int] = set()  # columns that hold the heading of an earlier instant
        self._kept: set[int] = set()  # first of three columns that hold the pose of an earlier instant
        self._points: set[str] = set()  # blocks that were appended: a point [m] in the local frame each
        self.frame: int | None = None  # first column of the map frame; None: the local frame is the map
        self.lost = False  # the pose is wrong by metres: it must not teach the map frame
        self._whitened = np.zeros(0)  # of the last correction: innovations whose covariance is the unit matrix
        for block in blocks:
            self.add(block)

    @property
    def x(self) -> float:
        """X of the pose [m]."""
        return float(self._x[0])

    @property
    def y(self) -> float:
        """Y of the pose [m]."""
        return float(self._x[1])

    @property
    def theta(self) -> float:
        """Heading of the pose [rad], not wrapped."""
        return float(self._x[2])

    @property
    def state(self) -> Array:
        """The state vector, a view (n,)."""
        return self._x[: self.n]

    @property
    def covariance(self) -> Array:
        """The joint covariance, a view (n, n)."""
        return self._P[: self.n, : self.n]

    @property
    def arrays(self) -> tuple[Array, Array]:
        """State and covariance with the room they have for more states, for the core."""
        return self._x, self._P

    @property
    def in_frame(self) -> int:
        """First column of the map frame, for the core; -1: the local frame is the map."""
        return -1 if self.frame is None else self.frame

    @property
    def drifting(self) -> Sequence[tuple[Ints, Array]]:
        """State columns (k,) that drift, and the variance (k,) that each of them gains in a second."""
        return self._drift

    @property
    def plain(self) -> bool:
        """Whether the core may take it: it keeps no journal, and it is not lost."""
        return type(self) is JointBelief and not self.lost

    @property
    def moved_by(self) -> tuple[int, int]:
        """First column of the states that correct the motion, and how many there are, for the core."""
        block = self._motion_block
        return (0, 0) if block is None else (block.start, block.stop - block.start)

    @property
    def kept(self) -> tuple[Ints, bool]:
        """Which states are considered, 1 or 0 for each (n,), and whether any is, for the core."""
        return self._chosen(self._considered)

    def pose(self) -> Pose:
        """Return (x, y, theta)."""
        x, y, theta = self._x[:3].tolist()
        return x, y, theta

    def located(self, in_map: bool = False) -> tuple[Pose, Triangle]:
        """Return the pose, local or that in the map, and its covariance's upper triangle."""
        out = np.empty(9)
        first = self.in_frame if in_map else -1
        self._room.on_arrays.locate(self._x, self._P, first, out)
        x, y, theta, xx, xy, xt, yy, yt, tt = out.tolist()
        return (x, y, theta), (xx, xy, xt, yy, yt, tt)

    def by_local(self, H: tuple[float, float, float]) -> list[float]:
        """Return the derivative (6,) by local pose and map frame of what has H by the pose in the map."""
        row = np.empty(6)
        n = self._room.on_arrays.by_local(self._x, self.in_frame, *H, row)
        derivative: list[float] = row[:n].tolist()
        return derivative

    def triangle(self) -> Triangle:
        """Return the pose covariance's upper triangle."""
        return self.located()[1]

    def matrix(self) -> Array:
        """Return the pose covariance, (3, 3)."""
        return self._P[:3, :3].copy()

    def block(self, name: str) -> tuple[int, Array]:
        """Return (first state column, values) of a block."""
        where = self._slices[name]
        return int(where.start), self._x[where]

    def variances(self, name: str) -> list[float]:
        """Return the variance of every value of a block."""
        where = self._slices[name]
        variances: list[float] = self._P.diagonal()[where].tolist()
        return variances

    def add(self, block: Block) -> None:
        """Append an independent block to the state."""
        where = self._grow(len(block.x))
        self._slices[block.name] = where
        self._x[where] = block.x
        self._P[where, where] = block.P
        if np.any(block.drift > 0):
            self._drift.append((np.arange(where.start, where.stop), block.drift))

    def drive_with(self, name: str) -> None:
        """Let a block's values correct the wheel motion: `predict` takes J = du/d(block)."""
        self._motion_block = self._slices[name]

    def begin_frame(self) -> None:
        """Let a local frame begin at the pose, which becomes exactly 0 in it (map_frame).

        Nothing happens where the pose is known exactly: the map frame would have no uncertainty. A second time,
        where a map was lost, the map frame is moved on to the pose, and what the old frame knew is forgotten.
        """
        first = self.frame is None
        if first and not self._P[:3, :3].any():
            return
        if first:
            self.frame = self._clone_pose()
        else:
            self._move_frame()
        for column in sorted(self._clones):  # kept headings become local; a transform, not a new clone: the noise
            turned = np.array([[1.0, 0.0], [-1.0, 1.0]])  # between a kept heading and now stays
            self.transform(np.array([2, column]), np.array([self.theta, self._x[column] - self.theta]), turned)
        for column in sorted(self._kept):
            self._keep_in_frame(column)
        for name in sorted(self._points):
            self._point_in_frame(self._slices[name].start)
        self._forget_pose(first)

    def _keep_in_frame(self, column: int) -> None:
        """Let a kept pose be seen from where the robot is now."""
        pose, at = self._x[:3].copy(), np.arange(column, column + 3)
        kept = self._x[at].copy()
        J = np.eye(6)
        J[3:, :3], J[3:, 3:] = se2.between_jacobians(pose, kept)
        self.transform(np.concatenate((POSE, at)), np.concatenate((pose, se2.between(pose, kept))), J)

    def _point_in_frame(self, column: int) -> None:
        """Let a point be seen from where the robot is now."""
        pose, at = self._x[:3].copy(), np.arange(column, column + 2)
        placed = np.append(self._x[at], 0.0)
        by_pose, by_placed = se2.between_jacobians(pose, placed)
        J = np.eye(5)
        J[3:, :3], J[3:, 3:] = by_pose[:2], by_placed[:2, :2]
        self.transform(np.concatenate((POSE, at)), np.append(pose, se2.between(pose, placed)[:2]), J)

    def own_point(self, name: str, column: int) -> None:
        """Let two appended states be a block: a point in the local frame, found by its name wherever it moves."""
        self._slices[name] = slice(column, column + 2)
        self._points.add(name)

    def _clone_pose(self) -> int:
        """Append a copy of the pose and return its first column."""
        return self.augment(self._x[:3].copy(), np.eye(3), np.zeros((3, 3)))

    def _move_frame(self) -> None:
        """Replace G by G o q."""
        G, q = np.array(self.frame_pose()), self._x[:3].copy()
        at = np.concatenate((np.arange(3), self._frame_columns()))
        J = np.eye(6)
        J[3:] = np.hstack((se2.rotation(G[2]), by_frame(G[None], q[None])[0]))
        self.transform(at, np.concatenate((q, se2.compose(G, q))), J)

    def _forget_pose(self, first: bool) -> None:
        """Set the pose to exactly 0: the map frame has taken its place."""
        self._x[:3] = 0.0
        self._P[:3, : self.n] = 0.0
        self._P[: self.n, :3] = 0.0

    def _frame_columns(self) -> Ints:
        return np.zeros(0, np.int64) if self.frame is None else np.arange(self.frame, self.frame + 3)

    def frame_pose(self) -> Pose | None:
        """Return the map frame, where the local frame lies in the map; None: they are the same."""
        if self.frame is None:
            return None
        x, y, theta = self._x[self.frame : self.frame + 3].tolist()
        return x, y, theta

    def know_frame(self, frame: Array, P: Array) -> None:
        """Let the map frame be (3,) with covariance P (3, 3), by evidence that is none of this state's.

        All else follows by what it has to do with the frame (Jeffrey's rule for Gaussians): with K = P_rG P_G^-1
        it moves by K (frame - G), and its covariance changes by K (P - P_G) K'.
        """
        if self.frame is None:
            raise ValueError("no local frame has begun")
        n, at = self.n, self._frame_columns()
        own = self._P[np.ix_(at, at)]
        K = np.linalg.solve(own, self._P[at, :n]).T  # (n, 3), the unit matrix in the frame's own rows
        step = frame - self._x[at]
        step[2] = se2.wrap(float(step[2]))
        self._x[:n] += K @ step
        self._P[:n, :n] += K @ (P - own) @ K.T
        self._P[np.ix_(at, at)] = 0.5 * (P + P.T)

    def with_frame(self) -> Together:
        """Return the pose and the map frame with their covariances."""
        first = self.frame or 0
        x, rows = self._x[: first + 3].tolist(), self._P[:3, : first + 3].tolist()
        (xx, xy, xt, *_), (_, yy, yt, *_), (_, _, tt, *_) = rows
        return Together(
            (x[0], x[1], x[2]),
            (x[first], x[first + 1], x[first + 2]),
            (xx, xy, xt, yy, yt, tt),
            [row[first:] for row in rows],
            self._P[first : first + 3, first : first + 3].tolist(),
        )

    def observed(
        self, H: PoseRows, columns: tuple[int, ...] = (), H_block: Matrix = ()
    ) -> tuple[Matrix, PoseRows, tuple[int, ...], Matrix]:
        """Return H P H' and the derivatives as they are: they are by this belief's own pose."""
        return self.spread(H, columns, H_block), H, columns, H_block

    def shift(self, turn: float, xy: float, theta: float) -> None:
        """Turn the pose by `turn` [rad] and add variances xy [m^2] and theta [rad^2]: a slip was found."""
        behind = self._behind()
        self._shift(turn, xy, theta)
        self._carry(behind)

    def _shift(self, turn: float, xy: float, theta: float) -> None:
        self._x[2] += turn
        self._P[(0, 1, 2), (0, 1, 2)] += (xy, xy, theta)

    def place(self, pose: Pose, xy: float, theta: float) -> None:
        """Set the pose with variances xy [m^2] and theta [rad^2]: the robot was kidnapped, or found again."""
        behind = self._behind()
        self._place(pose, xy, theta)
        self._carry(behind)

    def _place(self, pose: Pose, xy: float, theta: float) -> None:
        self._x[:3] = pose
        self._P[:3, : self.n] = 0.0
        self._P[: self.n, :3] = 0.0
        self._P[(0, 1, 2), (0, 1, 2)] = (xy, xy, theta)

    def clone_heading(self, column: int, behind: float = 0.0) -> None:
        """Let a state be the heading as it is now, less `behind` [rad] (stochastic cloning, sensors/gyro)."""
        self._room.on_arrays.keep_heading(self._x, self._P, self.n, column, behind)
        self._clones.add(column)

    def clone_pose(self, column: int, behind: Array | None = None) -> None:
        """Let three states be the pose as it is now, or the pose `behind` (3,) as it is seen from there."""
        n, P, at = self.n, self._P, slice(column, column + 3)
        pose = self._x[:3].copy()
        self._x[at] = pose if behind is None else se2.compose(pose, behind)
        J = np.eye(3) if behind is None else by_frame(pose[None], behind[None])[0]
        P[at, :n] = J @ P[:3, :n]
        P[:n, at] = P[at, :n].T
        P[at, at] = J @ P[:3, :3] @ J.T
        self._kept.add(column)

    def _behind(self) -> tuple[dict[int, float], dict[int, Array]]:
        turns = {column: float(self._x[2] - self._x[column]) for column in self._clones}
        return turns, {c: se2.between(self._x[:3], self._x[c : c + 3]) for c in self._kept}

    def _carry(self, behind: tuple[dict[int, float], dict[int, Array]]) -> None:
        """Move kept headings and poses along with a pose that was found wrong: nothing has moved."""
        turns, poses = behind
        for column, turn in turns.items():
            self.clone_heading(column, turn)
        for column, pose in poses.items():
            self.clone_pose(column, pose)

    def transform(self, columns: Ints, values: Array, G: Array) -> None:
        """Replace states (k,) by functions of themselves: their values (k,) and derivative G (k, k)."""
        n, P = self.n, self._P
        self._x[columns] = values
        P[columns, :n] = G @ P[columns, :n]
        P[:n, columns] = P[:n, columns] @ G.T

    def augment(self, values: Array, G: Array, noise: Array, columns: Sequence[int] = ()) -> int:
        """Append states that are functions of others plus noise: returns the first new column.

        values (k,), G (k, 3 + c) their derivative by the pose and the states `columns` (c,), noise (k, k)
        independent of the state.
        """
        n = self.n
        where = self._grow(len(values))
        of = [0, 1, 2, *columns]
        PG = self._P[:n, of] @ G.T
        self._x[where] = values
        self._P[:n, where] = PG
        self._P[where, :n] = PG.T
        own = G @ PG[of] + noise
        self._P[where, where] = 0.5 * (own + own.T)
        return int(where.start)

    def loosen(self, columns: Ints, variance: Array) -> None:
        """Add independent variance (k,) to distinct states: they are not quite what they were."""
        self._P[columns, columns] += variance

    def remove(self, columns: Ints) -> None:
        """Drop state columns that belong to no named block (map lines that proved worthless).

        Map lines come after the map frame, whose columns stay where they are. Only what lies behind a dropped
        column moves: the covariance is not copied.
        """
        if not len(columns):
            return
        n, m = self.n, self.n - len(columns)
        moves = _moves(columns, n)
        for to, block in moves:
            room = slice(to, to + block.stop - block.start)
            self._x[room] = self._x[block]
            self._P[room, :n] = self._P[block, :n]
        for to, block in moves:
            self._P[:m, to : to + block.stop - block.start] = self._P[:m, block]
        self._x[m:n] = 0.0
        self._P[m:n, :n] = 0.0
        self._P[:m, m:n] = 0.0
        self.n = m
        for name in self._points:
            start = self._slices[name].start - int((columns < self._slices[name].start).sum())
            self._slices[name] = slice(start, start + 2)

    def consider(self, columns: Ints) -> None:
        """Make columns considered (Schmidt-Kalman): their covariance counts, their values stay."""
        self._considered = np.union1d(self._considered, columns)

    def _grow(self, k: int) -> slice:
        n, self.n = self.n, self.n + k
        if self.n > len(self._x):
            size = 2 * self.n
            x, P = np.zeros(size), np.zeros((size, size))
            x[:n], P[:n, :n] = self._x[:n], self._P[:n, :n]
            self._x, self._P = x, P
        return slice(n, n + k)

    def predict(self, u: Sequence[float], Q: Sequence[float], dt: float = 0.0, J: Array | None = None) -> None:
        """Paper eq. 5, 6: move by the relative pose u = (x, y, theta) whose covariance triangle is Q.

        Blocks drift by their random walk over dt [s]; J is the derivative of u by the wheel parameters.
        """
        P = self._P
        by = (NO_STATES, 0, 0, 0)
        if self._motion_block is not None and J is not None:
            by = np.ascontiguousarray(J).reshape(1, -1), 0, *self.moved_by
        self._room.on_arrays.move(self._x, P, self.n, *u, *Q, *by)
        for columns, drift in self._drift:
            P[columns, columns] += drift * dt

    def spread(self, H: Rows, columns: Sequence[int] = (), H_block: Rows = ()) -> tuple[tuple[float, ...], ...]:
        """Return H P H', (d, d)."""
        if len(H) == 1:
            row, P = sparse_row(H[0], columns, H_block), self._P
            return ((max(sum([g * h * P.item(i, j) for i, g in row for j, h in row]), 0.0),),)  # but for rounding
        d, at = len(H), np.array((0, 1, 2, *columns))
        rows = np.array([(*h, *b) for h, b in zip(H, H_block, strict=True)] if H_block else H, np.float64)
        S = np.zeros((d, d))
        self._room.on_arrays.projected(self._P, self.n, at, len(at), rows, S, d, np.empty((d, self.n)))
        lower = S.tolist()
        return tuple([tuple([lower[max(i, j)][min(i, j)] for j in range(d)]) for i in range(d)])

    def correct(self, seen: Sequence[Innovation | Reading]) -> None:
        """Paper eq. 10-12 with everything one instant saw stacked; considered columns keep their values."""
        if not seen:
            return
        kept = self._considered  # and while lost the map frame: a wrong lever must not teach it
        if self.frame is None:
            self._take_in(seen, kept)
            return
        at = slice(self.frame, self.frame + 2)
        before = self._x[at].tolist()
        self._take_in(seen, np.union1d(kept, self._frame_columns()) if self.lost else kept)
        after = self._x[at].tolist()
        if after != before:
            self._swing(after[0] - before[0], after[1] - before[1])

    def _take_in(self, seen: Sequence[Innovation | Reading], kept: Ints) -> None:
        equation = together(seen)
        given = self._given(*equation)
        positive(self._room.on_arrays.take_in(self._x, *given, *self._chosen(kept)))
        self._whitened = equation[0]

    def _chosen(self, kept: Ints) -> tuple[Ints, bool]:
        """Return columns as the core wants them: one number for each state, and whether there are any."""
        if not len(kept):
            return NONE_KEPT, False
        chosen = np.zeros(self.n, np.intp)
        chosen[kept] = 1
        return chosen, True

    def _given(self, y: Array, columns: Ints, H: Array, R: Array) -> tuple[Any, ...]:
        """Return P and an equation as the core wants them; e is written over y, V has rows of zeros behind it."""
        m = len(y)
        V = np.zeros((-(-m // AT_ONCE) * AT_ONCE, self.n))
        return self._P, self.n, columns, len(columns), H, R, y, m, V

    def nis_of_first(self, m: int) -> tuple[float, int]:
        """Return y' S^-1 y of the first m numbers of the last correction as a whole, and its dof."""
        e = self._whitened[:m]
        return float(e @ e), len(e)

    def joint_nis(self, seen: Sequence[Innovation | Reading]) -> tuple[float, int]:
        """Return y' S^-1 y of several innovations, where S has all that their errors share, and its dof."""
        equation = together(seen)
        positive(self._room.on_arrays.whiten(*self._given(*equation)))
        e = equation[0]
        return float(e @ e), len(e)

    def _swing(self, dx: float, dy: float) -> None:
        """Let the uncertainty of the map frame's place follow its correction by (dx, dy) [m].

        A turn of the map about a point of it is what nobody has observed yet, and the frame's place is where that
        turn takes it: with the place moves the direction in which it takes it, rows x, y += (-dy, dx) row Th.
        """
        self._room.on_arrays.swing(self._P, self.n, self.frame or 0, dx, dy)

    def listen(self, seen: Sequence[Innovation]) -> None:
        """Let innovations teach only the block columns that they name; the pose and all else is considered."""
        named = np.array([c for s in seen for c in s.columns], dtype=np.int64)
        named = np.setdiff1d(named, self._frame_columns())
        if len(named):
            kept = np.setdiff1d(np.arange(self.n), named)
            self._take_in(seen, np.union1d(kept, self._considered))


def _moves(gone: Ints, n: int) -> list[tuple[int, slice]]:
    """Return where the blocks of n columns between those that are gone (k,) move to, and the blocks, in order."""
    found, to = [], int(gone.min())
    after = np.sort(gone) + 1
    for begin, end in zip(after.tolist(), [*(after[1:] - 1).tolist(), n], strict=True):
        if end > begin:
            found.append((to, slice(begin, end)))
            to += end - begin
    return found
