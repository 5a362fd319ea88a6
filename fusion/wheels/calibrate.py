"""Calibration of wheel noise and wheel geometry by another motion: the ground truth, or an odometry of the robot.

With ground truth this generalises the paper's experiment for delta, by maximum likelihood. Drives are cut into
straight runs and turns on the spot, and these into pieces. For each piece, the motion by the truth is compared
with the motion by the wheels. Wheel noise is white along the path, so the errors of pieces are independent, with
the covariance k Q of wheels/motion.py. In closed form, with track L: for a straight piece of length D, var(along)
= k D/2, var(yaw) = 2 k D/L^2, var(across) = 2 k D^3/(3 L^2); for a turn phi, var(yaw) = k |phi|/L. Wheel scales
and track are fitted jointly (the error is linear in them), so that a systematic error does not count as noise.

An odometry that the robot computed from its wheel angles shows the wheel radius and the track that it used.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import msgspec
import numpy as np
from msgspec.structs import replace

from locfuse.fusion import se2
from locfuse.fusion.data import (
    Array,
    Drive,
    Ints,
    LocfuseError,
    Stream,
    Truth,
    changes,
    interpolate,
    stretches,
    totals,
)
from locfuse.fusion.robot import Mirrored, WheelSettings
from locfuse.fusion.scan_matching.match import Columns
from locfuse.fusion.statistics import CONFIDENCE, chi_square

from .motion import STANDS_M, Wheels
from .read import SIGNS, Counters, WheelReading, read_counters, read_wheels
from .repairs import repaired

# ---- noise scale by restricted likelihood with linear nuisance parameters ----  e_i = X_i p + noise, noise ~ N(0,
# s Q_i + T_i), p ~ N(0, P0): p is integrated out, so that systematic errors do not count as noise (Patterson and
# Thompson 1971). With T = 0 and a vague prior, s is the sum of squares over its degrees of freedom, and the
# interval is the chi-square interval.

S_BOUNDS = (1e-10, 10.0)  # search interval of s
LN_S_TOLERANCE = 1e-6  # of ln s


class Figure(msgspec.Struct, frozen=True):
    """An estimate with its confidence interval at CONFIDENCE."""

    value: float
    low: float
    high: float


class Residuals(msgspec.Struct, frozen=True):
    """Linear regression of n errors with d components: regressors of p nuisance parameters, and covariances."""

    e: Array  # (n, d)
    X: Array  # (n, d, p)
    Q: Array  # (n, d, d) covariance per unit of the noise scale to be estimated
    T: Array  # (n, d, d) known covariance
    prior: Array  # (p,) standard deviations of the nuisance parameters

    def parameters(self, scale: float) -> tuple[Array, Array]:
        """Return the estimated nuisance parameters (p,) and their covariance (p, p), for a noise scale."""
        V = scale * self.Q + self.T
        VX = np.linalg.solve(V, self.X)
        M = np.diag(self.prior**-2.0) + np.einsum("nij,nik->jk", self.X, VX)
        b = np.einsum("nij,ni->j", VX, self.e)
        return np.linalg.solve(M, b), np.linalg.inv(M)

    def squares(self, scale: float, p: Array) -> Array:
        """Return the squared Mahalanobis distance of each piece (n,), for a noise scale and parameters p (p,)."""
        r = self.e - self.X @ p
        return np.asarray(np.einsum("ni,ni->n", r, np.linalg.solve(scale * self.Q + self.T, r[..., None])[..., 0]))

    def ln_likelihood(self, scale: float) -> float:
        """Return the log likelihood of a noise scale, up to a constant."""
        V = scale * self.Q + self.T
        p, spread = self.parameters(scale)
        Ve = np.linalg.solve(V, self.e[..., None])[..., 0]
        explained = p @ np.linalg.solve(spread, p)
        quadratic = float((self.e * Ve).sum()) - float(explained)
        determinants = float(np.linalg.slogdet(V)[1].sum()) - float(np.linalg.slogdet(spread)[1])
        return -0.5 * (quadratic + determinants)

    def best(self) -> tuple[float, float]:
        """Return the maximum-likelihood noise scale and its log likelihood."""
        from scipy.optimize import minimize_scalar

        bounds = tuple(map(math.log, S_BOUNDS))
        how = {"bounds": bounds, "method": "bounded", "options": {"xatol": LN_S_TOLERANCE}}
        found = minimize_scalar(lambda x: -self.ln_likelihood(math.exp(x)), **how)
        return math.exp(found.x), -float(found.fun)

    def fit(self) -> tuple[Figure, float]:
        """Return the maximum-likelihood noise scale with its likelihood-ratio interval, and its log likelihood."""
        from scipy.optimize import brentq

        scale, top = self.best()
        drop = 0.5 * chi_square(CONFIDENCE, 1)

        def beyond(x: float) -> float:  # negative within the interval
            return top - self.ln_likelihood(math.exp(x)) - drop

        inside, ends = math.log(scale), [math.log(end) for end in S_BOUNDS]
        edges = (brentq(beyond, inside, end, xtol=LN_S_TOLERANCE) if beyond(end) > 0.0 else end for end in ends)
        return Figure(scale, *map(math.exp, edges)), top


STRAIGHT, TURN = 0, 1
WINDOW_S = 0.3  # s, window in which the motion is classified
STANDSTILL_MPS = 0.01  # m/s of the wheel rim below which the robot is at rest
MAX_OTHER_SHARE = 0.2  # largest share of turning in a straight run, and of translation in a turn
MAX_CURVATURE_RAD_PER_M = 0.7  # rad/m: largest curvature of a straight run
MIN_RUNS = (0.5, math.radians(45.0))  # m, rad: shorter runs are not used
PAPER_PERIOD_S = 0.1  # s, the sampling time for which the paper gives delta
# weak prior, relative: mean scale, scale difference, track
PRIOR_SIGMAS = np.array([0.1, 0.1, 0.3])
FIXED_SIGMA = 1e-9  # prior of parameters that are not observable in the log
UNSEEN_VARIANCE = 1e6  # m^2, rad^2: variance of components that the truth does not measure
FROM_PARAMETERS = np.array([[1.0, -0.5, 0.0], [1.0, 0.5, 0.0], [0.0, 0.0, 1.0]])  # to left, right, track
OUTLIER_CONFIDENCE = 0.99999  # a piece beyond this quantile is a slip or a jump of the truth
CHI_SQUARE_MEDIANS = {1: 0.4549, 3: 2.3660}  # of chi-square, by degrees of freedom
MIN_PIECES = 4
MIN_STANDSTILL_S = 0.5  # least standstill from which the truth's noise is estimated
MOVES_SIGMAS = 3.0  # sigmas of white noise: beyond this and STANDS_M, the truth moves during a standstill
MAX_MOVING_FACTOR = 2.0  # scatter in all standstills / in those where the truth is at rest: above, most is motion
USUAL_NOISE = 4e-4  # m: variance per metre that a wheel rolls


class Sigma(NamedTuple):
    """Standard deviations of the ground truth's noise."""

    xy: float  # m, per axis
    theta: float  # rad


