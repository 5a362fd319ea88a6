"""Which beams of a scan see the same straight wall: split, merge, bridge shadows, leave corners out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from locfuse.fusion.data import Array, Ints

from .beams import Beams, LineSettings, Runs
from .fit import Mask, misfit, total_least_squares
from .split import chords, merge, split

MAX_STRAY_BEAMS = 2  # beams that hit something else and do not end a line: strays


@dataclass(frozen=True)
class Walls:
    """Walls made of parts: wall i owns the parts bounds[i]:bounds[i + 1], part j the rows start[j]:stop[j]."""

    start: Ints  # (parts,) rows of the beam columns
    stop: Ints  # (parts,)
    bounds: Ints  # (m + 1,)
    r: Array  # (m,) m, first estimate: weighted perpendicular fit
    psi: Array  # (m,) rad

    @property
    def head(self) -> Ints:
        """Row of every wall's first beam, (m,)."""
        return self.start[self.bounds[:-1]]

    @property
    def tail(self) -> Ints:
        """Row of every wall's last beam, (m,)."""
        return self.stop[self.bounds[1:] - 1] - 1

    def rows(self) -> tuple[Ints, Ints]:
        """Return the rows of all beams, one wall after another (k,), and how many each wall has (m,)."""
        sizes = self.stop - self.start
        total = np.concatenate(([0], np.cumsum(sizes)))
        return np.arange(total[-1]) + np.repeat(self.start - total[:-1], sizes), np.diff(total[self.bounds])


def find_walls(runs: Runs, settings: LineSettings) -> Walls:
    """Return the straight walls among the beams."""
    beams = runs.beams
    x, y, d = (a.astype(np.float32) for a in (beams.x, beams.y, beams.rays.d))  # a micrometre decides no corner
    tolerance = np.maximum(settings.split_sigmas * point_sigma(d, settings), settings.split_floor)
    first = split(x, y, tolerance, runs.first)
    moments = _weighted_moments(beams, first, settings)
    first, moments = _merge_neighbours(runs, first, moments, settings.merge_chi2)
    wall = _long_enough(beams, first, settings)
    parts, moments = (first[:-1][wall], first[1:][wall]), moments[:, wall]
    bounds, moments = _bridge_shadows(runs, *parts, moments, settings)
    parts, bounds, moments = _close_rings(runs, parts, bounds, moments, settings)
    r, psi, _ = total_least_squares(moments)
    return Walls(*parts, bounds, r, psi)


def point_sigma(d: NDArray[Any], settings: LineSettings) -> NDArray[Any]:
    """Return the larger standard deviation of a beam's end point at range d [m], whatever the wall's direction."""
    across = settings.sigma_angle * d
    across *= across
    across += settings.sigma_range**2
    return np.asarray(np.sqrt(across, out=across))


def _weighted_moments(beams: Beams, first: Ints, settings: LineSettings) -> Array:
    """Return each piece's moments (6, p), its points weighted by 1/variance across the piece's chord."""
    rays, (nx, ny, _) = beams.rays, chords(beams.x, beams.y, first)
    nx, ny = np.repeat(nx, np.diff(first)), np.repeat(ny, np.diff(first))
    cos, sin = nx * rays.c, nx * rays.s
    cos += ny * rays.s
    sin -= ny * rays.c
    sin *= rays.d
    cos *= settings.sigma_range
    cos *= cos
    sin *= settings.sigma_angle
    sin *= sin
    variance = np.add(cos, sin, out=cos)
    variance += settings.flatness**2
    rows = np.empty((6, len(cos)))
    np.divide(1.0, variance, out=rows[0])
    np.multiply(rows[0], beams.x, out=rows[1])
    np.multiply(rows[0], beams.y, out=rows[2])
    np.multiply(rows[1], beams.x, out=rows[3])
    np.multiply(rows[1], beams.y, out=rows[4])
    np.multiply(rows[2], beams.y, out=rows[5])
    return np.add.reduceat(rows, first[:-1], axis=1)


