"""A pose with a few states beside it, such as a compass' offset, in plain floats.

Four or five states are too few for arrays: the overhead of a dozen NumPy calls is ten times the arithmetic
(benchmarks: "one configuration, frozen map"). The equations are those of `JointBelief`, which takes over where
states come and go, are cloned, transformed or considered, or correct the wheels' motion.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from locfuse.fusion.data import Array
from locfuse.fusion.sensor import Block, Innovation

from .belief_pose import Pose, PoseBelief, Rows, Triangle, too_far_apart
from .map_frame import Together
from .rows import Row, pose_rows, whitened, whitened_with_blocks

MAX_BLOCK_STATES = 6  # states beside the pose; with more of them arrays are faster
Beside = tuple[tuple[int, float], ...]  # (which state, derivative of a row by it)


class FewBlocks(PoseBelief):
    """Pose (x, y, theta) and m states b beside it."""

    __slots__ = ("_b", "_drift", "_rows", "_states", "_where", "frame")
    frame: int | None

    def __init__(self, pose: Pose, P: Triangle, blocks: Sequence[Block]) -> None:
        super().__init__(pose, P)
        self.frame = None
        self._where: dict[str, range] = {}
        self._b: list[float] = []
        self._drift: list[float] = []  # variance per second
        for block in blocks:
            self._where[block.name] = range(len(self._b), len(self._b) + len(block.x))
            self._b += block.x.tolist()
            self._drift += block.drift.tolist()
        across = np.zeros((len(self._b), 3 + len(self._b)))
        for block in blocks:
            where = self._where[block.name]
            across[where.start : where.stop, 3 + where.start : 3 + where.stop] = block.P
        self._states = range(len(self._b))
        self._rows: list[list[float]] = across.tolist()  # of P: covariance of state i with x, y, theta, and all b

    def block(self, name: str) -> tuple[int, Sequence[float]]:
        """Return (first state column, values) of a block."""
        where = self._where[name]
        return 3 + where.start, self._b[where.start : where.stop]

    def variances(self, name: str) -> list[float]:
        """Return the variance of every value of a block."""
        return [self._rows[i][3 + i] for i in self._where[name]]

    @property
    def state(self) -> Array:
        """The state vector, (3 + m,)."""
        return np.array((self.x, self.y, self.theta, *self._b))

    @property
    def covariance(self) -> Array:
        """The joint covariance, (3 + m, 3 + m)."""
        rows = np.array(self._rows)
        return np.vstack((np.hstack((self.matrix(), rows[:, :3].T)), rows))

    def begin_frame(self) -> None:
        """Let a local frame begin at the pose, which becomes exactly 0 in it (map_frame).

        Nothing happens where the pose is known exactly. Once only: a map that is no part of the state stays.
        """
        if self.frame is not None:
            raise ValueError("the local frame has begun")
        if not any(self.P):
            return
        m = len(self._b)
        self.frame = 3 + m
        xx, xy, xt, yy, yt, tt = self.P
        of_pose = [[row[k] for row in self._rows] for k in range(3)]
        for row in self._rows:
            row[:] = [0.0, 0.0, 0.0, *row[3:], *row[:3]]
        for own, across in zip(((xx, xy, xt), (xy, yy, yt), (xt, yt, tt)), of_pose, strict=True):
            self._rows.append([0.0, 0.0, 0.0, *across, *own])
        self._b += self.pose()
        self._drift += [0.0, 0.0, 0.0]
        self._states = range(m + 3)
        self.x = self.y = self.theta = 0.0
        self.P = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)

    def frame_pose(self) -> Pose | None:
        """Return the map frame, where the local frame lies in the map; None: they are the same."""
        if self.frame is None:
            return None
        x, y, theta = self._b[self.frame - 3 : self.frame]
        return x, y, theta

    def with_frame(self) -> Together:
        """Return the pose and the map frame with their covariances."""
        first = self.frame or 0
        (x, y, theta), rows = self._b[first - 3 : first], self._rows[first - 3 : first]
        (ax, bx, cx, *_), (ay, by, cy, *_), (at, bt, ct, *_) = rows
        across = [[ax, ay, at], [bx, by, bt], [cx, cy, ct]]
        own = [row[first : first + 3] for row in rows]
        return Together((self.x, self.y, self.theta), (x, y, theta), self.P, across, own)

    def predict(self, u: Sequence[float], Q: Sequence[float], dt: float = 0.0, J: Array | None = None) -> None:
        """Paper eq. 5, 6 for pose and blocks: blocks drift by their random walk over dt [s]."""
        x, y = self.x, self.y
        super().predict(u, Q)
        dx, dy = self.x - x, self.y - y
        for i, row in enumerate(self._rows):
            row[0] -= dy * row[2]
            row[1] += dx * row[2]
            row[3 + i] += self._drift[i] * dt

    def spread(self, H: Rows, columns: Sequence[int] = (), H_block: Rows = ()) -> tuple[tuple[float, ...], ...]:
        """Return H P H', (d, d)."""
        if not columns:
            return super().spread(H)
        rows = [(a, b, c, _beside(columns, g)) for (a, b, c), g in zip(H, H_block, strict=True)]
        out = []
        for k, row in enumerate(rows):
            p0, p1, p2, q = self._covaried(*row)
            spread = [a * p0 + b * p1 + c * p2 + sum([g * q[i] for i, g in s]) for a, b, c, s in rows]
            spread[k] = max(spread[k], 0.0)  # but for rounding
            out.append(tuple(spread))
        return tuple(out)

    def _covaried(self, a: float, b: float, c: float, beside: Beside) -> tuple[float, float, float, list[float]]:
        """Return P h' of one row h: of x, y, theta, and of the states beside them (m,)."""
        xx, xy, xt, yy, yt, tt = self.P
        p0, p1, p2 = xx * a + xy * b + xt * c, xy * a + yy * b + yt * c, xt * a + yt * b + tt * c
        q = [row[0] * a + row[1] * b + row[2] * c for row in self._rows]
        for i, g in beside:
            row = self._rows[i]
            p0 += row[0] * g
            p1 += row[1] * g
            p2 += row[2] * g
            for j in self._states:
                q[j] += row[3 + j] * g
        return p0, p1, p2, q

    def correct(self, seen: Sequence[Innovation]) -> None:
        """Paper eq. 10-12, one scalar row after another, as in `PoseBelief`."""
        rows, values = self._rows, self._b
        before = values.copy()
        dx = dy = dt = 0.0
        for (y, a, b, c, r), beside in _scalar_rows(seen):
            p0, p1, p2, q = self._covaried(a, b, c, beside)
            s = a * p0 + b * p1 + c * p2 + r
            e = y - a * dx - b * dy - c * dt
            for i, g in beside:
                s += g * q[i]
                e -= g * (values[i] - before[i])
            if not s > 0.0:
                raise too_far_apart(s)
            e /= s
            dx += p0 * e
            dy += p1 * e
            dt += p2 * e
            g0, g1, g2 = p0 / s, p1 / s, p2 / s
            xx, xy, xt, yy, yt, tt = self.P
            self.P = (xx - g0 * p0, xy - g0 * p1, xt - g0 * p2, yy - g1 * p1, yt - g1 * p2, tt - g2 * p2)
            for i, row in enumerate(rows):
                p = q[i]
                gain = p / s
                values[i] += p * e
                row[0] -= gain * p0
                row[1] -= gain * p1
                row[2] -= gain * p2
                for j in self._states:
                    row[3 + j] -= gain * q[j]
        self.x += dx
        self.y += dy
        self.theta += dt
        if self.frame is not None:
            self._swing(before)

    def _swing(self, before: Sequence[float]) -> None:
        """Let the uncertainty of the map frame's place follow its correction (map_frame.swung)."""
        i = (self.frame or 0) - 3
        dx, dy = self._b[i] - before[i], self._b[i + 1] - before[i + 1]
        if not dx and not dy:
            return
        rows, (a, b, t) = self._rows, (i, i + 1, i + 2)
        rows[a] = [p - dy * q for p, q in zip(rows[a], rows[t], strict=True)]
        rows[b] = [p + dx * q for p, q in zip(rows[b], rows[t], strict=True)]
        for row in rows:
            row[3 + a] -= dy * row[3 + t]
            row[3 + b] += dx * row[3 + t]

    def place(self, pose: Pose, xy: float, theta: float) -> None:
        """Set the pose with variances xy [m^2] and theta [rad^2]: the robot was kidnapped, or found again."""
        super().place(pose, xy, theta)
        for row in self._rows:
            row[:3] = 0.0, 0.0, 0.0


def _scalar_rows(seen: Sequence[Innovation]) -> list[tuple[Row, Beside]]:
    """Return scalar rows with independent noise, each with its derivatives by states beside the pose."""
    alone = [s for s in seen if not s.columns]
    out: list[tuple[Row, Beside]] = [(row, ()) for row in pose_rows(alone)] if alone else []
    for s in seen:
        if s.columns and len(s.y) == 1:
            a, b, c = s.H[0]
            out.append(((s.y[0], a, b, c, s.R[0][0]), _beside(s.columns, s.H_block[0])))
        elif s.columns and len(s.y) > 2:
            out += [(row, _beside(s.columns, g)) for row, g in whitened_with_blocks(s)]
        elif s.columns:
            rows, (g, *more) = whitened(s), s.H_block
            out.append((rows[0], _beside(s.columns, g)))
            for h in more:  # whitened like the rows
                k = s.R[0][1] / s.R[0][0]
                out.append((rows[1], _beside(s.columns, [v - k * w for v, w in zip(h, g, strict=True)])))
    return out


def _beside(columns: Sequence[int], derivatives: Sequence[float]) -> Beside:
    return tuple([(c - 3, g) for c, g in zip(columns, derivatives, strict=True)])