class Pieces(Columns, frozen=True):
    """Straight or turning pieces of drives: errors of wheels against truth, derivatives and covariances."""

    kind: Ints  # (n,)
    size: Array  # (n,) m or rad
    e: Array  # (n, 3) truth's motion - wheels' motion, in the frame of the piece's start [m, m, rad]
    X: Array  # (n, 3, 3) derivative of the wheels' motion by (mean scale, scale difference, track)
    Q: Array  # (n, 3, 3) covariance per k [m]
    Q_delta: Array  # (n, 3, 3) covariance per delta
    T: Array  # (n, 3, 3) covariance of the truth
    dof: Ints  # (n,) number of components of e that the truth measures

    @property
    def prior(self) -> Array:
        """Return prior standard deviations (3,) of mean scale, scale difference and track.

        FIXED_SIGMA for a parameter that no piece determines.
        """
        straight, turn = self.kind == STRAIGHT, self.kind == TURN
        observable = (straight.any(), ((self.dof > 1) & (straight | turn)).any(), turn.any())
        return np.where(observable, PRIOR_SIGMAS, FIXED_SIGMA)

    def residuals(self, Q: Array) -> Residuals:
        """Return the residuals for a noise covariance `Q` (n, 3, 3) per unit of the noise scale."""
        return Residuals(self.e, self.X, Q, self.T, self.prior)


class WheelCalibration(msgspec.Struct, frozen=True):
    """Wheel calibration by straight runs and turns, relative to the configured geometry (0: no change)."""

    k: Figure  # m: variance per metre rolled
    delta: Figure  # of the paper, for PAPER_PERIOD_S
    prefers_k: float  # log likelihood ratio of noise per metre over the paper's noise model
    parameters: Array  # (3,) mean scale, scale difference (right - left), track
    sigmas: Array  # (3,) NaN for parameters that are not observable in the drives
    pieces: dict[str, int]  # kind -> number of used pieces
    outliers: int
    straight_m: float
    turned_rad: float


