"""A laser's beams relative to a map: the mixture with which AMCL weighs its particles, fitted to a drive.

Likelihood field (Thrun, Burgard and Fox 2005, Probabilistic Robotics, table 6.3): a beam that ends at the distance
d from the nearest wall has the density z_hit N(d; 0, sigma_hit) + z_rand / z_max. The weights and sigma_hit are
found by expectation and maximization, as table 6.2 finds those of the beam model. A beam that ends before the wall
in its direction, and not at one, is a short one: people and furniture that the map lacks.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from locfuse.fusion.data import Array, MapLine

MAX_STEPS = 200  # of expectation and maximization
MIN_STEP_M = 1e-6  # m
BEGIN_SIGMA_M, BEGIN_HIT = 0.1, 0.8
MIN_SIGMA_M, MIN_RANDOM = 1e-3, 0.01  # a share of 0 would let a single beam rule a particle out
SHORT_SIGMAS = 3.0  # a beam that ends so far before its wall is a short one
POINTS_AT_ONCE = 4096  # points at once
MIN_BEAMS = 200


class BeamModel(NamedTuple):
    """Shares of the beams by kind, and the distance of hits from their walls."""

    sigma: float  # m
    spread: float  # m, 1 sigma of it
    hit: float  # shares of all beams, these four add up to 1
    short: float
    none: float  # without a return
    random: float
    decay: float | None  # 1/m: short ones get rarer so fast (table 6.2: lambda_short)
    beams: int


def fit_beams(
    origins: Array, points: Array, lines: Sequence[MapLine], none: int, reach: float
) -> BeamModel | None:
    """Fit the mixture to points (n, 2), seen from origins (n, 2), in the map [m]; None with too few points.

    `none` beams had no return; `reach` is the laser's [m].
    """
    if len(points) < MIN_BEAMS or not lines:
        return None
    d, expected = _beside_walls(origins, points, lines)
    hit, sigma = _mixture(d, reach)
    hits = _hits(d, hit, sigma, reach)
    seen = np.hypot(*(points - origins).T)
    short = (hits < 0.5) & (seen < expected - SHORT_SIGMAS * sigma) & np.isfinite(expected)
    total = len(points) + none
    of_short = float(short.sum()) / total
    of_hit = min(hit * len(points) / total, 1.0 - MIN_RANDOM)
    random = max(1.0 - of_hit - of_short - none / total, MIN_RANDOM)
    decay = float(short.sum() / seen[short].sum()) if short.any() else None
    shares = np.array([of_hit, of_short, none / total, random]) / (of_hit + of_short + none / total + random)
    of_hit, of_short, of_none, random = shares.tolist()
    spread = sigma / float(np.sqrt(2.0 * hits.sum()))
    return BeamModel(sigma, spread, of_hit, of_short, of_none, random, decay, total)


def _mixture(d: Array, reach: float) -> tuple[float, float]:
    """Return z_hit and sigma_hit [m] of distances (n,) [m]."""
    hit, sigma = BEGIN_HIT, BEGIN_SIGMA_M
    for _ in range(MAX_STEPS):
        share = _hits(d, hit, sigma, reach)
        before, hit = sigma, float(share.mean())
        sigma = max(float(np.sqrt((share * d**2).sum() / max(share.sum(), 1e-12))), MIN_SIGMA_M)
        if abs(sigma - before) < MIN_STEP_M:
            break
    return hit, sigma


def _hits(d: Array, hit: float, sigma: float, reach: float) -> Array:
    """Return the probability (n,) that each distance belongs to a wall."""
    near = hit * np.exp(-0.5 * (d / sigma) ** 2) / (np.sqrt(2.0 * np.pi) * sigma)
    return np.asarray(near / (near + (1.0 - hit) / reach + 1e-300))


def _beside_walls(origins: Array, points: Array, lines: Sequence[MapLine]) -> tuple[Array, Array]:
    """Return each point's (n, 2) distance to the nearest wall, and to the first wall along its beam.

    The second is measured from the point's origin (n, 2), and inf where no wall is there; all in m.
    """
    rho, beta = np.array([line.rho for line in lines]), np.array([line.beta for line in lines])
    low, high = np.array([line.ends for line in lines]).T
    c, s = np.cos(beta), np.sin(beta)
    nearest, first = [], []
    for begin in range(0, len(points), POINTS_AT_ONCE):
        (x, y), (x0, y0) = (xy[begin : begin + POINTS_AT_ONCE].T[..., None] for xy in (points, origins))
        off, along = x * c + y * s - rho, y * c - x * s
        nearest.append(np.hypot(off, np.maximum(np.maximum(low - along, along - high), 0.0)).min(axis=1))
        dx, dy = x - x0, y - y0
        with np.errstate(divide="ignore", invalid="ignore"):
            share = (rho - x0 * c - y0 * s) / (dx * c + dy * s)  # of the way to the point
            along = (y0 + share * dy) * c - (x0 + share * dx) * s
            hits = (share > 0.0) & (low <= along) & (along <= high)
            first.append(np.where(hits, share * np.hypot(dx, dy), np.inf).min(axis=1))
    return np.concatenate(nearest), np.concatenate(first)
