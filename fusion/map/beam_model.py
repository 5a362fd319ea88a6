"""Beam model of a laser for AMCL: parameters of the likelihood field, fitted to a drive.

Likelihood field (Thrun, Burgard and Fox 2005, Probabilistic Robotics, table 6.3): a beam that ends at the distance
d from the nearest wall has the density z_hit N(d; 0, sigma_hit) + z_rand / z_max. Expectation maximisation finds
the weights and sigma_hit, as in table 6.2. A "short" beam ends in free space, before the first wall along the
beam: it hit a person or furniture that the map does not have.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from locfuse.fusion.data import Array, MapLine

MAX_STEPS = 200  # of expectation maximisation
MIN_STEP_M = 1e-6  # m
BEGIN_SIGMA_M, BEGIN_HIT = 0.1, 0.8
MIN_SIGMA_M, MIN_RANDOM = 1e-3, 0.01  # least values: with z_rand = 0 one beam could give a particle the weight 0
SHORT_SIGMAS = 3.0  # a short beam ends at least this far before its wall
POINTS_AT_ONCE = 4096
MIN_BEAMS = 200


class BeamModel(NamedTuple):
    """Shares of hit, short, missing and random beams, and the standard deviation of hits from walls."""

    sigma: float  # m
    spread: float  # m, standard deviation of `sigma`
    hit: float  # shares of all beams; the four shares add up to 1
    short: float
    none: float  # share of beams without a return
    random: float
    decay: float | None  # 1/m: exponential decay of short beams (table 6.2: lambda_short)
    beams: int


def fit_beams(
    origins: Array, points: Array, lines: Sequence[MapLine], none: int, reach: float
) -> BeamModel | None:
    """Fit the beam model to points (n, 2) of beams from origins (n, 2) in the map [m]; None with too few points.

    `none` is the number of beams without a return, `reach` the laser's range [m].
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
    """Fit z_hit and sigma_hit [m] to distances d (n,) [m] from the nearest wall."""
    hit, sigma = BEGIN_HIT, BEGIN_SIGMA_M
    for _ in range(MAX_STEPS):
        share = _hits(d, hit, sigma, reach)
        before, hit = sigma, float(share.mean())
        sigma = max(float(np.sqrt((share * d**2).sum() / max(share.sum(), 1e-12))), MIN_SIGMA_M)
        if abs(sigma - before) < MIN_STEP_M:
            break
    return hit, sigma


def _hits(d: Array, hit: float, sigma: float, reach: float) -> Array:
    """Return the probability (n,) that each point, d (n,) [m] from the nearest wall, lies on a wall."""
    near = hit * np.exp(-0.5 * (d / sigma) ** 2) / (np.sqrt(2.0 * np.pi) * sigma)
    return np.asarray(near / (near + (1.0 - hit) / reach + 1e-300))


def _beside_walls(origins: Array, points: Array, lines: Sequence[MapLine]) -> tuple[Array, Array]:
    """Return for each point (n, 2) the distance to the nearest wall and the range to the first wall on its beam.

    The range is measured from the beam's origin (n, 2), and inf if the beam meets no wall; all in m.
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