def calibrate_wheels(drives: Sequence[Drive]) -> WheelCalibration:
    """Estimate wheel noise and geometry from straight runs and turns on the spot of one robot's drives.

    Raises LocfuseError if a drive has no truth or there are too few pieces.
    """
    moved = np.zeros(3)  # left, right, track, relative
    # an odometry with sideways motion has no wheels to correct
    sideways = any(drive.wheels.twist[:, 1].any() for drive in drives)
    for _ in range(1 if sideways else 3):  # Gauss-Newton: a track error of 10 % is not linear in the turn
        found = Pieces.joined(*(find_pieces(drive, moved) for drive in drives))
        used = without_outliers(found)
        if len(used.e) < MIN_PIECES:
            least = f"{MIN_RUNS[STRAIGHT]:g} m straight or {math.degrees(MIN_RUNS[TURN]):.0f} degrees on the spot"
            raise LocfuseError(
                f"{len(used.e)} usable pieces of straight runs and turns on the spot; at least {MIN_PIECES} of "
                f"{least} are needed. See how such a drive looks: locfuse simulate straight_runs",
                role="calibrate",
            )
        residuals = used.residuals(used.Q)
        step, spread = residuals.parameters(residuals.best()[0])
        moved = (1.0 + moved) * (1.0 + FROM_PARAMETERS @ step) - 1.0
    k, ln_k = residuals.fit()
    delta, ln_delta = used.residuals(used.Q_delta).fit()
    straight = used.kind == STRAIGHT
    return WheelCalibration(
        k=k,
        delta=delta,
        prefers_k=ln_k - ln_delta,
        parameters=np.array([0.5 * (moved[0] + moved[1]), moved[1] - moved[0], moved[2]]),
        sigmas=np.where(used.prior > FIXED_SIGMA, np.sqrt(np.diag(spread)), np.nan),
        pieces={"straight": int(straight.sum()), "turn": int((~straight).sum())},
        outliers=len(found.e) - len(used.e),
        straight_m=float(used.size[straight].sum()),
        turned_rad=float(used.size[~straight].sum()),
    )


def find_pieces(drive: Drive, moved: Array) -> Pieces:
    """Cut a drive into straight and turning pieces; return the errors of the wheels against the truth in each.

    `moved` (3,) are relative changes of left scale, right scale and track. Raises LocfuseError without a truth.
    """
    truth = drive.truth
    if truth is None:
        hint = "(--set truth.topic=/TOPIC names it)"
        raise LocfuseError("no truth to compare the wheels with", role="calibrate", hint=hint)
    wheels: Wheels = drive.wheels
    if moved.any():
        wheels = wheels.rerolled(wheels.rolled * (1.0 + moved[:2]), wheels.track * (1.0 + float(moved[2])))
    inside = (truth.t >= wheels.t[0]) & (truth.t <= wheels.t[-1])
    theta = np.zeros(len(truth.t)) if truth.theta is None else truth.theta
    body = se2.compose(np.column_stack((truth.xy, theta)), np.array([*(-np.array(truth.point)), 0.0]))
    stamps, pose = truth.t[inside], body[inside]
    sigma = truth_sigma(truth, wheels)
    kind, a, b = cut_runs(find_runs(wheels), wheels, stamps, piece_length(sigma, wheels))
    if truth.theta is None:  # the truth does not measure turns
        kind, a, b = (column[kind == STRAIGHT] for column in (kind, a, b))
    motions = replace(wheels, noise=1.0).between(stamps[a], stamps[b], parameters=True)
    seen = se2.between(pose[a], pose[b])
    e, T = _errors(seen, motions.u, sigma, truth.theta is not None)
    # eq. 9: the variance of a wheel's distance in one period is delta (omega dt R)^2, so per metre delta v dt
    per_period = wheels.rolled**2 * (PAPER_PERIOD_S / np.diff(wheels.t))[:, None]
    return Pieces(
        kind=kind,
        size=np.where(kind == STRAIGHT, np.hypot(motions.u[:, 0], motions.u[:, 1]), np.abs(motions.u[:, 2])),
        e=e,
        X=motions.J @ FROM_PARAMETERS,
        Q=motions.Q,
        Q_delta=replace(wheels, rolled=per_period, noise=1.0).between(stamps[a], stamps[b]).Q,
        T=T,
        dof=np.full(len(kind), 1 if truth.theta is None else 3),
    )


