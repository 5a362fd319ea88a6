"""What a test tells a filter: one motion, and rows of y = H dx + noise, for the product and for a textbook."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from locfuse.fusion.data import Array
from locfuse.fusion.kernels.ekf import Innovation, Steps


def step(u: Sequence[float] | Array, Q: Any, dt: float = 0.0, J: Array | None = None) -> Steps:
    """One motion, as step 0: Q (3, 3) or its upper triangle (6,), J (3, p) by the wheel parameters."""
    whole = np.array(Q, np.float64)
    if whole.shape != (3, 3):
        xx, xy, xt, yy, yt, tt = whole.tolist()
        whole = np.array([[xx, xy, xt], [xy, yy, yt], [xt, yt, tt]])
    by = np.zeros((3, 0)) if J is None else J
    return Steps(np.array([u], np.float64), whole.reshape(1, 9), np.array([dt]), by.reshape(1, -1).copy())


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
