"""Calibration of track, wheel ratio and wheel noise by a gyro, without truth or laser.

Over a window of length W a robot turns by

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

import msgspec
import numpy as np

from locfuse.fusion.chi_square import SIGMAS_95
from locfuse.fusion.data import Array, LocfuseError, changes, totals

from .calibrate import Figure
from .motion import Wheels

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
    noise, windows = _noise(drives, delays, (a, b), slides, white)
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


def _noise(
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
