"""Evaluation of an estimate: errors against truth, ANEES and NIS; and what happened in the run, as timed events.

Errors are computed at the truth's stamps, to which the filter predicts. By default nothing is aligned, since
alignment hides an error of the start.

The length of the truth's path is not the sum of steps between readings: 2 mm of noise at 100 Hz add 0.35 m per
second of standstill, and a drift per metre would look better. So the path consists of chords between readings that
are further apart than noise can move them.

Events are standstill, lost robot, pose jumps, loop closures, and consecutive rejected readings.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Literal, NamedTuple

import msgspec
import numpy as np
from msgspec.structs import replace

from locfuse.fusion import se2
from locfuse.fusion.data import (
    JUMP,
    LOOP,
    LOOP_TAKEN,
    LOST,
    REFUSED,
    RELOCALISED,
    REST,
    SLIP,
    VERDICTS,
    Array,
    Audit,
    Drive,
    Estimates,
    Evaluation,
    Event,
    Ints,
    Jump,
    Mask,
    Measurements,
    RowVerdict,
    RunningNis,
    SensorFigures,
    Truth,
    consecutive,
    stretches,
)
from locfuse.fusion.ekf.map_frame import pose_by_frame
from locfuse.fusion.statistics import mean_bounds, robust_sigma
from locfuse.fusion.streams import gap_limit

from .bootstrap import effective_samples

CHORD_SIGMAS = 10.0  # least length of a chord in sigmas of the truth's noise per axis
TANGENT_SIGMAS = 30.0  # the same for chords that give directions: noise turns these by 3 degrees (1 sigma)
MIN_CHORD_M = 1e-6  # m: shorter chords are rounding errors
MAX_NOISE_S = 0.1  # s: faster variations of the position are noise
MAX_PERIOD_S = 1.5  # s: with a longer period, noise and motion of the robot cannot be separated
NOISE_ORDER = 5  # order of the differences: a polynomial of degree 4 through six readings has no noise
MAX_NOISE_SAMPLES = 2000  # largest number of places along the truth at which the noise is sampled
Align = Literal["none", "origin", "se2"]
DRIFT_LENGTHS_M = (1.0, 5.0, 10.0)  # m
ERRORS_AT_ONCE = 4096  # errors in one step, to limit memory
MIN_EIGENVALUE_RATIO = 1e-12  # smallest / largest eigenvalue, below which a covariance is singular
ERROR_KEYS = (
    "position_rmse_m",
    "position_mean_m",
    "position_median_m",
    "position_max_m",
    "final_position_error_m",
    "x_rmse_m",
    "y_rmse_m",
    "along_rmse_m",
    "cross_rmse_m",
    "heading_rmse_deg",
    "heading_max_deg",
    "drift_1m",
    "drift_5m",
    "drift_10m",
)


def steps_of(t: Array, xy: Array, segments: Ints, sigmas: float = CHORD_SIGMAS) -> Array:
    """Return the robot's displacement from the stamp before to each stamp, (q, 2) [m], from a noisy truth.

    The truth is xy (q, 2) [m] at t (q,) [s]; `segments` (q,) numbers its parts between gaps. The displacement
    across a gap is 0, and a segment's end after its last chord is not counted. Noise makes a chord longer by
    sigma^2 / length, which is subtracted.
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
    chord = np.minimum(np.cumsum(is_mark) - 1, len(chords) - 1)  # (q,) index of the chord of each reading
    along = ((xy - xy[marks[chord]]) * chords[chord]).sum(axis=1) / square[chord]
    gone = np.maximum.accumulate(chord + np.clip(along, 0.0, 1.0))  # (q,) in chords, never decreasing
    chords *= (1.0 - noise**2 / square)[:, None]
    steps[1:] = np.diff(gone)[:, None] * chords[chord[:-1]]
    return steps


