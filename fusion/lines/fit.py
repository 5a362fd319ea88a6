"""Weighted line fit on laser beams, for many lines at once: (r, psi) and their covariance.

A line is n.P = r with n = (cos psi, sin psi), r >= 0. A beam starts at o (the laser's own place when the beam
was fired: zero without deskewing), points along u and should return the range p = (r - n.o) / n.u. Its noise acts
along and across the beam, so what is minimised is the sum of (d - p)^2 / v, v = s_d^2 + (s_phi p tan(alpha))^2,
alpha the angle of incidence. Fits of perpendicular distances (Pfister, Roumeliotis, Burdick: "Weighted line
fitting algorithms for mobile robot map building", ICRA 2003) are a good start, but biased off-centre.

The rays of all lines stand one line after another; `counts` (m,) says how many each line has.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from locfuse.fusion.data import Array, Ints

Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Rays:
    """Laser beams as the fit needs them; every array is (k,)."""

    d: Array  # measured range [m]
    c: Array  # direction u = (c, s) in the scan's frame
    s: Array
    ox: Array | None = None  # origin o [m]; None where every beam starts at the frame's origin
    oy: Array | None = None

    def take(self, rows: Ints) -> Rays:
        """Return the rays at `rows`."""
        columns = (self.d, self.c, self.s, self.ox, self.oy)
        return Rays(*(a.take(rows) for a in columns if a is not None))


@dataclass(frozen=True)
class Fits:
    """Fitted lines. Sums of squares are of residuals over their sigma, times sigma_range^2 [m^2]."""

    r: Array  # (m,) m
    psi: Array  # (m,) rad
    R_unit: Array  # (m, 2, 2) covariance of (r, psi) / sigma_range^2; r-psi counts as much as the others
    misfit: Array  # (m,) sum of squares
    bend: Array  # (m,) by how much a parabola would lower it ...
    curvature: Array  # (m,) ... and that parabola's coefficient [1/m]


def total_least_squares(moments: Array) -> tuple[Array, Array, Array]:
    """Return (r, psi, misfit) of the lines nearest to weighted points, from their moments (6, m).

    Moments are the weighted sums of 1, x, y, xx, xy, yy. Pfister et al. 2003, closed form: psi from the scatter
    about the weighted mean; the misfit is the weighted sum of squared distances, the scatter's small eigenvalue.
    """
    w, sx, sy, sxx, sxy, syy = moments
    mx, my = sx / w, sy / w
    a, b, c = sxx - sx * mx, sxy - sx * my, syy - sy * my
    psi = 0.5 * np.arctan2(-2.0 * b, c - a)
    r = mx * np.cos(psi) + my * np.sin(psi)
    return np.abs(r), np.where(r < 0, psi + np.pi, psi), _small_eigenvalue(a, b, c)


def misfit(moments: Array) -> Array:
    """Return the weighted sum of squared distances from the nearest line, (m,), by the points' moments (6, m)."""
    w, sx, sy, sxx, sxy, syy = moments
    mx, my = sx / w, sy / w
    return _small_eigenvalue(sxx - sx * mx, sxy - sx * my, syy - sy * my)


class Seen(NamedTuple):
    """Rays beside the line they are counted to; every array is (k,)."""

    e: Array  # distance from the line [m]
    q: Array  # foot of the predicted point along the line [m]
    w: Array  # sigma_range^2 / var(e), 0 for what is not in the fit


def improved(seen: Seen, counts: Ints, r: Array, psi: Array) -> tuple[Array, Array]:
    """Return (r, psi) after one Gauss-Newton step from where the residuals were taken."""
    dr, dpsi = _step(np.add.reduceat(_summands(seen), np.cumsum(counts) - counts, axis=1))
    return r + dr, psi + dpsi


def fitted(seen: Seen, counts: Ints, r: Array, psi: Array) -> Fits:
    """Return the lines after a last Gauss-Newton step, with covariance and misfit."""
    first = np.cumsum(counts) - counts
    sums = np.add.reduceat(_summands(seen), first, axis=1)
    dr, dpsi = _step(sums)
    a, b, c, f, g, ee = sums
    det = a * c - b * b
    R_unit = np.stack((c / det, b / det, b / det, a / det), axis=-1).reshape(-1, 2, 2)
    # q^2 less its part along 1 and q, which the line already has: what a parabola would explain on top
    cubic, quartic, qqe = np.add.reduceat(_parabola(seen), first, axis=1)
    norm = quartic - (c * (c * c - b * cubic) + cubic * (a * cubic - b * c)) / det
    product = qqe - dr * c + dpsi * cubic
    misfit = np.maximum(ee - dr * f + dpsi * g, 0.0)
    return Fits(r + dr, psi + dpsi, R_unit, misfit, product * product / norm, product / norm)


def residuals(rays: Rays, counts: Ints, r: Array, psi: Array, ratio: float) -> Seen:
    """Return the rays beside the lines (r, psi), each (m,).

    Times n.u, the range residual d - p is the distance e = (d - p) n.u, and its derivative by (r, psi) is (-1, q),
    q the foot of the *predicted* point: taking the measured one instead is the bias of perpendicular fits.
    Worked in place: at these sizes fetching memory for every intermediate result would double the time.
    """
    nx, ny, q = (np.repeat(a, counts) for a in (np.cos(psi), np.sin(psi), r))
    cos, sin = nx * rays.c, nx * rays.s
    cos += ny * rays.s
    sin -= ny * rays.c
    foot = None
    if rays.ox is not None and rays.oy is not None:
        q -= nx * rays.ox + ny * rays.oy
        foot = nx * rays.oy - ny * rays.ox
    e = np.multiply(rays.d, cos, out=nx)
    e -= q
    q /= cos
    q *= sin  # also what one radian of angle error moves the end point away from the wall
    w = np.multiply(q, ratio, out=ny)
    w *= w
    w += np.multiply(cos, cos, out=cos)
    np.divide(1.0, w, out=w)
    return Seen(e, q if foot is None else np.add(q, foot, out=q), w)


def _step(sums: Array) -> tuple[Array, Array]:
    """Return the solution (dr, dpsi) of the normal equations, from their sums (6, m)."""
    a, b, c, f, g, _ = sums
    det = a * c - b * b
    return (c * f - b * g) / det, (b * f - a * g) / det


def _summands(seen: Seen) -> Array:
    """Return the summands of the normal equations, (6, k): w, wq, wqq, we, wqe, wee."""
    e, q, w = seen
    rows = np.empty((6, len(e)))
    rows[0] = w
    np.multiply(w, q, out=rows[1])
    np.multiply(rows[1], q, out=rows[2])
    np.multiply(w, e, out=rows[3])
    np.multiply(rows[1], e, out=rows[4])
    np.multiply(rows[3], e, out=rows[5])
    return rows


def _parabola(seen: Seen) -> Array:
    """Return the summands that a parabola adds, (3, k): wqqq, wqqqq, wqqe."""
    e, q, w = seen
    rows = np.empty((3, len(e)))
    wqq = w * q
    wqq *= q
    np.multiply(wqq, q, out=rows[0])
    np.multiply(rows[0], q, out=rows[1])
    np.multiply(wqq, e, out=rows[2])
    return rows


def _small_eigenvalue(a: Array, b: Array, c: Array) -> Array:
    """Return the smaller eigenvalue of [[a, b], [b, c]], at least 0."""
    half = 0.5 * (a - c)
    return np.asarray(np.maximum(0.5 * (a + c) - np.sqrt(half * half + b * b), 0.0))
