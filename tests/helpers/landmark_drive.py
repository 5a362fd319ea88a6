"""A drive among five landmarks: where they stand, and the true path of the wheels of `wheel_bags`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from wheel_bags import RADIUS, TRACK

Array = NDArray[np.float64]
MAP = {6: (2.0, 1.5), 7: (-1.0, 2.0), 8: (1.0, -2.0), 9: (3.0, -1.0), 12: (-2.0, -1.0)}


def path_of(t: Array, angle: Array) -> Array:
    """Poses (n, 3) of dead reckoning along chords: the truth of these logs."""
    ds, turn = np.diff(angle, axis=0).mean(axis=1) * RADIUS, np.diff(angle, axis=0) @ [-1, 1] * RADIUS / TRACK
    theta = np.concatenate(([0.0], np.cumsum(turn)))
    middle = theta[:-1] + turn / 2
    steps = np.stack((ds * np.cos(middle), ds * np.sin(middle)), axis=-1)
    return np.column_stack((np.vstack(([0.0, 0.0], np.cumsum(steps, axis=0))), theta))