def without_outliers(pieces: Pieces) -> Pieces:
    """Remove pieces with a large error compared with the median: slips, or jumps of the truth."""
    for _ in range(2):
        if len(pieces.e) < MIN_PIECES:
            break
        residuals = pieces.residuals(pieces.Q)
        scale, _ = residuals.best()
        p = residuals.parameters(scale)[0]
        middle = np.array([CHI_SQUARE_MEDIANS[d] for d in pieces.dof.tolist()])
        scale *= float(np.median(residuals.squares(scale, p) / middle))
        limit = np.array([chi_square(OUTLIER_CONFIDENCE, d) for d in pieces.dof.tolist()])
        pieces = pieces.take(residuals.squares(scale, p) <= limit)
    return pieces


def truth_sigma(truth: Truth, wheels: Wheels) -> Sigma:
    """Return the noise of the truth: the configured value, else its scatter while the robot is at rest.

    A truth that is late or jumps moves while the wheels are at rest: this scatter is not noise.
    """
    middle = 0.5 * (wheels.t[1:] + wheels.t[:-1])
    still = np.abs(wheels.rolled).max(axis=1) < STANDSTILL_MPS * np.diff(wheels.t)
    found: dict[bool, list[Array]] = {False: [], True: []}  # rows of (x [m], y [m], theta [rad]), by "it moves"
    for first, last in stretches(still):
        rows = (truth.t >= middle[first]) & (truth.t <= middle[last])
        if middle[last] - middle[first] < MIN_STANDSTILL_S or rows.sum() < 3:
            continue
        xy, theta = truth.xy[rows], np.zeros(int(rows.sum()))
        if truth.theta is not None:
            theta = se2.wrap_all(truth.theta[rows] - truth.theta[rows][0])
        own = np.column_stack((xy, theta))
        found[_moves(xy)].append(own - own.mean(axis=0))
    resting, whole = (_scatters([*found[False], *moving]) for moving in ([], found[True]))
    place, turn = (r if w > MAX_MOVING_FACTOR * r else w for r, w in zip(resting, whole, strict=True))
    return Sigma(truth.sigma or place, turn)


def _scatters(own: Sequence[Array]) -> tuple[float, float]:
    """Return the standard deviations [m, rad] of rows (n, 3) [m, m, rad] of several times; 0 without any."""
    rows = np.concatenate(own) if own else np.zeros((1, 3))
    return float(rows[:, :2].std()), float(rows[:, 2].std())


def _moves(xy: Array) -> bool:
    """Return whether positions (n, 2) [m] at a standstill of the wheels move: the truth is late, or it jumps."""
    half = len(xy) // 2
    away = float(np.hypot(*(xy[-half:].mean(axis=0) - xy[:half].mean(axis=0))))
    white = math.sqrt(0.5 * float((np.diff(xy, axis=0) ** 2).sum(axis=1).mean()))
    return away > max(STANDS_M, MOVES_SIGMAS * white * 2.0 / math.sqrt(len(xy)))


def piece_length(sigma: Sigma, wheels: Wheels) -> tuple[float, float]:
    """Return the least length of a straight [m] and of a turning [rad] piece.

    In pieces of this length, the noise of the truth is small beside that of the wheels.
    """
    noise = wheels.noise or USUAL_NOISE  # the configured noise may be 0
    straight = 16.0 * sigma.xy**2 / noise
    turn = 8.0 * sigma.theta**2 * wheels.track / noise
    return max(MIN_RUNS[STRAIGHT], straight), max(MIN_RUNS[TURN], turn)


def _errors(seen: Array, u: Array, sigma: Sigma, headings: bool) -> tuple[Array, Array]:
    """Return errors (n, 3) of motions u (n, 3) against those of the truth, `seen` (n, 3), and its covariances.

    Both poses of the truth have noise `sigma`. Without `headings`, only lengths of straight pieces are compared.
    """
    variance = 2.0 * sigma.xy**2
    if headings:
        lever = np.stack((seen[:, 1], -seen[:, 0], -np.ones(len(seen))), axis=-1)
        T = sigma.theta**2 * lever[:, :, None] * lever[:, None, :]
        return se2.difference(seen, u), T + np.diag([variance, variance, sigma.theta**2])
    e = np.zeros_like(u)
    e[:, 0] = np.sign(u[:, 0]) * (np.hypot(seen[:, 0], seen[:, 1]) - np.hypot(u[:, 0], u[:, 1]))
    return e, np.tile(np.diag([variance, UNSEEN_VARIANCE, UNSEEN_VARIANCE]), (len(u), 1, 1))


