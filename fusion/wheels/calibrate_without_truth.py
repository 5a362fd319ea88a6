"""Calibration of wheels without truth: with the laser's mount by matching scans, or by a gyro.

By scans: in an interval the robot moves by u according to its wheels, and the laser by s according to its scans.
With the laser mount l on the robot,

    s = (-)l (+) u (+) l

Intervals of different curvature determine wheel scales, track and mount (Censi, Franchi, Marchionni and Oriolo,
IEEE T-RO 2013). Their closed form gives the initial values: turns give the ratio of track and scale, and then the
problem is linear in (b, l_x, l_y, cos, sin) up to cos^2 + sin^2 = 1. From there all parameters, including the
laser's delay, are fitted by weighted least squares: with wheel noise along the path, the covariance of the
matches, and the scale of both by restricted likelihood (fusion.wheels.calibrate). The laser's distance scale
counts as correct.

By a gyro: over a window of length W a robot turns by

    turn = (1 + d/2) right / track - (1 - d/2) left / track + bias W

with the distances that the right and left wheel rolled, the relative difference d of the wheel scales, and the
gyro's bias. Non-overlapping windows are fitted by least squares. The mean wheel scale is not changed, since a gyro
measures no lengths. The residuals of windows of 0.1 to 10 s give the noise of the wheels at these time scales:
encoder noise in short windows, slip in long ones.

On a skid-steered robot the effective track is wider than the distance between the wheels. Each side slides, on
average by half the difference of both tracks times the turn. A gyro measures only the difference of both slides,
not each of them. So the slide of a wheel in a window is modelled as uniform between zero and twice the average,
with variance slide^2 / 3.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import msgspec
import numpy as np
from msgspec.structs import replace

from locfuse.fusion import se2
from locfuse.fusion.data import Array, LocfuseError, Mask, changes, spaced, totals
from locfuse.fusion.statistics import SIGMAS_95, chi_square

from .calibrate import CHI_SQUARE_MEDIANS, FROM_PARAMETERS, OUTLIER_CONFIDENCE, Figure, Residuals
from .motion import Wheels

NAMES = ("scale", "difference", "track", "x", "y", "yaw", "delay")
# steps of numerical derivatives; large for the delay, so that wheel noise does not matter
STEPS = np.array([1e-4, 1e-4, 1e-4, 1e-4, 1e-4, 1e-4, 0.15])
PRIOR = np.array([0.1, 0.1, 0.3, 0.5, 0.5, 1.0, 0.5])  # weak prior, 1 sigma: relative (3), m (2), rad, s
# parameters that only translations determine (scale and mount), and that only turns determine (track, x, y)
BY_TRANSLATION, BY_TURN = [0, 3, 4, 5], [2, 3, 4]
UNOBSERVED_SHARE = 0.3  # share of the prior's sigma from which a parameter counts as not determined
# motion of the laser, or time, after which an interval ends
INTERVAL_M, INTERVAL_RAD, INTERVAL_S = 0.4, np.radians(25.0), 3.0
MOVED_M, MOVED_RAD = 0.03, np.radians(1.5)  # intervals with less motion are not used
MIN_INTERVALS = 12
DELAYS_S = sorted(np.linspace(-1.0, 1.0, 41).tolist(), key=abs)  # tried for the first guess, the smallest first
NEAR_BASE = np.diag([0.0, 1e-3, 1e-3])  # weak prior on a laser at the middle of the base, for drives without turns
MIN_TURN_RATIO = 0.2  # least ratio of the laser's turns to the wheels' with which the track is initialised
MATCH_SCALES = (0.03, 0.1, 0.3, 1.0, 3.0, 10.0)  # factors tried on the covariance of the matches
# least standard deviations: matches have correlated errors of about 1 cm per radian of turn, and 0.4 % of the path
CORRELATED_SIGMAS = np.array([0.004, 0.002, 0.004, 0.015, 0.015, 0.005, 0.005])
FLOOR_COVARIANCE = np.diag([0.001**2, 0.001**2, np.radians(0.02) ** 2])  # m^2, rad^2: least covariance of a match
MAX_STEPS, MIN_STEP_SIGMAS = 10, 1e-2  # Gauss-Newton: largest number of steps; it stops after a smaller step
MAX_SCALE = 0.6  # largest relative change of a wheel's scale: with a larger one the unit is wrong


class ScanMotions(NamedTuple):
    """Motions of wheels and laser in one drive, on one clock."""

    wheels: Wheels  # the robot, as configured
    laser: Wheels  # the laser, by its scans, in the laser frame
    delay: float  # s to add to the laser's times


class LaserCalibration(msgspec.Struct, frozen=True):
    """Calibrated parameters in the order of NAMES (three relative, two in m, then rad and s)."""

    parameters: Array  # (7,)
    sigmas: Array  # (7,) NaN for parameters that the drives do not determine
    noise: float  # m: maximum-likelihood wheel noise per metre
    intervals: int
    outliers: int
    distance_m: float
    turned_rad: float

    def undetermined(self) -> list[str]:
        """Return the names of the parameters that the drives do not determine."""
        return [name for name, sigma in zip(NAMES, self.sigmas.tolist(), strict=True) if np.isnan(sigma)]


class Intervals(msgspec.Struct, frozen=True):
    """Intervals (n,) in which wheels and laser are compared, with the laser's motion in each."""

    motion: ScanMotions
    t_from: Array
    t_to: Array
    s: Array  # (n, 3) motion of the laser in its frame at the begin
    T: Array  # (n, 3, 3) covariance of s

    @classmethod
    def of(cls, motion: ScanMotions) -> Intervals:
        """Cut a drive into intervals of INTERVAL_M or INTERVAL_RAD; leave out intervals at rest."""
        t, pose = motion.laser.t, motion.laser.pose
        distance = totals(np.hypot(*np.diff(pose[:, :2], axis=0).T))
        turn = totals(np.abs(np.diff(pose[:, 2])))
        cuts = spaced((distance, INTERVAL_M), (turn, INTERVAL_RAD), (t, INTERVAL_S))
        a, b = cuts[:-1], cuts[1:]
        inside = (t[a] + motion.delay > motion.wheels.t[0]) & (t[b] + motion.delay < motion.wheels.t[-1])
        moved = se2.between(pose[a], pose[b])
        turned = np.abs(moved[:, 2]) > MOVED_RAD
        used = inside & ((np.hypot(moved[:, 0], moved[:, 1]) > MOVED_M) | turned)
        t_from, t_to = t[a[used]], t[b[used]]
        found = motion.laser.between(t_from, t_to)
        return cls(motion, t_from + motion.delay, t_to + motion.delay, found.u, found.Q)

    def predicted(self, p: Array) -> Array:
        """Return the laser's motions (n, 3) predicted by wheel odometry, for parameters p (7,)."""
        wheels = corrected(self.motion.wheels, p[:3])
        u = wheels.relative(self.t_from + p[6], self.t_to + p[6])
        mount = np.broadcast_to(p[3:6], u.shape)
        return se2.between(mount, se2.compose(u, mount))

    def derivative(self, p: Array) -> Array:
        """Return the derivative (n, 3, 7) of `predicted` by the parameters p, by central differences."""
        columns = []
        for k, h in enumerate(STEPS.tolist()):
            step = np.zeros(7)
            step[k] = h
            columns.append(se2.difference(self.predicted(p + step), self.predicted(p - step)) / (2.0 * h))
        return np.stack(columns, axis=-1)

    def wheel_noise(self, p: Array) -> Array:
        """Return covariances (n, 3, 3) of the motions `predicted` by parameters p (7,), for wheel noise of 1 m."""
        wheels = replace(corrected(self.motion.wheels, p[:3]), noise=1.0)
        found = wheels.between(self.t_from + p[6], self.t_to + p[6])
        x, y = se2.rotated(found.u[:, 2], np.broadcast_to(p[3:5], (len(found.u), 2))).T
        J = se2.rotation(np.array(-p[5])) @ se2.lever(-y, x)
        return se2.propagated(J, found.Q)

    def take(self, keep: Mask) -> Intervals:
        """Return the intervals selected by a mask (n,)."""
        return Intervals(self.motion, self.t_from[keep], self.t_to[keep], self.s[keep], self.T[keep])


