"""Does a sensor's clock agree with the wheels'? Its own turning is compared with theirs at every lag.

Neither needs a pose: a compass turns by itself, a laser by its lines from scan to scan. Increments over about a
second are correlated, so that constant offsets and a wrong track (a scale) do not matter.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from .data import Array
from .sensors.base import WheelMotion

WINDOW = 1.0  # s over which turning is compared
LONGEST = 1.5  # s
COARSE, STEP = 0.05, 0.01  # s: correlations over a whole window are smooth, so the best is near the coarse best
WORTH_SAYING = 0.04  # s
LEAST_TURN = math.radians(3.0)  # rms turn per window below which there is nothing to correlate
LEAST_CORRELATION = 0.8


class Lag(NamedTuple):
    """The time_offset under which a sensor's turning agrees best with the wheels'."""

    offset: float  # s to add to the sensor's stamps
    correlation: float  # at that offset
    without: float  # correlation at no further offset


def find_lag(t: Array, heading: Array, wheels: WheelMotion, span: tuple[float, float]) -> Lag | None:
    """Return the lag of a sensor's heading (n,) [rad, unwrapped, up to a constant] at t (n,), or None.

    None where the robot hardly turned, or where no lag makes the two agree. `span` is the wheels' time.
    """
    ok = np.isfinite(heading)
    t, heading = t[ok], heading[ok]
    inside = (t >= span[0] + LONGEST) & (t <= span[1] - LONGEST - WINDOW)
    start = t[inside]
    if len(start) < 20:
        return None
    end = np.interp(start + WINDOW, t, t)
    own = np.interp(end, t, heading) - heading[inside]
    if math.sqrt(float((own**2).mean())) < LEAST_TURN:
        return None

    def scores(lags: Array) -> Array:
        shifted = lags[:, None]
        return _correlations(own, wheels.heading(end + shifted) - wheels.heading(start + shifted))

    coarse = np.arange(-LONGEST, LONGEST + COARSE / 2, COARSE)
    middle = coarse[np.argmax(scores(coarse))]
    fine = middle + np.arange(-COARSE, COARSE + STEP / 2, STEP)
    score = scores(fine)
    best = int(np.argmax(score))
    if score[best] <= LEAST_CORRELATION or abs(middle) > LONGEST - COARSE / 2 or best in (0, len(fine) - 1):
        return None
    offset = float(fine[best]) + STEP * _vertex(*score[best - 1 : best + 2].tolist())
    return Lag(offset, float(score[best]), float(scores(np.zeros(1))[0]))


def _correlations(a: Array, b: Array) -> Array:
    """Correlation of a (n,) with every row of b (k, n), (k,)."""
    a, b = a - a.mean(), b - b.mean(axis=1, keepdims=True)
    scale = np.sqrt((a @ a) * (b**2).sum(axis=1))
    out: Array = np.divide(b @ a, scale, out=np.zeros(len(b)), where=scale > 0)
    return out


def _vertex(left: float, middle: float, right: float) -> float:
    """Offset of a parabola's top from its middle sample, in samples."""
    bend = left - 2.0 * middle + right
    return 0.5 * (left - right) / bend if bend < 0 else 0.0


def worth_saying(lag: Lag) -> bool:
    """Return whether a lag is large and clear enough to be reported."""
    return abs(lag.offset) >= WORTH_SAYING and lag.correlation - lag.without > 0.1 * (1.0 - lag.without)
