"""Is the covariance right? With truth: are the errors as large as claimed, for all states and for each.

Without truth: the mean NIS of short intervals, with its bounds for so many values.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import msgspec
import numpy as np
from msgspec import field

from locfuse.fusion.chi_square import mean_bounds
from locfuse.fusion.data import Array, Audit, Evaluation

from .bootstrap import effective_samples

STRETCHES = 80
MIN_MEASUREMENTS = 8  # accepted measurements that a stretch should hold
CONFIDENCE = 0.95
STATES = ("x", "y", "theta")


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


class Honesty(msgspec.Struct, frozen=True):
    """Mean squared error over predicted variance: 1 is right, more is overconfident."""

    anees: float
    bounds: tuple[float, float]  # of a consistent filter's ANEES at CONFIDENCE, for one drive's worth of errors
    states: Mapping[str, float] = field(default_factory=dict)  # of x, y and theta, each on its own
    state_bounds: tuple[float, float] = (0.0, math.inf)
    independent: float = math.nan  # how many independent errors the drive is worth
    words: str = ""

    @property
    def overconfident(self) -> bool:
        """Whether the errors are larger than those of a consistent filter by more than chance."""
        return self.anees > self.bounds[1]

    @property
    def consistent(self) -> bool:
        """Whether the ANEES is one that a consistent filter can have."""
        return self.bounds[0] <= self.anees <= self.bounds[1]


def honesty(judged: Evaluation) -> Honesty | None:
    """Return the consistency of a configuration's covariance; None without truth or after alignment."""
    anees = judged.figures.get("anees")
    e = judged.deviation if judged.heading is None else np.column_stack((judged.deviation, judged.heading))
    sigma = judged.sigma[:, : e.shape[1]]
    good = np.isfinite(judged.nees) & (sigma > 0).all(axis=1)
    if anees is None or good.sum() < 2:
        return None
    unit = e[good] / sigma[good]
    independent = effective_samples(unit)
    bounds = mean_bounds(CONFIDENCE, unit.shape[1], independent)
    states = dict(zip(STATES, (unit**2).mean(axis=0).tolist(), strict=False))
    alone = mean_bounds(CONFIDENCE, 1, independent)
    return Honesty(anees, bounds, states, alone, independent, _words(anees, bounds))


def _words(anees: float, bounds: tuple[float, float]) -> str:
    low, high = bounds
    if anees > high:
        return f"overconfident: errors are about {math.sqrt(anees):.1f} times what the covariance says"
    if anees < low:
        return f"underconfident: errors are about {math.sqrt(anees):.1f} times what the covariance says"
    return "consistent"
