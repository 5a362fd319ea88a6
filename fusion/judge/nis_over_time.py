"""Consistency over time: the mean NIS of short intervals, with its bounds for so many values."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from locfuse.fusion.chi_square import mean_bounds
from locfuse.fusion.data import Array, Audit

STRETCHES = 80
MIN_MEASUREMENTS = 8  # accepted measurements that a stretch should hold
CONFIDENCE = 0.95


class Running(NamedTuple):
    """Mean NIS per degree of freedom of intervals of a drive; NaN for an interval without values."""

    t: Array  # (n,) s, middle of each stretch
    mean: Array  # (n,)
    low: Array  # (n,) bounds at CONFIDENCE for innovations that are white and as large as they should be
    high: Array  # (n,)


def running_nis(audit: Audit, t: Array, stretches: int = STRETCHES) -> Running:
    """Return the running NIS of one run's accepted innovations; `t` (n,) are the drive's instants [s]."""
    accepted = audit.verdict == 0
    stretches = int(np.clip(int(accepted.sum()) // MIN_MEASUREMENTS, 1, stretches))
    edges = np.linspace(t[0], t[-1], stretches + 1)
    dof = audit.y.shape[1]
    nis = audit.nis[accepted] / dof
    place = np.clip(np.searchsorted(edges, t[audit.instant[accepted]], side="right") - 1, 0, stretches - 1)
    counts = np.bincount(place, minlength=stretches)
    sums = np.bincount(place, weights=nis, minlength=stretches)
    mean = np.where(counts > 0, sums / np.maximum(counts, 1), np.nan)
    bounds = np.array([mean_bounds(CONFIDENCE, dof, int(c)) if c else (np.nan, np.nan) for c in counts])
    return Running(0.5 * (edges[1:] + edges[:-1]), mean, bounds[:, 0], bounds[:, 1])
