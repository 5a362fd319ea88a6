"""Noise of the wheels for a filter that has velocities as states, such as that of robot_localization.

Here noise grows with the way (docs/paper.md, eq. 9): a wheel that rolls s metres has the variance k |s|, so per
second

    forward   k (|v_left| + |v_right|) / 4         m^2 / s
    turn      k (|v_left| + |v_right|) / track^2   rad^2 / s

at the speeds of the drive. In such a filter a twist is measured every T seconds with the variance R, and
the velocity itself wanders with the process noise q per second. R T is what a reading adds to the pose per second,
so R = needed / T.

Only noise that differs from reading to reading belongs into R: slip that lasts does not show in an odometry's own
readings, and with so large an R a filter averages over real changes of speed. Of z_k = v_k + noise with a
wandering v, the steps d_k = z_{k+1} - z_k have E d_k d_{k+1} = -R (covariance matching; Mehra 1970), and q is what
makes the readings most likely in a filter whose only state is v (`random_walk`). What `needed` has beyond that R
goes into the process noise of the pose.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from locfuse.fusion.data import Array

from .motion import Wheels

MIN_SHARE = 0.01  # of the steps' variance: R and q stay above it, or a filter divides by next to nothing
MIN_VARIANCE = 1e-12
LN_RATIOS, LN_TOLERANCE = (-16.0, 16.0), 0.005  # ln of q T / R
MAX_READINGS = 4000
MAX_PERIODS = 1.5  # a longer pause between two readings is no step


class VelocityNoise(NamedTuple):
    """Variances of forward speed and turning rate, (2,) each: in m and rad."""

    period: float  # s, T
    reading: Array  # R: of one reading, (m/s)^2 and (rad/s)^2
    walk: Array  # q: of the velocity's own random walk, per second
    pose: Array  # of way and turn beyond R, m^2 and rad^2 per second
    needed: Array  # of way and turn in all, m^2 and rad^2 per second


def velocity_noise(wheels: Wheels) -> VelocityNoise:
    """Return the noise of the wheels per reading and per second, at the speeds of this drive."""
    dt = np.diff(wheels.t)
    period = float(np.median(dt))
    grown = _grown(wheels)
    moves = np.abs(wheels.rolled).sum(axis=1) > 0.0
    used = moves if moves.any() else np.ones_like(moves)
    needed = grown[used].sum(axis=0) / dt[used].sum()
    speeds = wheels.twist[:, [0, 2]] / dt[:, None]
    steps = np.diff(speeds, axis=0)
    even = np.maximum(dt[1:], dt[:-1]) <= MAX_PERIODS * period
    both = even[1:] & even[:-1]
    square = _mean(steps[even] ** 2)
    white = -_mean((steps[1:] * steps[:-1])[both])
    reading = np.minimum(np.maximum(white, MIN_SHARE * square), needed / period) + MIN_VARIANCE
    walk = np.array([random_walk(*of, period) for of in zip(speeds.T, reading.tolist(), strict=True)])
    return VelocityNoise(period, reading, walk, np.maximum(needed - reading * period, 0.0), needed)


def random_walk(z: Array, variance: float, period: float) -> float:
    """Return the process noise per second of a value z (n,) that is read every `period` s, with this variance.

    By maximum likelihood: the prior variance p of the one state settles where p = p R / (p + R) + q T.
    """
    from scipy.optimize import minimize_scalar

    begin = max(0, (len(z) - MAX_READINGS) // 2)
    values = z[begin : begin + MAX_READINGS].tolist()
    if len(values) < 3 or not variance > 0.0:
        return MIN_VARIANCE

    def cost(ln_ratio: float) -> float:
        added = variance * math.exp(ln_ratio)
        p = 0.5 * (added + math.sqrt(added * added + 4.0 * added * variance))
        gain, mean, square = p / (p + variance), values[0], 0.0
        for value in values[1:]:
            off = value - mean
            mean += gain * off
            square += off * off
        return square / (p + variance) + (len(values) - 1) * math.log(p + variance)

    best = minimize_scalar(cost, bounds=LN_RATIOS, method="bounded", options={"xatol": LN_TOLERANCE})
    return variance * math.exp(float(best.x)) / period


def _grown(wheels: Wheels) -> Array:
    """Return the variance of distance [m^2] and turn [rad^2] added in each interval, (n, 2)."""
    if wheels.matched is not None:
        return np.stack((wheels.matched[:, 0, 0], wheels.matched[:, 2, 2]), axis=-1)
    noise = wheels.noise * np.abs(wheels.rolled).sum(axis=1)
    return np.stack((0.25 * noise, noise / wheels.track**2), axis=-1)


def _mean(values: Array) -> Array:
    return np.asarray(values.mean(axis=0)) if len(values) else np.zeros(2)