def calibrate_by_scans(motions: Sequence[ScanMotions]) -> LaserCalibration:
    """Calibrate wheels, laser mount and laser delay from the drives of one robot.

    Raises LocfuseError if the drives are too short, or the motions of wheels and laser differ too much.
    """
    every = [Intervals.of(motion) for motion in motions]
    n = sum(len(one.t_from) for one in every)
    if n < MIN_INTERVALS:
        raise LocfuseError(
            f"{n} pieces of way are seen by wheels and laser; at least {MIN_INTERVALS} of {INTERVAL_M:g} m or "
            f"{np.degrees(INTERVAL_RAD):.0f} degrees are needed",
            role="calibrate",
        )
    first = first_guess(every)
    _refuse_another_unit(first)
    p, _, _ = _fitted(every, first, first)
    inside = [_inliers(one, p) for one in every]
    used = [one.take(keep) for one, keep in zip(every, inside, strict=True)]
    p, spread, scale = _fitted(used, p, first)
    sigmas = np.hypot(np.sqrt(np.diagonal(spread)), CORRELATED_SIGMAS)
    if _on_the_spot(_wheel_motions(used, float(p[6]))):  # mounts rotated about the axle give the same motions
        sigmas[BY_TRANSLATION] = np.inf
    s = np.concatenate([one.s for one in used])
    if _straight(s):  # measured turns are only noise
        sigmas[BY_TURN] = np.inf
    _refuse_another_unit(np.where(sigmas < UNOBSERVED_SHARE * PRIOR, p, 0.0))
    return LaserCalibration(
        parameters=p,
        sigmas=np.where(sigmas < UNOBSERVED_SHARE * PRIOR, sigmas, np.nan),
        noise=scale,
        intervals=len(s),
        outliers=n - len(s),
        distance_m=float(np.hypot(s[:, 0], s[:, 1]).sum()),
        turned_rad=float(np.abs(s[:, 2]).sum()),
    )


