"""Judging configurations without truth: how well does each predict the sensors that it does not use?

A configuration runs while the other sensors listen (`fuse(..., listen=...)`): each reading is compared with what
the pose, its covariance and that sensor's own map or offset predict, and scored by the logarithm of the
predicted density (Good 1952; "innovation score"). The score is proper: to be vague costs, to be overconfident
costs more. Configurations are compared reading by reading, only on sensors that both leave out.

A configuration that leaves nothing out is tried in stretches of the drive: each sensor in turn only listens. That
favours it, since the sensor itself has just set the pose right, and the report says so. What no score can see: an
error that all sensors share, and walls that were taken for others.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence

import msgspec
import numpy as np
from numpy.typing import NDArray

from locfuse.fusion.data import Array, Audit, Drive, Estimates

from .bootstrap import block_means

OUTLIER_SHARE = 0.05  # share of readings that may be anything: one wild reading must not decide
MIN_GAIN_NATS = 0.02  # nats per number: less is none
BLOCK_S = 5.0  # s: readings this far apart are taken as independent
LASER = "lrf"  # whose scans are the motion where there are no wheels
STRETCH_S = 5.0  # s that a sensor listens at a time where it cannot be left out


class Score(msgspec.Struct, frozen=True):
    """How well one configuration predicts one sensor that only listened."""

    configuration: str
    sensor: str
    numbers: int  # scored
    score: float  # mean logarithm of the predicted density, nats per number
    gain: float  # compared with odometry on the same readings
    low: float  # the gain's 95 % interval, by blocks
    high: float
    stretches: bool  # the sensor belongs to the configuration and listened in stretches only
    shared: bool = False  # odometry was made of the same readings: to be worse than that says nothing


class Ranked(msgspec.Struct, frozen=True):
    """The rank of one configuration."""

    configuration: str
    gain: float | None  # mean over the sensors that listened; None where the configuration has no place
    on: tuple[str, ...]  # these sensors
    stretches: bool  # they are its own and listened in stretches only


def listeners(drive: Drive, sensors: Sequence[str]) -> dict[str, NDArray[np.bool_]]:
    """Return which readings a configuration of `sensors` only listens to: flags per reading, for `fuse`.

    Sensors left out listen always. Where none is left out, stretches of STRETCH_S take turns: in the first all
    are used, then one sensor after the other listens.
    """
    out = {s: np.ones(len(m.t), dtype=bool) for s, m in drive.measurements.items() if s not in sensors}
    if out:
        return out
    turns = {s: np.floor(drive.measurements[s].t / STRETCH_S) % (len(sensors) + 1) for s in sensors}
    return {s: turn == i + 1 for i, (s, turn) in enumerate(turns.items())}


def log_density(audit: Audit, z: Array) -> Array:
    """Return the log predicted density of every number of every measurement, (rows of z,); NaN if not compared.

    A mixture: with probability OUTLIER_SHARE the reading is anything the sensor ever says. A measurement that
    nothing was predicted for is such a reading. Components count one by one, so that d numbers are d scores.
    """
    m, d = z.shape
    width = np.maximum(z.max(axis=0) - z.min(axis=0), 1e-9) if m else np.ones(d)
    anything = math.log(OUTLIER_SHARE) - np.log(width)
    out = np.full(m, np.nan)
    with np.errstate(divide="ignore", invalid="ignore"):
        normal = -0.5 * (np.log(2.0 * np.pi * audit.sigma**2) + (audit.y / audit.sigma) ** 2)
    normal = np.where(np.isfinite(normal), normal + math.log(1.0 - OUTLIER_SHARE), -np.inf)
    out[audit.row] = np.logaddexp(normal, anything).mean(axis=1)
    return out


def scores(drive: Drive, tried: Iterable[Estimates]) -> list[Score]:
    """Return every configuration's score on every sensor that listened; the first tried must be odometry.

    Each is let go of before the next is tried: their audits are big.
    """
    runs = iter(tried)
    base = next(runs)
    found = scores_of(drive, base, base)
    while (e := next(runs, None)) is not None:
        found += scores_of(drive, e, base)
        del e
    return found


def scores_of(drive: Drive, e: Estimates, base: Estimates) -> list[Score]:
    """Return the scores of one configuration's run, compared with those of odometry's, `base`."""
    found = []
    flags = listeners(drive, e.sensors)
    for sensor in (s for s in e.audits if s in flags):
        m = drive.measurements[sensor]
        mine, theirs = log_density(e.audits[sensor], m.z), log_density(base.audits[sensor], m.z)
        counts = np.diff(m.first)
        listened = np.repeat(flags[sensor], counts) & _later(base.audits[sensor], len(m.z))
        rows = np.flatnonzero(listened & np.isfinite(mine) & np.isfinite(theirs))
        if len(rows):
            gain = mine[rows] - theirs[rows]
            low, high = interval(gain, np.repeat(m.t, counts)[rows])
            own = sensor in e.sensors
            mean = float(mine[rows].mean())
            shared = sensor == LASER and drive.wheels.matched is not None
            found.append(Score(e.name, sensor, len(rows), mean, float(gain.mean()), low, high, own, shared))
    return found


def mean_density(drive: Drive, e: Estimates, flags: Mapping[str, NDArray[np.bool_]]) -> float | None:
    """Return the mean log density of the sensors that only listened, each in nats per number; None without any."""
    means = []
    for sensor in (s for s in e.audits if s in flags):
        m = drive.measurements[sensor]
        density = log_density(e.audits[sensor], m.z)
        rows = np.repeat(flags[sensor], np.diff(m.first)) & np.isfinite(density)
        if rows.any():
            means.append(float(density[rows].mean()))
    return float(np.mean(means)) if means else None


def ranking(found: Sequence[Score], configurations: Sequence[str]) -> list[Ranked]:
    """Return configurations from the best predictor to the worst; those without a rank come last.

    Places go by sensors left out. A configuration that leaves none out has a place only where no other way of
    comparing is left: where the log has a single sensor.
    """
    alone = len({s.sensor for s in found}) == 1
    ranked = []
    for name in configurations:
        mine = [s for s in found if s.configuration == name and (alone or not s.stretches)]
        gain = float(np.mean([s.gain for s in mine])) if mine else None
        ranked.append(Ranked(name, gain, tuple(s.sensor for s in mine), any(s.stretches for s in mine)))
    return sorted(ranked, key=lambda r: -math.inf if r.gain is None else r.gain, reverse=True)


def contradictions(found: Sequence[Score], alone: Mapping[str, str]) -> list[tuple[str, str]]:
    """Return pairs of sensors of which one certainly makes the prediction of the other worse than odometry's.

    `alone` names the configuration that uses a sensor alone.
    """
    sensor_of = {name: sensor for sensor, name in alone.items()}
    pairs = {
        tuple(sorted((sensor_of[s.configuration], s.sensor)))
        for s in found
        if s.configuration in sensor_of
        and not s.stretches
        and not s.shared
        and s.high < 0.0
        and s.gain < -MIN_GAIN_NATS
    }
    return sorted((a, b) for a, b in pairs)


def _later(audit: Audit, rows: int) -> NDArray[np.bool_]:
    """Return which rows come after the sensor's first reading, which only initialises its map or offset."""
    out = np.ones(rows, dtype=bool)
    if len(audit.instant):
        out[audit.row[audit.instant == audit.instant[0]]] = False
    return out


def interval(values: Array, t: Array) -> tuple[float, float]:
    """Return the 95 % interval of the mean of `values` (n,) at times t (n,), by blocks of BLOCK_S."""
    duration = float(t[-1] - t[0])
    share = BLOCK_S / duration if duration > BLOCK_S else 1.0
    block = max(1, min(len(values), math.ceil(share * len(values))))
    low, high = np.percentile(block_means(values[None], block)[:, 0], (2.5, 97.5))
    return float(low), float(high)
