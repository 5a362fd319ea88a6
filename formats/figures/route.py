"""Along a path: where it begins and ends, a spot every few seconds, and where it was when."""

from __future__ import annotations

import numpy as np

from locfuse.fusion.data import Array, Estimates, Evaluation

from .panels import Spots, Track

STEPS_S = (10.0, 30.0, 60.0, 300.0, 600.0, 3600.0)
MAX_SPOTS = 60
TRACK_STEP_S = 0.25
MAX_TRACK = 600  # places of one track


def timed_path(estimates: Estimates, judged: Evaluation) -> tuple[Array, Array]:
    """Return times (n,) and path (n, 2): at every instant, or as aligned to the truth."""
    if judged.align == "none":
        return estimates.t, estimates.pose[:, :2]
    return judged.t, judged.estimate_xy


def spots(t: Array, xy: Array) -> list[Spots]:
    """Return start, end and the spots between them; none of a path that has no place."""
    good = np.isfinite(xy).all(axis=1)
    t, xy = t[good], xy[good]
    if len(t) == 0:
        return []
    at = between(t, xy, np.arange(t[0] + step(t), t[-1], step(t)))
    return [Spots("time", *at.T), Spots("end", *xy[-1:].T), Spots("start", *xy[:1].T)]


def step(t: Array) -> float:
    """Return the time [s] between two spots: the shortest round one that leaves a path readable."""
    span = float(t[-1] - t[0]) if len(t) else 0.0
    return next((s for s in STEPS_S if span <= s * MAX_SPOTS), max(STEPS_S[-1], span / MAX_SPOTS))


def between(t: Array, xy: Array, times: Array) -> Array:
    """Return the places (k, 2) at `times` (k,) on the path."""
    return np.stack([np.interp(times, t, column) for column in xy.T], axis=-1)


def track(of: str, t: Array, xy: Array) -> list[Track]:
    """Return where the path was at evenly spaced times; none of a path that has no place."""
    good = np.isfinite(xy).all(axis=1)
    t, xy = t[good], xy[good]
    if len(t) < 2:
        return []
    start, end = float(t[0]), float(t[-1])
    times = np.linspace(start, end, int(np.clip((end - start) / TRACK_STEP_S, 2, MAX_TRACK)))
    return [Track(of, start, end, *between(t, xy, times).T)]