def directions(t: Array, xy: Array, segments: Ints) -> Array:
    """Return the direction of travel (q,) [rad, map frame] at the stamps of a truth xy (q, 2).

    It is that of the steps before and after each stamp. At standstill it is that of the last motion, or, before
    any motion, of the first.
    """
    steps = steps_of(t, xy, segments, TANGENT_SIGMAS)
    both = steps + np.append(steps[1:], np.zeros((1, 2)), axis=0)
    moving = np.flatnonzero(both.any(axis=1))
    if not len(moving):
        return np.zeros(len(t))
    last = moving[np.maximum(np.searchsorted(moving, np.arange(len(t)), side="right") - 1, 0)]
    return np.asarray(np.arctan2(both[last, 1], both[last, 0]))


def noise_of(t: Array, xy: Array, segments: Ints) -> float:
    """Return the standard deviation [m, per axis] of noise in positions xy (q, 2) that is faster than MAX_NOISE_S.

    It is computed from divided differences of six readings, scaled to keep the size of white noise. Several
    spacings are used, since noise may be correlated. The median ignores starts and stops of the robot.
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
        found = max(found, robust_sigma(np.einsum("nk,nkd->nd", weights, xy[at])))
        lag *= 2
    return found


def _marks(xy: Array, segments: Ints, least: float) -> Mask:
    """Return flags (q,) of chord ends.

    These are the first reading of each segment, then each reading more than `least` [m] from the last chord end.
    """
    marks = np.diff(segments, prepend=-1) > 0
    x = y = 0.0
    columns = (memoryview(column) for column in xy.T.copy())  # lists of floats would need more memory
    for i, (begins, px, py) in enumerate(zip(marks.tolist(), *columns, strict=True)):
        if begins or math.hypot(px - x, py - y) > least:
            marks[i], x, y = True, px, py
    return marks


class _PosePairs(NamedTuple):
    """Estimated and true poses at the truth stamps within the drive."""

    t: Array  # (q,)
    pose: Array  # (q, 3) of the estimate
    P: Array  # (q, 3, 3)
    xy: Array  # (q, 2) truth of the tracked point
    theta: Array | None  # (q,) truth

    def tracked(self, truth: Truth) -> Array:
        """Return the estimated positions (q, 2) [m] of the point that the truth tracks."""
        return se2.transform(self.pose, np.broadcast_to(np.array(truth.point), self.xy.shape))


def evaluate(estimates: Estimates, drive: Drive, align: Align = "none") -> Evaluation:
    """Return errors, ANEES and NIS of one configuration."""
    sensors = {s: _sensor_figures(a, drive.measurements[s].absent) for s, a in estimates.audits.items()}
    length = float(np.hypot(*np.diff(estimates.pose[:, :2], axis=0).T).sum())
    own = {"duration_s": float(drive.t[-1] - drive.t[0]), "distance_m": length}
    truth = drive.truth
    pairs = _pairs(estimates, truth) if truth is not None else None
    found = Evaluation(
        estimates.configuration,
        sensors,
        {**dict.fromkeys((*ERROR_KEYS, "anees", "truth_coverage")), **own},
        smoothed=estimates.smoothed,
        lost=estimates.lost,
        notes=estimates.notes,
        rates=estimates.rates,
    )
    if truth is None or pairs is None or len(pairs.t) == 0:
        return found
    if align != "none":
        pairs = aligned(pairs, truth, align)
    estimate_xy = pairs.tracked(truth)
    deviation = estimate_xy - pairs.xy
    heading = None if pairs.theta is None else se2.wrap_all(pairs.pose[:, 2] - pairs.theta)
    sigma, nees = _expected(pairs, deviation, heading, truth)
    if align != "none":
        nees[:] = np.nan
    segments: Ints = np.cumsum(np.diff(pairs.t, prepend=pairs.t[0]) > gap_limit(pairs.t))  # (q,) between gaps
    ahead = directions(pairs.t, pairs.xy, segments) if pairs.theta is None else pairs.theta
    along_cross = se2.rotated(-ahead, deviation)
    distance = np.cumsum(np.hypot(*steps_of(pairs.t, pairs.xy, segments).T))
    steps, duration = np.diff(pairs.t), own["duration_s"]
    covered = float(steps[steps <= gap_limit(pairs.t)].sum()) / duration if duration > 0 else 0.0
    figures = {
        **_position_figures(deviation, along_cross),
        "heading_rmse_deg": None if heading is None else math.degrees(_rms(heading)),
        "heading_max_deg": None if heading is None else math.degrees(float(np.abs(heading).max())),
        **_drift_figures(pairs, deviation, distance, segments),
        "anees": _mean(nees),
        "truth_coverage": min(1.0, covered),
        **own,
    }
    return replace(
        found,
        figures=figures,
        t=pairs.t,
        deviation=deviation,
        heading=heading,
        along_cross=along_cross,
        sigma=sigma,
        nees=nees,
        distance=distance,
        estimate_xy=estimate_xy,
        align=align,
    )


def shape_error(estimates: Estimates, drive: Drive) -> float | None:
    """Return the position RMSE [m] after rigid alignment of the path with the truth; None without truth."""
    pairs = None if drive.truth is None else _pairs(estimates, drive.truth)
    if drive.truth is None or pairs is None or len(pairs.t) == 0:
        return None
    pairs = aligned(pairs, drive.truth, "se2")
    return float(np.sqrt(np.square(pairs.tracked(drive.truth) - pairs.xy).sum(axis=1).mean()))


def _pairs(estimates: Estimates, truth: Truth) -> _PosePairs:
    if estimates.truth_pose is None or estimates.truth_P is None:
        raise ValueError("estimates hold no prediction at the truth stamps")
    found = np.isfinite(estimates.truth_pose[:, 0])
    inside = slice(None) if found.all() else found  # a slice does not copy
    theta = None if truth.theta is None else truth.theta[inside]
    pose, P = estimates.truth_pose[inside], estimates.truth_P[inside]
    return _PosePairs(truth.t[inside], pose, P, truth.xy[inside], theta)


def aligned(pairs: _PosePairs, truth: Truth, align: Align) -> _PosePairs:
    """Return the pairs with estimated poses and covariances moved rigidly onto the truth.

    "origin": the first pose moves to the truth's first pose; without headings, only its position. "se2": least
    squares over all positions (Umeyama 1991, without scale).
    """
    p = pairs.tracked(truth)
    if align == "origin":
        turn = 0.0 if pairs.theta is None else float(pairs.theta[0] - pairs.pose[0, 2])
        a, b = p[0], pairs.xy[0]
    else:
        a, b = p.mean(axis=0), pairs.xy.mean(axis=0)
        turn, _ = se2.laid_on(p, pairs.xy)
    c, s = math.cos(turn), math.sin(turn)
    move = np.array([b[0] - c * a[0] + s * a[1], b[1] - s * a[0] - c * a[1], turn])
    turned = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    pose = se2.compose(np.broadcast_to(move, pairs.pose.shape), pairs.pose)
    return pairs._replace(pose=pose, P=turned @ pairs.P @ turned.T)


def _expected(pairs: _PosePairs, deviation: Array, heading: Array | None, truth: Truth) -> tuple[Array, Array]:
    """Return predicted standard deviations (q, 3) of the tracked point and heading [m, m, rad], and NEES (q,).

    The lever arm of the tracked point turns a heading error into a position error. NEES is per degree of freedom
    (Bar-Shalom 2001, 5.4.2). It includes the truth's noise of position and, if the truth has headings, of heading.
    """
    e = deviation if heading is None else np.column_stack((deviation, heading))
    dof, own = e.shape[1], np.diag(np.square((truth.sigma, truth.sigma, truth.sigma_theta)))
    lever = np.broadcast_to(np.append(truth.point, 0.0), pairs.pose.shape)
    sigma, found = np.empty((len(pairs.t), 3)), np.empty(len(pairs.t))
    for at in (slice(a, a + ERRORS_AT_ONCE) for a in range(0, len(pairs.t), ERRORS_AT_ONCE)):
        G = pose_by_frame(pairs.pose[at], lever[at])
        P = se2.propagated(G, pairs.P[at])
        sigma[at] = np.sqrt(np.maximum(np.diagonal(P, axis1=1, axis2=2), 0.0))
        found[at] = nees(e[at], (P + own)[:, :dof, :dof])
    return sigma, found


def nees(e: Array, S: Array) -> Array:
    """Return e' S^-1 e / d for errors e (n, d) with covariances S (n, d, d); NaN for a singular S.

    S is singular if 1 / tr S^-1 <= r max(tr S, r), with r = MIN_EIGENVALUE_RATIO. Up to the factor d, 1 / tr S^-1
    is the smallest eigenvalue of S, and tr S the largest.
    """
    found = np.full(len(e), np.nan)
    finite = np.flatnonzero(np.isfinite(S).all(axis=(1, 2)))
    sizes = np.linalg.eigvalsh(S[finite])
    with np.errstate(divide="ignore", over="ignore"):
        wide = MIN_EIGENVALUE_RATIO * np.maximum(sizes.sum(axis=1), MIN_EIGENVALUE_RATIO)
        regular = finite[(sizes > 0.0).all(axis=1) & (wide * (1.0 / sizes).sum(axis=1) < 1.0)]
    L = np.linalg.cholesky(S[regular])
    found[regular] = np.square(np.linalg.solve(L, e[regular, :, None])).sum(axis=(1, 2)) / e.shape[1]
    return found


def _position_figures(deviation: Array, along_cross: Array) -> dict[str, float | None]:
    error = np.hypot(deviation[:, 0], deviation[:, 1])
    return {
        "position_rmse_m": _rms(error),
        "position_mean_m": float(error.mean()),
        "position_median_m": float(np.median(error)),
        "position_max_m": float(error.max()),
        "final_position_error_m": float(error[-1]),
        "x_rmse_m": _rms(deviation[:, 0]),
        "y_rmse_m": _rms(deviation[:, 1]),
        "along_rmse_m": _rms(along_cross[:, 0]),
        "cross_rmse_m": _rms(along_cross[:, 1]),
    }


def _drift_figures(
    pairs: _PosePairs, deviation: Array, distance: Array, segments: Ints
) -> dict[str, float | None]:
    """Return the mean relative position error per metre [m/m] over fixed lengths of the truth's path.

    With headings it is the error of the relative pose (Kümmerle et al. 2009), without headings that of the
    displacement. The end of a length is interpolated between two stamps, so that the rate of the truth has no
    effect.
    """
    out: dict[str, float | None] = {}
    both = np.column_stack((pairs.xy + deviation, pairs.xy))
    for length in DRIFT_LENGTHS_M:
        end = np.searchsorted(distance, distance + length)
        i = np.flatnonzero(end < len(distance))
        i = i[segments[i] == segments[end[i]]]
        if len(i) == 0:
            out[f"drift_{length:.0f}m"] = None
            continue
        j = end[i]
        share = (distance[i] + length - distance[j - 1]) / (distance[j] - distance[j - 1])
        motion = both[j - 1] + share[:, None] * (both[j] - both[j - 1]) - both[i]
        if pairs.theta is None:
            error = motion[:, :2] - motion[:, 2:]
        else:
            error = se2.rotated(-pairs.pose[i, 2], motion[:, :2]) - se2.rotated(-pairs.theta[i], motion[:, 2:])
        out[f"drift_{length:.0f}m"] = float(np.hypot(error[:, 0], error[:, 1]).mean()) / length
    return out


def _sensor_figures(audit: Audit, absent: int) -> SensorFigures:
    counts = np.bincount(audit.verdict, minlength=len(VERDICTS)).tolist()
    verdicts = {name: n for name, n in zip(VERDICTS, counts, strict=True) if n}
    accepted = verdicts.get("accepted", 0)
    refused = sum(verdicts.values()) - accepted - verdicts.get("new", 0) - verdicts.get("repeated", 0)
    nis = _mean(audit.nis[audit.verdict == 0] / audit.y.shape[1])
    joint, dof = audit.joint.sum(axis=0).tolist()
    return SensorFigures(accepted, refused, absent, nis, joint / dof if dof else None, verdicts)


def _rms(values: Array) -> float:
    return math.sqrt(float((values**2).mean()))


def _mean(values: Array) -> float | None:
    finite = values[np.isfinite(values)]
    return float(finite.mean()) if len(finite) else None


# ---- consistency of the covariance ----
#
# With truth: squared error / predicted variance, for all states together and for each state. Without truth: the
# mean NIS of short intervals, with its bounds for the number of values in an interval.

MAX_INTERVALS = 80
MIN_MEASUREMENTS = 8  # least number of accepted measurements in one interval
STATES = ("x", "y", "theta")


def running_nis(audit: Audit, t: Array) -> RunningNis:
    """Return the mean NIS of accepted innovations over successive intervals. `t` (n,) [s] are the update times."""
    accepted = audit.verdict == 0
    intervals = int(np.clip(int(accepted.sum()) // MIN_MEASUREMENTS, 1, MAX_INTERVALS))
    edges = np.linspace(t[0], t[-1], intervals + 1)
    dof = audit.y.shape[1]
    nis = audit.nis[accepted] / dof
    place = np.clip(np.searchsorted(edges, t[audit.instant[accepted]], side="right") - 1, 0, intervals - 1)
    counts = np.bincount(place, minlength=intervals)
    sums = np.bincount(place, weights=nis, minlength=intervals)
    mean = np.where(counts > 0, sums / np.maximum(counts, 1), np.nan)
    bounds = np.array([mean_bounds(dof, int(c)) if c else (np.nan, np.nan) for c in counts])
    return RunningNis(0.5 * (edges[1:] + edges[:-1]), mean, bounds[:, 0], bounds[:, 1])


class CovarianceCheck(msgspec.Struct, frozen=True):
    """ANEES of one configuration: mean of squared error / predicted variance; above 1 means overconfident."""

    anees: float
    bounds: tuple[float, float]  # 95 % bounds of the ANEES of a consistent filter on such a drive
    states: Mapping[str, float] = {}  # ANEES of x, y and theta alone
    independent: float = math.nan  # effective number of independent errors
    words: str = ""

    @property
    def overconfident(self) -> bool:
        """Whether ANEES is above the bounds of a consistent filter."""
        return self.anees > self.bounds[1]

    @property
    def consistent(self) -> bool:
        """Whether ANEES is within the bounds of a consistent filter."""
        return self.bounds[0] <= self.anees <= self.bounds[1]


def covariance_check(judged: Evaluation) -> CovarianceCheck | None:
    """Return the consistency check of a configuration's covariance; None without truth or after alignment."""
    anees = judged.figures.get("anees")
    e = judged.deviation if judged.heading is None else np.column_stack((judged.deviation, judged.heading))
    sigma = judged.sigma[:, : e.shape[1]]
    good = np.isfinite(judged.nees) & (sigma > 0).all(axis=1)
    if anees is None or good.sum() < 2:
        return None
    unit = e[good] / sigma[good]
    independent = effective_samples(unit)
    bounds = mean_bounds(unit.shape[1], independent)
    states = dict(zip(STATES, (unit**2).mean(axis=0).tolist(), strict=False))
    return CovarianceCheck(anees, bounds, states, independent, _words(anees, bounds))


