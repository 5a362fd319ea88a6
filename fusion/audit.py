"""What became of every measurement of one sensor in one run, in columns as narrow as the values allow."""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from typing import Any

import numpy as np
from msgspec.structs import astuple
from numpy.typing import NDArray

from .data import Audit, Ints
from .sensor import Innovation, Reading, Table

MANY = 256
COLUMNS = {
    "instant": np.int32,
    "row": np.int32,
    "verdict": np.int8,
    "landmark": np.int32,
    "nis": np.float64,
    "threshold": np.float64,
    "y": np.float64,
    "sigma": np.float64,
}
WIDE = ("y", "sigma")  # one number for each that the sensor measures


class Record:
    """An hour of Python objects would be hundreds of megabytes; of columns it is tens.

    `room` is how many rows will come, where that is known: a column that grows is moved, and leaves a hole.
    """

    def __init__(self, room: int = MANY) -> None:
        self._room, self._rows = room, 0
        self._instants: list[int] = []
        self._waiting: list[Innovation] = []  # until there are enough of them to be turned into columns at once
        self._columns: dict[str, NDArray[Any]] = {}
        self.joint = array("d")  # flat: y' S^-1 y of all accepted rows of a reading together, its dof

    def add(self, k: int, seen: Sequence[Innovation]) -> None:
        """Note the innovations of one reading at instant k."""
        if isinstance(seen, Reading):
            self.add_rows(k, seen.table())
            return
        self._waiting += seen
        self._instants += [k] * len(seen)
        if len(self._waiting) > MANY:
            self._write()

    def add_rows(self, k: int | Ints, of: Table) -> None:
        """Note rows of one reading at instant k, or of many, at instants (n,)."""
        self._write()
        at = slice(self._rows, self._rows + len(of.nis))
        self._make_room(at.stop, of.y.shape[1])
        rows = np.arange(of.first, of.first + len(of.nis))
        values = (k, rows, of.verdict, of.landmark, of.nis, of.threshold, of.y, of.sigma)
        for column, of_rows in zip(self._columns.values(), values, strict=True):
            column[at] = of_rows
        self._rows = at.stop

    def _write(self) -> None:
        if not self._waiting:
            return
        at = slice(self._rows, self._rows + len(self._waiting))
        self._make_room(at.stop, len(self._waiting[0].y))
        values = (self._instants, *zip(*map(astuple, self._waiting), strict=True))
        for column, of_rows in zip(self._columns.values(), values, strict=False):  # H, R, ... end here
            column[at] = of_rows
        self._rows = at.stop
        self._instants.clear()
        self._waiting.clear()

    def _make_room(self, rows: int, width: int) -> None:
        """Have columns of at least so many rows; an innovation has `width` numbers."""
        if self._columns and rows <= self._room:
            return
        self._room = max(self._room if not self._columns else 3 * self._room // 2, rows)
        for name, dtype in COLUMNS.items():
            shape = (self._room, width) if name in WIDE else (self._room,)
            column = np.empty(shape, dtype)
            if self._rows:
                column[: self._rows] = self._columns[name][: self._rows]
            self._columns[name] = column

    def audit(self) -> Audit:
        """Return the record as columns: views, since a copy would hold everything twice for a moment."""
        self._write()
        self._make_room(0, 1)
        joint = np.array(self.joint).reshape(-1, 2)
        return Audit(**{name: column[: self._rows] for name, column in self._columns.items()}, joint=joint)
