"""Hard and soft iron of a magnetometer: an ellipse fit to the field readings of one full turn of the robot.

In a uniform field the two axes trace a circle about zero. Magnets on the robot move its centre (hard iron), steel
makes it an ellipse (soft iron). The fit finds the centre c and the symmetric matrix A with |A (m - c)| = 1. A
rotation of the axes is not observable; it is part of the compass offset.
"""

from __future__ import annotations

import math

import msgspec
import numpy as np

from locfuse.fusion.chi_square import robust_sigma
from locfuse.fusion.data import Array, LocfuseError
from locfuse.fusion.se2 import wrap_all

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
