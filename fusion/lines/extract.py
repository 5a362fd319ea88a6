"""Straight walls in laser scans: (r, psi), covariance, extent; many scans at once (paper section III, LRF).

A line is x cos(psi) + y sin(psi) = r with r >= 0, in the frame of the scan. What is one line and what is two: the
two parts of a wall left and right of something that stands before it are two lines, unless the shadow is narrower
than `bridge` and than either part, and both are statistically the same line. Joining across wider shadows
sometimes succeeds and sometimes not as the robot moves, and what is one line here and two there cannot be matched
with the map one to one. Beams that could belong to either of two walls meeting in a corner belong to none.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np

from locfuse.fusion.data import Array, Ints
from locfuse.fusion.se2 import wrap_all

from .beams import LineSettings, Runs, Scans, cut_at_gaps
from .corners import clear_beams
from .fit import Fits, Mask, Rays, Seen, fitted, improved, residuals
from .sweep import Motion, loadings, shares
from .walls import Walls, find_walls

__all__ = ["LineSettings", "Lines", "extract_lines", "to_base"]

# glibc hands blocks larger than the largest one freed so far back to the kernel at once, and every new one is then
# zeroed page by page: a third of the time here. One large block, freed untouched, ends that for the process.
_POOL = 2_000_000  # numbers
PAPER_LASER = LineSettings()
_BATCH = 256  # scans worked on at once: enough to hide NumPy's overhead per call, few enough for the cache,
_BEAMS = 100_000  # unless they have more beams than this in all: working memory is some 500 bytes a beam


@dataclass(frozen=True)
class Lines:
    """Lines of n scans in scan order, within a scan in beam order."""

    first: Ints  # (n + 1,) scan i owns the lines first[i]:first[i + 1]
    z: Array  # (m, 2) r [m] >= 0, psi [rad] in [-pi, pi), in the scan's frame
    R_unit: Array  # (m, 2, 2) covariance / sigma_range^2: depends on sigma_angle / sigma_range only
    ends: Array  # (m, 2) extent along the tangent (-sin psi, cos psi), lo < hi [m]
    points: Ints  # (m,) beams in the fit
    chi2: Array  # (m,) residual chi2 per degree of freedom
    span: Ints  # (m, 2) first and last beam in the fit; first > last where the line crosses beam 0
    sweep: Array  # (m, 2, 2, pieces) what (r, psi) owe to the robot's turn and move in every piece of the sweep


def extract_lines(
    ranges: Array,
    angles: Array,
    settings: LineSettings = PAPER_LASER,
    offsets: Array | None = None,
    range_min: float = 0.0,
    range_max: float = math.inf,
    motion: Motion | None = None,
) -> Lines:
    """Return the straight walls in `ranges` (n, b) [m], seen along `angles` (b,) or (n, b) [rad].

    `offsets` (n, b, 3) is each beam's laser pose (x [m], y [m], theta [rad]) in the frame of its scan: deskewing.
    `motion`, where the beams' errors of deskewing are wanted, is how they move with the base (sweep).
    NaN, Inf, and ranges outside [range_min, range_max) are no returns. Angles grow or fall steadily; scans of the
    whole circle may have walls across beam 0. The result of a scan does not depend on the scans beside it.
    """
    parts = []
    np.empty(_POOL)
    batch = min(_BATCH, max(_BEAMS // max(ranges.shape[1], 1), 1))
    for i in range(0, max(len(ranges), 1), batch):
        rows = slice(i, i + batch)
        scans = Scans(
            ranges[rows],
            angles if angles.ndim == 1 else angles[rows],
            None if offsets is None else offsets[rows],
            range_min,
            range_max,
        )
        parts.append(_extract(scans, settings, motion))
    return _joined(parts)


def to_base(z: Array, R_unit: Array, ends: Array, x: float, y: float, yaw: float) -> tuple[Array, Array, Array]:
    """Return (z, R_unit, ends) in the base frame, of lines seen by a laser at (x [m], y [m], yaw [rad]) on it.

    Exact: r_b = r + l.n(psi_b), psi_b = psi + yaw, Jacobian [[1, u], [0, 1]] with u = l.t(psi_b), t the tangent
    (-sin, cos). Where r_b < 0 the base stands beyond the line: (r, psi), the ends, and the sign of the r-psi
    covariance turn over. For rows scaled by sigma_range^2 plus a floor, the floor is the base frame's.
    """
    psi = z[:, 1] + yaw
    c, s = np.cos(psi), np.sin(psi)
    r, u = z[:, 0] + x * c + y * s, y * c - x * s
    flip = np.where(r < 0, -1.0, 1.0)
    rr, rp, pp = R_unit[:, 0, 0], R_unit[:, 0, 1], R_unit[:, 1, 1]
    cross = (rp + u * pp) * flip
    R = np.stack((rr + u * (2.0 * rp + u * pp), cross, cross, pp), axis=-1).reshape(-1, 2, 2)
    z = np.stack((r * flip, wrap_all(np.where(r < 0, psi + np.pi, psi))), axis=-1)
    return z, R, np.sort((ends + u[:, None]) * flip[:, None], axis=1)


def _extract(scans: Scans, settings: LineSettings, motion: Motion | None) -> Lines:
    """Return the lines of one batch."""
    runs = cut_at_gaps(scans, settings.max_gap, settings.gap_spacings)
    walls = find_walls(runs, settings)
    rows, counts = walls.rows()
    rays = runs.beams.rays.take(rows)
    fit, clear, seen, enough = _fit(runs, walls, rays, counts, settings)
    head, tail, points = _first_and_last(clear, counts)
    ends = np.stack((head, tail), axis=1)
    two = np.full(len(ends), 2)
    feet = residuals(rays.take(ends.ravel()), two, fit.r, fit.psi, 0.0).q.reshape(-1, 2)
    good = np.flatnonzero(enough & _straight(fit, points, feet, settings))
    scan = runs.beams.scan[walls.head[good]]
    sweep = np.zeros((len(counts), 2, 2, 0))
    if motion is not None:
        normal = np.stack((np.cos(fit.psi), np.sin(fit.psi)), axis=-1)
        share = shares(scans.ranges.shape[1])[:, runs.beams.beam[rows]]
        sweep = loadings(share, seen.q, seen.w, counts, normal, motion)
    return Lines(
        first=np.concatenate(([0], np.cumsum(np.bincount(scan, minlength=len(scans.ranges))))),
        z=np.stack((fit.r, wrap_all(fit.psi)), axis=1)[good],
        R_unit=fit.R_unit[good],
        ends=np.sort(feet[good], axis=1),
        points=points[good],
        chi2=(fit.misfit / settings.sigma_range**2 / np.maximum(points - 2, 1))[good],
        span=runs.beams.beam[rows[ends[good]]],
        sweep=sweep[good],
    )


def _fit(
    runs: Runs, walls: Walls, rays: Rays, counts: Ints, settings: LineSettings
) -> tuple[Fits, Mask, Seen, Mask]:
    """Return the walls' fits, which beams are in them (k,), beside which lines, and which walls have enough (m,).

    Two Gauss-Newton steps. Corners leave before the first, strays before the second.
    """
    ratio, least = settings.sigma_angle / settings.sigma_range, max(settings.min_points, 3)
    seen = residuals(rays, counts, walls.r, walls.psi, ratio)
    clear = clear_beams(runs, walls, seen.q, counts, settings)
    points = _first_and_last(clear, counts)[2]
    enough = points >= least
    clear |= np.repeat(~enough, counts)  # refused in the end; until then they need something to fit
    np.multiply(seen.w, clear, out=seen.w)
    r, psi = improved(seen, counts, walls.r, walls.psi)
    seen = residuals(rays, counts, r, psi, ratio)
    clear[_strays(seen, clear, counts, points - least, settings)] = False
    np.multiply(seen.w, clear, out=seen.w)
    return fitted(seen, counts, r, psi), clear, seen, enough


def _strays(seen: Seen, clear: Mask, counts: Ints, spare: Ints, settings: LineSettings) -> Ints:
    """Return the rows of beams that are not of their wall: a pole or a person's leg before it.

    A few such beams are too few to be cut off as a piece of their own, and pull the whole line towards them. Walls
    that have fewer beams to `spare` (m,) than strays keep them, and their misfit shows.
    """
    rows = np.flatnonzero((seen.e * seen.e * seen.w > (settings.stray_sigmas * settings.sigma_range) ** 2) & clear)
    wall = np.searchsorted(np.cumsum(counts), rows, side="right")
    return rows[(np.bincount(wall, minlength=len(counts)) <= spare)[wall]]


def _straight(fit: Fits, points: Ints, feet: Array, settings: LineSettings) -> Mask:
    """Return which fits are a straight wall, known well enough to be of use, (m,)."""
    variance = settings.sigma_range**2
    rough = fit.misfit > settings.max_chi2 * variance * np.maximum(points - 2, 1)
    bow = np.abs(fit.curvature * (feet[:, 1] - feet[:, 0])) / 4.0  # height over length
    curved = (fit.bend > settings.max_bend * variance) & (bow > settings.max_bow)
    R = fit.R_unit * variance
    swing = 0.5 * fit.r * R[:, 1, 1]  # turning about its middle by sigma(psi) moves the line's foot by this [m]
    sigma_r = np.sqrt(R[:, 0, 0] - R[:, 0, 1] ** 2 / R[:, 1, 1])  # of r where psi is known
    vague = (R[:, 1, 1] > settings.max_sigma_psi**2) | (swing > settings.max_swing * sigma_r)
    return np.asarray((fit.r > 0.0) & ~rough & ~curved & ~vague)


def _first_and_last(clear: Mask, counts: Ints) -> tuple[Ints, Ints, Ints]:
    """Return the first and the last clear row of every wall and how many it has, each (m,)."""
    hits, end = np.flatnonzero(clear), np.cumsum(counts)
    if not len(hits):
        return np.zeros_like(counts), np.zeros_like(counts), np.zeros_like(counts)
    stop = np.searchsorted(hits, end)
    begin = np.concatenate(([0], stop))[:-1]
    return hits.take(begin, mode="clip"), hits.take(stop - 1, mode="clip"), stop - begin


def _joined(parts: list[Lines]) -> Lines:
    """Return the batches' lines as one."""
    columns = {f.name: np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(Lines)}
    counts = np.concatenate([np.diff(part.first) for part in parts])
    return Lines(**(columns | {"first": np.concatenate(([0], np.cumsum(counts)))}))
