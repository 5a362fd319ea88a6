"""Lag of a sensor's clock relative to the wheels', by correlation of turns.

Turns over a second are correlated (Knapp & Carter 1976): a constant offset or a wrong track (a scale) does not
matter. Then the lag is refined by least squares on short windows in which the turning rate changes:

- slip is white noise of the wheels' rates, so the lag would be less exact with long windows;
- windows with a constant turning rate bias the lag by 10 ms: a robot that steers by its pose compensates its slips
  later by turning its wheels (identification in closed loop: Ljung 1999, 13.4).

For a heading with white errors (a compass) and a reference without drift (the truth, a laser's run) no windows are
needed: the residuals are the lag times the turning rate. That is ten times more exact.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from locfuse.fusion.data import Array, Ints, Mask, Measurements
from locfuse.fusion.sensors.registry import REGISTRY
from locfuse.fusion.statistics import jackknife
from locfuse.fusion.wheels.motion import Wheels

WINDOW_S = 1.0  # s over which turning is compared
MAX_LAG_S = 1.5  # s
SHORT_WINDOWS_S = (0.1, 0.25, 0.5)  # s: the best one depends on the noise of sensor and reference
RATE_CHANGE_SPAN_S = 0.3  # s between the rates whose difference is the change of the turning rate
MAX_LEFT_OUT_SHARE = 0.9  # largest share of windows left out for a constant turning rate
RATE_SPAN_S = 0.1  # s over which the wheels' turning rate is computed
MAX_ITERATIONS = 3  # of least squares: the problem is nearly linear over the few 0.01 s left
# s, steps of the lag: correlations over a whole window are smooth, so the best is near the coarse best
COARSE_STEP_S, FINE_STEP_S = 0.05, 0.01
MIN_LAG_S = 0.04  # s: a sensor with a smaller lag can be a reference for others
MIN_SAID_LAG_S, SAID_SIGMAS = 0.01, 4.0  # s, sigmas: a smaller lag is not reported
MIN_RMS_TURN_RAD = math.radians(3.0)  # smallest rms turn per window
MIN_CORRELATION = 0.8
MIN_WINDOWS = 20  # windows
MIN_READINGS, MAX_READINGS = 20, 3000  # that are used: five minutes of a 10 Hz laser
STRETCH_COUNT = 16  # of the drive, over which residuals are summed, for errors that are correlated
MIN_SIGMA_S = 5e-4  # s, as turning rates are differences over 0.1 s
MAX_RESIDUAL_CORRELATION = 0.5  # of neighbouring residuals: with more they show no lag
PART_COUNT = 8  # of the drive: one at a time is left out
COARSE_OVERLAP = 4.0  # number of windows at any time, for the coarse search

Heading = Callable[[Array], Array]  # [rad, not wrapped, up to a constant] at any time [s]


class HeadingReference(NamedTuple):
    """Headings over time (of the wheels, the truth or a run) that a sensor's turns are compared with."""

    heading: Heading
    span: tuple[float, float]  # s
    wheels: Heading  # headings with little noise from reading to reading, for turning rates
    wanders: bool = True  # whether its errors accumulate, as for wheels and scan matching

    @classmethod
    def of(cls, t: Array, heading: Array, wheels: Wheels, wanders: bool = True) -> HeadingReference:
        """Return headings (n,) [rad, unwrapped] at t (n,) [s] as a reference."""
        return cls(lambda at: np.interp(at, t, heading), (float(t[0]), float(t[-1])), wheels.heading, wanders)


class Lag(NamedTuple):
    """Time offset at which a sensor's turns agree best with a reference."""

    offset: float  # s to add to the sensor's stamps
    correlation: float  # at that offset
    without: float  # correlation at offset 0
    sigma: float = math.inf  # s, standard deviation of the offset; infinite if found by correlation only
    spread: float = 0.0  # s, standard deviation of an offset by correlation only, by parts of the drive


class _Turns(NamedTuple):
    """Turns of a sensor between pairs of its readings."""

    start: Array  # (n,) s
    end: Array  # (n,) s
    angle: Array  # (n,) rad
    overlap: float  # number of turns at any time

    def where(self, keep: Mask | Ints) -> _Turns:
        """Return only the turns of `keep`: a mask (n,) or indices."""
        return _Turns(self.start[keep], self.end[keep], self.angle[keep], self.overlap)

    def scores(self, heading: Heading, lags: Array) -> Array:
        """Return the correlations (k,) with another heading at lags (k,) [s]."""
        shift = lags[:, None]
        a, b = self.angle - self.angle.mean(), heading(self.end + shift) - heading(self.start + shift)
        b = b - b.mean(axis=1, keepdims=True)
        scale = np.sqrt((a @ a) * (b**2).sum(axis=1))
        out: Array = np.divide(b @ a, scale, out=np.zeros(len(b)), where=scale > 0)
        return out


