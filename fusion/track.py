"""What is recorded of the state at every instant: the pose with its covariance, and the sensors' own states."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from locfuse.fusion.ekf.belief_arrays import JointBelief
from locfuse.fusion.kernels import ekf

from .data import Array, Ints


class Track:
    """Columns with room for more instants: an hour of Python tuples would be hundreds of megabytes."""

    def __init__(self, belief: JointBelief, blocks: Sequence[str], instants: int) -> None:
        """`blocks` are recorded too: their states keep their columns. `instants`: how many come, if known."""
        parts = [(name, *belief.block(name)) for name in blocks]
        self._states: Ints = np.array([c + i for _, c, x in parts for i in range(len(x))], np.intp)
        self._names = [(name, len(x)) for name, _, x in parts]
        self._n = self._room = 0
        # in the map (n, 3) [m, m, rad, not wrapped]; its covariance (n, 6) xx, xy, xt, yy, yt, tt; blocks' states,
        # then their variances, (n, 2 b)
        self._columns: tuple[Array, ...] = tuple(np.empty((0, k)) for k in (3, 6, 2 * len(self._states)))
        self._make_room(instants)

    def _make_room(self, instants: int) -> None:
        more = tuple(np.empty((instants, column.shape[1])) for column in self._columns)
        for old, new in zip(self._columns, more, strict=True):
            new[: self._n] = old[: self._n]
        self._columns, self._room = more, instants
        pose, triangle, values = more
        self._kernel = ekf.Track(pose, triangle, values, self._states)

    def note(self, belief: JointBelief) -> None:
        """Record an instant, seen from the map."""
        if self._n == self._room:
            self._make_room(2 * self._n + 1)
        belief.note(self._n, self._kernel)
        self._n += 1

    def recorded(self) -> tuple[Array, Array]:
        """Return pose (n, 3) and covariance triangles (n, 6)."""
        return self._columns[0][: self._n], self._columns[1][: self._n]

    def blocks(self, variances: bool = False) -> dict[str, Array]:
        """Return one column per number of every block, (n, numbers), or its variances."""
        at = len(self._states) if variances else 0
        found = {}
        for name, n in self._names:
            found[name] = np.ascontiguousarray(self._columns[2][: self._n, at : at + n])
            at += n
        return found
