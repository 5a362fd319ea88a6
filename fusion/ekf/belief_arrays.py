"""State of the extended Kalman filter: a pose, and more states (map lines, offsets, mounts, wheel parameters).

State and covariance are changed only by methods of one class: predict, compare, queue, correct, know, listen; add,
augment, remove, transform, add_variance; clone_heading, clone_pose; shift, place; begin_frame, know_frame. Many
of them are compiled (fusion.kernels.ekf, with the paper's eq. 5-7 and 10-12). They agree with a textbook filter to
1e-9 (tests/ekf/test_ekf.py). P stays symmetric by construction. If `events` is set, every method records an event.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from locfuse.fusion import se2
from locfuse.fusion.data import Array, Ints, LocfuseError
from locfuse.fusion.kernels import ekf
from locfuse.fusion.kernels.ekf import Innovation, Steps
from locfuse.fusion.kernels.sight import SightLines
from locfuse.fusion.sensor import Block, Equation

from .equations import eq6_noise
from .events import (
    Added,
    Before,
    Changed,
    Corrected,
    Dropped,
    Events,
    FrameMoved,
    FrameTurned,
    Moved,
    Source,
    Undone,
    VarianceAdded,
    by_others,
    undone,
)
from .map_frame import Pose, Triangle, pose_by_frame

POSE = np.arange(3)
MAX_STATES_OF_A_ROW = 24  # largest number of states on which one row of a measurement equation depends
FIRST_ROWS, FIRST_STATES = 32, 16  # initial capacity


class JointBelief(ekf.State):
    """Pose, blocks of the sensors, map frame and map lines as one state vector (n,) with covariance (n, n).

    After a local frame has begun (map_frame), x, y, theta, pose(), matrix() and lines are in this local frame.
    """

    def __init__(self, pose: Pose, P: Triangle, blocks: Sequence[Block] = ()) -> None:
        """`P` is the upper triangle xx, xy, xt, yy, yt, tt of the pose covariance. Blocks are independent."""
        super().__init__()
        xx, xy, xt, yy, yt, tt = P
        self._x, self._P = np.zeros(FIRST_STATES), np.zeros((FIRST_STATES, FIRST_STATES))
        self._x[:3] = pose
        self._P[:3, :3] = ((xx, xy, xt), (xy, yy, yt), (xt, yt, tt))
        self._slices: dict[str, slice] = {}
        self._considered: Ints = np.zeros(0, dtype=np.int64)  # columns of considered states (Schmidt-Kalman)
        self._drift: list[tuple[Ints, Array]] = []
        self._clones: set[int] = set()  # columns of cloned headings
        self._kept: set[int] = set()  # first columns of cloned poses
        self._points: set[str] = set()  # names of blocks that are points [m] in the local frame
        self._lost = False
        self._rows: tuple[Any, ...] = ()  # arrays of the kernel: at, H, count, y, R
        self._queue: Ints = np.zeros(0, np.intp)
        self._sources: list[Source] = []  # sources of the queued rows, if events are recorded
        self.events: Events | None = None
        self._hold()
        for block in blocks:
            self.add(block)

    @classmethod
    def still(cls, blocks: Sequence[Block]) -> JointBelief:
        """Return a belief for models outside the filter; its blocks are constant and exactly known."""
        return cls((0.0,) * 3, (0.0,) * 6, [block._replace(P=0.0 * block.P) for block in blocks])

    def stand(self, pose: Array | Sequence[float], P: Any = 0.0) -> None:
        """Set the pose with covariance P (3, 3), independent of other states; remove all queued rows."""
        self._x[:3], self._P[:3, :3] = pose, P
        self.begin()

    # ---- access ----

    @property
    def state(self) -> Array:
        """Return the state vector (n,), as a view."""
        return self._x[: self.n]

    @property
    def covariance(self) -> Array:
        """Return the joint covariance (n, n), as a view."""
        return self._P[: self.n, : self.n]

    @property
    def framed(self) -> bool:
        """Return whether a local frame has begun; until then, the local frame is the map."""
        return self.frame >= 0

    @property
    def lost(self) -> bool:
        """Whether the robot is lost; then corrections of the pose do not change the map frame."""
        return self._lost

    @lost.setter
    def lost(self, lost: bool) -> None:
        self._lost = lost
        self._mark_kept()

    def matrix(self) -> Array:
        """Return the pose covariance, (3, 3)."""
        return self._P[:3, :3].copy()

    def block(self, name: str) -> tuple[int, Array]:
        """Return (first state column, values) of a block."""
        where = self._slices[name]
        return int(where.start), self._x[where]

    def column(self, name: str) -> int:
        """Return the first state column of a block."""
        column: int = self._slices[name].start
        return column

    def variances(self, name: str) -> list[float]:
        """Return the variances of a block's states."""
        where = self._slices[name]
        variances: list[float] = self._P.diagonal()[where].tolist()
        return variances

    def spread(self, H: Array, columns: Sequence[int] = ()) -> Array:
        """Return H P H' (d, d) for derivatives H (d, 3 + c) by the pose and the states `columns` (c,)."""
        at = [0, 1, 2, *columns]
        return H @ self._P[np.ix_(at, at)] @ H.T

    def frame_pose(self) -> Pose | None:
        """Return the pose of the local frame in the map; None if no local frame has begun."""
        if self.frame < 0:
            return None
        x, y, theta = self._x[self.frame : self.frame + 3].tolist()
        return x, y, theta

    def frame_covariance(self) -> Array:
        """Return the covariance (3, 3) of the map frame, or of the pose if no local frame has begun."""
        at = slice(max(self.frame, 0), max(self.frame, 0) + 3)
        return self._P[at, at].copy()

    # ---- update: predict, compare, queue, correct ----

    def predict(self, steps: Steps, k: int) -> None:
        """Eq. 5-7: predict over motion step k; drifting states also get the noise of their random walk."""
        if self.events is None:
            self.move(steps, k)
            return
        before, start = self._before(), self.pose()
        self.move(steps, k)
        Q, J = (np.array(part) for part in steps.noise_of(k))
        W = se2.rotation(np.array(start[2]))
        noise = eq6_noise(W, Q.reshape(3, 3))
        coupling = W @ J.reshape(3, -1) if self.wheels >= 0 else None
        back = None
        if self.events.backward:
            rows = np.concatenate((POSE, *(columns for columns, _ in self._drift))).astype(np.int64)
            spread = np.zeros((len(rows), len(rows)))
            spread[:3, :3] = noise
            drift = np.concatenate([np.zeros(0), *(drift for _, drift in self._drift)])
            np.fill_diagonal(spread[3:, 3:], float(steps.dt_of(k)) * drift)
            by_wheels = None
            if coupling is not None:
                by_wheels = np.zeros((3, self.n))
                by_wheels[:, self.wheels : self.wheels + coupling.shape[1]] = coupling
            back = undone(before, self._before(), rows, spread, by_wheels)
        self.events.add(Moved(start, self.pose(), noise, coupling, back))

    def queue(self, seen: Innovation | SightLines, sensor: str = "") -> None:
        """Queue the accepted rows of a measurement for the next `correct`."""
        self.queue_rows(seen.first, seen.numbers)
        if self.events is not None:
            rows = seen.rows_used() if isinstance(seen, SightLines) else [seen.row]
            self._sources += [(sensor, row, seen.numbers // len(rows)) for row in rows]

    def fit_of(self, begin: int, end: int) -> float:
        """Return the joint NIS, y' S^-1 y, of the queued rows begin:end."""
        greatest = self.whiten(begin, end)
        if not greatest > 0.0:
            self.not_positive(greatest)
        return self.fit(end - begin)

    def correct(self) -> None:
        """Eq. 10-12 with all queued rows; considered states keep their values."""
        if not self.queued:
            return
        if self.events is None:
            self.correct_queued()
            return
        noted, before = self.events, self._before()
        equation = None if noted.backward else self.equation()
        self.correct_queued()
        if equation is not None:
            noted.add(Corrected(*equation, tuple(self._sources), self.state - before.x))
        self._sources.clear()
        if self.frame_x or self.frame_y:  # the map frame was turned (State.turn_frame)
            rows, G = np.array((self.frame, self.frame + 1)), np.zeros((2, self.n))
            G[(0, 1), rows] = 1.0
            G[:, self.frame + 2] = self.frame_y, -self.frame_x
            back = Undone(rows, self.state[rows] - G @ self.state, G, np.zeros((2, 2)))
            noted.add(FrameTurned(self.frame, self.frame_x, self.frame_y, back))

    def know(self, y: Sequence[float], R: Any, columns: Sequence[int], H: Any) -> None:
        """Correct by an equation between states without a reading, for example that two states are equal.

        y (d,) = H dx + noise of covariance R (d, d), with derivatives H (d, c) by the states `columns` (c,).
        """
        self.begin()
        self.queue(self.compare(-1, y, ((0.0, 0.0, 0.0),) * len(y), R, np.inf, columns, H))
        self.correct()
        self.begin()

    def listen(self, seen: Sequence[Innovation | SightLines]) -> None:
        """Correct only the blocks on which the innovations depend; all other states are considered."""
        at, _, count, *_ = self._rows
        kept = np.ones(self.n, bool)
        for k in (k for s in seen for k in range(s.first, s.first + s.numbers)):
            kept[at[k, : count[k]]] = False
        kept[POSE] = kept[self._frame_columns()] = True
        if kept.all():
            return
        waiting, self.queued = self._queue[: self.queued].copy(), 0
        for s in seen:
            self.queue_rows(s.first, s.numbers)
        self._mark_kept(np.flatnonzero(kept))
        self.correct_queued()
        self._mark_kept()
        self.queued = len(waiting)
        self._queue[: self.queued] = waiting

    def equation(self, seen: Sequence[Innovation] | None = None) -> Equation:
        """Return the queued innovations (or `seen`) as one equation: y (m,), columns, H (m, c), R (m, m)."""
        at, H, count, y, R = self._rows
        rows = self._queue[: self.queued].tolist()
        if seen is not None:
            rows = [k for s in seen for k in range(s.first, s.first + s.numbers)]
        columns = np.unique(np.concatenate([POSE, *(at[k, : count[k]] for k in rows)]))
        dense = np.zeros((len(rows), len(columns)))
        for i, k in enumerate(rows):
            dense[i, np.searchsorted(columns, at[k, : count[k]])] = H[k, : count[k]]
        lower = np.tril(R)
        whole = lower + lower.T - np.diag(np.diagonal(R))
        return Equation(y[rows], columns, dense, whole[np.ix_(rows, rows)])

    # ---- blocks and other states ----

    def add(self, block: Block) -> None:
        """Append an independent block to the state."""
        where = self._grow(len(block.x))
        self._slices[block.name] = where
        self._x[where] = block.x
        self._P[where, where] = block.P
        if np.any(block.drift > 0):
            self._drift.append((np.arange(where.start, where.stop), block.drift))
            self._let_drift()

    def _let_drift(self) -> None:
        """Pass the drifting states to the kernel."""
        if self._drift:
            columns, drift = (np.concatenate(part) for part in zip(*self._drift, strict=True))
            self.drift(columns.astype(np.intp), drift.astype(np.float64))

    def drive_with(self, name: str) -> None:
        """Use a block as the wheel parameters: `predict` then uses J = du/d(block)."""
        self.wheels = self._slices[name].start

    def augment(self, values: Array, G: Array, noise: Array, columns: Sequence[int] = ()) -> int:
        """Append states that are functions of other states, plus noise; return their first column.

        `values` (k,) have the derivative G (k, 3 + c) by the pose and the states `columns` (c,), and independent
        noise of covariance `noise` (k, k). Their covariance is G P G' + noise, that of all states with them is P
        G'.
        """
        n, k = self.n, len(values)
        where = self._grow(k)
        of = [0, 1, 2, *columns]
        PG = self._P[:n, of] @ G.T
        self._x[where] = values
        self._P[:n, where] = PG
        self._P[where, :n] = PG.T
        own = G @ PG[of] + noise
        self._P[where, where] = 0.5 * (own + own.T)
        if self.events is not None:
            self.events.add(Added(n, k))
        return int(where.start)

    def own_point(self, name: str, column: int) -> None:
        """Give two appended states a name, as a block: a point in the local frame."""
        self._slices[name] = slice(column, column + 2)
        self._points.add(name)

    def remove(self, columns: Ints) -> None:
        """Remove state columns that belong to no named block, such as map lines.

        Only columns after a removed column move; the covariance is not copied. Map lines come after the map frame,
        so the columns of the frame do not move.
        """
        if not len(columns):
            return
        if self.events is not None:
            back = by_others(self._before(), columns, dropped=True) if self.events.backward else None
            self.events.add(Dropped(np.asarray(columns), self.n, back))
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

    def transform(self, columns: Ints | Sequence[int], values: Array | Sequence[float], G: Any) -> None:
        """Replace states (k,) by functions of themselves: new values (k,) with derivative G (k, k).

        x <- values, P <- T P T', where T is the unit matrix with G in the rows and columns of these states.
        """
        if self.events is None:
            self.replace(columns, values, G)
            return
        columns = np.asarray(columns)
        before, n, k = self.state[columns].copy(), self.n, len(columns)
        self.replace(columns, values, G)
        by = np.zeros((k, n))
        by[:, columns] = G
        back = None
        if self.events.backward:
            inverse = np.zeros((k, n))
            inverse[:, columns] = np.linalg.inv(G)
            back = Undone(columns, before - inverse @ self.state, inverse, np.zeros((k, k)))
        self.events.add(Changed(columns, by, np.zeros((k, k)), back))

    def add_variance(self, columns: Ints, variance: Array) -> None:
        """Add independent variances (k,) to the states `columns` (k,)."""
        if self.events is None:
            self._P[columns, columns] += variance
            return
        before = self._before()
        columns, variance = columns.copy(), variance.copy()  # copies, since the caller may reuse the arrays
        self._P[columns, columns] += variance
        back = None
        if self.events.backward:
            noise = np.diag(np.append(np.zeros(3), variance))
            back = undone(before, self._before(), np.concatenate((POSE, columns)), noise)
        self.events.add(VarianceAdded(columns, variance, back))

    def consider(self, columns: Ints) -> None:
        """Make states considered (Schmidt-Kalman): their covariance is used, but their values do not change."""
        self._considered = np.union1d(self._considered, columns)
        self._mark_kept()

    # ---- changes of the pose ----

    def shift(self, step: Pose, xy: float, theta: float) -> None:
        """Add a step (3,) [m, m, rad] to the pose, and variances xy [m^2], theta [rad^2] to its covariance."""
        behind, before = self._behind(), self._before()
        self._x[:3] += step
        self._P[(0, 1, 2), (0, 1, 2)] += (xy, xy, theta)
        if self.events is not None:
            noise = np.diag((xy, xy, theta))
            back = undone(before, self._before(), POSE, noise) if self.events.backward else None
            self.events.add(Changed(POSE, np.eye(3, self.n), noise, back))
        self._carry(behind)

    def place(self, pose: Pose, xy: float, theta: float) -> None:
        """Set the pose (3,) with variances xy [m^2] and theta [rad^2], independent of all other states."""
        behind = self._behind()
        self._note_change(POSE, np.zeros((3, self.n)), np.diag((xy, xy, theta)))
        self._x[:3] = pose
        self._P[:3, : self.n] = 0.0
        self._P[: self.n, :3] = 0.0
        self._P[(0, 1, 2), (0, 1, 2)] = (xy, xy, theta)
        self._carry(behind)

    # ---- clones ----

    def clone_heading(self, column: int, behind: float = 0.0) -> None:
        """Clone the present heading minus the angle `behind` [rad] to a state (Roumeliotis and Burdick 2002)."""
        n = self.n
        if self.events is not None:
            self._note_change(np.array([column]), np.eye(3, n)[2:])
        self._x[column] = self._x[2] - behind
        self._P[column, :n] = self._P[2, :n]
        self._P[:n, column] = self._P[:n, 2]
        self._clones.add(column)

    def clone_pose(self, column: int, behind: Array | None = None) -> None:
        """Copy the present pose to the three states from `column` on.

        With `behind` (3,), a pose in the frame of the present one, that pose is copied instead.
        """
        J = np.eye(3) if behind is None else pose_by_frame(self._x[None, :3], behind[None])[0]
        if self.events is not None:
            self._note_change(np.arange(column, column + 3), J @ np.eye(3, self.n))
        self._kept.add(column)
        self.copy_pose(column)
        if behind is None:
            return
        n, P, at = self.n, self._P, slice(column, column + 3)
        self._x[at] = se2.compose(self._x[:3].copy(), behind)
        P[at, :n] = J @ P[:3, :n]
        P[:n, at] = P[at, :n].T
        P[at, at] = J @ P[:3, :3] @ J.T

    def _behind(self) -> tuple[dict[int, float], dict[int, Array]]:
        turns = {column: float(self._x[2] - self._x[column]) for column in self._clones}
        return turns, {c: se2.between(self._x[:3], self._x[c : c + 3]) for c in self._kept}

    def _carry(self, behind: tuple[dict[int, float], dict[int, Array]]) -> None:
        """Move cloned headings and poses together with a corrected pose, since the robot itself did not move."""
        turns, poses = behind
        for column, turn in turns.items():
            self.clone_heading(column, turn)
        for column, pose in poses.items():
            self.clone_pose(column, pose)

    # ---- the map frame ----

    def begin_frame(self) -> None:
        """Begin a local frame at the present pose, which becomes exactly 0 in the new frame (map_frame).

        If the pose is known exactly, nothing happens, since the map frame would have no uncertainty. At a second
        call (after a map was left), the map frame moves to the pose, and the old frame is removed.
        """
        first = self.frame < 0
        if first and not self._P[:3, :3].any():
            return
        if first:  # the map frame is a copy of the pose
            self.frame = self.augment(self._x[:3].copy(), np.eye(3), np.zeros((3, 3)))
            if self.events is not None:
                self.events.list[-1] = Added(self.frame, 3, frame=True)
        else:  # the frame's pose in the map, G, becomes G o q
            if self.events is not None:
                self.events.add(FrameMoved())
            G, q = np.array(self.frame_pose()), self._x[:3].copy()
            J = np.eye(6)
            J[3:] = np.hstack((se2.rotation(G[2]), pose_by_frame(G[None], q[None])[0]))
            at = np.concatenate((POSE, self._frame_columns()))
            self.transform(at, np.concatenate((q, se2.compose(G, q))), J)
        pose = self._x[:3].copy()
        for at, part, placed in self._placed():  # convert to the local frame
            by_pose, by_placed = se2.between_jacobians(pose, placed)
            J = np.eye(3 + len(at))
            J[3:, :3], J[3:, 3:] = by_pose[part], by_placed[part, part]
            self.transform(np.concatenate((POSE, at)), np.append(pose, se2.between(pose, placed)[part]), J)
        zero = np.zeros((3, self.n))  # the local pose is exactly 0, since the map frame now contains its value
        if first and self.events is not None:
            G = zero.copy()
            G[POSE, self._frame_columns()] = 1.0
            back = Undone(POSE, np.zeros(3), G, np.zeros((3, 3)))
            self.events.add(Changed(POSE, zero, np.zeros((3, 3)), back))
        else:
            self._note_change(POSE, zero)
        self._x[:3] = self._P[:3, : self.n] = self._P[: self.n, :3] = 0.0
        self._mark_kept()

    def change_frame(self, R: Array) -> None:
        """Change the local frame to one in which the present frame has the pose R (3,).

        The pose in the map, G o q, does not change: G becomes G o R^-1 and q becomes R o q. Cloned poses and
        points change as q does.
        """
        if self.events is not None:
            self.events.add(FrameMoved())
        G, back, turn = np.array(self.frame_pose()), se2.inverse(R), se2.rotation(R[2])
        self.transform(self._frame_columns(), se2.compose(G, back), pose_by_frame(G[None], back[None])[0])
        for at, part, placed in [(POSE, slice(0, 3), self._x[:3].copy()), *self._placed()]:
            self.transform(at, se2.compose(R, placed)[part], turn[part, part])

    def _placed(self) -> list[tuple[Ints, slice, Array]]:
        """Return cloned headings, cloned poses and points: columns, their part of a pose, and this pose (3,)."""
        found = [(c, slice(2, 3), np.zeros(3)) for c in sorted(self._clones)]
        found += [(c, slice(0, 3), np.zeros(3)) for c in sorted(self._kept)]
        found += [(self._slices[name].start, slice(0, 2), np.zeros(3)) for name in sorted(self._points)]
        for first, part, pose in found:
            pose[part] = self._x[first : first + part.stop - part.start]
        return [(np.arange(c, c + part.stop - part.start), part, pose) for c, part, pose in found]

    def know_frame(self, frame: Array, P: Array) -> None:
        """Set the map frame pose to `frame` (3,), covariance P (3, 3), by evidence independent of the state.

        All other states are corrected by their covariance with the frame (Jeffrey's rule for Gaussians): a state
        changes by K (frame - G), and its covariance by K (P - P_G) K', with K = P_rG P_G^-1.
        """
        if self.frame < 0:
            raise ValueError("no local frame has begun")
        n, at = self.n, self._frame_columns()
        own = self._P[np.ix_(at, at)]
        K = np.linalg.solve(own, self._P[at, :n]).T  # (n, 3), the unit matrix in the frame's own rows
        step = frame - self._x[at]
        step[2] = se2.wrap(float(step[2]))
        self._x[:n] += K @ step
        self._P[:n, :n] += K @ (P - own) @ K.T
        self._P[np.ix_(at, at)] = 0.5 * (P + P.T)

    def _frame_columns(self) -> Ints:
        return np.zeros(0, np.int64) if self.frame < 0 else np.arange(self.frame, self.frame + 3)

    # ---- events ----

    def note_events(self, events: Events) -> None:
        """Record events from now on."""
        self.events = events
        events.start = self._before()
        events.columns = {name: where.start for name, where in self._slices.items()}
        names = {column: name for name, column in events.columns.items()}
        events.drifts = {names[int(columns[0])]: (columns, drift) for columns, drift in self._drift}
        if self.wheels >= 0:
            (events.wheels,) = (where for where in self._slices.values() if where.start == self.wheels)

    def _before(self) -> Before:
        """Return copies of state and covariance if events are recorded, else views."""
        if self.events is None:
            return Before(self.state, self.covariance)
        return Before(self.state.copy(), self.covariance.copy())

    def _note_change(self, rows: Ints, by: Array, noise: Array | None = None) -> None:
        """Record that states `rows` (r,) become by (r, n) x before, plus noise of covariance (r, r)."""
        if self.events is not None:
            back = by_others(self._before(), rows) if self.events.backward else None
            none = np.zeros((len(rows), len(rows)))
            self.events.add(Changed(rows, by, none if noise is None else noise, back))

    # ---- capacity ----

    def _grow(self, k: int) -> slice:
        n = self.n
        if n + k > len(self._x):
            size = 2 * (n + k)
            x, P = np.zeros(size), np.zeros((size, size))
            x[:n], P[:n, :n] = self._x[:n], self._P[:n, :n]
            self._x, self._P = x, P
            self._hold()
        self.n = n + k
        return slice(n, n + k)

    def _hold(self) -> None:
        """Pass the present state arrays to the kernel."""
        self._flags = np.zeros(len(self._x), np.intp)
        self.hold(self._x, self._P, self._flags)
        self._mark_kept()
        self.more_rows(len(self._rows[3]) if self._rows else FIRST_ROWS)

    def more_rows(self, rows: int) -> None:
        """Increase the capacity to at least `rows` rows of measurement equations."""
        m = max(rows, 2 * self.written)
        wide, old = (m, MAX_STATES_OF_A_ROW), self._rows
        new = np.zeros(wide, np.intp), np.zeros(wide), np.zeros(m, np.intp), np.zeros(m), np.zeros((m, m))
        queue = np.zeros(m, np.intp)
        if old:
            k = min(m, len(old[3]))
            for to, of in zip((*new, queue), (*old, self._queue), strict=True):
                part = (slice(0, k),) * (2 if to.shape == (m, m) else 1)
                to[part] = of[part]
        self._rows, self._queue = new, queue
        self.hold_rows(*new, queue)

    def _mark_kept(self, columns: Ints | None = None) -> None:
        """Mark the states whose values corrections keep: considered states, and the map frame of a lost robot."""
        kept = self._considered
        if columns is not None:
            kept = np.union1d(columns, kept)
        elif self._lost:
            kept = np.union1d(kept, self._frame_columns())
        self._flags[:] = 0
        self._flags[kept] = 1
        self.keeps = len(kept) > 0

    def not_positive(self, greatest: float) -> None:
        """Raise LocfuseError: an innovation covariance with variances of up to -`greatest` is singular."""
        raise LocfuseError(
            f"an innovation covariance became singular (variances of up to {-greatest:.0e}): check the values of "
            "sigma and floor in robot.toml"
        )


def _moves(gone: Ints, n: int) -> list[tuple[int, slice]]:
    """Return (new begin, old slice) of the columns that move when columns `gone` (k,) of n are removed."""
    found, to = [], int(gone.min())
    after = np.sort(gone) + 1
    for begin, end in zip(after.tolist(), [*(after[1:] - 1).tolist(), n], strict=True):
        if end > begin:
            found.append((to, slice(begin, end)))
            to += end - begin
    return found
