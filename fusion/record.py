"""What became of every measurement of one sensor in one run, in columns as narrow as the values allow."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from msgspec.structs import astuple
from numpy.typing import NDArray

from .data import Audit
from .sensors.base import Innovation

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


class Record:
    """An hour of Python objects would be hundreds of megabytes; of columns it is tens.

    Columns are kept in pieces until they are asked for: one that grows is moved again and again, and leaves holes
    in the heap that nothing fits into.
    """

    def __init__(self) -> None:
        self._instants: list[int] = []
        self._waiting: list[Innovation] = []  # until there are enough of them to be turned into columns at once
        self._pieces: dict[str, list[NDArray[Any]]] = {name: [] for name in COLUMNS}

    def add(self, k: int, seen: Sequence[Innovation]) -> None:
        """Note the innovations of one reading at instant k."""
        self._waiting += seen
        self._instants += [k] * len(seen)
        if len(self._waiting) > MANY:
            self._write()

    def _write(self) -> None:
        if not self._waiting:
            return
        columns = (self._instants, *zip(*map(astuple, self._waiting), strict=True))
        for (name, pieces), values in zip(self._pieces.items(), columns, strict=False):  # H, R, ... end here
            pieces.append(np.array(values, COLUMNS[name]))
        self._instants.clear()
        self._waiting.clear()

    def audit(self) -> Audit:
        """Return the record as columns."""
        self._write()
        for name, pieces in self._pieces.items():  # one column after the other: all at once would hold it twice
            none = np.empty((0, 1) if name in {"y", "sigma"} else 0, COLUMNS[name])
            pieces[:] = [np.concatenate(pieces) if pieces else none]
        return Audit(**{name: whole for name, (whole,) in self._pieces.items()})