def _words(anees: float, bounds: tuple[float, float]) -> str:
    low, high = bounds
    if anees > high:
        return f"overconfident: errors are about {math.sqrt(anees):.1f} times what the covariance says"
    if anees < low:
        return f"underconfident: errors are about {math.sqrt(anees):.1f} times what the covariance says"
    return "consistent"


MIN_REST_S = 2.0
REST_STEP_M, REST_STEP_RAD = 1e-4, 1e-4  # motion in one interval of the wheels; less is standstill
SAME_LOOP_S = 5.0  # loop closures in closer succession are reported as one event
MIN_REFUSED = 5  # consecutive rejected readings; fewer are single outliers
JUMPS = {SLIP: "wheel slip undone", RELOCALISED: "lost robot found", LOOP_TAKEN: "loop closed"}
USED_VERDICTS = (RowVerdict.ACCEPTED, RowVerdict.NEW, RowVerdict.REPEATED)


def events_of_drive(drive: Drive) -> list[Event]:
    """Return the intervals of at least MIN_REST_S without wheel motion, as events."""
    u = drive.motions.u
    if len(u) != len(drive.t):
        return []  # a drive read from the files of a result has no motions
    still = (np.hypot(u[:, 0], u[:, 1]) < REST_STEP_M) & (np.abs(u[:, 2]) < REST_STEP_RAD)
    still[0] = False  # no interval ends at the first update time
    rests = [(float(drive.t[first - 1]), float(drive.t[last])) for first, last in stretches(still)]
    return [Event(a, b, REST, f"at rest for {b - a:.1f} s") for a, b in rests if b - a >= MIN_REST_S]


