"""From range matrices to flat columns of valid beams, in an order in which no wall is cut in two by chance."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from locfuse.fusion.data import Array, Ints

from .fit import Mask, Rays


@dataclass(frozen=True)
class Beams:
    """Valid laser beams of several scans, one after another; every array is (k,)."""

    scan: Ints  # which scan
    beam: Ints  # which beam of that scan
    rays: Rays
    x: Array  # end point [m], in the scan's frame
    y: Array

    def take(self, rows: Ints) -> Beams:
        """Return the beams at `rows`."""
        columns = (a.take(rows) for a in (self.x, self.y))
        return Beams(self.scan.take(rows), self.beam.take(rows), self.rays.take(rows), *columns)


@dataclass(frozen=True)
class LineSettings:
    """How noisy the laser is and what counts as a wall; the defaults are the paper's laser: 30 mm, 0.25 deg."""

    sigma_range: float = 0.03  # m
    sigma_angle: float = math.radians(0.25)  # rad
    min_points: int = 5  # beams in the fit
    min_length: float = 0.30  # m, before corners are trimmed
    max_gap: float = 0.30  # m between neighbouring beams on one wall ...
    gap_spacings: float = 6.0  # ... or this many beam spacings at that range: a wall seen at 80 degrees
    bridge: float = 0.1  # m, widest shadow across which a line goes on: a stray beam's, not a pole's
    split_sigmas: float = 3.0  # farther from the chord is a corner; what noise cuts, merging joins again
    split_floor: float = 0.02  # m, and never nearer than this
    flatness: float = 0.005  # m by which real walls are not flat: added to the noise where lines are compared
    merge_chi2: float = 20.0  # two pieces are one line below it (2 degrees of freedom, cut where it looked worst)
    max_incidence: float = math.radians(85.0)  # rad; flatter beams are not used: range noise is not linear there
    stray_sigmas: float = 3.3  # a beam farther from its line than this is not of the wall
    corner_sigmas: float = 2.5  # a beam closer to the neighbouring wall than this could belong to either
    max_sigma_psi: float = math.radians(3.0)  # rad; a line known worse is too short for its noise
    max_swing: float = 0.5  # in sigmas: beyond it (r, psi) is not Gaussian, and no covariance is honest
    max_chi2: float = 4.0  # residual chi2 per degree of freedom; more is not a straight wall
    max_bow: float = 0.03  # height of the bow over its chord: more is a column, or two walls ...
    max_bend: float = 12.0  # ... if the bow is not noise: chi2 that a parabola explains (99.95 % of 1 degree)


class Scans(NamedTuple):
    """Scans of one laser as it delivers them."""

    ranges: Array  # (n, b) m; NaN, Inf and what lies outside [range_min, range_max) is no return
    angles: Array  # (b,) or (n, b) rad, steadily growing or falling along the beams
    offsets: Array | None  # (n, b, 3) each beam's laser pose in the scan's frame; None: all at its origin
    range_min: float
    range_max: float

    def spacing(self) -> Array:
        """Return the angle between neighbouring beams [rad], (n,)."""
        n, b = self.ranges.shape
        if b < 2:
            return np.zeros(n)
        spread = np.abs(self.angles[..., -1] - self.angles[..., 0]) / (b - 1)
        return np.broadcast_to(spread, (n,))


@dataclass(frozen=True)
class Runs:
    """Beams cut at gaps: run i owns the beams first[i]:first[i + 1]."""

    beams: Beams
    first: Ints  # (runs + 1,)
    counts: Ints  # (n,) valid beams of each scan
    closed: Mask  # (n,) scans that go all the way round and have no gap where they start


