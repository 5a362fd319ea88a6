"""Ranking of configurations without truth: how well each predicts the readings of sensors that it does not use.

Sensors that a configuration does not use "listen" (`fuse(..., listen=...)`): their readings do not correct the
pose. They are predicted from the pose, its covariance, and the map or offset of the sensor itself. The score is
the logarithm of the predicted density (Good 1952; "innovation score"). It is proper: a large covariance costs, and
overconfidence costs more. Configurations are compared reading by reading, only on sensors that neither of them
uses.

For a configuration that uses all sensors, each sensor in turn only listens for STRETCH_S. The report notes that
this favours the configuration, since the same sensor corrected the pose just before. The score does not show an
error that all sensors share, or walls that are matched with other walls.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence

import msgspec
import numpy as np

from locfuse.fusion.data import Array, Audit, Drive, Estimates, Mask

from .bootstrap import block_means

OUTLIER_SHARE = 0.05  # probability of an outlier with any value, so that a single outlier does not decide
MIN_GAIN_NATS = 0.02  # nats per number: a smaller gain counts as no gain
BLOCK_S = 5.0  # s: readings in different blocks count as independent
LASER = "lrf"  # without wheels, its scans give the motion
STRETCH_S = 5.0  # s: length of an interval in which a sensor of the configuration listens


class Score(msgspec.Struct, frozen=True):
    """Predictive score of one configuration on one sensor that does not correct its pose."""

    configuration: str
    sensor: str
    numbers: int  # number of scored numbers
    score: float  # mean logarithm of the predicted density, nats per number
    gain: float  # score minus that of odometry on the same readings
    low: float  # 95 % interval of the gain, by block bootstrap
    high: float
    stretches: bool  # whether the configuration uses the sensor, which listened only in some intervals
    shared: bool = False  # whether odometry uses the same readings: then there is no evidence of a contradiction


class Ranked(msgspec.Struct, frozen=True):
    """Mean predictive gain of one configuration, by which configurations are ranked."""

    configuration: str
    gain: float | None  # mean over the sensors that listened; None without rank
    on: tuple[str, ...]  # the sensors that listened
    stretches: bool  # whether the configuration uses these sensors, which listened only in some intervals


def listeners(drive: Drive, sensors: Sequence[str]) -> dict[str, Mask]:
    """Return sensor -> flags (n,): true for readings that a run with `sensors` predicts but does not use.

    Sensors that are not used always listen. If all are used, intervals of STRETCH_S alternate: in the first, all
    sensors are used; in each of the next ones, one sensor listens.
    """
    out = {s: np.ones(len(m.t), dtype=bool) for s, m in drive.measurements.items() if s not in sensors}
    if out:
        return out
    turns = {s: np.floor(drive.measurements[s].t / STRETCH_S) % (len(sensors) + 1) for s in sensors}
    return {s: turn == i + 1 for i, (s, turn) in enumerate(turns.items())}


def log_density(audit: Audit, z: Array) -> Array:
    """Return the log predicted density (m,) of measurements z (m, d), mean over components; NaN if not compared.

    The density is a mixture: with probability OUTLIER_SHARE, a value is uniform over the range of all values of
    the sensor. A measurement without a prediction has only this uniform density.
    """
    m, d = z.shape
    width = np.maximum(z.max(axis=0) - z.min(axis=0), 1e-9) if m else np.ones(d)
    log_uniform = math.log(OUTLIER_SHARE) - np.log(width)
    out = np.full(m, np.nan)
    with np.errstate(divide="ignore", invalid="ignore"):
        normal = -0.5 * (np.log(2.0 * np.pi * audit.sigma**2) + (audit.y / audit.sigma) ** 2)
    normal = np.where(np.isfinite(normal), normal + math.log(1.0 - OUTLIER_SHARE), -np.inf)
    out[audit.row] = np.logaddexp(normal, log_uniform).mean(axis=1)
    return out


def scores(drive: Drive, tried: Iterable[Estimates]) -> list[Score]:
    """Return the scores of all configurations on all sensors; the first configuration must be odometry.

    Only one run is kept at a time, since audits need much memory.
    """
    runs = iter(tried)
    base = next(runs)
    found = scores_of(drive, base, base)
    while (e := next(runs, None)) is not None:
        found += scores_of(drive, e, base)
        del e
    return found


def scores_of(drive: Drive, e: Estimates, base: Estimates) -> list[Score]:
    """Return the scores of one configuration's run, compared with `base`, the run of odometry."""
    found = []
    flags = listeners(drive, e.sensors)
    for sensor in (s for s in e.audits if s in flags):
        m = drive.measurements[sensor]
        mine, theirs = log_density(e.audits[sensor], m.z), log_density(base.audits[sensor], m.z)
        counts = np.diff(m.first)
        listened, first = np.repeat(flags[sensor], counts), base.audits[sensor]
        # the first reading only initialises the map or offset of the sensor
        listened[first.row[first.instant == first.instant[:1]]] = False
        rows = np.flatnonzero(listened & np.isfinite(mine) & np.isfinite(theirs))
        if len(rows):
            gain = mine[rows] - theirs[rows]
            low, high = interval(gain, np.repeat(m.t, counts)[rows])
            own = sensor in e.sensors
            mean = float(mine[rows].mean())
            shared = sensor == LASER and drive.wheels.matched is not None
            found.append(Score(e.name, sensor, len(rows), mean, float(gain.mean()), low, high, own, shared))
    return found


def mean_density(drive: Drive, e: Estimates, flags: Mapping[str, Mask]) -> float | None:
    """Return the mean log predicted density [nats per number] of flagged readings.

    None if no flagged reading has a prediction.
    """
    means = []
    for sensor in (s for s in e.audits if s in flags):
        m = drive.measurements[sensor]
        density = log_density(e.audits[sensor], m.z)
        rows = np.repeat(flags[sensor], np.diff(m.first)) & np.isfinite(density)
        if rows.any():
            means.append(float(density[rows].mean()))
    return float(np.mean(means)) if means else None


def ranking(found: Sequence[Score], configurations: Sequence[str]) -> list[Ranked]:
    """Return the configurations sorted by mean predictive gain, best first; those without a score are last.

    A configuration that uses all sensors has a rank only if the log has a single sensor.
    """
    alone = len({s.sensor for s in found}) == 1
    ranked = []
    for name in configurations:
        mine = [s for s in found if s.configuration == name and (alone or not s.stretches)]
        gain = float(np.mean([s.gain for s in mine])) if mine else None
        ranked.append(Ranked(name, gain, tuple(s.sensor for s in mine), any(s.stretches for s in mine)))
    return sorted(ranked, key=lambda r: -math.inf if r.gain is None else r.gain, reverse=True)


def contradictions(found: Sequence[Score], alone: Mapping[str, str]) -> list[tuple[str, str]]:
    """Return the pairs of sensors that contradict each other.

    A run with only one of them predicts the other one significantly worse than odometry does. `alone` maps each
    sensor to the configuration that uses only this sensor.
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


def interval(values: Array, t: Array) -> tuple[float, float]:
    """Return the 95 % interval of the mean of `values` (n,) at times t (n,) [s], by block bootstrap."""
    duration = float(t[-1] - t[0])
    share = BLOCK_S / duration if duration > BLOCK_S else 1.0
    block = max(1, min(len(values), math.ceil(share * len(values))))
    low, high = np.percentile(block_means(values[None], block)[:, 0], (2.5, 97.5))
    return float(low), float(high)