# ---- straight runs and turns on the spot ----


Run = tuple[int, float, float]  # motion in one direction: STRAIGHT or TURN, start and end [s]


def find_runs(wheels: Wheels) -> list[Run]:
    """Return the straight runs and turns on the spot of a drive, in time order."""
    label = _labels(wheels)
    edges = np.flatnonzero(np.diff(label, prepend=0, append=0))
    found = []
    for a, b in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        if label[a] == 0:
            continue
        kind = STRAIGHT if abs(label[a]) == 1 else TURN
        if abs(float(wheels.twist[a:b, (0, 2)[kind]].sum())) >= MIN_RUNS[kind]:
            found.append((kind, float(wheels.t[a]), float(wheels.t[b])))
    return found


def _labels(wheels: Wheels) -> Ints:
    """Label each wheel interval: +-1 straight forward/backward, +-2 left/right turn, 0 other motion or rest."""
    middle = 0.5 * (wheels.t[1:] + wheels.t[:-1])
    travelled = totals(wheels.twist[:, [0, 2]])
    before, after = (interpolate(middle + h, wheels.t, travelled) for h in (-0.5 * WINDOW_S, 0.5 * WINDOW_S))
    ds, turn = (after - before).T
    rim = 0.5 * wheels.track * turn
    moving = np.abs(ds) + np.abs(rim) > STANDSTILL_MPS * WINDOW_S
    straight = np.abs(rim) <= MAX_OTHER_SHARE * np.abs(ds)
    straight &= np.abs(turn) <= MAX_CURVATURE_RAD_PER_M * np.abs(ds)
    label = np.where(straight, np.sign(ds), 0.0)
    label = np.where(np.abs(ds) <= MAX_OTHER_SHARE * np.abs(rim), 2.0 * np.sign(rim), label)
    return np.where(moving, label, 0.0).astype(np.int64)


def cut_runs(
    runs: Sequence[Run], wheels: Wheels, stamps: Array, least: tuple[float, float]
) -> tuple[Ints, Ints, Ints]:
    """Cut runs into equal pieces of about `least` (m, rad) each, at the truth's stamps (m,) [s].

    Returns (kind, index of first stamp, index of last stamp) of each piece, (k,) each; pieces do not overlap.
    """
    travelled = interpolate(stamps, wheels.t, totals(np.abs(wheels.twist[:, [0, 2]]))).T
    pieces = [np.zeros((0, 3), np.int64)]
    for kind, start, end in runs:
        a, b = np.searchsorted(stamps, start).item(), np.searchsorted(stamps, end, side="right").item() - 1
        if a >= b or (total := float(travelled[kind][b] - travelled[kind][a])) < 0.5 * MIN_RUNS[kind]:
            continue
        cuts = np.linspace(travelled[kind][a], travelled[kind][b], max(1, int(total / least[kind])) + 1)
        at = np.unique(np.clip(np.searchsorted(travelled[kind], cuts), a, b))
        pieces.append(np.stack((np.full(len(at) - 1, kind), at[:-1], at[1:]), axis=-1))
    kinds, first, last = np.concatenate(pieces).T
    return kinds, first, last


ODOMETRY_WINDOW_S = 0.5  # s, window in which both are compared
ASSUMED_RADIUS_M = 0.05  # m: radius assumed until it is known
MIN_WINDOWS, MIN_CORRELATION = 40, 0.95  # windows; correlation
EQUAL_CORRELATION = 1e-3  # correlations that differ by less are equal: on a circle all combinations of signs fit
MIN_TRACK_TURN_RAD = 0.5  # rad, root of the sum of squared turns, from which the track is estimated


class Geometry(NamedTuple):
    """Wheel radius and track with which the robot's odometry was computed."""

    radius: float  # m; if ticks_per_revolution is not configured, a tick counts as 1 rad: metres per tick
    track: float | None  # m; None if the robot hardly turned
    mirrored: Mirrored = "none"  # wheels that count backwards while the robot drives forward
    sigmas: tuple[float, float] = (0.0, 0.0)  # standard deviations of radius and track, by the residuals


