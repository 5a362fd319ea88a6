"""The equations of the paper as printed: Hoang, Duong, Van, Viet, Vinh, "Multi-Sensor Perceptual System ...".

There is one function per numbered equation, with the misprints; `filter` runs them. docs/paper.md describes the
corrected equations of locfuse. State (x, y, theta) [m, m, rad]; L is the distance of the wheels [m], called l in
eq. 8. Leading axes are allowed for shapes with (...).
"""

from __future__ import annotations

import math

import msgspec
import numpy as np

from locfuse.fusion.data import Array


class Printed(msgspec.Struct, frozen=True):
    """Parameters of the paper's filter (sections III and IV).

    The last three are chosen here, since the paper prints none.
    """

    period: float = 0.1  # s, sampling time of the EKF
    delta: float = 0.01  # of eq. 9
    var_r: float = 0.03**2  # m^2: "30 mm in distance"
    var_psi: float = math.radians(0.25) ** 2  # rad^2: "0.25 degrees in deflect angle"
    var_phi: float = 0.01  # "0.1 degrees corresponds to the noise variance of 0.01": square degrees, used as rad^2
    var_gamma: float = math.radians(0.5) ** 2  # rad^2
    window_r: float = 0.5  # m, half width of the window in which lines are matched
    window_psi: float = math.radians(15.0)  # rad


PRINTED = Printed()


def eq1_distance(dt: float, radius: float, omega: Array) -> Array:
    """Eq. 1: distance [m] that a wheel turning at omega [rad/s] travels in one sampling period, (...)."""
    return dt * radius * omega


def eq2_increments(ds_right: Array, ds_left: Array, L: float) -> tuple[Array, Array]:
    """Eq. 2: displacement of the centre [m] and turn [rad] from the wheels' distances [m], (...)."""
    return (ds_left + ds_right) / 2, (ds_right - ds_left) / L


def eq3_motion(x: Array, ds: Array, dtheta: Array) -> Array:
    """Eq. 3: the pose (..., 3) after driving ds [m] along the heading half-way through the turn dtheta [rad]."""
    m = x[..., 2] + dtheta / 2
    return x + np.stack((ds * np.cos(m), ds * np.sin(m), dtheta + np.zeros_like(m)), axis=-1)


def eq6_P(P: Array, A: Array, W: Array, Q: Array) -> Array:
    """Eq. 6: covariance (..., 3, 3) after the prediction."""
    return A @ P @ np.swapaxes(A, -1, -2) + W @ Q @ np.swapaxes(W, -1, -2)


def eq7_A(ds: Array, dtheta: Array, theta: Array) -> Array:
    """Eq. 7: derivative of eq. 3 by the pose, (..., 3, 3), correct as printed."""
    m = theta + dtheta / 2
    A = np.zeros((*np.shape(m), 3, 3))
    A[..., 0, 0] = A[..., 1, 1] = A[..., 2, 2] = 1.0
    A[..., 0, 2] = -ds * np.sin(m)
    A[..., 1, 2] = ds * np.cos(m)
    return A


def eq8_W(ds: Array, dtheta: Array, theta: Array, L: float) -> Array:
    """Eq. 8 as printed, (..., 3, 2) for the (right, left) wheel.

    Two things are missing: the terms cos/2 and sin/2, so that noise on a straight path is only sideways; and the
    factor dt R from wheel speeds to distances.
    """
    m = theta + dtheta / 2
    W = np.empty((*np.shape(m), 3, 2))
    W[..., 0, 0] = -ds * np.sin(m) / (2 * L)
    W[..., 0, 1] = ds * np.sin(m) / (2 * L)
    W[..., 1, 0] = ds * np.cos(m) / (2 * L)
    W[..., 1, 1] = -ds * np.cos(m) / (2 * L)
    W[..., 2, 0] = 1 / L
    W[..., 2, 1] = -1 / L
    return W


def eq9_Q(delta: float, omega_right: Array, omega_left: Array) -> Array:
    """Eq. 9: covariance (..., 2, 2) of the wheel speeds [rad^2/s^2], independent of the sampling period."""
    Q = np.zeros((*np.shape(omega_right), 2, 2))
    Q[..., 0, 0] = delta * omega_right**2
    Q[..., 1, 1] = delta * omega_left**2
    return Q


def eq10_K(P: Array, H: Array, R: Array) -> Array:
    """Eq. 10: the gain, (3, m)."""
    return P @ H.T @ np.linalg.inv(H @ P @ H.T + R)


def eq11_x(x: Array, K: Array, y: Array) -> Array:
    """Eq. 11: the corrected pose (3,) from the innovation y = z - h(x), (m,)."""
    return x + K @ y


def eq12_P(K: Array, H: Array, P: Array) -> Array:
    """Eq. 12: covariance (3, 3) after the correction; it may become asymmetric or lose positivity."""
    return (np.eye(len(P)) - K @ H) @ P


def eq13_H_line(C: float, beta: float) -> Array:
    """Rows of eq. 13 for one line, (2, 3) for (r, psi); the derivative is that of |C|, as in the paper."""
    return np.array([[-C * math.cos(beta), -C * math.sin(beta), 0.0], [0.0, 0.0, -1.0]])


def eq13_H_heading() -> Array:
    """Row of eq. 13 for the compass, (1, 3); as printed, it is also that of the camera."""
    return np.array([[0.0, 0.0, 1.0]])


def eq14_line(x: Array, r: float, psi: float) -> tuple[float, float]:
    """Return (rho, beta) of eq. 14 for a line (r, psi) of eq. 15 and the pose x (3,): the inverse of eq. 18.

    0 degrees of the scan point to the robot's right, so beta = psi + theta - pi/2 and C = r > 0.
    """
    beta = psi + float(x[2]) - math.pi / 2
    return r + float(x[0]) * math.cos(beta) + float(x[1]) * math.sin(beta), beta


def eq17_C(rho: float, beta: float, x: float, y: float) -> float:
    """Eq. 17: signed distance [m] of the robot to a line (rho, beta) of the map."""
    return rho - x * math.cos(beta) - y * math.sin(beta)


def eq18_prediction(C: float, beta: float, theta: float) -> tuple[float, float]:
    """Eq. 18: the predicted (r, psi) of the line, not wrapped. (The print lost the "+" before 0.5.)"""
    sign = math.copysign(1.0, C) if C else 0.0
    return abs(C), beta - (theta - math.pi / 2) + (-0.5 * sign + 0.5) * math.pi


def eq19_R(lines: int, compass: bool, camera: bool) -> Array:
    """Eq. 19: diagonal covariance (m, m) of the measurement (16): lines (r, psi), then phi, then gamma."""
    variances = [PRINTED.var_r, PRINTED.var_psi] * lines
    return np.diag(variances + [PRINTED.var_phi] * compass + [PRINTED.var_gamma] * camera)
