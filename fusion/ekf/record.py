"""Record of one run: the verdict on every measurement, and the state at every update time, as columns."""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from operator import attrgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from locfuse.fusion.data import Array, Audit, Ints
from locfuse.fusion.kernels import ekf, sight
from locfuse.fusion.kernels.ekf import Innovation

from .belief_arrays import JointBelief

FIRST_CAPACITY = 256
COLUMNS = {
    "instant": np.int32,
    "row": np.int32,
    "verdict": np.int8,
    "landmark": np.int64,  # landmark ids are chosen by the user and may be large
    "nis": np.float64,
    "threshold": np.float64,
    "y": np.float64,
    "sigma": np.float64,
}
ROW = attrgetter("row")
PER_COMPONENT = ("y", "sigma")  # columns with one number per component of the measurement


class Record:
    """Record of measurements in columns: tens of megabytes per hour, instead of hundreds as Python objects.

    `room` is the expected number of rows, if known: growing columns fragment the memory.
    """

    def __init__(self, room: int = FIRST_CAPACITY) -> None:
        self._room, self._rows = room, 0
        self._instants: list[int] = []
        self._waiting: list[Innovation] = []  # not yet written to columns
        self._columns: dict[str, NDArray[Any]] = {}
        self._kernel: sight.AuditColumns | None = None
        self.joint = array("d")  # in turn: joint NIS of a reading's accepted rows, its dof

    def add(self, k: int, seen: Sequence[Innovation] | sight.SightLines) -> None:
        """Record the innovations of one reading at update k, with their verdicts."""
        if isinstance(seen, sight.SightLines):
            self._write()
            end = self._rows + seen.lines
            if self._kernel is None or end > self._room:
                self._make_room(end, 2)
                self._kernel = sight.AuditColumns(*[self._columns[name] for name in COLUMNS][:4])
                self._kernel.judged(*[self._columns[name] for name in COLUMNS][4:])
            seen.write(self._kernel, self._rows, k)
            self._rows = end
            return
        self._waiting += seen if len(seen) < 2 else sorted(seen, key=ROW)
        self._instants += [k] * len(seen)
        if len(self._waiting) > FIRST_CAPACITY:
            self._write()

    def _write(self) -> None:
        waiting = self._waiting
        if not waiting:
            return
        at = slice(self._rows, self._rows + len(waiting))
        self._make_room(at.stop, len(waiting[0].y))
        self._columns["instant"][at] = self._instants
        for name in list(COLUMNS)[1:]:
            self._columns[name][at] = [getattr(s, name) for s in waiting]
        self._rows = at.stop
        self._instants.clear()
        waiting.clear()

    def _make_room(self, rows: int, width: int) -> None:
        """Increase the capacity to `rows` rows; each innovation has `width` components."""
        if self._columns and rows <= self._room:
            return
        self._room = max(self._room if not self._columns else 3 * self._room // 2, rows)
        self._kernel = None
        for name, dtype in COLUMNS.items():
            shape = (self._room, width) if name in PER_COMPONENT else (self._room,)
            column = np.empty(shape, dtype)
            if self._rows:
                column[: self._rows] = self._columns[name][: self._rows]
            self._columns[name] = column

    def audit(self) -> Audit:
        """Return the record as columns, which are views to save memory."""
        self._write()
        self._make_room(0, 1)
        joint = np.array(self.joint).reshape(-1, 2)
        return Audit(**{name: column[: self._rows] for name, column in self._columns.items()}, joint=joint)


class Track:
    """Record of the states in columns, with spare rows."""

    def __init__(self, belief: JointBelief, blocks: Sequence[str], instants: int) -> None:
        """Begin the record.

        `blocks` are the names of states to record besides the pose, `instants` the expected number of rows.
        """
        parts = [(name, *belief.block(name)) for name in blocks]
        self._states: Ints = np.array([c + i for _, c, x in parts for i in range(len(x))], np.intp)
        self._names = [(name, len(x)) for name, _, x in parts]
        self._n = self._room = 0
        # pose in the map (n, 3) [m, m, rad, not wrapped]; its covariance (n, 6) xx, xy, xt, yy, yt, tt; states of
        # the blocks, then their variances, (n, 2 b)
        self._columns: tuple[Array, ...] = tuple(np.empty((0, k)) for k in (3, 6, 2 * len(self._states)))
        self._make_room(instants)

    def _make_room(self, instants: int) -> None:
        more = tuple(np.empty((instants, column.shape[1])) for column in self._columns)
        for old, new in zip(self._columns, more, strict=True):
            new[: self._n] = old[: self._n]
        self._columns, self._room = more, instants
        pose, triangle, values = more
        self._kernel = ekf.TrackColumns(pose, triangle, values, self._states)

    def note(self, belief: JointBelief) -> None:
        """Record the state at one update, with the pose in the map."""
        if self._n == self._room:
            self._make_room(2 * self._n + 1)
        belief.note(self._n, self._kernel)
        self._n += 1

    def recorded(self) -> tuple[Array, Array]:
        """Return poses (n, 3) and covariance triangles (n, 6)."""
        return self._columns[0][: self._n], self._columns[1][: self._n]

    def blocks(self, variances: bool = False) -> dict[str, Array]:
        """Return the states of every block, (n, states), or with `variances` their variances."""
        at = len(self._states) if variances else 0
        found = {}
        for name, n in self._names:
            found[name] = np.ascontiguousarray(self._columns[2][: self._n, at : at + n])
            at += n
        return found
