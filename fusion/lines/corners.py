"""Leave out what does not show a wall as it is: beams near a corner, and beams that graze it.

Near a corner the noise decides which wall a beam is counted to, so those beams are biased, and at the end of a
wall they turn it most. Which beams to leave out is decided by the *predicted* point on the wall, never by the
measured one, for choosing by the noise would bias what stays.
"""

from __future__ import annotations

import numpy as np

from locfuse.fusion.data import Array, Ints

from .beams import LineSettings, Runs
from .fit import Mask
from .walls import Walls, point_sigma

_TOUCHING = 4  # walls whose facing ends are this many beams apart meet in a corner
_SHARE = 0.2  # of a wall's length may be left out at either end
_BENT = 0.1  # sine of the least angle that is a corner


def clear_beams(runs: Runs, walls: Walls, foot: Array, counts: Ints, settings: LineSettings) -> Mask:
    """Return which of the walls' beams show their wall as it is, (k,), by their predicted feet (k,) [m]."""
    low, high = _corner_limits(runs, walls, settings)
    flat = walls.r * np.tan(settings.max_incidence)
    clear = foot >= np.repeat(np.maximum(low, -flat), counts)
    clear &= foot <= np.repeat(np.minimum(high, flat), counts)
    return clear


def _corner_limits(runs: Runs, walls: Walls, settings: LineSettings) -> tuple[Array, Array]:
    """Return the feet [m] along each wall's tangent between which its beams are its own, low and high (m,)."""
    x, y, tx, ty = runs.beams.x, runs.beams.y, -np.sin(walls.psi), np.cos(walls.psi)
    begin, end = (tx * x[i] + ty * y[i] for i in (walls.head, walls.tail))
    sign = np.where(end >= begin, 1.0, -1.0)  # +1 where the feet grow along the beams
    low, high = np.full(len(sign), -np.inf), np.full(len(sign), np.inf)
    i, j = _corners(runs, walls, settings.max_gap)
    turn = walls.psi[j] - walls.psi[i]
    sin, cos = np.sin(turn), np.cos(turn)
    margin = settings.corner_sigmas * point_sigma(runs.beams.rays.d[walls.tail[i]], settings) / np.abs(sin)
    corner_i = sign[i] * (walls.r[j] - walls.r[i] * cos) / sin
    corner_j = sign[j] * (walls.r[j] * cos - walls.r[i]) / sin
    share = _SHARE * np.abs(end - begin)
    high[i] = np.maximum(corner_i - margin, (sign * end - share)[i])
    low[j] = np.minimum(corner_j + margin, (sign * begin + share)[j])
    return np.where(sign > 0, low, -high), np.where(sign > 0, high, -low)


def _corners(runs: Runs, walls: Walls, reach: float) -> tuple[Ints, Ints]:
    """Return the walls (i, j) where j begins where i ends: within a few beams and nearer than `reach` [m]."""
    beams, scan = runs.beams, runs.beams.scan[walls.head]
    i = np.arange(len(scan))
    last = np.append(scan[1:] != scan[:-1], True)
    j = np.where(last, np.searchsorted(scan, scan), i + 1)  # behind the last wall comes the scan's first
    head, tail = walls.head[j], walls.tail
    apart = (head - tail) % runs.counts[scan]
    gap = np.hypot(beams.x[head] - beams.x[tail], beams.y[head] - beams.y[tail])
    bent = np.abs(np.sin(walls.psi[j] - walls.psi)) > _BENT
    pair = (apart <= _TOUCHING) & (gap <= reach) & bent & (runs.closed[scan] | ~last)
    return i[pair], j[pair]