def events_of_run(drive: Drive, e: Estimates) -> list[Event]:
    """Return the events of a run (lost, jumps, loop closures, rejections) in order of time.

    `drive` has the readings to which the audits refer (thinned as in the run); `e` is the run, with its audits.
    """
    found = [Event(a, b, LOST, f"lost for {b - a:.1f} s", e.name) for a, b in e.lost]
    found += _loops(e)
    found += [Event(jump.t, jump.t, JUMP, _step(jump), e.name) for jump in e.jumps]
    for sensor, audit in e.audits.items():
        found += _refusals(sensor, drive.measurements[sensor], drive.t[drive.instant[sensor]], audit, e.name)
    return sorted(found)


def _loops(e: Estimates) -> Iterator[Event]:
    """Yield loop closures as events; loop closures in close succession are one event."""
    if not len(e.loops):
        return
    then, now = e.loops.T
    for some in consecutive(np.cumsum(np.diff(now, prepend=now[0]) > SAME_LOOP_S)):
        a, b = float(then[some].min()), float(then[some].max())
        place = f"the place of {a:.0f} s" if b - a < 1.0 else f"places of {a:.0f} to {b:.0f} s"
        yield Event(float(now[some[0]]), float(now[some[-1]]), LOOP, f"{place} recognised", e.name)


def _step(jump: Jump) -> str:
    """Return the kind and the size of a pose jump as text."""
    x, y, turn = jump.step
    return f"{JUMPS[jump.kind]}: moved {math.hypot(x, y):.2f} m, turned {math.degrees(turn):+.1f}°"


def _refusals(sensor: str, m: Measurements, t: Array, audit: Audit, name: str) -> Iterator[Event]:
    """Yield the intervals with at least MIN_REFUSED consecutive rejected readings of a sensor, as events."""
    n = len(m.t)
    owner = np.searchsorted(m.first, audit.row, side="right") - 1
    taken = np.bincount(owner[np.isin(audit.verdict, USED_VERDICTS)], minlength=n) > 0
    seen = np.flatnonzero(np.bincount(owner, minlength=n) > 0)  # readings without measurements are skipped
    for first, last in stretches(~taken[seen]):
        if last - first + 1 < MIN_REFUSED:
            continue
        start, end = float(t[seen[first]]), float(t[seen[last]])
        words = f"{sensor}: {last - first + 1} readings in a row refused, for {end - start:.1f} s"
        yield Event(start, end, REFUSED, words, name)
