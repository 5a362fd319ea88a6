"""Points as SVG path text: no more of them than pixels show, in tenths of a pixel.

Noise keeps its peaks (the least and the greatest value of every pixel), smooth stretches keep few points.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from locfuse.formats.thin import extremes
from locfuse.fusion.data import Array, Ints

MAX_OFF_LINE_PX = 0.1  # px: a point this near to the line between its neighbours is not seen
MAX_PASSES = 8
MAX_DOTS, COARSE_PX = 2500, 2  # so many dots of a panel lie on single px, more on every second
TOUCHING_PX = 2  # px: dots this near in one column look like a line
CELL_PX = 0.4  # px: points of a path that follow each other within it look like one
CROSS_PX = 2.5  # px: half the side of a cross
MAX_COORDINATE_PX = 1e4  # px: beyond lies nothing that is drawn


def curve_path(x: Array, y: Array, pixels: int) -> str:
    """Return the path of a curve (n,) in px whose x grows; NaN breaks it."""
    kept = extremes(y, 2 * pixels)
    return _pieces(np.stack((x[kept], y[kept]), axis=-1))


def free_path(x: Array, y: Array) -> str:
    """Return the path of a curve (n,) in px that goes anywhere: a trajectory, one point per small cell."""
    cells = np.floor(np.stack((x, y), axis=-1) / CELL_PX)
    stays = (cells[1:-1] == cells[:-2]).all(axis=1) & np.isfinite(x[2:]) if len(x) > 2 else np.zeros(0, dtype=bool)
    kept = np.concatenate(([True], ~stays, [True]))[: len(x)]
    return _pieces(np.stack((x, y), axis=-1)[kept])


def band_path(x: Array, low: Array, high: Array, pixels: int) -> str:
    """Return the outline of a band (n,) in px."""
    good = np.isfinite(low) & np.isfinite(high)
    edges = np.stack((low, high), axis=-1)
    parts = []
    for run in _runs(good):
        kept = run[extremes(edges[run], 4 * pixels)]
        top = straightened(np.stack((x[kept], high[kept]), axis=-1))
        bottom = straightened(np.stack((x[kept], low[kept]), axis=-1))
        parts.append(_text(np.concatenate((top, bottom[::-1]))) + "z")
    return "".join(parts)


def dots_path(x: Array, y: Array) -> str:
    """Return one stroke per run of dots in a column of pixels; round caps make a single dot round."""
    good = np.isfinite(x) & np.isfinite(y) & (np.abs(y) < MAX_COORDINATE_PX)
    cells = np.unique(np.rint(np.stack((x[good], y[good]), axis=-1)).astype(np.int64), axis=0)
    if len(cells) == 0:
        return ""
    if len(cells) > MAX_DOTS:  # a dot is wider than two px
        cells = np.unique(cells // COARSE_PX * COARSE_PX, axis=0)
    step = np.diff(cells, axis=0)
    starts = np.flatnonzero(np.concatenate(([True], (step[:, 0] > 0) | (step[:, 1] > TOUCHING_PX))))
    ends = np.append(starts[1:] - 1, len(cells) - 1)
    runs = zip(cells[starts].tolist(), (cells[ends, 1] - cells[starts, 1]).tolist(), strict=True)
    return "".join(f"M{a}0 {b}0v{length}0" for (a, b), length in runs)


def strokes_path(ends: Array) -> str:
    """Return straight pieces (k, 2, 2) in px."""
    return "".join(_text(pair) for pair in ends if np.isfinite(pair).all())


def spots_path(x: Array, y: Array, crossed: bool = False) -> str:
    """Return one point per place, which its round or square cap makes a spot of fixed size; or a cross."""
    good = np.isfinite(x) & np.isfinite(y)
    tenths = np.rint(10.0 * np.clip(np.stack((x[good], y[good]), axis=-1), -MAX_COORDINATE_PX, MAX_COORDINATE_PX))
    r = round(10 * CROSS_PX)
    stroke = f"m{-r} {-r}l{2 * r} {2 * r}m0 {-2 * r}l{-2 * r} {2 * r}" if crossed else "h0"
    return "".join(f"M{a} {b}{stroke}" for a, b in tenths.astype(np.int64).tolist())


def places(x: Array, y: Array) -> str:
    """Return points in whole px, each as the step from the one before: "x y dx dy ..."."""
    limit = MAX_COORDINATE_PX
    whole = np.rint(np.clip(np.stack((x, y), axis=-1), -limit, limit)).astype(np.int64)
    steps = np.diff(whole, axis=0, prepend=np.zeros((1, 2), np.int64))
    return " ".join(map(str, steps.ravel().tolist()))


def straightened(points: Array) -> Array:
    """Drop points within MAX_OFF_LINE_PX of the line between their neighbours, never two neighbours at once."""
    for _ in range(MAX_PASSES):
        if len(points) < 3:
            break
        a, b, c = points[:-2], points[1:-1], points[2:]
        chord, to = c - a, b - a
        length = np.hypot(chord[:, 0], chord[:, 1])
        along = (chord * to).sum(axis=1)
        off = np.abs(chord[:, 0] * to[:, 1] - chord[:, 1] * to[:, 0])
        flat = (off <= MAX_OFF_LINE_PX * length) & (along >= 0.0) & (along <= length**2)
        flat[1::2] &= ~flat[:-1:2][: len(flat[1::2])]
        flat[2::2] &= ~flat[1::2][: len(flat[2::2])]
        if not flat.any():
            break
        points = points[np.concatenate(([True], ~flat, [True]))]
    return points


def _pieces(points: Array) -> str:
    good = np.isfinite(points[:, 0]) & np.isfinite(points[:, 1])
    return "".join(_text(straightened(points[run])) for run in _runs(good))


def _runs(good: NDArray[np.bool_]) -> list[Ints]:
    """Return the positions of each unbroken run of True."""
    at = np.flatnonzero(good)
    return [run for run in np.split(at, np.flatnonzero(np.diff(at) > 1) + 1) if len(run)]


def _text(points: Array) -> str:
    """Return "M x y l dx dy ..." in tenths of a pixel, without spaces that a minus sign can replace."""
    tenths = np.rint(np.clip(points, -MAX_COORDINATE_PX, MAX_COORDINATE_PX) * 10.0).astype(np.int64)
    steps = np.diff(tenths, axis=0)
    steps = steps[(steps != 0).any(axis=1)]
    start = f"M{tenths[0, 0]} {tenths[0, 1]}"
    if len(steps) == 0:
        return start + "h0"
    return start + "l" + " ".join(map(str, steps.ravel().tolist())).replace(" -", "-")
