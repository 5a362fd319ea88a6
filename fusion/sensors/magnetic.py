"""The earth's magnetic field at the robot: levelled by an IMU, and freed from iron of the robot.

In most places the field is inclined by 60 degrees and more: a degree of roll turns a heading by two degrees. The
vertical direction comes from the IMU's orientation if it has one, else from gravity and turning rates by a
complementary filter (Mahony, Hamel and Pflimlin 2008, without its integral term):

    u' = -w x u + (a / |a| - u) / T,    T = 5 s

with the up direction u in the IMU's axes, the rates w minus their median, and the accelerations a. If u changes by
less than 3 degrees, the field is not rotated.

In a uniform field the two axes trace a circle about zero. Magnets on the robot move its centre (hard iron), steel
makes it an ellipse (soft iron). The fit to the readings of one full turn finds the centre c and the symmetric
matrix A with |A (m - c)| = 1. A rotation of the axes is not observable; it is part of the compass offset.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import msgspec
import numpy as np

from locfuse.fusion.data import Array, Block, Column, Ints, LocfuseError, Stream, interpolate
from locfuse.fusion.se2 import rotated_3d, wrap_all
from locfuse.fusion.statistics import robust_sigma
from locfuse.fusion.streams import arrays

IMU = "sensor_msgs/msg/Imu"
FIELD = "sensor_msgs/msg/MagneticField"
AXES = "xyz"
ORIENTATION = tuple(f"orientation.{a}" for a in "xyzw")
RATES = tuple(f"angular_velocity.{a}" for a in AXES)
ACCELERATIONS = tuple(f"linear_acceleration.{a}" for a in AXES)
READS = (*ORIENTATION, "orientation_covariance", *RATES, "angular_velocity_covariance", *ACCELERATIONS)
MIN_TILT_RAD = math.radians(3.0)  # a robot tilts if 5 % of the readings are tilted by more than this
MAX_APART_RAD = math.radians(25.0)  # between measured and configured up: with more the mount is wrong
SETTLING_S = 5.0  # T above: an acceleration of the robot that lasts a second has a fifth of its full effect
STEP_S = 0.02  # readings are averaged over this time
MAX_GRAVITY_DEVIATION = 0.1  # largest relative difference of gravity from the usual acceleration
MIN_UP_CHANGE = 1e-9  # an orientation is constant if its up direction changes by less
MAX_STEP_S = 0.5  # longest step over which rates are integrated: after a longer gap the filter restarts


class Tilt(NamedTuple):
    """Vertical direction over time, in the base frame."""

    t_ns: Ints  # (n,)
    up: Array  # (n, 3) unit vectors in the base's axes
    words: str  # how it was measured (orientation or gravity), and the topic


class LevelledField:
    """A magnetometer's stream with the vertical direction `up` (n, 3) for each reading."""

    def __init__(self, stream: Stream, tilt: Tilt) -> None:
        self.topic, self.msgtype, self.frame_id = stream.topic, stream.msgtype, stream.frame_id
        self.t_ns, self.dropped = stream.t_ns, stream.dropped
        self._stream = stream
        zero = self.t_ns[0] if len(self.t_ns) else 0
        t, at = (self.t_ns - zero) * 1e-9, (tilt.t_ns - zero) * 1e-9
        up = interpolate(t, at, tilt.up)
        self.up: Array = up / np.linalg.norm(up, axis=1, keepdims=True)  # (n, 3) in the base's axes
        degrees = math.degrees(float(np.quantile(_angles_to(self.up, np.array([0.0, 0.0, 1.0])), 0.95)))
        self.note = f"the robot tilts by up to {degrees:.0f}° by {tilt.words}: the field is levelled by that"

    def columns(self, *fields: str) -> dict[str, Column]:
        """Return columns of the magnetometer's stream, by field name."""
        return self._stream.columns(*fields)

    def blocks(self, *fields: str, rows: int = 256) -> Iterator[Block]:
        """Yield the magnetometer's readings in blocks."""
        yield from self._stream.blocks(*fields, rows=rows)


