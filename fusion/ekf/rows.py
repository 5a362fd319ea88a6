"""Innovations as one equation, y = H dx + noise of covariance R, by the states that any of them depends on."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from locfuse.fusion.data import Array, Ints
from locfuse.fusion.sensor import Equation, Innovation, Reading


def sparse_row(
    h: Sequence[float], columns: Sequence[int], H_block: Sequence[Sequence[float]]
) -> list[tuple[int, float]]:
    """Return one row's derivatives that are not zero, with their state columns."""
    entries = [*enumerate(h), *zip(columns, H_block[0], strict=True)] if columns else list(enumerate(h))
    return [(i, g) for i, g in entries if g != 0.0]


def together(seen: Sequence[Innovation | Reading]) -> Equation:
    """Return what single innovations and readings of many say at once, in their order."""
    if len(seen) == 1:
        s = seen[0]
        return s.equation() if isinstance(s, Reading) else _alone(s)
    parts: list[Equation] = []
    single: list[Innovation] = []
    for s in seen:
        if not isinstance(s, Reading):
            single.append(s)
            continue
        parts += [stacked(single)] if single else []
        parts.append(s.equation())
        single = []
    parts += [stacked(single)] if single else []
    return parts[0] if len(parts) == 1 else _beside(parts)


def _beside(parts: Sequence[Equation]) -> Equation:
    """Return equations whose noise is independent as one."""
    m, c = sum([len(p.y) for p in parts]), sum([len(p.columns) for p in parts])
    H, R = np.zeros((m, c)), np.zeros((m, m))
    i = j = 0
    for y, columns, part, noise in parts:
        below, right = i + len(y), j + len(columns)
        H[i:below, j:right], R[i:below, i:below] = part, noise
        i, j = below, right
    return Equation(np.concatenate([p.y for p in parts]), np.concatenate([p.columns for p in parts]), H, R)


def stacked(seen: Sequence[Innovation]) -> Equation:
    """Return y (m,), the state columns (c,) that all of it depends on, H (m, c), R (m, m)."""
    if len(seen) == 1:
        return _alone(seen[0])
    columns, H_at, R_at = _layout(tuple([(len(s.y), s.columns) for s in seen]))
    y: list[float] = []
    H_values: list[float] = []
    R_values: list[float] = []
    for s in seen:
        y += s.y
        for i, h in enumerate(s.H):
            H_values += h
            if s.columns:
                H_values += s.H_block[i]
            R_values += s.R[i]
    H, R = np.zeros((len(y), len(columns))), np.zeros((len(y), len(y)))
    H.put(H_at, H_values)
    R.put(R_at, R_values)
    shared = [s.shared for s in seen if s.shared]
    if shared:
        R += _between(seen, len(shared[0][0]), R_at)
    return Equation(np.array(y, np.float64), columns, H, R)


def _alone(s: Innovation) -> Equation:
    H = [(*h, *own) for h, own in zip(s.H, s.H_block, strict=True)] if s.columns else s.H
    columns: Ints = np.array((0, 1, 2, *s.columns))
    return Equation(np.array(s.y, np.float64), columns, np.array(H, np.float64), np.array(s.R, np.float64))


def _between(seen: Sequence[Innovation], k: int, own: Ints) -> Array:
    """Return the covariance (m, m) of k errors that innovations share; 0 at the places `own`, which hold R."""
    none = ((0.0,) * k,)
    G = np.array([g for s in seen for g in s.shared or none * len(s.y)])
    between: Array = G @ G.T
    between.put(own, 0.0)
    return between


@lru_cache(maxsize=1024)
def _layout(parts: tuple[tuple[int, tuple[int, ...]], ...]) -> tuple[Ints, Ints, Ints]:
    """Return the state columns (c,) and the flat places of the numbers in H and R, for parts (d, state columns).

    The same walls are seen scan after scan, so that what lies where is mostly known.
    """
    columns = [0, 1, 2, *dict.fromkeys([c for _, own in parts for c in own])]
    at = {c: i for i, c in enumerate(columns)}
    m, c = sum(d for d, _ in parts), len(columns)
    H_at: list[int] = []
    R_at: list[int] = []
    first = 0
    for d, own in parts:
        for i in range(first, first + d):
            H_at += [i * c + at[j] for j in (0, 1, 2, *own)]
            R_at += range(i * m + first, i * m + first + d)
        first += d
    return np.array(columns), np.array(H_at), np.array(R_at)
