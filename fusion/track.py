"""What is recorded of the state at every instant: the pose with its covariance, and the sensors' own states."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from locfuse.fusion.core import coast as interpreted
from locfuse.fusion.core.room import Room
from locfuse.fusion.ekf.belief_arrays import JointBelief

from .data import Array, Ints


class Columns(NamedTuple):
    """The columns of a track, one row for each instant."""

    pose: Array  # (n, 3) in the map [m, m, rad], theta not wrapped
    triangle: Array  # (n, 6) xx, xy, xt, yy, yt, tt
    values: Array  # (n, 2 b) states of blocks, then their variances


class Track:
    """Columns with room for more instants: an hour of Python tuples would be hundreds of megabytes."""

    def __init__(self, belief: JointBelief, blocks: Sequence[str], instants: int) -> None:
        """`blocks` are recorded too: their states keep their columns. `instants`: how many come, if known."""
        parts = [(name, *belief.block(name)) for name in blocks]
        self.states: Ints = np.array([c + i for _, c, x in parts for i in range(len(x))], np.intp)
        self._names = [(name, len(x)) for name, _, x in parts]
        self.columns = self._of(instants)
        self.n = 0
        self._room = np.empty(9)
        self._core = Room.here(interpreted).on_arrays

    def _of(self, n: int) -> Columns:
        return Columns(np.empty((n, 3)), np.empty((n, 6)), np.empty((n, 2 * len(self.states))))

    def make_room(self, instants: int) -> None:
        """Have columns of at least so many instants."""
        if instants <= len(self.columns.pose):
            return
        more = self._of(max(instants, 2 * self.n))
        for old, new in zip(self.columns, more, strict=True):
            new[: self.n] = old[: self.n]
        self.columns = more

    def note(self, belief: JointBelief) -> None:
        """Record an instant, seen from the map."""
        self.make_room(self.n + 1)
        (pose, triangle, values), states = self.columns, self.states
        at = *belief.arrays, belief.in_frame, self._room, self.n
        self._core.note(*at, pose, triangle, states, len(states), values)
        self.n += 1

    def recorded(self) -> tuple[Array, Array]:
        """Return pose (n, 3) and covariance triangles (n, 6)."""
        return self.columns.pose[: self.n], self.columns.triangle[: self.n]

    def blocks(self, variances: bool = False) -> dict[str, Array]:
        """Return one column per number of every block, (n, numbers), or its variances."""
        at = len(self.states) if variances else 0
        found = {}
        for name, n in self._names:
            found[name] = np.ascontiguousarray(self.columns.values[: self.n, at : at + n])
            at += n
        return found