def tilt_of(stream: Stream, R: Array) -> Tilt | None:
    """Return the vertical direction in the base frame over time, by an IMU; None if the robot hardly tilts.

    R (3, 3) is the rotation from IMU axes to base axes. Also None if the IMU has neither an orientation nor
    accelerations and rates, or if up contradicts the configured mount (`locfuse info` reports that).
    """
    columns = arrays(stream, *READS)
    up, words = by_orientation(columns), "the orientation"
    if up is None:
        up, words = by_gravity(stream.t_ns, columns), "gravity and turning rates"
    if up is None:
        return None
    good = np.isfinite(up).all(axis=1)
    t_ns, up = stream.t_ns[good], up[good] @ R.T
    if not len(t_ns):
        return None
    middle = np.median(up, axis=0)
    if middle[2] < 0.0:  # the axes are north, east, down, or gravity has the opposite sign
        up, middle = -up, -middle
    vertical = np.array([0.0, 0.0, 1.0])
    size = float(np.linalg.norm(middle))
    if size < 0.5 or _angles_to(middle[None] / size, vertical)[0] > MAX_APART_RAD:
        return None
    moves = float(np.quantile(_angles_to(up, middle / size), 0.95))
    return Tilt(t_ns, up, f"{words} of {stream.topic}") if moves > MIN_TILT_RAD else None


def levelled(m: Array, up: Array) -> tuple[Array, Array]:
    """Return the horizontal components (n,), forward and left, of fields (n, 3) given in the base frame.

    Forward is the base's x axis, projected onto the horizontal plane. So the heading is the yaw, for any roll and
    pitch.
    """
    ahead = np.array([1.0, 0.0, 0.0]) - up[:, :1] * up
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    left = np.cross(up, ahead)
    return (m * ahead).sum(axis=1), (m * left).sum(axis=1)


def by_orientation(columns: dict[str, Array]) -> Array | None:
    """Return up directions (n, 3) in the IMU frame by its orientation; None if it is missing or constant."""
    q = np.stack([columns[name] for name in ORIENTATION], axis=-1).astype(np.float64)
    none = (columns["orientation_covariance"][:, 0] == -1.0) | ~((q**2).sum(axis=1) >= 0.25)
    if none.all():
        return None
    up = rotated_3d(q * np.array([-1.0, -1.0, -1.0, 1.0]), np.array([0.0, 0.0, 1.0]))
    up[none] = np.nan
    return up if float(np.nanmax(np.nanmax(up, axis=0) - np.nanmin(up, axis=0))) > MIN_UP_CHANGE else None


def by_gravity(t_ns: Ints, columns: dict[str, Array]) -> Array | None:
    """Return up (n, 3) in the IMU frame from accelerations and turning rates; None if either is missing."""
    vectors = ([columns[name] for name in names] for names in (ACCELERATIONS, RATES))
    a, w = (np.stack(axes, axis=-1).astype(np.float64) for axes in vectors)
    good = np.isfinite(a).all(axis=1) & np.isfinite(w).all(axis=1)
    if not good.any() or (columns["angular_velocity_covariance"][good, 0] == -1.0).all() or not w[good].any():
        return None
    strength = np.linalg.norm(a[good], axis=1)
    usual = float(np.median(strength))
    if usual <= 0.0:
        return None
    t = (t_ns[good] - t_ns[0]) * 1e-9
    first = np.flatnonzero(np.diff(np.floor(t / STEP_S), prepend=-1.0))
    n = np.diff(np.append(first, len(t)))
    ts, a, w = t[first], np.add.reduceat(a[good], first) / n[:, None], np.add.reduceat(w[good], first) / n[:, None]
    up, bias = np.median(a, axis=0), np.median(w, axis=0)  # the bias of the rates about horizontal axes
    up /= max(float(np.linalg.norm(up)), 1e-9)
    found = _complementary(ts, a, w - (bias - (bias @ up) * up), usual)
    out = np.full((len(t_ns), 3), np.nan)
    out[good] = interpolate(t, ts, found)
    return out


def _complementary(t: Array, a: Array, w: Array, usual: float) -> Array:
    """Return up (n, 3) by a complementary filter; accelerations far from gravity's strength are not used."""
    x, y, z = (float(v) for v in np.median(a[t < t[0] + MAX_STEP_S], axis=0) / usual)
    found = []
    before = float(t[0])
    for now, (ax, ay, az), (wx, wy, wz) in zip(t.tolist(), a.tolist(), w.tolist(), strict=True):
        dt = now - before
        before = now
        size = math.sqrt(ax * ax + ay * ay + az * az)
        is_gravity = abs(size / usual - 1.0) < MAX_GRAVITY_DEVIATION
        if dt > MAX_STEP_S and is_gravity:
            x, y, z = ax, ay, az
        else:
            x, y, z = x - (wy * z - wz * y) * dt, y - (wz * x - wx * z) * dt, z - (wx * y - wy * x) * dt
            if is_gravity:
                share = dt / (SETTLING_S + dt)
                x, y, z = x + share * (ax / size - x), y + share * (ay / size - y), z + share * (az / size - z)
        length = math.sqrt(x * x + y * y + z * z) or 1.0
        x, y, z = x / length, y / length, z / length
        found.append((x, y, z))
    return np.array(found)


