"""Does a sensor's clock agree with the wheels'? Its own turning is compared with theirs at every lag.

Neither needs a pose: a compass turns by itself, a laser by its lines from scan to scan. Increments over about a
second are correlated, so that constant offsets and a wrong track (a scale) do not matter.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np

from .data import Array
from .sensors.base import WheelMotion

WINDOW = 1.0  # s over which turning is compared
LONGEST = 1.5  # s
SHARP = (
    0.5  # s: once found, over less: slips are white, and what is summed longer blurs the lag (8 instead of 13 ms)
)
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
    start = t[(t >= span[0] + LONGEST) & (t <= span[1] - LONGEST - WINDOW)]
    if len(start) < 20:
        return None

    def scores(lags: Array, window: float = WINDOW) -> Array:
        end = np.minimum(start + window, t[-1])
        own, shifted = np.interp(end, t, heading) - np.interp(start, t, heading), lags[:, None]
        return _correlations(own, wheels.heading(end + shifted) - wheels.heading(start + shifted))

    if _turned(t, heading, start) < LEAST_TURN:
        return None
    coarse = np.arange(-LONGEST, LONGEST + COARSE / 2, COARSE)
    middle = float(coarse[np.argmax(scores(coarse))])
    found = _peak(middle, scores)
    if found is None or abs(middle) > LONGEST - COARSE / 2:
        return None
    sharp = _peak(found, partial(scores, window=SHARP))
    offset = found if sharp is None else sharp
    at, zero = scores(np.array([offset, 0.0])).tolist()
    return Lag(offset, at, zero)


def _turned(t: Array, heading: Array, start: Array) -> float:
    """Return the rms turn over a window [rad]."""
    own = np.interp(start + WINDOW, t, heading) - np.interp(start, t, heading)
    return math.sqrt(float((own**2).mean()))


def _peak(middle: float, scores: Callable[[Array], Array]) -> float | None:
    """Return where correlation is best within COARSE of `middle` [s]; None where it is poor or rises further."""
    lags = middle + np.arange(-COARSE, COARSE + STEP / 2, STEP)
    score = scores(lags)
    best = int(np.argmax(score))
    if score[best] <= LEAST_CORRELATION or best in (0, len(lags) - 1):
        return None
    return float(lags[best]) + STEP * _vertex(*score[best - 1 : best + 2].tolist())


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