class _Fit(NamedTuple):
    lag: float  # s
    sigma: float  # s, its standard deviation


def headings(measurements: Mapping[str, Measurements]) -> dict[str, tuple[Array, Array]]:
    """Return times (n,) [s] and headings (n,) [rad] of each sensor that measures turns, by its first readings."""
    found = {}
    for name, m in measurements.items():
        first = m.take(np.arange(min(len(m.t), MAX_READINGS)))
        if len(m.t) < MIN_READINGS or (heading := REGISTRY[name].heading(first)) is None:
            continue
        t, angle = heading
        known = np.isfinite(angle)
        if known.sum() >= MIN_READINGS:
            found[name] = t[known], angle[known]
    return found


def by_wheels(wheels: Wheels) -> HeadingReference:
    """Return the wheels' headings as the reference for a lag."""
    return HeadingReference(wheels.heading, (float(wheels.t[0]), float(wheels.t[-1])), wheels.heading)


def find_lag(t: Array, heading: Array, reference: HeadingReference) -> Lag | None:
    """Return the lag of headings (n,) [rad, unwrapped] at t (n,) [s] relative to a reference.

    None if the robot hardly turned, or if headings and reference do not agree at any lag.
    """
    ok = np.isfinite(heading)
    t, heading = t[ok], heading[ok]
    turns = _turns(t, heading, WINDOW_S, reference.span)
    if len(turns.angle) < MIN_WINDOWS or math.sqrt(float((turns.angle**2).mean())) < MIN_RMS_TURN_RAD:
        return None
    found = _best(turns, reference.heading)
    if found is None:
        return None
    fits = [_least_squares(found, _turns(t, heading, w, reference.span), reference) for w in SHORT_WINDOWS_S]
    if not reference.wanders:
        fits.append(_by_residuals(found, t, heading, reference))
    best = min((f for f in fits if f is not None), key=lambda f: f.sigma, default=None)
    if best is None and turns.overlap <= 1.0:
        return None  # with readings further apart than the window, correlation does not show the lag
    spread = 0.0
    if best is None:
        best = _Fit(found, math.inf)
        parts = jackknife(lambda some: _best(turns.where(some), reference.heading), len(turns.angle), PART_COUNT)
        spread = float(parts)
    if math.isinf(spread):
        return None
    at, zero = turns.scores(reference.heading, np.array([best.lag, 0.0])).tolist()
    return Lag(best.lag, at, zero, best.sigma, spread=spread)


def _turns(t: Array, heading: Array, window: float, span: tuple[float, float]) -> _Turns:
    """Return the turns from each reading to the reading about `window` [s] later, without those across gaps.

    Turns begin and end at readings, since interpolation between them would blur the lag.
    """
    first = np.arange(max(len(t) - 1, 0))
    last = np.maximum(np.searchsorted(0.5 * (t[1:] + t[:-1]), t[:-1] + window), first + 1)
    start, end = t[first], t[last]
    period = float(np.median(np.diff(t))) if len(first) else window
    whole = (end - start > 0.5 * window) & (end - start < 2.0 * max(window, period))
    inside = (start >= span[0] + MAX_LAG_S) & (end <= span[1] - MAX_LAG_S)
    turns = _Turns(start, end, heading[last] - heading[first], max(window / max(period, 1e-9), 1.0))
    return turns.where(whole & inside)


def _best(turns: _Turns, heading: Heading) -> float | None:
    """Return the lag [s] with the highest correlation; None if that is low or at the end of the range."""
    coarse = np.arange(-MAX_LAG_S, MAX_LAG_S + COARSE_STEP_S / 2, COARSE_STEP_S)
    some = turns.where(np.arange(len(turns.angle)) % max(round(turns.overlap / COARSE_OVERLAP), 1) == 0)
    middle = float(coarse[np.argmax(some.scores(heading, coarse))])
    lags = middle + np.arange(-COARSE_STEP_S, COARSE_STEP_S + FINE_STEP_S / 2, FINE_STEP_S)
    score = turns.scores(heading, lags)
    best = int(np.argmax(score))
    if abs(middle) > MAX_LAG_S - COARSE_STEP_S / 2 or score[best] <= MIN_CORRELATION or best in (0, len(lags) - 1):
        return None
    left, middle, right = score[best - 1 : best + 2].tolist()
    curvature = left - 2.0 * middle + right  # of a parabola through the best three
    vertex = 0.5 * (left - right) / curvature if curvature < 0 else 0.0
    return float(lags[best]) + FINE_STEP_S * vertex