def _angles_to(up: Array, middle: Array) -> Array:
    """Return the angles (n,) [rad] between unit vectors (n, 3) and one unit vector (3,)."""
    return np.asarray(np.arctan2(np.linalg.norm(np.cross(up, middle), axis=1), up @ middle))


MIN_READINGS = 50  # readings
MAX_MISSING_ARC_RAD = math.radians(60.0)  # largest part of the circle that may be missing
MAX_FIT_ROUNDS = 100
MAX_STRENGTH_RATIO = 10.0  # times the median strength: neither iron nor the earth causes a stronger field
NO_ELLIPSE = "the field readings lie on no ellipse: turn the robot once on the spot while recording"
TUKEY_SIGMAS = 4.685  # of the scatter: readings further off do not count (95 % efficient for Gaussian noise)
MAX_ELLIPSE_SCATTER = 0.2  # relative scatter above which the readings lie on no ellipse


class Iron(msgspec.Struct, frozen=True):
    """Calibration of a magnetometer: the heading is the direction of soft (m - hard) for a field reading m."""

    hard: Array  # (2,) in the unit of the message
    soft: Array  # (2, 2) symmetric, determinant 1
    hard_sigma: Array  # (2,)
    soft_sigma: Array  # (2, 2)
    strength: float  # of the field, in the unit of the message
    scatter: float  # relative, of the strength: robust
    error_before_deg: float  # rms heading error over a full turn without calibration, minus its mean
    gap_deg: float  # largest part of the circle without a reading
    readings: int


def fit_iron(field: Array) -> Iron:
    """Fit an ellipse to field readings (n, 2). Raises LocfuseError if they cover too little of a turn."""
    field = field[plausible(field)]
    if len(field) < MIN_READINGS:
        raise LocfuseError(f"{len(field)} field readings; at least {MIN_READINGS} are needed", role="compass")
    unit = float(np.abs(field - field.mean(axis=0)).max()) or 1.0
    c, A = _start(field / unit)
    weights = np.ones(len(field))
    for _ in range(MAX_FIT_ROUNDS):
        step, e, spread = _gauss_newton(field / unit, c, A, weights)
        c, A = c + step[:2], A + np.array([[step[2], step[3]], [step[3], step[4]]])
        if not float(np.linalg.det(A)) > 0.0:  # NaN too: a short arc has been fitted with a line
            raise LocfuseError(NO_ELLIPSE, role="compass")
        scatter = robust_sigma(e)
        weights = np.clip(1.0 - (e / (TUKEY_SIGMAS * max(scatter, 1e-9))) ** 2, 0.0, None) ** 2
        if np.abs(step).max() < 1e-12:
            break
    return _judged(field, unit, c, A, scatter, spread * scatter**2)


def plausible(field: Array) -> Array:
    """Return which field readings (n, d) are finite and at most MAX_STRENGTH_RATIO times the median strength."""
    with np.errstate(over="ignore", invalid="ignore"):
        strength = np.linalg.norm(field, axis=1)
    finite = np.isfinite(strength)
    usual = float(np.median(strength[finite])) if finite.any() else 0.0
    return np.asarray(finite & (strength <= MAX_STRENGTH_RATIO * usual))


def _start(m: Array) -> tuple[Array, Array]:
    """Return a first guess of centre (2,) and shape (2, 2) of the ellipse, by linear least squares.

    The fitted equation is a x^2 + b x y + d y^2 + e x + f y = 1, with x, y relative to the mean.
    """
    mean = m.mean(axis=0)
    x, y = (m - mean).T
    if min(np.ptp(x), np.ptp(y)) < 1e-6:
        raise LocfuseError(
            "the field reading does not change: turn the robot once, or check the topic", role="compass"
        )
    a, b, d, e, f = np.linalg.lstsq(np.column_stack((x * x, x * y, y * y, x, y)), np.ones(len(x)), rcond=None)[0]
    G = np.array([[a, 0.5 * b], [0.5 * b, d]])
    if a * d - 0.25 * b * b <= 0.0 or a <= 0.0:
        raise LocfuseError(NO_ELLIPSE, role="compass")
    centre = np.linalg.solve(G, [-0.5 * e, -0.5 * f])
    values, vectors = np.linalg.eigh(G / (1.0 + centre @ G @ centre))
    return mean + centre, (vectors * np.sqrt(values)) @ vectors.T


