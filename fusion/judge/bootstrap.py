"""Confidence intervals for contrasts of ln(RMSE) between configurations on one drive, with correlated errors.

Errors of one drive are not independent samples: those of odometry are one random walk. So the drive is resampled
in blocks longer than the correlation time (moving-block bootstrap, Künsch 1989). Few blocks give too small a
spread. So the interval is at least as wide as for the same number of independent Gaussian pairs (Pitman 1939,
Morgan 1939: for paired errors, the ln of the ratio of their standard deviations has the half width asinh(t sqrt((1
- r^2) / n))).
"""

from __future__ import annotations

import math
from functools import cache

import msgspec
import numpy as np

from locfuse.fusion.data import Array, totals
from locfuse.fusion.statistics import CONFIDENCE

RESAMPLE_COUNT = 2000
STARTS_AT_ONCE = 1 << 20  # block starts in memory at once
CHANCE_DRAWS = 20_000  # number of random effects that are drawn, for quantiles of their distribution
MIN_REPLICATES = 4  # drives or robots; with fewer, Student's interval is too wide and not given
MAX_BLOCKS = 200  # largest number of blocks in a drive: longer blocks do no harm, shorter blocks cost memory
MIN_MSE_M2 = 1e-18  # m^2: smaller mean squared errors are raised to this


class Errors(msgspec.Struct, frozen=True):
    """Deviations of k configurations at q common truth stamps of one drive, with statistics for intervals."""

    deviation: Array  # (k, q, 2) m
    ln_rmse: Array  # (k,)
    samples: Array  # (k,) effective number of independent samples
    correlation: Array  # (k, k) lower confidence bound of the correlation of the deviations
    resampled: Array  # (RESAMPLE_COUNT, k) ln_rmse of the resampled drives
    block: int  # stamps per block

    @classmethod
    def of(cls, deviation: Array) -> Errors:
        """Return the statistics of deviations (k, q, 2) [m], q >= 1."""
        q = deviation.shape[1]
        squares = (deviation**2).sum(axis=2)
        samples = np.array([effective_samples(d) for d in deviation])
        block = max(math.ceil(q / MAX_BLOCKS), min(q, math.ceil(2.0 * q / float(samples.min()))))
        means = squares.mean(axis=1), block_means(squares, block)
        ln_rms, ln_blocks = (0.5 * np.log(np.maximum(m, MIN_MSE_M2)) for m in means)
        return cls(deviation, ln_rms, samples, _correlation(deviation, samples), ln_blocks, block)

    def interval(self, weights: Array) -> tuple[float, float]:
        """Return the confidence interval of sum(weights * ln_rmse), for weights (k,) that sum to zero.

        It is at least that of Gaussian errors: the errors x and y at the `samples` independent stamps count as
        2 `samples` independent numbers.
        """
        value = float(weights @ self.ln_rmse)
        tail = 50.0 * (1.0 - CONFIDENCE)
        low, high = np.percentile(self.resampled @ weights, (tail, 100.0 - tail))
        n, least = 2.0 * self.samples, 0.0
        scaled, own = weights / np.sqrt(n), weights**2 / n
        if own.any():
            variance = 0.5 * float(scaled @ self.correlation**2 @ scaled)
            freedom = float(own.sum() ** 2 / (own**2 / n).sum())  # Welch and Satterthwaite
            least = math.asinh(student_t(max(1.0, freedom - 1.0)) * math.sqrt(max(variance, 0.0)))
        return min(float(low), value - least), max(float(high), value + least)


def effective_samples(deviation: Array) -> float:
    """Return the effective number of independent samples of deviations (q, 2): q / (1 + 2 sum rho).

    The autocorrelation rho is about zero instead of the mean, so a constant error counts as one sample. The sum
    ends at the first negative rho (Geyer 1992).
    """
    q = len(deviation)
    size = 1 << (2 * q - 1).bit_length()
    power = (np.abs(np.fft.rfft(deviation, size, axis=0)) ** 2).sum(axis=1)
    covariance = np.fft.irfft(power, size)[:q]
    if covariance[0] <= 0.0:
        return float(q)
    rho = covariance / covariance[0]
    negative = np.flatnonzero(rho <= 0.0)
    until = int(negative[0]) if len(negative) else q
    return max(1.0, q / (1.0 + 2.0 * float(rho[1:until].sum())))


def block_means(values: Array, block: int) -> Array:
    """Return the means of `values` (k, q) over RESAMPLE_COUNT block-bootstrap samples, (RESAMPLE_COUNT, k).

    Blocks start anywhere and continue at the beginning after the end. All k rows use the same blocks, so that they
    stay paired.
    """
    k, q = values.shape
    count = math.ceil(q / block)
    twice = np.concatenate((np.zeros((k, 1)), values, values), axis=1)
    sums = np.cumsum(twice, axis=1)
    rng = np.random.default_rng(1)
    at_once = max(1, STARTS_AT_ONCE // count)
    totals = np.empty((RESAMPLE_COUNT, k))
    for first in range(0, RESAMPLE_COUNT, at_once):
        some = totals[first : first + at_once]
        starts = rng.integers(0, q, size=(len(some), count))
        for j, row in enumerate(sums):
            some[:, j] = (row[starts + block] - row[starts]).sum(axis=1)
    return np.asarray(totals / (count * block))


def _correlation(deviation: Array, samples: Array) -> Array:
    """Return the lower confidence bounds (Fisher's z) of the correlations (k, k) of deviations (k, q, 2)."""
    k = len(deviation)
    flat = deviation.reshape(k, -1)
    norms = np.linalg.norm(flat, axis=1)
    r = np.clip(flat @ flat.T / np.maximum(np.outer(norms, norms), MIN_MSE_M2), -1.0, 1.0)
    n = 2.0 * np.minimum.outer(samples, samples)
    uncertainty = np.where(n > 3.0, 1.0 / np.sqrt(np.maximum(n - 3.0, 1e-9)), np.inf)
    z = np.arctanh(np.minimum(np.abs(r), 1.0 - 1e-12))
    lowered: Array = np.tanh(np.maximum(z - uncertainty, 0.0))
    np.fill_diagonal(lowered, 1.0)
    return lowered


@cache
def by_chance(move: float, n: float) -> tuple[float, float]:
    """Return the interval of ln(error before / after) that random moves of an estimate cause by chance.

    n independent errors e of size 1 get random moves d. `move` is the standard deviation of d / that of e. The new
    error is |e + d|^2 = (sqrt(n) e + d_1)^2 + d_2^2 + ... + d_n^2.
    """
    rng = np.random.default_rng(1)
    along = (math.sqrt(n) + move * rng.standard_normal(CHANCE_DRAWS)) ** 2
    across = 2.0 * move**2 * rng.standard_gamma(0.5 * (n - 1.0), CHANCE_DRAWS)
    tail = 50.0 * (1.0 - CONFIDENCE)
    low, high = np.percentile(-0.5 * np.log((along + across) / n), (tail, 100.0 - tail))
    return float(low), float(high)


def student_t(freedom: float) -> float:
    """Return the two-sided quantile of Student's t at CONFIDENCE, with `freedom` degrees of freedom."""
    a = np.linspace(0.0, 0.5 * math.pi, 20001)  # with x = sqrt(f) tan(a) the density is cos(a)^(f - 1) da
    density = np.cos(a) ** (freedom - 1.0)
    mass = totals(0.5 * (density[1:] + density[:-1]))
    return math.sqrt(freedom) * math.tan(float(np.interp(CONFIDENCE * mass[-1], mass, a)))