def _refuse_another_unit(p: Array) -> None:
    if np.abs(FROM_PARAMETERS @ p[:3]).max() > MAX_SCALE:
        raise LocfuseError(
            f"by the laser the robot goes {1.0 + p[0]:.3g} times as far as by the wheels, with a track "
            f"{1.0 + p[2]:.3g} times the configured one: another unit (wheels.radius, "
            "wheels.ticks_per_revolution), or wheels and laser of different drives",
            role="calibrate",
        )


def corrected(wheels: Wheels, p: Array) -> Wheels:
    """Return the wheels with mean scale, scale difference and track changed by p (3,), relative.

    For an odometry with sideways motion, the translation is scaled, and the turn changes as with wheels of its
    track.
    """
    left, right, track = (FROM_PARAMETERS @ p).tolist()
    if not wheels.twist[:, 1].any():
        sides = wheels.rolled * (1.0 + np.array([left, right]))
        ds, turn = 0.5 * sides.sum(axis=1), np.diff(sides, axis=1)[:, 0] / (wheels.track * (1.0 + track))
        twist = np.stack((ds, np.zeros_like(ds), turn), axis=-1)
    else:
        twist = wheels.twist * (1.0 + 0.5 * (left + right))
        twist[:, 2] /= 1.0 + track
        twist[:, 2] += (right - left) * wheels.twist[:, 0] / wheels.track
    return Wheels.from_twists(wheels.t, twist, wheels.track * (1.0 + track), wheels.noise)


