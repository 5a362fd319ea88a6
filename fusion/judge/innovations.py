"""Innovation statistics: a sensor's actual noise, without truth (Mehra 1970; Bar-Shalom et al. 2001).

`own` uses the innovations of a run that uses the sensor: the state also contains the sensor's errors.
`compare_readings` uses a run without the sensor: the innovations contain the full errors of the sensor.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from locfuse.fusion.data import Array, Audit, Counts, Drive, Estimates, Ints, Measurements, RowVerdict, matrices
from locfuse.fusion.ekf.belief_arrays import JointBelief
from locfuse.fusion.kernels.sight import SightLines
from locfuse.fusion.robot import Robot
from locfuse.fusion.se2 import wrap, wrap_all
from locfuse.fusion.sensors.registry import REGISTRY
from locfuse.fusion.statistics import best_split, chi_square, mean_bounds, robust_sigma

MAX_LAG_READINGS = 5
MIN_AUTOCORRELATION = 0.05  # a smaller autocorrelation counts as zero
MAX_COMPARED_READINGS, STRETCH_READINGS = 1500, 150  # most compared readings; length of an interval
MIN_CHANGE_SHARE = 0.85  # share of the variance that is not white, which a step or drift must explain
MIN_SIDE_SHARE = 0.1  # share of the readings, before a step and after it
OUTLIER_SIGMAS = 6.0  # a reading further away is an outlier; sigmas by the median deviation


class OwnInnovations(NamedTuple):
    """Innovation figures of one sensor, in a run that uses the sensor."""

    compared: int
    refused: float  # share of rejected measurements
    nis: float  # mean NIS per degree of freedom of accepted measurements
    bounds: tuple[float, float]  # 95 % bounds of the mean NIS of a consistent filter
    bias: tuple[float, ...]  # mean innovation in predicted standard deviations, rejected ones included
    middle: tuple[float, ...]  # median innovation, rejected ones included
    standard_error: tuple[float, ...]  # standard error of the median
    whiteness: tuple[float, ...]  # autocorrelation at lags 1 to MAX_LAG_READINGS
    raw: float  # observed / predicted covariance S of the innovations
    scale: float  # factor by which R should be multiplied
    white: float  # share of the innovations' variance that is white
    share: float  # share of R in the predicted variance of the innovations
    R: tuple[float, ...]  # mean claimed variance


class Change(NamedTuple):
    """Change of a sensor's mean error during a drive: one step or a steady drift."""

    step_s: float | None  # s: time of the step; None: a drift
    amount: float  # rad or m, over the drive
    span: float  # s, of the readings


class ComparedReadings(NamedTuple):
    """Innovation figures of one sensor, in a run that does not use the sensor."""

    readings: int
    outlier_share: float  # share of outliers
    bias: float | None  # mean innovation; None if the sensor's offset is unknown
    standard_error: float  # standard error of the bias, including the uncertainty of the reference
    white: float  # variance of the white part
    slow: float  # covariance of neighbouring readings
    spread: float  # variance
    memory: float  # correlation length in readings; 1 is white
    period: float  # s between readings
    reference: float  # predicted variance of the run that does not use the sensor
    R: float  # claimed variance
    change: Change | None = None  # step or drift, if it explains most of the slow errors


def own(audit: Audit, m: Measurements) -> OwnInnovations | None:
    """Return innovation figures of one sensor in a run that uses it; None for too few compared measurements."""
    d = audit.y.shape[1]
    far = np.isin(audit.verdict, (RowVerdict.GATE, RowVerdict.UNMATCHED)) & (audit.nis > audit.threshold)
    compared = np.flatnonzero((audit.verdict == RowVerdict.ACCEPTED) | (far & (audit.verdict == RowVerdict.GATE)))
    if len(compared) < 2 * MAX_LAG_READINGS:
        return None
    accepted = int((audit.verdict == RowVerdict.ACCEPTED).sum())
    refused = int(np.isin(audit.verdict, (RowVerdict.GATE, RowVerdict.UNMATCHED, RowVerdict.LOST)).sum())
    nis, bounds, raw = _accepted(audit, int(far.sum()), d)
    ratio, R = _prediction_ratio(audit, m, compared)
    middle, deviation, bias, whiteness = _shape(audit, compared)
    lasts = math.sqrt(_memory(np.append(1.0, whiteness)) / len(compared))
    return OwnInnovations(
        compared=len(compared),
        refused=refused / (accepted + refused),
        nis=nis,
        bounds=bounds,
        bias=tuple(bias.tolist()),
        middle=tuple(middle.tolist()),
        standard_error=tuple((deviation * lasts).tolist()),
        whiteness=tuple(whiteness.tolist()),
        raw=raw,
        scale=raw * min(max(1.0 - whiteness[0] * ratio, 0.3), 2.0),
        white=max(1.0 / ratio - whiteness[0], 0.0),
        share=1.0 / ratio,
        R=tuple(R.tolist()),
    )


