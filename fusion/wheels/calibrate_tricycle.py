"""A tricycle's size, steering and tracked point from encoders and truth: nonlinear least squares.

First what the truth moves in short windows is fitted, from several steering gains, since a gain that is far off
has local minima; then the whole path, with its start.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import msgspec
import numpy as np

from locfuse.fusion import se2
from locfuse.fusion.data import Array, LocfuseError, Truth
from locfuse.fusion.robot import WheelSettings

from .likelihood import Figure
from .motion import dead_reckoning
from .tricycle import Encoders, rolled_by

WINDOW_S = 1.0  # s of truth that is compared at first
GAIN_FACTORS = (1.0, 0.3, 3.0, 8.0, -1.0)  # of the steering gain that was set
OUTLIER_M = 0.05  # residuals beyond count less: the tracker jumps
MIN_ROWS = 50  # readings of the truth
SIGMAS_95 = 1.96


class TricycleCalibration(msgspec.Struct, frozen=True):
    """What a drive with truth says of a tricycle: values with their 95 % intervals by the keys of robot.toml."""

    wheels: dict[str, Figure]  # radius, servo_gain, servo_offset, wheelbase
    truth: dict[str, Figure]  # x, y: the tracked point on the base
    rms_m: float  # that the whole path leaves over


def calibrate_tricycle(
    found: Encoders, settings: WheelSettings, truth: Truth, shift: float
) -> TricycleCalibration:
    """Fit ten parameters to the truth; `shift` [s] is added to the encoders' times to be the truth's.

    Raises LocfuseError where the truth has no heading or too few readings.
    """
    from scipy.optimize import least_squares

    t = found.t + shift
    inside = (truth.t >= t[0]) & (truth.t <= t[-1])
    if truth.theta is None or inside.sum() < MIN_ROWS:
        raise LocfuseError("a steered tricycle needs a truth with heading", role="calibrate")
    stamps = truth.t[inside]
    pose = np.column_stack((truth.xy[inside], truth.theta[inside]))
    later = np.searchsorted(stamps, stamps + WINDOW_S)
    first = np.flatnonzero(later < len(stamps))
    moved = se2.between(pose[first], pose[later[first]])

    def point(p: Array) -> Array:
        """Poses (k, 3) of the tracked point, seen from the start of the body."""
        ds = np.diff(found.rolled) * p[0]
        angle = (found.steering - settings.servo_offset) * p[1] + p[2]
        way = dead_reckoning(rolled_by(ds, angle, p[3]))
        body = np.stack([np.interp(stamps, t, column) for column in way.T], axis=-1)
        return se2.compose(body, np.broadcast_to(p[4:7], body.shape))

    def of_windows(p: Array) -> Array:
        at = point(p)
        return _residual(se2.between(at[first], at[later[first]]), moved)

    def of_path(p: Array) -> Array:
        at = point(p)
        return _residual(se2.compose(np.broadcast_to(p[7:10], at.shape), at), pose)

    gain, base = 1.0 / (settings.servo_gain or 1.0), settings.wheelbase or 1.0
    how = {"loss": "soft_l1", "f_scale": OUTLIER_M, "x_scale": "jac"}
    starts = [np.array([1.0, gain * factor, 0.0, base, 0.0, 0.0, 0.0]) for factor in GAIN_FACTORS]
    fits = [least_squares(of_windows, start, max_nfev=40, **how) for start in starts]
    # driven backwards with the wheel turned by half a turn the same path fits: then the point looks backwards
    best = min(fits, key=lambda fit: (np.cos(fit.x[6]) < 0.0, float(fit.cost))).x
    begin = se2.compose(pose[:1], se2.inverse(point(best)[:1]))[0]
    whole = least_squares(of_path, np.concatenate((best, begin)), max_nfev=100, **how)
    rest = of_path(whole.x).reshape(-1, 3)[:, :2]
    # neighbours on a path share their errors: as many residuals count as parameters could bend
    variance = 2.0 * float(whole.cost) / len(whole.x)
    sigmas = np.sqrt(np.diag(np.linalg.pinv(whole.jac.T @ whole.jac)) * variance)
    return TricycleCalibration(*_figures(whole.x, sigmas, settings), rms_m=float(np.sqrt((rest**2).sum(1).mean())))


def _residual(a: Array, b: Array) -> Array:
    e = a - b
    e[:, 2] = se2.wrap_all(e[:, 2])
    return e.ravel()


def _figures(p: Array, sigmas: Array, settings: WheelSettings) -> tuple[dict[str, Figure], dict[str, Figure]]:
    """Return what the parameters mean by the keys of [wheels] and [truth]."""
    scale, gain, offset, base = p[:4].tolist()
    zero = settings.servo_offset - offset / gain
    values: Sequence[tuple[str, float, float]] = (
        ("radius", (settings.radius or 0.0) * scale, (settings.radius or 0.0) * sigmas[0]),
        ("servo_gain", 1.0 / gain, sigmas[1] / gain**2),
        ("servo_offset", zero, math.hypot(sigmas[2] / gain, offset * sigmas[1] / gain**2)),
        ("wheelbase", base, sigmas[3]),
    )
    wheels = {key: Figure(v, v - SIGMAS_95 * abs(s), v + SIGMAS_95 * abs(s)) for key, v, s in values}
    tracked = zip(("x", "y"), p[4:6].tolist(), sigmas[4:6].tolist(), strict=True)
    return wheels, {key: Figure(v, v - SIGMAS_95 * s, v + SIGMAS_95 * s) for key, v, s in tracked}