def first_guess(every: Sequence[Intervals]) -> Array:
    """Return initial parameters (7,) in closed form: first the delay and the turns, then scale and mount.

    R(yaw) s = b u + (R(turn) - 1) l with the wheels' translation u and its scale b: linear in (b, l, cos, sin).
    """
    s = np.concatenate([one.s for one in every])

    def mismatch(delay: float) -> float:  # squares of the laser's turns that the wheels' turns do not explain
        turn = _wheel_motions(every, delay)[:, 2]
        rest = s[:, 2] - turn * (float(turn @ s[:, 2]) / max(float(turn @ turn), 1e-12))
        return float(rest @ rest)

    delay = min(DELAYS_S, key=mismatch)
    u = _wheel_motions(every, delay)
    if _on_the_spot(u):
        return np.append(np.zeros(6), delay)
    turns = float(u[:, 2] @ s[:, 2]) / max(float(u[:, 2] @ u[:, 2]), 1e-12)
    c, sn = np.cos(s[:, 2]) - 1.0, np.sin(s[:, 2])
    A = np.stack((np.stack((u[:, 0], c, -sn), axis=-1), np.stack((u[:, 1], sn, c), axis=-1)), axis=1)
    B = -np.stack((np.stack((s[:, 0], -s[:, 1]), axis=-1), np.stack((s[:, 1], s[:, 0]), axis=-1)), axis=1)
    A, B = A.reshape(-1, 3), B.reshape(-1, 2)
    solved = np.linalg.solve(A.T @ A + NEAR_BASE, A.T @ B)
    yaw = np.linalg.eigh(B.T @ B - (A.T @ B).T @ solved)[1][:, 0]  # its cos and sin, up to their sign
    b, x, y = -solved @ yaw
    yaw, x, y = (yaw, x, y) if b > 0.0 else (-yaw, -x, -y)
    has_turns = turns > MIN_TURN_RATIO and not _straight(s)
    track = abs(float(b)) / turns - 1.0 if has_turns else 0.0
    return np.array([abs(float(b)) - 1.0, 0.0, track, x, y, np.arctan2(yaw[1], yaw[0]), delay])


def _wheel_motions(every: Sequence[Intervals], delay: float) -> Array:
    """Return the robot's motions (n, 3) by the configured wheels, for a delay [s] of the laser's stamps."""
    return np.concatenate([one.motion.wheels.relative(one.t_from + delay, one.t_to + delay) for one in every])


def _on_the_spot(u: Array) -> bool:
    """Return whether the mean translation of motions u (n, 3) is below MOVED_M."""
    return bool(np.hypot(u[:, 0], u[:, 1]).mean() < MOVED_M)


def _straight(s: Array) -> bool:
    """Return whether the mean turn of motions s (n, 3) is below MOVED_RAD."""
    return bool(np.abs(s[:, 2]).mean() < MOVED_RAD)


def _residuals(every: Sequence[Intervals], p: Array) -> Residuals:
    """Return the least-squares problem linearised at parameters p (7,): errors, derivatives, covariances."""
    return Residuals(
        np.concatenate([se2.difference(one.s, one.predicted(p)) for one in every]),
        np.concatenate([one.derivative(p) for one in every]),
        np.concatenate([one.wheel_noise(p) for one in every]),
        np.concatenate([one.T for one in every]),
        PRIOR,
    )


def _scaled(residuals: Residuals, match: float) -> Residuals:
    """Return the problem with the covariance of the scan matches multiplied by `match`, plus FLOOR."""
    return replace(residuals, T=match * residuals.T + FLOOR_COVARIANCE)


def _noise(residuals: Residuals) -> tuple[float, float]:
    """Return the maximum-likelihood factor on the matches' covariance, and wheel noise [m]."""
    tried = [(_scaled(residuals, match).best(), match) for match in MATCH_SCALES]
    (noise, _), match = max(tried, key=lambda one: one[0][1])
    return match, noise


def _fitted(every: Sequence[Intervals], p: Array, guess: Array) -> tuple[Array, Array, float]:
    """Fit parameters from the start p (7,): return parameters, covariance (7, 7), and wheel noise [m].

    The prior keeps undetermined parameters near `guess` (7,).
    """
    for _ in range(2):  # the noise estimate needs good parameters
        match, noise = _noise(_residuals(every, p))
        for _ in range(MAX_STEPS):
            step, spread = _scaled(_residuals(every, p), match).parameters(noise)
            step = step - spread @ ((p - guess) / PRIOR**2)
            p = p + step
            if (np.abs(step) < MIN_STEP_SIGMAS * np.sqrt(np.diagonal(spread))).all():
                break
    return p, spread, noise


