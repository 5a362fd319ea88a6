"""Steps that no wheel can make: readings that leave and return (spikes), and values that restart (resets)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from locfuse.fusion.data import Array, Ints

WINDOW_STEPS = 11  # steps whose median speed is the speed of the moment
JUMP_FACTOR = 8.0  # times the speed of the moment ...
JUMP_SLACK_MPS = 0.5  # ... plus this much [m/s] ...
MIN_JUMP_M = 0.02  # ... plus this much [m]: less is no jump
MAX_SPEED_MPS = 1e6  # m/s: not even a counter in a unit that nobody told goes faster
MAX_SPIKE_READINGS, MAX_SPIKE_S = 10, 0.5  # what returns later than this did not spike

Mask = NDArray[np.bool_]


def limits(t: Array, steps: Array, max_speed: float | None = None) -> Array:
    """Return how far each step (n-1,) [m] may go: generously more than the speed of the moment, or `max_speed`.

    A burst of messages has tiny dt, so that a step is never judged by less than the usual dt.
    """
    dt = np.diff(t)
    if not len(dt):
        return np.zeros(0)
    usual = np.maximum(dt, np.median(dt))
    if max_speed is not None:
        return max_speed * usual + MIN_JUMP_M
    least: Array = JUMP_SLACK_MPS * usual + MIN_JUMP_M
    suspects = np.flatnonzero(np.abs(steps) > least)
    out = least.copy()
    out[suspects] += JUMP_FACTOR * _speeds(np.abs(steps) / usual, suspects) * usual[suspects]
    return np.minimum(out, MAX_SPEED_MPS * usual)


def _speeds(speed: Array, at: Ints) -> Array:
    """Median of `speed` (n,) over the WINDOW_STEPS steps around, or nearest to, each position `at` (k,)."""
    if not len(at):
        return np.zeros(0)
    window = min(WINDOW_STEPS, len(speed))
    begin = np.clip(at - WINDOW_STEPS // 2, 0, len(speed) - window)
    median: Array = np.median(speed[begin[:, None] + np.arange(window)], axis=1)
    return median


def spikes(t: Array, values: Array, limit: Array) -> Mask:
    """Mark readings that jump away and return: values (n, k), steps longer than `limit` (n-1,) are jumps."""
    out = np.zeros(len(t), dtype=bool)
    jumps = np.flatnonzero(_length(np.diff(values, axis=0)) > limit)
    at = 0
    while at < len(jumps):
        end = _return_of(t, values, limit, jumps, at)
        if end is None:
            at += 1
            continue
        out[jumps[at] + 1 : jumps[end] + 1] = True
        at = end + 1
    return out


def _return_of(t: Array, values: Array, limit: Array, jumps: Ints, at: int) -> int | None:
    """Return which later jump brings the value back to where it was before jump `at`."""
    before = int(jumps[at])
    for later in range(at + 1, len(jumps)):
        after = int(jumps[later]) + 1
        if after - before > MAX_SPIKE_READINGS or t[after] - t[before] > MAX_SPIKE_S:
            return None
        allowed = float(limit[before:after].min()) * (after - before)
        if float(_length(values[after] - values[before])) <= min(allowed, float(limit[before])):
            return later
    return None


class Restarts(NamedTuple):
    """Steps with those replaced that no wheel can have made."""

    steps: Array  # (n-1, k)
    number: int  # of the steps replaced


def restarted(t: Array, steps: Array, jumps: Mask) -> Restarts:
    """Replace jumping steps (n-1, k) by what the steps around them went on average per second.

    A counter that restarts says nothing about the motion between its last old and its first new value.
    """
    out = steps.copy()
    dt = np.diff(t)
    good = np.flatnonzero(~jumps)
    for i in np.flatnonzero(jumps).tolist():
        near = np.searchsorted(good, i)
        beside = good[max(0, near - 1) : near + 1]
        rate = (steps[beside] / dt[beside, None]).mean(axis=0) if len(beside) else 0.0
        out[i] = rate * dt[i]
    return Restarts(out, int(jumps.sum()))


def _length(steps: Array) -> Array:
    length: Array = np.hypot.reduce(steps, axis=-1)  # squares of absurd steps would overflow
    return length
