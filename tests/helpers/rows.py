"""What a test tells a filter: one motion, and rows of y = H dx + noise, for the product and for a textbook."""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from locfuse.fusion.data import Array, Ints, Measurements, matrices
from locfuse.fusion.ekf.belief_arrays import JointBelief
from locfuse.fusion.kernels.ekf import Innovation, Steps, TrackColumns
from locfuse.fusion.kernels.sight import AuditColumns, SightLines


def step(u: Sequence[float] | Array, Q: Any, dt: float = 0.0, J: Array | None = None) -> Steps:
    """One motion, as step 0: Q (3, 3) or its upper triangle (6,), J (3, p) by the wheel parameters."""
    whole = np.array(Q, np.float64)
    if whole.shape != (3, 3):
        xx, xy, xt, yy, yt, tt = whole.tolist()
        whole = np.array([[xx, xy, xt], [xy, yy, yt], [xt, yt, tt]])
    by = np.zeros((3, 0)) if J is None else J
    return Steps(np.array([u], np.float64), whole.reshape(1, 9), np.array([dt]), by.reshape(1, -1).copy())


def matrix_in_map(belief: JointBelief) -> Array:
    """Return the covariance (3, 3) of the pose in the map."""
    pose, triangle = np.empty((1, 3)), np.empty((1, 6))
    belief.note(0, TrackColumns(pose, triangle, np.empty((1, 0)), np.zeros(0, np.intp)))
    return matrices(triangle[0])


class Told(NamedTuple):
    """Rows y (d,) = H dx + noise of covariance R (d, d): H (d, 3) by the pose, `own` (d, c) by `columns` (c,)."""

    y: tuple[float, ...]
    H: Any
    R: Any
    columns: tuple[int, ...] = ()
    own: Any = ()

    def judged(self, belief: Any, threshold: float = math.inf) -> Innovation:
        found: Innovation = belief.compare(0, self.y, self.H, self.R, threshold, self.columns, self.own)
        return found


def some_told(rng: np.random.Generator, d: int, columns: tuple[int, ...] = ()) -> Told:
    """Random rows, their noise correlated."""
    L = 0.05 * (np.tril(rng.normal(size=(d, d))) + np.eye(d))
    y = tuple((0.05 * rng.normal(size=d)).tolist())
    return Told(y, rng.normal(size=(d, 3)), L @ L.T, columns, rng.normal(size=(d, len(columns))))


def dense(told: Sequence[Told], n: int) -> tuple[Array, Array, Array]:
    """What all rows say together: y (m,), H (m, n), R (m, m)."""
    m, k = sum(len(s.y) for s in told), 0
    H, R = np.zeros((m, n)), np.zeros((m, m))
    for s in told:
        at = slice(k, k + len(s.y))
        H[at, :3], R[at, at] = s.H, s.R
        if s.columns:
            H[at, list(s.columns)] = s.own
        k = at.stop
    return np.concatenate([np.zeros(0), *(s.y for s in told)]), H, R


def correct(belief: Any, *told: Told) -> None:
    """One instant: compare all, then correct once by all."""
    belief.begin()
    for seen in [s.judged(belief) for s in told]:
        belief.queue(seen)
    belief.correct()


def readings(t: Array, z: Array, sigma: float, **extra: Array) -> Measurements:
    """One row z (n, d) per reading, of noise sigma in every number and without a floor."""
    n, d = z.shape
    R_unit = np.broadcast_to(np.eye(d), (n, d, d)).copy()
    return Measurements(t, np.arange(n + 1), z, R_unit, sigma, np.zeros((d, d)), extra)


# --- what sensors say of their readings, as plain matrices and single innovations


class Said(NamedTuple):
    """One innovation: y = H dx + noise of covariance R."""

    columns: tuple[int, ...]  # states that it depends on, beside the pose, (c,)
    H: Array  # (d, 3 + c)
    R: Array  # (d, d)

    def over(self, n: int) -> Array:
        """H by the whole state, (d, n)."""
        return over_states(np.array([0, 1, 2, *self.columns]), self.H, n)


def over_states(columns: Ints, H: Array, n: int) -> Array:
    """H (d, c) by the states `columns`, by the whole state (d, n)."""
    out = np.zeros((len(H), n))
    out[:, columns] = H
    return out


def said(seen: Innovation, belief: JointBelief) -> Said:
    """What an innovation says, its H without states on which it does not depend."""
    equation = belief.equation([seen])
    return Said(tuple(equation.columns[3:].tolist()), equation.H, equation.R)


class Written(NamedTuple):
    """What became of n lines of a scan, as an audit has it."""

    verdict: Ints  # (n,)
    landmark: Ints
    nis: Array
    threshold: Array
    y: Array  # (n, 2)
    sigma: Array


def written(found: SightLines, row: int = 0) -> Written:
    """What a reading of two numbers a row writes into an audit."""
    n = found.lines
    instant, rows, landmark = (np.full(n, -9, kind) for kind in (np.int32, np.int32, np.int64))
    verdict, nis, threshold = np.full(n, -9, np.int8), np.zeros(n), np.zeros(n)
    y, sigma = np.zeros((n, 2)), np.zeros((n, 2))
    audit = AuditColumns(instant, rows, verdict, landmark)
    audit.judged(nis, threshold, y, sigma)
    found.row = row
    found.write(audit, 0, 5)
    assert (instant == 5).all()
    assert rows.tolist() == list(range(row, row + n))
    return Written(verdict.astype(np.intp), landmark.astype(np.intp), nis, threshold, y, sigma)


def one_by_one(seen: Sequence[Innovation] | SightLines) -> list[Innovation]:
    """What a sensor says of a reading, row by row; the rows of a scan that matches stand in the belief's table."""
    if not isinstance(seen, SightLines):
        return list(seen)
    rows, out, first = seen.rows_used(), [], seen.first
    table = written(seen, seen.row)
    for i in range(seen.lines):
        row = seen.row + i
        values = int(table.verdict[i]), int(table.landmark[i]), float(table.nis[i]), float(table.threshold[i])
        one = Innovation(row, *values, tuple(table.y[i].tolist()), tuple(table.sigma[i].tolist()))
        assert (row in rows) == (values[0] == 0)
        if row in rows:
            one.first, one.numbers = first, 2
            first += 2
        out.append(one)
    return out
