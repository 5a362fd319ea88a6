"""Lines of many pairs of scans compared at once: each scan's lines padded to the longest scan's, no loop."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from locfuse.fusion.data import Array, Ints
from locfuse.fusion.se2 import wrap_all

CELLS_AT_ONCE = 1 << 18  # pairs of lines that are compared at a time: memory is bounded


class Padded(NamedTuple):
    """Rows of k readings side by side, at most w each."""

    row: Ints  # (k, w) row in Measurements.z; any row where there is none
    there: NDArray[np.bool_]  # (k, w)


def blocks(first: Ints, before: Ints, after: Ints) -> Iterator[tuple[Ints, Padded, Padded]]:
    """Yield (positions (k,), rows of readings before[positions], rows of after[positions]), block by block."""
    counts = np.diff(first)
    if not len(before) or not first[-1]:
        return
    widest = int(counts.max())
    for at in np.array_split(np.arange(len(before)), len(before) * widest**2 // CELLS_AT_ONCE + 1):
        yield at, _padded(first, counts, before[at]), _padded(first, counts, after[at])


def _padded(first: Ints, counts: Ints, readings: Ints) -> Padded:
    nth = np.arange(max(int(counts[readings].max()), 1))
    there = nth < counts[readings, None]
    return Padded(np.where(there, first[readings, None] + nth, 0), there)


def misfit(turn: Array, shift: Array, scale: tuple[float, float], a: Padded, b: Padded) -> Array:
    """Return how badly line j of b fits line i of a, (k, w_a, w_b): below 1 is near; infinite without a line.

    turn [rad] and shift [m] from one to the other, in units of scale (rad, m).
    """
    cost = (turn / scale[0]) ** 2 + (shift / scale[1]) ** 2
    return np.where(a.there[:, :, None] & b.there[:, None, :], cost, np.inf)


def turn_of(a: Array, b: Array) -> Array:
    """Return the turn of line j of b (k, w_b) against line i of a (k, w_a), [rad], (k, w_a, w_b)."""
    return wrap_all(a[:, :, None] - b[:, None, :])


def nearest(values: Array, cost: Array) -> tuple[Array, Array, Ints]:
    """Return for each line of a, (k, w_a), value, cost and index of its nearest line of b."""
    j = cost.argmin(axis=2)
    at = j[:, :, None]
    return np.take_along_axis(values, at, 2)[:, :, 0], np.take_along_axis(cost, at, 2)[:, :, 0], j