def cut_at_gaps(scans: Scans, max_gap: float, gap_spacings: float) -> Runs:
    """Return the valid beams, cut where two neighbours are too far apart for one wall.

    Too far is more than `max_gap` [m] and more than `gap_spacings` times the distance of neighbouring beams on a
    wall seen head-on, since that distance grows with the range and with the angle of incidence. A scan of the
    whole circle is turned so that it starts behind its widest gap, or at its farthest point where there is none.
    """
    (beams, counts), spacing = valid_beams(scans), scans.spacing()
    seeing = counts > 0
    bounds = np.concatenate(([0], np.cumsum(counts[seeing])))
    jump = _jumps(beams, bounds, max_gap, gap_spacings * spacing[seeing])
    ring = spacing * (scans.ranges.shape[1] + 0.5) > 2.0 * math.pi
    closed = np.zeros(len(ring), bool)
    if ring.any() and len(jump):
        score = np.where(jump > 1.0, 1e9 + jump, beams.rays.d)
        order, start = _turned(score, bounds, ring[seeing])
        closed[beams.scan[start]] = ring[beams.scan[start]] & (jump[start] <= 1.0)
        beams, jump = beams.take(order), jump.take(order)
    jump[bounds[:-1]] = np.inf
    return Runs(beams, np.append(np.flatnonzero(jump > 1.0), len(jump)), counts, closed)


def _jumps(beams: Beams, bounds: Ints, max_gap: float, growth: Array) -> Array:
    """Return the squared distance of every beam's end from the one before, in units of what a wall allows, (k,).

    Before a scan's first beam comes its last. `growth` (scans,) is the allowed distance per metre of range.
    """
    x, y, d = beams.x, beams.y, beams.rays.d
    first, last = bounds[:-1], bounds[1:] - 1
    jump, limit = np.empty_like(d), np.empty_like(d)
    dx, dy = x[1:] - x[:-1], y[1:] - y[:-1]
    dx *= dx
    dy *= dy
    np.add(dx, dy, out=jump[1:])
    jump[first] = (x[first] - x[last]) ** 2 + (y[first] - y[last]) ** 2
    np.maximum(d[1:], d[:-1], out=limit[1:])
    limit[first] = np.maximum(d[first], d[last])
    limit *= np.repeat(growth, np.diff(bounds))
    np.maximum(limit, max_gap, out=limit)
    limit *= limit
    jump /= limit
    return jump


def valid_beams(scans: Scans) -> tuple[Beams, Ints]:
    """Return the beams that hit something, row by row, and how many each scan has, (n,)."""
    ranges, angles = scans.ranges, scans.angles
    if angles.ndim == 2 and len(angles) and (angles == angles[0]).all():
        angles = angles[0]  # one sine per angle instead of one per beam
    valid = ranges >= max(scans.range_min, np.finfo(float).tiny)
    valid &= ranges < scans.range_max
    hit = np.flatnonzero(valid)
    counts = np.count_nonzero(valid, axis=1)
    scan = np.repeat(np.arange(len(ranges)), counts)
    beam = hit - scan * ranges.shape[1]
    d = ranges.ravel().take(hit).astype(np.float64, copy=False)
    rows = beam if angles.ndim == 1 else hit
    if scans.offsets is None:
        c, s = np.cos(angles).ravel().take(rows), np.sin(angles).ravel().take(rows)
        return Beams(scan, beam, Rays(d, c, s), d * c, d * s), counts
    ox, oy, turn = (scans.offsets[..., i].ravel().take(hit) for i in range(3))
    heading = angles.ravel().take(rows) + turn
    c, s = np.cos(heading), np.sin(heading)
    return Beams(scan, beam, Rays(d, c, s, ox, oy), ox + d * c, oy + d * s), counts


def argmax_each(values: Array, first: Ints) -> Ints:
    """Return the index of the greatest value in every first[i]:first[i + 1], the earliest of equals."""
    greatest = np.maximum.reduceat(values, first[:-1])
    hits = np.flatnonzero(values == np.repeat(greatest, np.diff(first)))
    return hits[np.searchsorted(hits, first[:-1])]


def _turned(score: Array, bounds: Ints, ring: Mask) -> tuple[Ints, Ints]:
    """Return the order (k,) in which every ring starts at its highest score, and the starts, one per scan."""
    start = np.where(ring, argmax_each(score, bounds), bounds[:-1])
    counts = np.diff(bounds)
    order = np.arange(len(score)) + np.repeat(start - bounds[:-1], counts)
    order -= np.where(order >= np.repeat(bounds[1:], counts), np.repeat(counts, counts), 0)
    return order, start
