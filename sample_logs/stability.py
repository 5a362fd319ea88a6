"""Stability of the wheel speeds, as in the paper: per sampling time, within 5 %."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .simulate import Outcome

SLOWEST = 1.2  # rad/s (0.06 m/s): below, one count in a window is more than 2.5 %


class Stability(NamedTuple):
    """Deviation of the mean wheel speed from its mean set point over windows of one sampling time."""

    worst: float  # relative, of all windows
    rms: float
    within_5_percent: float  # share of windows


def speed_stability(outcome: Outcome, window: float = 0.1) -> Stability:
    """Return the stability of both wheels over windows of `window` [s], without standstill."""
    per = max(1, round(window / (outcome.ticks_t[1] - outcome.ticks_t[0])))
    n = (len(outcome.ticks_t) - 1) // per
    turned = np.diff(outcome.counts[: n * per + 1 : per], axis=0) * outcome.rad_per_count
    asked = outcome.set_points[1 : n * per + 1].reshape(n, per, 2).mean(axis=1)
    seconds = outcome.ticks_t[per] - outcome.ticks_t[0]
    moving = np.abs(asked) > SLOWEST
    deviation = np.abs(turned[moving] / seconds / asked[moving] - 1)
    if len(deviation) == 0:
        return Stability(0.0, 0.0, 1.0)
    return Stability(
        float(deviation.max()), float(np.sqrt((deviation**2).mean())), float((deviation <= 0.05).mean())
    )