def _inliers(one: Intervals, p: Array) -> Mask:
    """Return a mask (n,) of the intervals without outliers: slips and wrong matches have large residuals."""
    residuals = _residuals([one], p)
    match, noise = _noise(residuals)
    squares = _scaled(residuals, match).squares(noise, np.zeros(7))
    squares = squares / (float(np.median(squares)) / CHI_SQUARE_MEDIANS[3])
    return np.asarray(squares <= chi_square(OUTLIER_CONFIDENCE, 3))


WINDOW_S = 2.0  # s: longer than clock delays, shorter than a drive
LAGS_S = np.arange(-1.2, 1.21, 0.02)  # tried delays of the gyro's clock
NOISE_WINDOWS_S = (0.1, 0.3, 1.0, 3.0, 10.0)
MIN_WINDOWS, MIN_MOVED_M, MIN_TURNED_RAD = 20, 0.02, math.radians(180.0)  # number, m per window, rad in total
MIN_EXPLAINED = 0.9  # least share of the turns that the wheels explain
SKID_RATIO = 1.25  # estimated over configured track from which the robot is skid-steered


class GyroCalibration(msgspec.Struct, frozen=True):
    """Wheel parameters by a gyro, relative to the configured ones (0: no change)."""

    parameters: Array  # (3,) mean scale (always 0), scale difference (right - left), track
    sigmas: Array  # (3,) NaN for the mean scale
    noise: dict[float, float]  # window [s] -> variance per metre rolled [m]
    k: Figure  # m: noise in the longest windows
    delay: float  # s to add to the gyro's stamps
    turned_rad: float
    windows: int
    slides: float  # m per radian of turn that a wheel slides; 0 if the robot is not skid-steered


def calibrate_by_gyro(
    drives: Sequence[tuple[Wheels, Array, Array]], scale_sigma: float, white: float
) -> GyroCalibration:
    """Fit track, wheel ratio and noise to wheels and to gyro turns (n,) [rad] at times (n,) [s], per drive.

    `scale_sigma` is the relative error of the gyro's rate, `white` its noise [rad / sqrt(s)]. All drives are of
    one robot. Raises LocfuseError if the robot turns too little, or the wheels do not explain the turns.
    """
    track = drives[0][0].track
    delays = [_delay(*drive) for drive in drives]
    rows = [_windows(*drive, delay, WINDOW_S) for drive, delay in zip(drives, delays, strict=True)]
    turned = sum(float(np.abs(own).sum()) for own, _ in rows)
    n = sum(len(own) for own, _ in rows)
    if n < MIN_WINDOWS or turned < MIN_TURNED_RAD:
        raise LocfuseError(
            f"the gyro turns by {math.degrees(turned):.0f} degrees in {n} windows of {WINDOW_S:g} s; at least "
            f"{math.degrees(MIN_TURNED_RAD):.0f} degrees in {MIN_WINDOWS} are needed",
            role="gyro",
        )
    x, covariance, explained = _fit(rows)
    a, b = float(x[0]), float(x[1])
    if explained < MIN_EXPLAINED or a <= 0.0 or b >= 0.0:
        raise LocfuseError(
            f"the wheels explain {max(explained, 0.0):.0%} of the gyro's turning: is its axis up, and are left "
            "and right as they are set?",
            role="gyro",
        )
    found, ratio = 2.0 / (a - b), a / -b
    of_track = float(np.sqrt(np.array([1.0, -1.0]) @ covariance @ np.array([1.0, -1.0]))) / (a - b)
    of_ratio = float(np.sqrt(np.array([1 / a, -1 / b]) @ covariance @ np.array([1 / a, -1 / b])))
    difference = 2.0 * (ratio - 1.0) / (ratio + 1.0)
    slides = 0.5 * (found - track) if found > SKID_RATIO * track else 0.0
    noise, windows = _window_noise(drives, delays, (a, b), slides, white)
    k, spread = list(noise.values())[-1], SIGMAS_95 * math.sqrt(2.0 / windows)
    return GyroCalibration(
        parameters=np.array([0.0, difference, found / track - 1.0]),
        sigmas=np.array([np.nan, of_ratio, found / track * math.hypot(of_track, scale_sigma)]),
        noise=noise,
        k=Figure(k, k * math.exp(-spread), k * math.exp(spread)),
        delay=float(np.mean(delays)),
        turned_rad=turned,
        windows=n,
        slides=slides,
    )