def _least_squares(start: float, turns: _Turns, reference: HeadingReference) -> _Fit | None:
    """Return the lag near `start` [s] by least squares of turns; None if the turns hardly agree.

    Gauss-Newton: a turn is the reference's turn times a scale, plus the lag times the change of the turning rate.
    """
    turns = turns.where(_changing(turns, reference, start))
    if len(turns.angle) < MIN_WINDOWS:
        return None
    lag, sigma = start, math.inf
    for _ in range(MAX_ITERATIONS):
        a, b = turns.start + lag, turns.end + lag
        columns = np.stack(
            (reference.heading(b) - reference.heading(a), _rate(reference, b) - _rate(reference, a))
        )
        columns, own = columns - columns.mean(axis=1, keepdims=True), turns.angle - turns.angle.mean()
        N = columns @ columns.T
        if np.linalg.det(N) <= 0.0:
            return None
        scale, shift = np.linalg.solve(N, columns @ own).tolist()
        left = own - scale * columns[0] - shift * columns[1]
        if left @ left > (1.0 - MIN_CORRELATION**2) * (own @ own) or scale <= 0.0:
            return None
        lag += shift / scale
        if abs(lag - start) > COARSE_STEP_S:
            return None
        inverse = np.linalg.inv(N)[1]
        # the residuals of a long slip are correlated (cluster-robust standard error)
        sums = np.array([part.sum() for part in np.array_split(inverse @ columns * left, STRETCH_COUNT)])
        sigma = math.sqrt(max(float(left.var()) * turns.overlap * inverse[1], float(sums @ sums))) / scale
    return _Fit(lag, sigma)


def _by_residuals(start: float, t: Array, heading: Array, reference: HeadingReference) -> _Fit | None:
    """Return the lag near `start` [s] for which headings differ least from the reference; None if this shows none.

    None too if successive differences are correlated. The sigma is by sums over stretches of the drive, to allow
    for slightly correlated errors.
    """
    inside = (t >= reference.span[0] + MAX_LAG_S) & (t <= reference.span[1] - MAX_LAG_S)
    t, heading = t[inside], heading[inside]
    if len(t) < MIN_WINDOWS * STRETCH_COUNT:
        return None
    lag, sigma = start, math.inf
    for _ in range(MAX_ITERATIONS):
        rate, theirs = _rate(reference, t + lag), reference.heading(t + lag)
        # possible errors of a heading: a constant, a drift, iron on the robot
        iron = (np.cos(theirs), np.sin(theirs), np.cos(2.0 * theirs), np.sin(2.0 * theirs))
        others = np.stack((np.ones(len(t)), t - t.mean(), *iron), axis=-1)
        own = _without(heading - theirs, others)
        rate = _without(rate, others)
        squares = float(rate @ rate)
        if squares <= 0.0:
            return None
        shift = float(rate @ own) / squares
        left = own - shift * rate
        if left[1:] @ left[:-1] > MAX_RESIDUAL_CORRELATION * float(left @ left):
            return None
        lag += shift
        if abs(lag - start) > COARSE_STEP_S:
            return None
        sums = np.array([part.sum() for part in np.array_split(rate * left, STRETCH_COUNT)])
        sigma = math.sqrt(float(sums @ sums)) / squares
    return _Fit(lag, math.hypot(sigma, MIN_SIGMA_S))


def _without(column: Array, others: Array) -> Array:
    """Return a column (n,) minus the least-squares fit by other columns (n, k)."""
    x, *_ = np.linalg.lstsq(others, column, rcond=None)
    return column - others @ x


def _changing(turns: _Turns, reference: HeadingReference, lag: float) -> Mask:
    """Return a mask (n,) of the turns whose rate changes most (above the rms); `lag` [s] is added to times."""
    middle = 0.5 * (turns.start + turns.end) + lag
    before, now, after = reference.wheels(middle + RATE_CHANGE_SPAN_S * np.array([[-1.0], [0.0], [1.0]]))
    change = np.abs(after - 2.0 * now + before)
    if not len(change):
        return np.zeros(0, bool)
    limit = float(np.quantile(change, MAX_LEFT_OUT_SHARE))
    kept: Mask = change >= min(math.sqrt((change**2).mean()), limit)
    return kept


def _rate(reference: HeadingReference, t: Array) -> Array:
    """Return the turning rate [rad/s] of the wheels at times t (n,) [s]."""
    return (reference.wheels(t + RATE_SPAN_S / 2) - reference.wheels(t - RATE_SPAN_S / 2)) / RATE_SPAN_S


def worth_saying(lag: Lag) -> bool:
    """Return whether a lag is large and clear enough to be reported."""
    clear = lag.correlation - lag.without > 0.1 * (1.0 - lag.without)
    return clear and abs(lag.offset) >= max(MIN_SAID_LAG_S, SAID_SIGMAS * lag.sigma)
