"""Judging without truth: how well a configuration predicts sensors that it does not use, and how well scans agree.

Predictions rank the configurations. Sensors that a configuration does not use "listen" (`fuse(..., listen=...)`):
their readings do not correct the pose. They are predicted from the pose, its covariance, and the map or offset of
the sensor itself. The score is the logarithm of the predicted density (Good 1952; "innovation score"). It is
proper: a large covariance costs, and overconfidence costs more. Configurations are compared reading by reading,
only on sensors that neither of them uses.

For a configuration that uses all sensors, each sensor in turn only listens for STRETCH_S. The report notes that
this favours the configuration, since the same sensor corrected the pose just before. The score does not show an
error that all sensors share, or walls that are matched with other walls.

Scans judge a path. Revisit agreement: share of the points of scans at revisited places that coincide with points
of earlier scans. Crispness: number of map cells that contain points; of two paths of one drive, the better one has
fewer. Neither proves that a path is right, since two paths can have the same error.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence

import msgspec
import numpy as np

from locfuse.fusion import se2
from locfuse.fusion.data import LASER, Array, Audit, Drive, Estimates, Ints, Mask
from locfuse.fusion.mount import found_mount

from .bootstrap import block_means

OUTLIER_SHARE = 0.05  # probability of an outlier with any value, so that a single outlier does not decide
MIN_GAIN_NATS = 0.02  # nats per number: a smaller gain counts as no gain
BLOCK_S = 5.0  # s: readings in different blocks count as independent
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


STRIDE_M, MAX_SCANS = 0.7, 2000  # distance between two selected scans; largest number of selected scans
# least time between two visits of a place; the same in drives shorter than SHORT_S; s
AGAIN_S, AGAIN_SHORT_S, SHORT_S = 30.0, 8.0, 120.0
NEAR_M, MAX_EARLIER = 3.0, 10  # largest distance of an earlier scan; largest number of earlier scans
SAME_M = 0.1  # a point at most this far from an earlier one agrees
# smallest share of scans at revisited places; smallest mean number of scans per cell
MIN_REVISITS, MIN_OVERLAP = 0.1, 3.0
CELL_M = 0.05
# m; share of the distance driven: paths that are further apart than both are doubted
DOUBT_M, DOUBT_SHARE = 0.3, 0.0075
# combined sigmas of two paths; m: a distance below either is no contradiction
MAX_APART_SIGMAS, MIN_APART_M = 3.0, 0.05
MAX_CLAIM_RATIO = 1.5  # distance to the smoothed path / claimed standard deviation; above it: overconfident
MIN_AGREEMENT_RISE, GOOD_AGREEMENT = 0.2, 0.7  # least rise of the agreement, or least value, of a better path


class Distance(msgspec.Struct, frozen=True):
    """The distance between two paths of one drive after rigid alignment (SE(2))."""

    rms: float  # m
    max: float  # m
    t_s: float  # time of the largest distance

    @classmethod
    def between(cls, t: Array, a: Array, b: Array) -> Distance:
        """Return the distance between paths a and b (n, 2) [m] at the times t (n,) [s], after rigid alignment."""
        off = np.hypot(*se2.off_laid_on(a, b).T)
        return cls(float(np.sqrt((off**2).mean())), float(off.max()), float(t[off.argmax()]))

    def doubted(self, distance: float) -> bool:
        """Return whether the paths lie implausibly far apart for a drive of length `distance` [m]."""
        return self.max > max(DOUBT_M, DOUBT_SHARE * distance)

    def contradicts(self, a: float, b: float) -> bool:
        """Return whether two paths differ by more than their standard deviations a and b [m] allow."""
        return self.rms > max(MAX_APART_SIGMAS * float(np.hypot(a, b)), MIN_APART_M)


class OwnScans(msgspec.Struct, frozen=True):
    """Laser scans selected along a drive, to compare paths of this drive."""

    t: Array  # (k,) s
    instants: Ints  # (k,) of the drive
    points: list[Array]  # each (p, 2) m, in the base frame, deskewed
    mount: Array  # (3,) of the laser on the base, as configured: x, y [m], yaw [rad]

    @classmethod
    def of(cls, drive: Drive) -> OwnScans | None:
        """Return the selected scans of a drive; None without a laser whose points can be read."""
        m = drive.measurements.get(LASER)
        if m is None or m.points is None or not len(m.t):
            return None
        instants = drive.instant[LASER]
        distance = np.cumsum(np.hypot(*drive.motions.u[:, :2].T))[instants]
        stride = max(STRIDE_M, float(distance[-1] - distance[0]) / MAX_SCANS)
        chosen = np.flatnonzero(np.diff(np.floor(distance / stride), prepend=-1.0) > 0)
        return cls(drive.t[instants[chosen]], instants[chosen], list(m.points.read(chosen)), m.points.mount)

    def judge(self, e: Estimates) -> tuple[float | None, int, float]:
        """Return revisit agreement (0 to 1; None without revisits), number of map cells, and scans per cell.

        If the run estimates the mount of the laser, this mount is used.
        """
        moved = se2.compose(found_mount(LASER, self.mount, e.blocks), se2.inverse(self.mount))
        pose = se2.compose(e.pose[self.instants], moved)
        scans = zip(pose, self.points, strict=True)
        placed = [se2.transform(np.broadcast_to(x, (len(p), 3)), p) for x, p in scans]
        cells = [np.unique(np.floor(p / CELL_M).astype(np.int64) @ (1 << 32, 1)) for p in placed]
        every = len(np.unique(np.concatenate([np.zeros(0, np.int64), *cells])))
        return self._agreement(pose, placed), every, sum(len(c) for c in cells) / max(every, 1)

    def _agreement(self, pose: Array, placed: list[Array]) -> float | None:
        from scipy.spatial import cKDTree

        again = AGAIN_SHORT_S if self.t[-1] - self.t[0] < SHORT_S else AGAIN_S
        agree = points = visits = 0
        for k, scan in enumerate(placed):
            before = int(np.searchsorted(self.t, self.t[k] - again))
            apart = np.hypot(*(pose[:before, :2] - pose[k, :2]).T)
            near = np.argsort(apart, kind="stable")[:MAX_EARLIER]
            earlier = [placed[j] for j in near[apart[near] < NEAR_M].tolist() if len(placed[j])]
            if not earlier or not len(scan):
                continue
            distance, _ = cKDTree(np.concatenate(earlier)).query(scan, distance_upper_bound=SAME_M)
            agree, points, visits = agree + int(np.isfinite(distance).sum()), points + len(scan), visits + 1
        return agree / points if visits > MIN_REVISITS * len(placed) else None


def are_contradictory(a: Estimates, b: Estimates) -> bool:
    """Return whether two estimates at the same times differ by more than their sigmas allow."""
    return Distance.between(a.t, a.pose[:, :2], b.pose[:, :2]).contradicts(_claimed(a), _claimed(b))


def _claimed(e: Estimates) -> float:
    """Return the predicted position standard deviation of an estimate, rms over the drive [m]."""
    return float(np.sqrt(np.maximum(e.triangles[:, 0] + e.triangles[:, 3], 0.0).mean()))


def is_better(before: float | None, after: float | None) -> bool:
    """Return whether a change made a path better, by revisit agreement before and after (None: no revisits)."""
    if before is None or after is None:
        return False
    return after >= before + MIN_AGREEMENT_RISE or (after >= GOOD_AGREEMENT and after >= before)


class OwnScanFigures(msgspec.Struct, frozen=True):
    """Path quality figures of one estimate, from the laser scans of its drive."""

    revisit_agreement: float | None
    crispness_cells: int | None
    smoothed: Distance | None = None  # distance to the smoothed path of the same sensors, if there is one
    smoothed_is_better: bool = False  # by revisit agreement
    claimed_m: float = 0.0  # predicted standard deviation over the drive, sqrt(P_xx + P_yy)
    contradicted: bool = False  # smoothed and estimated path differ by more than their sigmas allow

    @property
    def is_overconfident(self) -> bool:
        """Whether the distance to the smoothed path is larger than the estimate's covariance allows."""
        apart = 0.0 if self.smoothed is None else self.smoothed.rms
        return apart > max(MAX_CLAIM_RATIO * self.claimed_m, MIN_APART_M)


