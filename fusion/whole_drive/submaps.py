"""Submaps: the keys of a stretch of a few metres as one cloud; and where one lies on another, by correlation.

Two submaps are compared at every shift and turn of a window, all shifts of one turn at once by the Fourier
transform (what is compared: Olson 2009, "Real-time correlative scan matching").
"""

from __future__ import annotations

import msgspec
import numpy as np
from numpy.typing import NDArray

from locfuse.fusion import se2
from locfuse.fusion.data import Array, Ints
from locfuse.fusion.scan_matching.clouds import Clouds, merged
from locfuse.fusion.scan_matching.free_space import Views

SPACING_M, HALF_LENGTH_M = 3.0, 3.0  # between two submaps, and how far one reaches along the way to either side
CELL_M, TURN_RAD = 0.25, np.radians(3.0)
REACH_M = 12.0  # points further from the middle are left out
GRID_CELLS = 256  # cells of the transform: submap and window fit in without wrapping
MAX_SHIFT_M = 0.5 * GRID_CELLS * CELL_M - 2.0 - REACH_M
APART_M = 1.5  # two peaks further apart are two places
ALIKE_SHARE = 0.93  # a second peak of this share of the best leaves it undecided


class Submaps(msgspec.Struct, frozen=True):
    """One cloud for every middle key, in that key's frame."""

    middle: Ints  # (s,) which key
    members: list[Ints]  # keys of each
    clouds: Clouds
    keys: Clouds  # of the n keys themselves
    views: Views  # of the keys
    way: Array  # (n,) m, driven until each key


def submaps_of(keys: Clouds, origin: Array, x: Array, way: Array) -> Submaps:
    """Cut the keys at poses x (n, 3), `way` (n,) [m], into submaps that overlap by half."""
    middle = np.flatnonzero(np.diff(np.floor(way / SPACING_M), prepend=-1.0) > 0)
    members = [np.flatnonzero(np.abs(way - way[k]) <= HALF_LENGTH_M) for k in middle.tolist()]
    poses = [se2.between(x[k], x[group]) for k, group in zip(middle.tolist(), members, strict=True)]
    return Submaps(middle, members, merged(keys, members, poses), keys, Views.of(keys, origin), way)


class Peak(msgspec.Struct, frozen=True):
    """Where one submap lies best on another one."""

    pose: Array  # (3,)
    score: float  # share of its cells that meet a surface
    second: float  # the best score elsewhere
    edge: bool  # whether it lies at the edge of the window

    @property
    def decided(self) -> bool:
        """Whether no other place fits about as well."""
        return not self.edge and self.second < ALIKE_SHARE * self.score


def correlate(ours: Array, theirs: Array, guess: Array, sigma: Array) -> Peak:
    """Return where the points `theirs` (k, 2) lie best on the points `ours` (m, 2), within 3 sigma."""
    from scipy.fft import irfft2, rfft2

    target = rfft2(_raster(ours, spread=True))
    half = min(3.0 * float(sigma[2]), np.pi)
    n = int(np.ceil(half / TURN_RAD))
    turns = np.arange(-n, n + 1) * TURN_RAD
    reach = np.minimum(3.0 * np.hypot(sigma[0], sigma[1]) + 2.0 * CELL_M, MAX_SHIFT_M)
    cells = int(reach / CELL_M)
    shift = np.round(guess[:2] / CELL_M).astype(np.int64)
    window = np.arange(-cells, cells + 1)
    rows, columns = (window + shift[1]) % GRID_CELLS, (window + shift[0]) % GRID_CELLS
    scores = np.empty((len(turns), len(window), len(window)), np.float32)
    for n, turn in enumerate(turns.tolist()):
        other = _raster(se2.rotated(np.array(guess[2] + turn), theirs), spread=False)
        total = max(float(other.sum()), 1.0)
        scores[n] = (
            irfft2(target * np.conj(rfft2(other)), s=(GRID_CELLS, GRID_CELLS))[np.ix_(rows, columns)] / total
        )
    k, r, c = (int(i) for i in np.unravel_index(int(scores.argmax()), scores.shape))
    dy, dx = window[r] + shift[1], window[c] + shift[0]
    away = (window[:, None] - window[r]) ** 2 + (window[None, :] - window[c]) ** 2 > (APART_M / CELL_M) ** 2
    elsewhere = scores[:, away]
    second = float(elsewhere.max()) if elsewhere.size else 0.0
    edge = bool(min(r, c) == 0 or max(r, c) == len(window) - 1)
    pose = np.array([dx * CELL_M, dy * CELL_M, guess[2] + turns[k]])
    return Peak(pose, float(scores[k, r, c]), second, edge)


def _raster(points: Array, spread: bool) -> NDArray[np.float32]:
    """Return which cells points fall in, (SIZE, SIZE) about the origin; `spread` gives their neighbours a half."""
    cells = np.round(points[np.abs(points).max(axis=1) < REACH_M] / CELL_M).astype(np.int64) % GRID_CELLS
    grid = np.zeros((GRID_CELLS, GRID_CELLS), np.float32)
    grid[cells[:, 1], cells[:, 0]] = 1.0
    if spread:
        around = np.maximum.reduce([np.roll(grid, (dy, dx), (0, 1)) for dy in (-1, 0, 1) for dx in (-1, 0, 1)])
        grid = np.maximum(grid, np.float32(0.5) * around)
    return grid
