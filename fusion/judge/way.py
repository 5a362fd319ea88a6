"""The truth's path without its noise: the steps of the robot from stamp to stamp, and its direction of travel.

The steps between readings as recorded are no path: 2 mm of noise at 100 Hz are 0.35 m in a second of standing
still, and a drift per metre looks better by what they add. So the path is made of chords between readings that lie
further apart than noise can move them.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from locfuse.fusion.chi_square import MAD
from locfuse.fusion.data import Array, Ints

CHORD_SIGMAS = 10.0  # sigmas of the truth's noise, per axis: two readings of one place do not lie so far apart
TANGENT_SIGMAS = 30.0  # the same for chords that give directions: noise turns them by 3 degrees (1 sigma)
MIN_CHORD_M = 1e-6  # m: what is shorter is rounding
MAX_NOISE_S = 0.1  # s: what varies faster is noise
MAX_PERIOD_S = 1.5  # s: between readings further apart the motion of the robot varies, not only noise
NOISE_ORDER = 5  # of the differences: a path that is a polynomial of degree 4 over six readings has no noise
MAX_NOISE_SAMPLES = 2000  # places along the truth at which the noise is sampled, at most


def steps_of(t: Array, xy: Array, segments: Ints, sigmas: float = CHORD_SIGMAS) -> Array:
    """Return the robot's step to each stamp (q, 2) [m] by a noisy truth xy (q, 2) [m] at t (q,) [s].

    There is none across a hole: `segments` (q,) numbers the pieces between holes. The end of a piece that is
    shorter than a chord is not counted. Noise across a chord makes it longer by sigma^2 / length: that is removed.
    """
    noise = noise_of(t, xy, segments)
    is_mark = _marks(xy, segments, max(sigmas * noise, MIN_CHORD_M))
    marks = np.flatnonzero(is_mark)
    steps = np.zeros_like(xy)
    if len(marks) < 2:
        return steps
    within = np.diff(segments[marks]) == 0
    chords = np.where(within[:, None], np.diff(xy[marks], axis=0), 0.0)
    square = np.where(within, np.square(chords).sum(axis=1), 1.0)
    chord = np.minimum(np.cumsum(is_mark) - 1, len(chords) - 1)  # (q,) on which a reading lies
    along = ((xy - xy[marks[chord]]) * chords[chord]).sum(axis=1) / square[chord]
    gone = np.maximum.accumulate(chord + np.clip(along, 0.0, 1.0))  # (q,) in chords: noise turns no robot back
    chords *= (1.0 - noise**2 / square)[:, None]
    steps[1:] = np.diff(gone)[:, None] * chords[chord[:-1]]
    return steps


def directions(t: Array, xy: Array, segments: Ints) -> Array:
    """Return the direction of travel (q,) [rad] by the steps before and after each stamp.

    Where the robot rests it is the direction in which it came; before its first motion, that of this motion.
    """
    steps = steps_of(t, xy, segments, TANGENT_SIGMAS)
    both = steps + np.append(steps[1:], np.zeros((1, 2)), axis=0)
    moving = np.flatnonzero(both.any(axis=1))
    if not len(moving):
        return np.zeros(len(t))
    last = moving[np.maximum(np.searchsorted(moving, np.arange(len(t)), side="right") - 1, 0)]
    direction: Array = np.arctan2(both[last, 1], both[last, 0])
    return direction


def noise_of(t: Array, xy: Array, segments: Ints) -> float:
    """Return the standard deviation [m, per axis] of changes in a path (q, 2) that are faster than MAX_NOISE_S.

    By divided differences of six readings, scaled so that white noise keeps its size: of neighbours, and of
    readings further apart, since noise may last. The median ignores where the robot starts and stops.
    """
    period = float(np.median(np.diff(t))) if len(t) > 1 else math.inf
    if period > MAX_PERIOD_S:
        return 0.0
    found, lag = 0.0, 1
    while (lag == 1 or lag * period <= MAX_NOISE_S) and NOISE_ORDER * lag < len(t):
        reach = NOISE_ORDER * lag
        first = np.unique(np.linspace(0, len(t) - 1 - reach, MAX_NOISE_SAMPLES).astype(np.int64))
        first = first[segments[first] == segments[first + reach]]
        if not len(first):
            break
        at = first[:, None] + lag * np.arange(NOISE_ORDER + 1)
        apart = (t[at][:, :, None] - t[at][:, None, :]) / (lag * period) + np.eye(NOISE_ORDER + 1)
        weights = 1.0 / apart.prod(axis=2)
        weights /= np.linalg.norm(weights, axis=1)[:, None]
        found = max(found, float(np.median(np.abs(np.einsum("nk,nkd->nd", weights, xy[at])))) / MAD)
        lag *= 2
    return found


def _marks(xy: Array, segments: Ints, least: float) -> NDArray[np.bool_]:
    """Mark where chords end (q,): the first reading of a piece, and each that is `least` [m] from the last."""
    marks = np.diff(segments, prepend=-1) > 0
    x = y = 0.0
    columns = (memoryview(column) for column in xy.T.copy())  # an hour as lists of floats would be big
    for i, (begins, px, py) in enumerate(zip(marks.tolist(), *columns, strict=True)):
        if begins or math.hypot(px - x, py - y) > least:
            marks[i], x, y = True, px, py
    return marks
