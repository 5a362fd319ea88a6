"""Columns of message fields: reading them from bytes, and appending rows.

A column holds numbers, ragged rows or a list of values. Its name is the dotted path of its field ("header.stamp").
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from locfuse.fusion.data import Column, Ints, Ragged

Bytes = NDArray[np.uint8]
MAX_UNCHECKED_ELEMENTS = 1 << 22  # largest first allocation: the message count in a file may be wrong


def nested(fields: Mapping[str, Any]) -> dict[str, Any]:
    """Return fields by dotted path as nested fields: {"a.b": 1} -> {"a": {"b": 1}}."""
    tree: dict[str, Any] = {}
    for path, value in fields.items():
        *parents, leaf = path.split(".")
        node = tree
        for name in parents:
            node = node.setdefault(name, {})
        node[leaf] = value
    return tree


def view(data: Bytes, dtype: str, at: Ints) -> NDArray[Any]:
    """Return the values (k,) of numpy type `dtype` at byte offsets `at` (k,), which need not be aligned."""
    size = np.dtype(dtype).itemsize
    return np.ndarray((max(len(data) - size + 1, 0),), dtype, data, 0, (1,))[at]


def n_bytes(column: Column) -> int:
    """Return the approximate memory of a column [bytes]."""
    if isinstance(column, Ragged):
        return int(column.values.nbytes)
    if isinstance(column, list):
        return sum(len(value) for value in column)
    return int(column.nbytes)


class Growing:
    """Column to which rows are appended, in one allocation if the number of rows is known in advance.

    Concatenating a list of parts would need twice the memory and fragment the heap.
    """

    def __init__(self, rows: int) -> None:
        self._expected = rows
        self._values = GrowingArray(rows)
        self._lengths = GrowingArray(rows)
        self._list: list[Any] = []
        self._kind: type | None = None

    def add(self, piece: Column) -> None:
        """Append the rows of a piece."""
        self._kind = type(piece)
        if isinstance(piece, Ragged):
            if self._values.used == 0 and len(piece):
                mean = (piece.first[-1] - piece.first[0]) / len(piece)
                self._values = GrowingArray(max(round(mean * self._expected), 1))
            self._lengths.add(piece.lengths)
            self._values.add(piece.values[piece.first[0] : piece.first[-1]])
        elif isinstance(piece, list):
            self._list += piece
        else:
            self._values.add(piece)

    def column(self, empty: Column) -> Column:
        """Return the whole column; `empty` if nothing was added."""
        if self._kind is None:
            return empty
        if self._kind is list:
            return self._list
        if self._kind is not Ragged:
            return self._values.array()
        lengths = self._lengths.array()
        first = np.zeros(len(lengths) + 1, np.int64)
        np.cumsum(lengths, out=first[1:])
        return Ragged(self._values.array(), first)


class GrowingArray:
    """Array to which rows are appended; it has spare capacity."""

    def __init__(self, capacity: int) -> None:
        self.used = 0
        self._capacity = min(capacity, MAX_UNCHECKED_ELEMENTS)
        self._data: NDArray[Any] | None = None

    def add(self, piece: NDArray[Any]) -> None:
        """Append rows."""
        end = self.used + len(piece)
        if self._data is None:
            self._data = np.empty((max(self._capacity, end), *piece.shape[1:]), piece.dtype)
        if end > len(self._data):
            grown = np.empty((max(end, len(self._data) * 3 // 2), *piece.shape[1:]), piece.dtype)
            grown[: self.used] = self._data[: self.used]
            self._data = grown
        self._data[self.used : end] = piece
        self.used = end

    def array(self) -> NDArray[Any]:
        """Return all rows that were added."""
        return np.empty(0, np.int64) if self._data is None else self._data[: self.used]
