"""How much of another sensor's readings a motion explains: turns of a gyro or compass, distances between fixes.

The log is cut into windows; of n windows with what the sensor saw, a (n,), and what the motion says, b (n,), the
share explained is 1 - |a - b|^2 / |a|^2, at the delay between both clocks that suits the motion best. A motion
that stands explains nothing. What it does not see: an axis that points down (both senses of turning are tried).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from locfuse.fusion.data import Array

from .motion import Wheels

TURN_WINDOW_S, WAY_WINDOW_S, MIN_WINDOWS = 1.0, 5.0, 5
LAGS_S = np.arange(-1.0, 1.01, 0.1)  # between the clocks of a motion and a sensor
MIN_TURN_RAD = np.radians(3.0)  # rms over the windows: a sensor that turns less tells nothing
MIN_WAY_M = 15.0  # m in all: fixes of a receiver that stands wander by some metres


def turns_explained(wheels: Wheels, t: Array, heading: Array) -> float | None:
    """Return the share of a sensor's turning that a motion explains; None if the sensor hardly turns.

    `heading` (n,) [rad], not wrapped, is the sensor's at times t (n,) [s] on the clock of the motion.
    """
    start = np.arange(t[0], t[-1] - TURN_WINDOW_S, TURN_WINDOW_S)
    own = np.interp(start + TURN_WINDOW_S, t, heading) - np.interp(start, t, heading)
    if len(start) < MIN_WINDOWS or np.sqrt(np.mean(own**2)) < MIN_TURN_RAD:
        return None

    def turned(at: Array) -> Array:
        return wheels.heading(at + TURN_WINDOW_S) - wheels.heading(at)

    return max(_explained(own, start, turned), _explained(-own, start, turned))


def ways_explained(wheels: Wheels, t: Array, xy: Array, least: float = MIN_WAY_M) -> float | None:
    """Return the share of the distances between places that a motion explains; None below `least` [m] in all.

    `xy` (n, 2) [m] are the places at times t (n,) [s] on the clock of the motion; only distances count.
    """
    start = np.arange(t[0], t[-1] - WAY_WINDOW_S, WAY_WINDOW_S)
    own = _far(start, t, xy)
    if len(start) < MIN_WINDOWS or own.sum() < least:
        return None
    return _explained(own, start, lambda at: _far(at, wheels.t, wheels.pose[:, :2]))


def _far(start: Array, t: Array, xy: Array) -> Array:
    ends = [np.stack([np.interp(at, t, column) for column in xy.T]) for at in (start, start + WAY_WINDOW_S)]
    return np.asarray(np.hypot(*(ends[1] - ends[0])))


def _explained(own: Array, start: Array, motion: Callable[[Array], Array]) -> float:
    left = min(float(((own - motion(start + lag)) ** 2).sum()) for lag in LAGS_S.tolist())
    return max(0.0, 1.0 - left / float((own**2).sum()))