def geometry_by_odometry(counters: Stream, odometry: Stream, settings: WheelSettings) -> Geometry | None:
    """Fit radius and track to wheel angles and the motion of an odometry; None if they do not agree."""
    try:
        return geometry_by_motion(counters, read_wheels(odometry, WheelSettings()), settings)
    except LocfuseError:
        return None


def geometry_by_motion(counters: Stream, theirs: WheelReading, settings: WheelSettings) -> Geometry | None:
    """Fit wheel radius and track to wheel angles and a body motion `theirs`.

    None if wheels and body motion disagree or overlap too little in time. Raises LocfuseError if the counters
    cannot be read.
    """
    known = msgspec.structs.replace(settings, ticks_per_revolution=settings.ticks_per_revolution or None)
    both = read_counters(counters, known)
    t, left, right = _angles(both, known)
    offset = (theirs.epoch_ns - both.zero_ns) * 1e-9
    begin, end = max(t[0], offset), min(t[-1], offset + theirs.wheels.t[-1])
    # only windows with readings: clocks may differ by years
    windows = np.unique(np.floor((t - begin) / ODOMETRY_WINDOW_S))
    start = begin + ODOMETRY_WINDOW_S * windows
    start = start[(windows >= 0.0) & (start < end - ODOMETRY_WINDOW_S)]
    if len(start) < MIN_WINDOWS:
        return None
    # as twists, since the wheels roll along the arc, not along its chord
    moved = se2.log(theirs.wheels.relative(start - offset, start - offset + ODOMETRY_WINDOW_S))
    rolled = [changes(start, ODOMETRY_WINDOW_S, t, side) for side in (left, right)]
    return _best(rolled[0], rolled[1], moved)


def _angles(both: Counters, settings: WheelSettings) -> tuple[Array, Array, Array]:
    """Return times (n,) [s] and the repaired angles of both wheels (n,) [rad]."""
    turn = 2.0 * np.pi / settings.ticks_per_revolution if settings.ticks_per_revolution else 1.0
    how = ASSUMED_RADIUS_M * turn, settings.rollover, None
    left, right = (repaired(side, *how) for side in (both.left, both.right))
    t = both.left.t[left.keep]
    at_left = np.interp(t, both.right.t[right.keep], right.rolled / ASSUMED_RADIUS_M)
    return t, left.rolled / ASSUMED_RADIUS_M, at_left


def _best(left: Array, right: Array, moved: Array) -> Geometry | None:
    """Fit the geometry with the wheel directions that agree best with the motion; None if even these disagree.

    The configured directions are kept if they agree equally well. Wheel angles left, right (n,) [rad]; body twists
    `moved` (n, 3).
    """
    means = {mirrored: 0.5 * (a * left + b * right) for mirrored, (a, b) in SIGNS.items()}
    agrees = {mirrored: _correlation(mean, moved[:, 0]) for mirrored, mean in means.items()}
    best = max(agrees, key=lambda mirrored: agrees[mirrored] + (EQUAL_CORRELATION if mirrored == "none" else 0.0))
    s_left, s_right = SIGNS[best]
    found = _fitted(means[best], s_right * right - s_left * left, moved)
    return None if found is None else found._replace(mirrored=best)


def _correlation(a: Array, b: Array) -> float:
    return float(np.corrcoef(a, b)[0, 1]) if np.std(a) > 0.0 and np.std(b) > 0.0 else -1.0


def _fitted(mean: Array, difference: Array, moved: Array) -> Geometry | None:
    ahead, turn = moved[:, 0], moved[:, 2]
    if _correlation(mean, ahead) < MIN_CORRELATION:
        return None
    radius = float((mean * ahead).sum() / (mean**2).sum())
    off = float(np.std(ahead - radius * mean) / np.sqrt((mean**2).sum()))
    turns = float(np.sqrt((turn**2).sum()))
    if turns < MIN_TRACK_TURN_RAD or float(np.corrcoef(difference, turn)[0, 1]) < MIN_CORRELATION:
        return Geometry(radius, None, sigmas=(off, 0.0))
    per_turn = float((difference**2).sum() / (difference * turn).sum())
    off_turn = float(np.std(difference - per_turn * turn) / turns)
    return Geometry(radius, radius * per_turn, sigmas=(off, float(np.hypot(radius * off_turn, per_turn * off))))
