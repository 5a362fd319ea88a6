"""From one scan to another by all scans between them: each is matched with the next.

Two scans taken shortly after one another show the same surfaces, so that in clutter, too, nothing is taken for
something else. Half a metre or half a turn later that may happen.
"""

from __future__ import annotations

import numpy as np

from locfuse.fusion import se2
from locfuse.fusion.data import Array, Ints, Measurements, Points

from .clouds import clouds_of
from .match import Targets, match, sources_of
from .neighbours import by_wheels, good, next_scans

SCANS_AT_ONCE = 1024  # whose points are held


def scan_by_scan(m: Measurements, points: Points, begin: Ints, end: Ints) -> Array:
    """Return readings `end` (n,) seen from readings `begin` before them, (n, 3).

    Where a match on the way is not good, the wheels tell the step.
    """
    counts = end - begin
    first = np.cumsum(counts) - counts
    scans = np.arange(counts.sum()) + np.repeat(begin - first, counts)
    cuts = np.arange(SCANS_AT_ONCE, len(scans), SCANS_AT_ONCE)
    steps = np.concatenate([_next(m, points, part) for part in np.split(scans, cuts)])
    return np.stack([se2.chain(part)[-1] for part in np.split(steps, first[1:])])


def _next(m: Measurements, points: Points, scans: Ints) -> Array:
    """Return the scan after each seen from it, (k, 3)."""
    u = points.moved(m.t[scans], m.t[scans + 1])
    readings, at = np.unique(np.concatenate((scans, scans + 1)), return_inverse=True)
    clouds = clouds_of(m, readings)
    i, j = at[: len(scans)], at[len(scans) :]
    found = match(Targets(clouds), i, sources_of(clouds), j, u, by_wheels(u))
    return np.where(good(found)[:, None], found.pose, u)


def turned_beyond_wheels(m: Measurements, a: int, b: int) -> float | None:
    """Return how much more the robot turned from reading a to b than its wheels say [rad], by matching the two.

    None where they do not match.
    """
    if m.points is None or a < 0:
        return None
    u = m.points.moved(m.t[[a]], m.t[[b]])
    clouds = clouds_of(m, np.array([a, b]))
    found = next_scans(Targets(clouds), np.array([0]), sources_of(clouds), np.array([1]), u, by_wheels(u))
    return se2.wrap(float(found.pose[0, 2] - u[0, 2])) if good(found)[0] else None
