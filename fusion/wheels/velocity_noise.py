"""Wheel noise for a filter with velocities as states, such as robot_localization.

In locfuse, noise grows with the path (docs/paper.md, eq. 9): a wheel that rolls s metres has the variance k |s|,
so per second

    forward   k (|v_left| + |v_right|) / 4         m^2 / s
    turn      k (|v_left| + |v_right|) / track^2   rad^2 / s

at the speeds of the drive. A filter with velocities as states gets a twist every T seconds with the variance R,
and the velocity is a random walk with process noise q per second. A reading adds R T per second to the pose
variance, so R = needed / T.

But only independent noise of the readings belongs into R: lasting slip is not visible in consecutive readings, and
with a large R the filter would average over real changes of speed. For z_k = v_k + noise with a random walk v, the
steps d_k = z_{k+1} - z_k have E d_k d_{k+1} = -R (covariance matching; Mehra 1970). q is the maximum-likelihood
value of a filter whose only state is v (`random_walk`). The rest of `needed` becomes process noise of the pose.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from locfuse.fusion.data import Array

from .motion import Wheels

MIN_SHARE = 0.01  # least R as share of the steps' variance, for numerical stability
MIN_VARIANCE = 1e-12
LN_RATIOS, LN_TOLERANCE = (-16.0, 16.0), 0.005  # ln of q T / R
MAX_READINGS = 4000
MAX_PERIODS = 1.5  # steps over longer gaps are not used


class VelocityNoise(NamedTuple):
    """Noise of the wheels' velocities; arrays (2,) hold values of forward speed (m) and turning rate (rad)."""

    period: float  # s, T
    reading: Array  # R: variance of one reading, (m/s)^2 and (rad/s)^2
    walk: Array  # q: process noise of the velocity, per second
    pose: Array  # process noise of distance and turn in addition to R, m^2 and rad^2 per second
    needed: Array  # total noise of distance and turn, m^2 and rad^2 per second


def velocity_noise(wheels: Wheels) -> VelocityNoise:
    """Return the wheel noise as a filter with velocity states needs it, estimated from this drive.

    Variances are per reading or per second of motion; they hold at the speeds of this drive.
    """
    dt = np.diff(wheels.t)
    period = float(np.median(dt))
    if wheels.matched is not None:  # variances that each interval adds to distance [m^2] and turn [rad^2]
        grown = np.stack((wheels.matched[:, 0, 0], wheels.matched[:, 2, 2]), axis=-1)
    else:
        noise = wheels.noise * np.abs(wheels.rolled).sum(axis=1)
        grown = np.stack((0.25 * noise, noise / wheels.track**2), axis=-1)
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
    """Return the process noise per second of a random walk, from readings z (n,) at intervals of `period` s.

    Each reading has noise of this `variance`. If z is too short or has no noise, MIN_VARIANCE is returned. By
    maximum likelihood: in steady state the prior variance p satisfies p = p R / (p + R) + q T.
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


def _mean(values: Array) -> Array:
    return np.asarray(values.mean(axis=0)) if len(values) else np.zeros(2)