def _merge_neighbours(runs: Runs, first: Ints, moments: Array, limit: float) -> tuple[Ints, Array]:
    """Join pieces of one run that noise cut apart."""
    opens = np.zeros(first[-1] + 1, bool)
    opens[runs.first] = True
    bounds = merge(moments, ~opens[first[1:-1]], limit)
    return first[bounds], np.add.reduceat(moments, bounds[:-1], axis=1)


def _long_enough(beams: Beams, first: Ints, settings: LineSettings) -> Mask:
    """Return which pieces have the points and the length of a wall, (p,)."""
    head, tail = first[:-1], first[1:] - 1
    length = np.hypot(beams.x[tail] - beams.x[head], beams.y[tail] - beams.y[head])
    return np.asarray((np.diff(first) >= settings.min_points) & (length >= settings.min_length))


def _bridge_shadows(
    runs: Runs, start: Ints, stop: Ints, moments: Array, settings: LineSettings
) -> tuple[Ints, Array]:
    """Join parts of one wall left and right of what stands before it; return the groups' bounds and moments."""
    linked = _near(runs, start[:-1], stop[:-1] - 1, start[1:], stop[1:] - 1, settings)
    bounds = merge(moments, linked, settings.merge_chi2)
    return bounds, np.add.reduceat(moments, bounds[:-1], axis=1)


def _near(runs: Runs, head: Ints, tail: Ints, next_head: Ints, next_tail: Ints, settings: LineSettings) -> Mask:
    """Return whether one line may go on in the next part of its scan, given both parts' first and last rows.

    It may if next to no beams are between them, or if they are closer than `bridge` and than both their lengths.
    """
    x, y, scan = runs.beams.x, runs.beams.y, runs.beams.scan
    gap = np.hypot(x[next_head] - x[tail], y[next_head] - y[tail])
    length = np.hypot(x[tail] - x[head], y[tail] - y[head])
    next_length = np.hypot(x[next_tail] - x[next_head], y[next_tail] - y[next_head])
    near = gap <= np.minimum(np.minimum(length, next_length), settings.bridge)
    between = (next_head - tail) % runs.counts[scan[head]] - 1
    near |= (between <= MAX_STRAY_BEAMS) & (gap <= settings.max_gap)
    return np.asarray(near & (scan[head] == scan[next_head]))


def _close_rings(
    runs: Runs, parts: tuple[Ints, Ints], bounds: Ints, moments: Array, settings: LineSettings
) -> tuple[tuple[Ints, Ints], Ints, Array]:
    """Join the first and the last wall of a scan of the whole circle where its start cut one wall in two."""
    (start, stop), beams = parts, runs.beams
    if len(start) == 0 or not runs.closed.any():
        return parts, bounds, moments
    scan = beams.scan[start[bounds[:-1]]]
    first, last = _first_and_last(scan)
    heads, tails = start[bounds[:-1]], stop[bounds[1:] - 1] - 1
    near = _near(runs, heads[last], tails[last], heads[first], tails[first], settings)
    joint = moments[:, first] + moments[:, last]
    cost = misfit(joint) - misfit(moments[:, first]) - misfit(moments[:, last])
    one = runs.closed[scan[first]] & (first != last) & near & (cost < settings.merge_chi2)
    if not one.any():
        return parts, bounds, moments
    first, last, keep = first[one], last[one], np.ones(len(scan), bool)
    moments[:, last], keep[first] = joint[:, one], False
    wall = np.arange(len(scan))
    wall[first] = last
    wall, moved = np.repeat(wall, np.diff(bounds)), np.repeat(~keep, np.diff(bounds))
    order = np.lexsort((moved, wall))  # the parts of the first wall go behind those of the last
    bounds = np.flatnonzero(np.diff(wall[order], prepend=-1, append=-1))
    return (start[order], stop[order]), bounds, moments[:, keep]


def _first_and_last(scan: Ints) -> tuple[Ints, Ints]:
    """Return the first and the last wall of every scan that has walls; `scan` (m,) never decreases."""
    edges = np.flatnonzero(np.diff(scan, prepend=-1, append=-1))
    return edges[:-1], edges[1:] - 1