def _gauss_newton(m: Array, c: Array, A: Array, weights: Array) -> tuple[Array, Array, Array]:
    """Return a step of (c_x, c_y, A_xx, A_xy, A_yy), residuals |A (m - c)| - 1 (n,), and (J' W J)^-1 (5, 5)."""
    d = m - c
    v = d @ A
    length = np.hypot(v[:, 0], v[:, 1])
    n = v / length[:, None]
    J = np.column_stack((-n @ A, n[:, 0] * d[:, 0], n[:, 0] * d[:, 1] + n[:, 1] * d[:, 0], n[:, 1] * d[:, 1]))
    e = length - 1.0
    M = J.T @ (J * weights[:, None])
    try:
        spread = np.asarray(np.linalg.inv(M), np.float64)
    except np.linalg.LinAlgError:
        raise LocfuseError(NO_ELLIPSE, role="compass") from None
    return -spread @ (J.T @ (weights * e)), e, spread


def _judged(field: Array, unit: float, c: Array, A: Array, scatter: float, spread: Array) -> Iron:
    """Return the calibration in the field's unit. Raises LocfuseError if the fit is poor or has a large gap."""
    size = math.sqrt(float(np.linalg.det(A)))
    if scatter > MAX_ELLIPSE_SCATTER:
        raise LocfuseError(
            f"the field's strength scatters by {scatter:.0%} about the best ellipse: the readings are "
            "disturbed by more than iron on the robot",
            role="compass",
        )
    v = (field / unit - c) @ A
    angles = np.sort(np.arctan2(v[:, 1], v[:, 0]))
    gap = float(np.diff(angles, append=angles[0] + 2.0 * math.pi).max())
    if gap > MAX_MISSING_ARC_RAD:
        raise LocfuseError(
            f"the field turned through {360 - math.degrees(gap):.0f} of 360 degrees: "
            "turn the robot once on the spot while recording",
            role="compass",
        )
    return Iron(
        hard=c * unit,
        soft=A / size,
        hard_sigma=np.sqrt(np.diag(spread)[:2]) * unit,
        soft_sigma=_shape_sigma(A, spread[2:, 2:]) / size,
        strength=unit / size,
        scatter=scatter,
        error_before_deg=iron_error_deg(c, A),
        gap_deg=math.degrees(gap),
        readings=len(field),
    )


def _shape_sigma(A: Array, spread: Array) -> Array:
    """Return `size` times the standard deviations (2, 2) of the shape A / size, with size = sqrt(det A).

    `spread` (3, 3) is the covariance of (A_xx, A_xy, A_yy). The derivative is
    d(A / size) = (dA - A tr(A^-1 dA) / 2) / size.
    """
    B = np.linalg.inv(A)
    shape = np.array([A[0, 0], A[0, 1], A[1, 1]])
    G = np.eye(3) - 0.5 * np.outer(shape, [B[0, 0], 2.0 * B[0, 1], B[1, 1]])
    xx, xy, yy = np.sqrt(np.maximum(np.diag(G @ spread @ G.T), 0.0)).tolist()
    return np.array([[xx, xy], [xy, yy]])


def iron_error_deg(c: Array, A: Array) -> float:
    """Return the rms heading error [deg] that uncorrected iron causes over a full turn; the mean is subtracted.

    The field readings are m = c + A^-1 (cos, sin), with centre c (2,) and shape A (2, 2).
    """
    a = np.linspace(0.0, 2.0 * math.pi, 720, endpoint=False)
    raw = c + np.column_stack((np.cos(a), np.sin(a))) @ np.linalg.inv(A)
    error = wrap_all(np.arctan2(raw[:, 1], raw[:, 0]) - a)
    middle = math.atan2(float(np.sin(error).mean()), float(np.cos(error).mean()))
    return math.degrees(float(np.sqrt((wrap_all(error - middle) ** 2).mean())))
