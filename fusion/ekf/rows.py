"""Innovations as the rows of an equation: scalar rows for a filter in floats, one matrix for a filter in arrays.

A scalar row (y, a, b, c, r) says y = a dx + b dy + c dtheta + noise of variance r, independent of the others.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from math import inf, sqrt

import numpy as np

from locfuse.fusion.data import Array, Ints
from locfuse.fusion.sensor import Innovation

Row = tuple[float, float, float, float, float]
RANK = 1e-8  # relative information on a direction below which lines count as parallel


def whitened(seen: Innovation) -> list[Row]:
    """Return the rows of one innovation: a pair (r, psi) goes through the 2 x 2 Cholesky factor of its R."""
    y, H, R = seen.y, seen.H, seen.R
    if len(y) == 1:
        a, b, c = H[0]
        return [(y[0], a, b, c, R[0][0])]
    if len(y) > 2:
        return [row for row, _ in whitened_with_blocks(seen)]
    (r00, r01), (_, r11) = R
    (y0, y1), (h0, h1) = y, H
    k = r01 / r00
    a, b, c = h0
    return [(y0, a, b, c, r00), (y1 - k * y0, h1[0] - k * a, h1[1] - k * b, h1[2] - k * c, r11 - k * r01)]


def whitened_with_blocks(seen: Innovation) -> list[tuple[Row, list[float]]]:
    """Return rows of unit variance, each with its derivatives by the block's columns: L^-1 of R = L L' on all."""
    d = len(seen.y)
    own = np.array(seen.H_block) if seen.columns else np.zeros((d, 0))
    L = np.linalg.cholesky(np.array(seen.R))
    rows = np.linalg.solve(L, np.column_stack((seen.y, seen.H, own))).tolist()
    return [((y, a, b, c, 1.0), more) for y, a, b, c, *more in rows]


def pose_rows(seen: Sequence[Innovation]) -> list[Row]:
    """Return rows that say of the pose what innovations without blocks say.

    Numbers stay as they are and pairs are whitened, but lines, of which r tells x and y and psi tells theta, are
    added up: L = H' R^-1 H = U' U and U' w = H' R^-1 y make three rows w = U dx + noise of unit variance of them
    all, and adding a line costs less than two rows of the filter (benchmarks: "EKF step, predict + six lines").
    """
    if len(seen) == 1:
        return whitened(seen[0])
    rows: list[Row] = []
    lines = 0  # that are added up
    xx = xy = xt = yy = yt = tt = wx = wy = wt = 0.0
    for innovation in seen:
        y, H, R = innovation.y, innovation.H, innovation.R
        if len(y) == 1:
            a, b, c = H[0]
            rows.append((y[0], a, b, c, R[0][0]))
            continue
        if len(y) > 2:
            rows += whitened(innovation)
            continue
        (a, b, none), (no_x, no_y, c) = H
        (r00, r01), (_, r11) = R
        det = r00 * r11 - r01 * r01
        if none or no_x or no_y or not 0.0 < det < inf:
            rows += whitened(innovation)
            continue
        lines += 1
        y0, y1 = y
        i00, i01, i11 = r11 / det, -r01 / det, r00 / det
        ia, ib, jc = i00 * a, i00 * b, i01 * c
        e0 = i00 * y0 + i01 * y1
        xx += ia * a
        xy += ia * b
        yy += ib * b
        xt += jc * a
        yt += jc * b
        tt += i11 * c * c
        wx += a * e0
        wy += b * e0
        wt += c * (i01 * y0 + i11 * y1)
    if lines > 1 and xx > RANK * yy:
        u0 = sqrt(xx)
        u1, u2, w0 = xy / u0, xt / u0, wx / u0
        left = yy - u1 * u1
        if left > RANK * yy:
            v1 = sqrt(left)
            v2, w1 = (yt - u1 * u2) / v1, (wy - u1 * w0) / v1
            left = tt - u2 * u2 - v2 * v2
            if left > RANK * tt:
                t2 = sqrt(left)
                w2 = (wt - u2 * w0 - v2 * w1) / t2
                return [*rows, (w0, u0, u1, u2, 1.0), (w1, 0.0, v1, v2, 1.0), (w2, 0.0, 0.0, t2, 1.0)]
    return [row for innovation in seen for row in whitened(innovation)]  # lone or parallel lines: L is singular


def sparse_row(
    h: Sequence[float], columns: Sequence[int], H_block: Sequence[Sequence[float]]
) -> list[tuple[int, float]]:
    """Return one row's derivatives that are not zero, with their state columns."""
    entries = [*enumerate(h), *zip(columns, H_block[0], strict=True)] if columns else list(enumerate(h))
    return [(i, g) for i, g in entries if g != 0.0]


def stacked(seen: Sequence[Innovation]) -> tuple[Array, Ints, Array, Array]:
    """Return y (m,), the state columns (c,) that all of it depends on, H (m, c), R (m, m)."""
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
    return np.array(y), columns, H, R


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