def _accepted(audit: Audit, far: int, d: int) -> tuple[float, tuple[float, float], float]:
    """Return the mean NIS / dof of the accepted innovations, its 95 % bounds, and the factor that S needs.

    The factor is median NIS / expected median. The median includes `far` innovations beyond the gate.
    """
    used = np.flatnonzero(audit.verdict == RowVerdict.ACCEPTED)
    nis, repeats = audit.nis[used], 1.0
    if len(nis):
        order = np.argsort(audit.landmark[used], kind="stable")
        repeats = _memory(np.append(1.0, _whiteness((nis - nis.mean())[order, None], audit.landmark[used][order])))
    bounds = mean_bounds(d, max(1.0, len(nis) / repeats))
    at = (len(nis) + far) // 2
    scale = float(np.sort(nis)[at]) / chi_square(0.5, d) if at < len(nis) else math.inf
    return float(nis.mean()) / d if len(nis) else math.nan, bounds, scale


def _shape(audit: Audit, compared: Ints) -> tuple[Array, Array, Array, Array]:
    """Return median, robust deviation and normalised mean of each innovation component, (d,), and autocorrelation.

    Only the rows with the indices `compared` are used.
    """
    y = audit.y.take(compared, axis=0)  # ten times faster than audit.y[compared]
    middle = _medians(y)
    deviation = np.array([robust_sigma(c - centre) for c, centre in zip(y.T, middle, strict=True)])
    y /= audit.sigma.take(compared, axis=0)
    bias = y.mean(axis=0)
    y -= _medians(y)
    order = np.argsort(audit.landmark[compared], kind="stable")  # in order of time for each landmark
    y, mark = y.take(order, axis=0), audit.landmark[compared[order]]
    return middle, deviation, bias, _whiteness(y, mark)


def _prediction_ratio(audit: Audit, m: Measurements, compared: Ints) -> tuple[float, Array]:
    """Return the median of S / R (predicted over configured variance), and the mean configured variance R (d,)."""
    R = np.diagonal(m.R_unit, axis1=1, axis2=2)[audit.row[compared]]
    R *= m.scale**2
    R += np.diagonal(m.floor)
    ratio = audit.sigma.take(compared, axis=0)
    ratio *= ratio
    ratio /= R
    return float(np.median(ratio, overwrite_input=True)), R.mean(axis=0)


def _medians(values: Array) -> Array:
    """Return the medians (d,) of values (n, d), one column at a time to save memory."""
    return np.array([np.median(column) for column in values.T])


def _whiteness(v: Array, mark: Counts) -> Array:
    """Return the autocorrelation of v (k, d), averaged over columns, at lags 1 to MAX_LAG_READINGS.

    `mark` (k,), sorted, is the landmark of each row; only pairs of rows of the same landmark count.
    """
    out = np.zeros(MAX_LAG_READINGS)
    if len(v) < 2:
        return out
    variance = np.maximum((v**2).mean(axis=0), 1e-300)
    for lag in range(1, min(MAX_LAG_READINGS, len(v) - 1) + 1):
        same = mark[lag:] == mark[:-lag]
        if same.any():
            means = np.compress(same, v[lag:] * v[:-lag], axis=0).mean(axis=0)  # ten times faster than [same]
            out[lag - 1] = float((means / variance).mean())
    return out


def compare_readings(drive: Drive, robot: Robot, run: Estimates, sensor: str) -> ComparedReadings | None:
    """Return the innovation figures of a one-number sensor in a run that does not use the sensor.

    None for a sensor with several components, for a joint model, and for too few readings.
    """
    m = drive.measurements[sensor]
    model = REGISTRY[sensor].model(robot.settings(sensor))
    if model.joint or m.z.shape[1] != 1 or len(m.t) < 2 * MAX_LAG_READINGS:
        return None
    blocks, angular = model.blocks(), REGISTRY[sensor].components[0].unit == "deg"
    belief, rows = JointBelief.still(blocks), []
    readings = _sampled(len(m.t))
    readings = readings[np.isfinite(run.pose[drive.instant[sensor][readings], 0])]  # NaN in gaps of the truth
    instants = drive.instant[sensor][readings]
    poses, covariances = run.pose[instants].tolist(), matrices(run.triangles[instants]).tolist()
    for i, pose, P in zip(readings.tolist(), poses, covariances, strict=True):
        belief.stand(pose, P)
        seen = model.innovations(m, i, belief)
        assert not isinstance(seen, SightLines)  # lines have several numbers
        if seen and seen[0].verdict != RowVerdict.DISTURBED:
            best = seen[0]
            R = float(belief.equation(seen[:1]).R[0, 0])
            rows.append((float(m.t[i]), best.y[0], best.sigma[0] ** 2 - R, R, pose[2]))
    return _agreement(np.array(rows), bool(blocks), angular) if len(rows) >= 2 * MAX_LAG_READINGS else None


