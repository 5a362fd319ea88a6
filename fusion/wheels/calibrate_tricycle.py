"""Calibration of a tricycle's size and steering from encoders and truth, laser or gyro: nonlinear least squares.

First the motions of the reference in short windows are fitted, starting from several steering gains, since a wrong
gain leads to local minima. A truth does not drift, so then the whole path and its start are fitted. With a laser,
its mount and delay are estimated too. A gyro measures turns only, so the wheel radius is not changed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, Literal, NamedTuple

import msgspec
import numpy as np

from locfuse.fusion import se2
from locfuse.fusion.data import Array, Ints, LocfuseError, Truth, interpolate, stretches, totals
from locfuse.fusion.robot import WheelSettings
from locfuse.fusion.statistics import SIGMAS_95
from locfuse.fusion.streams import MergedStream

from .calibrate import ASSUMED_RADIUS_M, Figure
from .motion import dead_reckoning
from .steered import Encoders, read_encoders, rolled_by

By = Literal["truth", "lrf", "gyro"]
# indices of the parameters: scale of the radius, gain [rad per tick], zero [rad], wheelbase [m]; pose of the
# tracked point on the body; delay [s] of the reference; gyro bias [rad/s]; poses of the path's start, by its parts
SCALE, GAIN, ZERO, BASE, POINT, DELAY, BIAS, BEGIN = 0, 1, 2, 3, slice(4, 7), 7, 8, 9
FREE: dict[By, list[int]] = {
    "truth": [*range(7)],
    "lrf": [*range(7), DELAY],
    "gyro": [GAIN, ZERO, BASE, DELAY, BIAS],
}
WINDOW_S = 1.0  # s, windows of the first fit
GAIN_FACTORS = (1.0, 0.3, 3.0, 8.0, -1.0)  # start values of the steering gain, relative to the configured one
OUTLIER_M = 0.05  # m, rad: larger residuals are down-weighted (jumps of a tracker, wrong matches)
# least residual of a window across a break of the path: m, and times the usual residual (truth that jumps, counter
# that stands still)
MIN_BREAK_M, MIN_BREAK_SHARE = 0.3, 8.0
MAX_BROKEN_SHARE = 0.5  # of the residual of the whole path, in parts: else the path is not broken
MIN_ROWS, MAX_ROWS = 50, 3000  # readings of the reference; number of windows
MIN_TURN_RAD = math.radians(180.0)  # least total turn
ASSUMED_TICKS = 1000.0  # per revolution, if not configured: only radius over ticks is observable
MAX_SPEED_RATIO = 3.0  # largest ratio of the speeds of the wheel and of the tracked point


class ReferenceMotion(NamedTuple):
    """Reference motion with which the encoders are compared, on its own clock.

    Poses of a tracked point or of the laser; only headings if it is from a gyro.
    """

    by: By
    t: Array  # (n,) s
    pose: Array  # (n, 3) of the tracked point or the laser; for a gyro only the heading is used


class TricycleCalibration(msgspec.Struct, frozen=True):
    """Calibrated tricycle parameters with 95 % intervals, by keys of robot.toml."""

    wheels: dict[str, Figure]  # radius, servo_gain, servo_offset, wheelbase
    by: By
    mount: dict[str, Figure]  # x, y of the truth's point; x, y, yaw_deg, time_offset of a laser
    rms: float  # residual of the path [m], of a laser's windows [m], or of a gyro's turns [rad]
    breaks: tuple[tuple[float, float], ...] = ()  # s, left out: times in which encoders and truth disagree

    @property
    def left_out(self) -> str:
        """Text on the times left out; "" without any."""
        when = " and ".join(f"from {a:.1f} s to {b:.1f} s" for a, b in self.breaks)
        return f" without the time {when}, in which the encoders and the truth differ" if when else ""


def of_truth(truth: Truth) -> ReferenceMotion:
    """Return a ground truth as reference. Raises LocfuseError if the truth has no heading."""
    if truth.theta is None:
        raise LocfuseError("a steered tricycle needs a truth with heading", role="calibrate")
    return ReferenceMotion("truth", truth.t, np.column_stack((truth.xy, truth.theta)))


def calibrate_tricycle(
    found: Encoders, settings: WheelSettings, reference: ReferenceMotion, shift: float
) -> TricycleCalibration:
    """Fit size and steering to the reference; `shift` [s] converts the encoders' times to its clock.

    Raises LocfuseError if the reference has too few readings, or turns too little.
    """
    from scipy.optimize import least_squares

    t = found.t + shift
    inside = (reference.t >= t[0]) & (reference.t <= t[-1])
    stamps, pose, by = reference.t[inside], reference.pose[inside], reference.by
    if len(stamps) < MIN_ROWS or np.abs(np.diff(np.unwrap(pose[:, 2]))).sum() < MIN_TURN_RAD:
        raise LocfuseError(f"{by}: too few readings beside the encoders, or hardly a turn", role="calibrate")
    later = np.searchsorted(stamps, stamps + WINDOW_S)
    first = np.flatnonzero(later < len(stamps))[:: max(1, len(stamps) // MAX_ROWS)]
    moved, spans = se2.between(pose[first], pose[later[first]]), stamps[later[first]] - stamps[first]

    def point(p: Array) -> Array:
        """Return the poses (k, 3) of tracked point or laser by the encoders, in the robot's start frame.

        p are the tricycle's parameters.
        """
        ds = np.diff(found.rolled) * p[SCALE]
        angle = (found.steering - settings.servo_offset) * p[GAIN] + p[ZERO]
        path = dead_reckoning(rolled_by(ds, angle, p[BASE]))
        body = interpolate(stamps + p[DELAY], t, path)
        return se2.compose(body, np.broadcast_to(p[POINT], body.shape))

    def of_windows(p: Array) -> Array:
        at = point(p)
        e = se2.difference(se2.between(at[first], at[later[first]]), moved)
        return np.asarray(e[:, 2] + p[BIAS] * spans if by == "gyro" else e.ravel())

    def of_path(p: Array, part: Ints) -> Array:
        known = part >= 0
        begin = p[BEGIN:].reshape(-1, 3)[part[known]]
        return se2.difference(se2.compose(begin, point(p)[known]), pose[known]).ravel()

    def whole(p: Array, part: Ints) -> tuple[float, Array, Any]:
        """Return the residual (rms) [m] of the path fitted in parts, with the parameters and the solution."""
        first_of = [int(np.argmax(part == k)) for k in range(int(part.max()) + 1)]
        begin = se2.compose(pose[first_of], se2.inverse(point(p)[first_of]))
        free = [*FREE[by], *range(BEGIN, BEGIN + begin.size)]
        p, solved = fit(partial(of_path, part=part), np.append(p, begin), free, 100)
        return _rms(of_path(p, part).reshape(-1, 3)[:, :2]), p, solved

    def fit(residual: Callable[[Array], Array], start: Array, free: list[int], steps: int) -> tuple[Array, Any]:
        def put(x: Array) -> Array:
            p = start.copy()
            p[free] = x
            return p

        how = {"loss": "soft_l1", "f_scale": OUTLIER_M, "x_scale": "jac", "max_nfev": steps}
        solved = least_squares(lambda x: residual(put(x)), start[free], **how)
        return put(solved.x), solved

    fits = [fit(of_windows, start, FREE[by], 40) for start in _starts(settings)]
    # a tricycle that drives backwards with the wheel turned by 180 degrees has the same path: prefer a mount that
    # points forward
    best, solved = min(fits, key=lambda one: (np.cos(one[0][POINT][2]) < 0.0, float(one[1].cost)))
    rest, part = of_windows(best).reshape(len(first), -1), np.zeros(len(stamps), dtype=np.intp)
    rms = _rms(rest[:, : 1 if by == "gyro" else 2])
    if by == "truth":
        in_parts = _parts(first, later[first], rest, len(stamps))
        rms, *fitted = whole(best, part)
        if (in_parts < 0).any() and (broken := whole(best, in_parts))[0] < MAX_BROKEN_SHARE * rms:
            (rms, *fitted), part = broken, in_parts
        best, solved = fitted
    free = [*FREE[by], *range(BEGIN, len(best))]
    # residuals of neighbours are correlated, so only as many degrees of freedom as free parameters count
    sigmas = np.zeros(len(best))
    inverse = np.linalg.pinv(solved.jac.T @ solved.jac)
    sigmas[free] = np.sqrt(np.diag(inverse) * 2.0 * float(solved.cost) / len(free))
    breaks = tuple((float(stamps[a]), float(stamps[b])) for a, b in stretches(part < 0))
    return TricycleCalibration(_wheels(best, sigmas, settings), by, _mount(by, best, sigmas), rms, breaks)


def _rms(rest: Array) -> float:
    return float(np.sqrt((rest**2).sum(axis=1).mean()))


def _parts(first: Ints, last: Ints, rest: Array, n: int) -> Ints:
    """Return the parts of the path between breaks, 0, 1 ..., for n readings; -1 in a break and in a short part.

    `rest` (m, 3) are the residuals of windows from readings `first` to `last` (m,).
    """
    off = np.hypot(rest[:, 0], rest[:, 1])
    broken = np.zeros(n, dtype=bool)
    for k in np.flatnonzero(off > max(MIN_BREAK_M, MIN_BREAK_SHARE * float(np.median(off)))):
        broken[first[k] : last[k] + 1] = True
    whole = [(a, b) for a, b in stretches(~broken) if b - a >= MIN_ROWS]
    part = np.full(n, -1, dtype=np.intp)
    for i, (a, b) in enumerate(whole or [(0, n - 1)]):
        part[a : b + 1] = i
    return part


def nominal(
    stream: MergedStream, settings: WheelSettings, reference: ReferenceMotion, shift: float
) -> WheelSettings:
    """Return initial settings from which `calibrate_tricycle` converges; only missing values are guessed.

    The path length of the reference gives the radius. The middle of the steering values is the zero, and their
    range counts as one radian for the gain. `shift` [s] converts the encoders' times to the reference's clock.
    """
    rows = np.unique(np.searchsorted(reference.t, np.arange(reference.t[0], reference.t[-1], WINDOW_S)))
    distances = np.hypot(*np.diff(reference.pose[rows, :2], axis=0).T)
    fastest = math.ceil(MAX_SPEED_RATIO * float((distances / np.diff(reference.t[rows])).max()))
    assumed = msgspec.structs.replace(
        settings,
        ticks_per_revolution=settings.ticks_per_revolution or ASSUMED_TICKS,
        radius=ASSUMED_RADIUS_M,
        max_speed=math.inf,  # of a wheel of unknown size
    )
    found = read_encoders(stream, assumed)
    counted = totals(np.abs(np.diff(found.rolled)))
    rolled = np.ptp(np.interp(reference.t, found.t + shift, counted))
    low, middle, high = np.percentile(found.steering, (5.0, 50.0, 95.0)).tolist()
    return msgspec.structs.replace(
        assumed,
        radius=settings.radius or ASSUMED_RADIUS_M * float(distances.sum() / rolled),
        max_speed=settings.max_speed or float(fastest),
        servo_gain=settings.servo_gain or high - low,
        servo_offset=settings.servo_offset or middle,
        wheelbase=settings.wheelbase or 1.0,
    )


def _starts(settings: WheelSettings) -> list[Array]:
    starts = np.zeros((len(GAIN_FACTORS), BEGIN))
    starts[:, SCALE], starts[:, BASE] = 1.0, settings.wheelbase or 1.0
    starts[:, GAIN] = np.array(GAIN_FACTORS) / (settings.servo_gain or 1.0)
    return [*starts]


def _figure(value: float, sigma: float) -> Figure:
    return Figure(value, value - SIGMAS_95 * abs(sigma), value + SIGMAS_95 * abs(sigma))


def _wheels(p: Array, sigmas: Array, settings: WheelSettings) -> dict[str, Figure]:
    """Return the fitted wheel parameters with intervals, by their keys in [wheels]."""
    scale, gain, offset, base = p[:4].tolist()
    radius, zero = settings.radius or 0.0, settings.servo_offset - offset / gain
    values: Sequence[tuple[str, float, float]] = (
        ("radius", radius * scale, radius * sigmas[SCALE]),
        ("servo_gain", 1.0 / gain, sigmas[GAIN] / gain**2),
        ("servo_offset", zero, math.hypot(sigmas[ZERO] / gain, offset * sigmas[GAIN] / gain**2)),
        ("wheelbase", base, sigmas[BASE]),
    )
    return {key: _figure(value, float(sigma)) for key, value, sigma in values if sigma}


def _mount(by: By, p: Array, sigmas: Array) -> dict[str, Figure]:
    """Return the fitted mount of tracked point or laser, and the laser's delay, with intervals, by their keys."""
    found = {"x": (4, 1.0), "y": (5, 1.0), "yaw_deg": (6, math.degrees(1.0)), "time_offset": (DELAY, 1.0)}
    keys = {"truth": ("x", "y"), "lrf": (*found,), "gyro": ()}[by]
    fitted = ((key, *found[key]) for key in keys)
    return {key: _figure(float(p[i]) * unit, float(sigmas[i]) * unit) for key, i, unit in fitted}