def _delay(wheels: Wheels, t: Array, own: Array) -> float:
    """Return the time [s] to add to the gyro's stamps with which the wheels explain the gyro's turns best."""
    explained = []
    for delay in LAGS_S.tolist():
        rows = _windows(wheels, t, own, delay, 0.5 * WINDOW_S)
        explained.append(_fit([rows])[2] if len(rows[0]) >= MIN_WINDOWS else -1.0)
    return float(LAGS_S[int(np.argmax(explained))])


def _windows(wheels: Wheels, t: Array, own: Array, delay: float, length: float) -> tuple[Array, Array]:
    """Return gyro turns (n,) [rad] and wheel data (n, 4), in windows of `length` [s] in which the robot moves.

    Wheel data: distance of right and left wheel [m], `length` [s], sum of both absolute distances [m]. `delay` [s]
    is added to the gyro's times t to convert them to the wheels' clock.
    """
    first, last = max(t[0], wheels.t[0] - delay), min(t[-1], wheels.t[-1] - delay)
    start = np.arange(first, last - length, length)
    turn = changes(start, length, t, own)
    steps = np.column_stack((wheels.rolled, np.abs(wheels.rolled).sum(axis=1)))
    left, right, driven = changes(start + delay, length, wheels.t, totals(steps)).T
    moves = np.maximum(np.abs(left), np.abs(right)) > MIN_MOVED_M * length / WINDOW_S
    return turn[moves], np.column_stack((right, left, np.full(len(start), length), driven))[moves]


def _fit(rows: Sequence[tuple[Array, Array]]) -> tuple[Array, Array, float]:
    """Fit gyro turns by wheel distances, with one gyro bias per drive.

    Returns turn per metre of right and left wheel (2,) [rad/m], covariance (2, 2), explained share of the turns.
    """
    own, columns = (np.concatenate(parts) for parts in zip(*rows, strict=True))
    drive = np.repeat(np.arange(len(rows)), [len(turn) for turn, _ in rows])
    by = np.column_stack((columns[:, :2], columns[:, 2:3] * (drive[:, None] == np.arange(len(rows)))))
    x = np.linalg.lstsq(by, own, rcond=None)[0]
    rest = own - by @ x
    freedom = max(len(own) - by.shape[1], 1)
    covariance = np.linalg.pinv(by.T @ by)[:2, :2] * float(rest @ rest) / freedom
    return x[:2], covariance, 1.0 - float(rest @ rest) / max(float(own @ own), 1e-12)


def _window_noise(
    drives: Sequence[tuple[Wheels, Array, Array]],
    delays: Sequence[float],
    by: tuple[float, float],
    slides: float,
    white: float,
) -> tuple[dict[float, float], int]:
    """Return the wheel noise for each window length, {s: m}, and the number of longest windows.

    The noise is the variance per metre that one wheel rolls [m^2/m], minus the gyro's noise. `by` is the turn per
    metre of the right and the left wheel [rad/m].
    """
    found: dict[float, float] = {}
    track = 2.0 / (by[0] - by[1])
    windows = 2
    for length in NOISE_WINDOWS_S:
        squares, slid, metres, n = 0.0, 0.0, 0.0, 0
        for drive, delay in zip(drives, delays, strict=True):
            turn, columns = _windows(*drive, delay, length)
            if len(turn) < 2:
                continue
            rest = turn - columns[:, :2] @ np.array(by)
            rest -= rest.mean()  # the gyro's bias
            squares += float((rest**2).sum()) - white**2 * length * len(turn)
            slid += 2.0 / 3.0 * slides**2 * float((turn**2).sum())  # of both wheels
            metres += float(columns[:, 3].sum())
            n += len(turn)
        if n >= MIN_WINDOWS // 2 and metres > 0.0:
            found[length], windows = (max(squares, 0.0) * track**2 + slid) / metres, n
    return found, windows