def judged_by_scans(
    drive: Drive, estimates: Sequence[Estimates], smoothed: Mapping[str, Estimates]
) -> dict[str, OwnScanFigures]:
    """Return name of the estimate -> its path quality figures.

    `smoothed` maps the name of a filter's estimate to the smoothed estimate with the same sensors.
    """
    scans = OwnScans.of(drive)
    if scans is None or not len(scans.t):
        return {}
    every = {e.name: e for e in (*estimates, *(whole for whole in smoothed.values() if LASER in whole.sensors))}
    judged = {name: scans.judge(e) for name, e in every.items()}
    enough = max((judged[e.name][2] for e in estimates), default=0.0) >= MIN_OVERLAP
    found = {}
    for e in estimates:
        agreement, hit, _ = judged[e.name]
        cells = hit if enough else None
        whole = smoothed.get(e.name) if LASER in e.sensors else None
        if whole is None:
            found[e.name] = OwnScanFigures(agreement, cells)
            continue
        apart = Distance.between(e.t, e.pose[:, :2], whole.pose[:, :2])
        better, claimed = is_better(agreement, judged[whole.name][0]), _claimed(e)
        is_wrong = apart.contradicts(claimed, _claimed(whole))
        found[e.name] = OwnScanFigures(agreement, cells, apart, better, claimed, contradicted=is_wrong)
    return found