def _sampled(n: int) -> Ints:
    """Return the indices of all n readings; of many, those of evenly spaced intervals of consecutive readings."""
    if n <= MAX_COMPARED_READINGS:
        return np.arange(n)
    starts = np.linspace(0, n - STRETCH_READINGS, MAX_COMPARED_READINGS // STRETCH_READINGS).astype(np.int64)
    return (starts[:, None] + np.arange(STRETCH_READINGS)).ravel()


def usual_period(t: Array) -> float | None:
    """Return the median time [s] between distinct stamps t (n,); None if all stamps are equal."""
    gaps = np.diff(t)
    apart = gaps[gaps > 0.0]
    return float(np.median(apart)) if len(apart) else None


def _agreement(rows: Array, unknown: bool, angular: bool) -> ComparedReadings | None:
    """Return innovation figures without outliers; None if all rows have the same stamp.

    `rows` (k, 5) has t [s], innovation, variance of the reference, R, heading [rad]. Innovations are in rad if
    `angular` (then their mean is that of directions), else in m. `unknown`: they contain an unknown offset. Rows
    with a single stamp do not show how long an error lasts.
    """
    period = usual_period(rows[:, 0])
    if period is None:
        return None
    if angular:
        mean = math.atan2(float(np.sin(rows[:, 1]).mean()), float(np.cos(rows[:, 1]).mean()))
        y = wrap_all(rows[:, 1] - mean)
    else:
        mean = float(rows[:, 1].mean())
        y = rows[:, 1] - mean
    middle = float(np.median(y))
    deviation = robust_sigma(y - middle)
    inlier = np.abs(y - middle) <= OUTLIER_SIGMAS * max(deviation, 1e-12)
    t, _, h, R, theta = rows[inlier].T
    y = y[inlier]
    centred = y - y.mean()
    variance = float((centred**2).mean())
    near = np.diff(t) < 1.5 * period + 1e-9
    white = 0.5 * float((np.diff(y)[near] ** 2).mean()) if near.any() else variance
    correlation = _autocorrelation(centred, t, period)
    memory = _memory(correlation)
    offset = mean + float(y.mean())
    bias = None if unknown else wrap(offset) if angular else offset
    standard_error = math.sqrt(variance * memory / len(y) + float(h.mean()))
    return ComparedReadings(
        len(y),
        1.0 - float(inlier.mean()),
        bias,
        standard_error,
        white,
        variance - white,
        variance,
        memory,
        period,
        float(h.mean()),
        float(R.mean()),
        _change(t, centred, white, theta),
    )


def _change(t: Array, y: Array, white: float, theta: Array) -> Change | None:
    """Return a step or steady drift of errors y (k,) with mean 0 at t [s], if it explains most of their slow part.

    None if the robot's heading `theta` [rad] explains more, as for iron on the robot in a drive with few turns.
    """
    n, span = len(y), float(t[-1] - t[0])
    slow = float((y**2).mean()) - white
    edge = max(2, round(MIN_SIDE_SHARE * n))
    if slow <= 0.0 or 2 * edge >= n:
        return None
    split = best_split(np.ones(n), y, edge)
    by_step = split.explained / n
    middle = t - t.mean()
    slope = float(middle @ y) / float(middle @ middle)
    drift = slope * slope * float((middle**2).mean())
    A = np.stack((np.cos(theta), np.sin(theta), np.ones(n)), axis=-1)
    by_heading = float(np.square(A @ np.linalg.lstsq(A, y, rcond=None)[0]).mean())
    if max(drift, by_step) < max(MIN_CHANGE_SHARE * slow, by_heading):
        return None
    if drift > by_step:
        return Change(None, slope * span, span)
    return Change(0.5 * float(t[split.at] + t[split.at + 1]), split.after - split.before, span)


def _autocorrelation(y: Array, t: Array, period: float) -> Array:
    """Return the autocorrelation of y (k,) at lags 0, 1, ... periods, without pairs across a gap."""
    n = len(y)
    variance = float((y**2).mean())
    out = [1.0]
    for lag in range(1, min(n // 2, STRETCH_READINGS)):
        near = t[lag:] - t[:-lag] < (lag + 0.5) * period
        if not near.any() or out[-1] < MIN_AUTOCORRELATION:
            break
        out.append(float((y[lag:] * y[:-lag])[near].mean()) / max(variance, 1e-300))
    return np.array(out)


def _memory(correlation: Array) -> float:
    """Return the correlation length in readings: 1 + 2 (sum of the autocorrelation up to its first zero)."""
    forgotten = np.flatnonzero(correlation < MIN_AUTOCORRELATION)
    end = int(forgotten[0]) if len(forgotten) else len(correlation)
    return 1.0 + 2.0 * float(correlation[1:end].sum())
