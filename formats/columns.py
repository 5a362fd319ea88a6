"""The three kinds of column (numbers, ragged rows, one value per row), joined and reordered."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..fusion.data import Column, Ragged


def concat(parts: Sequence[Column]) -> Column:
    """Join columns of one kind end to end."""
    head = parts[0]
    if len(parts) == 1:
        return head
    if isinstance(head, Ragged):
        ragged = [part for part in parts if isinstance(part, Ragged)]
        lengths = np.concatenate([part.lengths for part in ragged])
        values = np.concatenate([part.values[part.first[0] : part.first[-1]] for part in ragged])
        return Ragged(values, np.concatenate(([0], np.cumsum(lengths))))
    if isinstance(head, list):
        return [value for part in parts if isinstance(part, list) for value in part]
    return np.concatenate([part for part in parts if isinstance(part, np.ndarray)])


def take(column: Column, rows: NDArray[Any]) -> Column:
    """Return the given rows (k,) in the given order."""
    if isinstance(column, list):
        return [column[i] for i in rows.tolist()]
    if isinstance(column, np.ndarray):
        picked: NDArray[Any] = column[rows]
        return picked
    matrix = column.matrix()
    if matrix is not None:
        n = matrix.shape[1]
        return Ragged(matrix[rows].ravel(), np.arange(len(rows) + 1) * n)
    lengths = column.lengths[rows]
    first = np.concatenate(([0], np.cumsum(lengths)))
    at = np.repeat(column.first[rows] - first[:-1], lengths) + np.arange(first[-1])
    return Ragged(column.values[at], first)


def n_bytes(column: Column) -> int:
    """Return about how much memory a column holds."""
    if isinstance(column, Ragged):
        return int(column.values.nbytes)
    if isinstance(column, list):
        return sum(len(value) for value in column)
    return int(column.nbytes)
