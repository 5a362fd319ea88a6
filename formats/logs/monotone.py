"""Which of a series of stamps to trust: the consistent ones with the greatest weight."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from locfuse.fusion.data import Array, Ints


def never_decreasing(values: Ints, weights: Array) -> NDArray[np.bool_]:
    """Mark the never-decreasing subsequence of `values` (n,) with the greatest sum of positive `weights` (n,).

    The series falls into blocks with everything before below everything behind: ordinary values are blocks of
    one, so that only the disordered places are searched.
    """
    keep = np.ones(len(values), bool)
    if len(values) < 2:
        return keep
    highest = np.maximum.accumulate(values)[:-1]
    lowest = np.minimum.accumulate(values[::-1])[::-1][1:]
    edges = np.concatenate(([0], np.flatnonzero(highest <= lowest) + 1, [len(values)]))
    for i in np.flatnonzero(np.diff(edges) > 1).tolist():
        block = slice(int(edges[i]), int(edges[i + 1]))
        keep[block] = _heaviest(values[block], weights[block])
    return keep


def _heaviest(values: Ints, weights: Array) -> NDArray[np.bool_]:
    """Search one block by dynamic programming over a Fenwick tree of values: O(n log n)."""
    n = len(values)
    place = (np.unique(values, return_inverse=True)[1] + 1).tolist()
    best = [(0.0, -1)] * (n + 1)  # Fenwick tree of maxima: (weight, last element)
    before: list[int] = []
    for i, weight in enumerate(weights.tolist()):
        so_far, previous = _maximum_up_to(best, place[i])
        before.append(previous)
        _raise(best, place[i], (so_far + weight, i))
    keep = np.zeros(n, bool)
    i = _maximum_up_to(best, n)[1]
    while i >= 0:
        keep[i] = True
        i = before[i]
    return keep


def _maximum_up_to(tree: list[tuple[float, int]], at: int) -> tuple[float, int]:
    found = (0.0, -1)
    while at > 0:
        found = max(found, tree[at])
        at -= at & -at
    return found


def _raise(tree: list[tuple[float, int]], at: int, value: tuple[float, int]) -> None:
    while at < len(tree):
        tree[at] = max(tree[at], value)
        at += at & -at
