"""Planar rigid motion SE(2), vectorised: a pose is (..., 3) = (x [m], y [m], theta [rad]).

`T_map_base` converts from the base to the map frame: compose(T_map_base, p_base) is p in the map.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Plain = tuple[float, float, float]  # one pose
# bearing [rad, not wrapped], distance [m], derivatives of the bearing by the pose and by the mount
Sight = tuple[float, float, Plain, Plain]

TAU = 2.0 * math.pi
MAX_OTHER_AXES, MIN_TURNED = 1e-3, 0.1  # y^2 + z^2 over x^2 of quaternions about the x axis; range of their w


def wrap(angle: float) -> float:
    """Return `angle` [rad] wrapped to [-pi, pi), in plain floats for the inner loop of the filter."""
    return (angle + math.pi) % TAU - math.pi


def direction(angle: float) -> tuple[float, float]:
    """Return (cos, sin) of an angle [rad]; NaN for an infinite angle."""
    return (math.cos(angle), math.sin(angle)) if math.isfinite(angle) else (math.nan, math.nan)


def sight(pose: Plain, point: tuple[float, float], mount: Plain, nearest: float) -> Sight | None:
    """Return bearing and distance of a point seen from a sensor on a robot; None if nearer than `nearest` [m].

    With d from the sensor to the point, in the map: bearing = atan2(d_y, d_x) - theta - yaw, distance = |d|
    (Thrun, Burgard and Fox 2005, 6.6.2).
    """
    x, y, theta = pose
    lever_x, lever_y, yaw = mount
    c, s = direction(theta)
    dx, dy = point[0] - x - c * lever_x + s * lever_y, point[1] - y - s * lever_x - c * lever_y
    square = dx * dx + dy * dy
    if not square >= nearest * nearest or not square > 0.0:
        return None
    by_lever_x, by_lever_y = (dy * c - dx * s) / square, -(dx * c + dy * s) / square
    by_theta = lever_x * by_lever_y - lever_y * by_lever_x - 1.0
    by_pose, by_mount = (dy / square, -dx / square, by_theta), (by_lever_x, by_lever_y, -1.0)
    return math.atan2(dy, dx) - theta - yaw, math.sqrt(square), by_pose, by_mount


def wrap_all(angle: Array) -> Array:
    """Return every angle [rad] wrapped to [-pi, pi), any shape."""
    return (angle + np.pi) % TAU - np.pi


def difference(a: Array, b: Array) -> Array:
    """Return a - b of poses (n, 3) by component, with the angle wrapped."""
    d = a - b
    d[:, 2] = wrap_all(d[:, 2])
    return d


def compose(a: Array, b: Array) -> Array:
    """Return a ⊕ b for poses (..., 3); headings are added without wrapping, so that full turns count."""
    c, s = np.cos(a[..., 2]), np.sin(a[..., 2])
    return np.stack(
        (
            a[..., 0] + c * b[..., 0] - s * b[..., 1],
            a[..., 1] + s * b[..., 0] + c * b[..., 1],
            a[..., 2] + b[..., 2],
        ),
        axis=-1,
    )


def inverse(a: Array) -> Array:
    """Return ⊖a, the inverse of a pose (..., 3)."""
    c, s = np.cos(a[..., 2]), np.sin(a[..., 2])
    return np.stack((-c * a[..., 0] - s * a[..., 1], s * a[..., 0] - c * a[..., 1], -a[..., 2]), axis=-1)


def between(a: Array, b: Array) -> Array:
    """Return ⊖a ⊕ b, pose b relative to pose a, (..., 3)."""
    c, s = np.cos(a[..., 2]), np.sin(a[..., 2])
    return np.stack(
        (
            -c * a[..., 0] - s * a[..., 1] + c * b[..., 0] + s * b[..., 1],
            s * a[..., 0] - c * a[..., 1] - s * b[..., 0] + c * b[..., 1],
            -a[..., 2] + b[..., 2],
        ),
        axis=-1,
    )


def chained(a: Array, steps: Array) -> Array:
    """Return the poses (n, 3) a ⊕ steps[0], a ⊕ steps[0] ⊕ steps[1], ... for steps (n, 3) from pose a (3,)."""
    theta = a[2] + np.cumsum(steps[:, 2])
    before = np.concatenate((a[2:], theta))[:-1]
    return np.column_stack((a[:2] + np.cumsum(rotated(before, steps[:, :2]), axis=0), theta))


def chain(steps: Array) -> Array:
    """Return the poses (n + 1, 3) along steps (n, 3), beginning with the pose (0, 0, 0)."""
    origin = np.zeros(3)
    return np.vstack((origin, chained(origin, steps)))


def carried(at: Plain, a: Plain, b: Plain) -> Plain:
    """Return the pose `at` after the motion from a to b: at ⊕ (⊖a ⊕ b).

    In plain floats, ten times faster than `chained`.
    """
    c, s = direction(a[2])
    x = -c * a[0] - s * a[1] + c * b[0] + s * b[1]
    y = s * a[0] - c * a[1] - s * b[0] + c * b[1]
    c, s = direction(at[2])
    return at[0] + (c * x - s * y), at[1] + (s * x + c * y), at[2] + (-a[2] + b[2])


def between_jacobians(a: Array, b: Array) -> tuple[Array, Array]:
    """Return the derivatives (..., 3, 3) of between(a, b) by a and by b (..., 3)."""
    by_b = rotation(-a[..., 2])
    by_a = -by_b
    local = rotated(-a[..., 2], b[..., :2] - a[..., :2])
    by_a[..., 0, 2], by_a[..., 1, 2] = local[..., 1], -local[..., 0]
    return by_a, by_b


def rotation(theta: Array) -> Array:
    """Return rotation matrices (..., 3, 3) of poses (x, y, theta), for angles theta (...) [rad]."""
    c, s = np.cos(theta), np.sin(theta)
    out = np.zeros((*np.shape(theta), 3, 3))
    out[..., 0, 0] = out[..., 1, 1] = c
    out[..., 0, 1], out[..., 1, 0] = -s, s
    out[..., 2, 2] = 1.0
    return out


def symmetric(P: Array) -> Array:
    """Return the symmetric part of matrices P (..., n, n): rounding errors make a covariance asymmetric."""
    return 0.5 * (P + np.swapaxes(P, -1, -2))


def propagated(J: Array, P: Array) -> Array:
    """Return J P J' (..., m, m): the covariance of numbers with derivatives J (..., m, n), for P (..., n, n)."""
    return np.asarray(J @ P @ np.swapaxes(J, -1, -2))


def turned_covariance(P: Array, theta: Array) -> Array:
    """Return covariances P (n, 3, 3) of (x, y, theta) in axes that are rotated by -theta (n,) [rad]."""
    return propagated(rotation(theta), P)


def lever(x: Array, y: Array) -> Array:
    """Return derivatives (..., 3, 3) of poses that move by x, y (...) [m] per radian of their heading."""
    out = np.zeros((*np.shape(x), 3, 3))
    out[..., (0, 1, 2), (0, 1, 2)] = 1.0
    out[..., 0, 2], out[..., 1, 2] = x, y
    return out


def rotated(theta: Array, v: Array) -> Array:
    """Return vectors v (..., 2) rotated by angles theta (...) [rad]."""
    c, s = np.cos(theta), np.sin(theta)
    return np.stack((c * v[..., 0] - s * v[..., 1], s * v[..., 0] + c * v[..., 1]), axis=-1)


def yaw(x: Array, y: Array, z: Array, w: Array) -> Array:
    """Return the yaws (...) [rad] of quaternions x, y, z, w (...) of any length."""
    return np.asarray(np.arctan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z), np.float64)


def turning_only(q: Array) -> Array:
    """Return quaternions q (n, 4), with NaN for those of zeros, which are no rotations; unless all are zeros."""
    zeros = ~q.any(axis=1, keepdims=True)
    return q if zeros.all() else np.where(zeros, np.nan, q)


def is_about_x(q: Array) -> bool:
    """Return whether quaternions q (n, 4), some of which may be NaN, turn about the x axis: w seems to come first.

    Robots turn about z, so x and y of their quaternions are small.
    """
    finite = q[np.isfinite(q).all(axis=1)]
    x, *others = np.square(finite[:, :3]).sum(axis=0).tolist()
    return bool(sum(others) < MAX_OTHER_AXES * x and np.ptp(finite[:, 3]) > MIN_TURNED)


def rotation_3d(roll_deg: float, pitch_deg: float, yaw_deg: float) -> Array:
    """Return R (3, 3) = Rz(yaw) Ry(pitch) Rx(roll), from sensor axes to base axes, as in URDF."""
    r, p, y = (math.radians(angle) for angle in (roll_deg, pitch_deg, yaw_deg))
    cr, sr, cp, sp, cy, sy = math.cos(r), math.sin(r), math.cos(p), math.sin(p), math.cos(y), math.sin(y)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def rotated_3d(q: Array, v: Array) -> Array:
    """Return vectors v (3,) or (n, 3) rotated by quaternions (n, 4) or (1, 4) x, y, z, w of any length, (n, 3)."""
    n = (q**2).sum(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        axis, w = q[:, :3] / np.sqrt(n)[:, None], q[:, 3] / np.sqrt(n)
    t = 2.0 * np.cross(axis, v)
    return np.asarray(v + w[:, None] * t + np.cross(axis, t))


def exp(twist: Array) -> Array:
    """Return the pose reached by a constant body twist (..., 3) = (forward, left, turn) over unit time.

    It lies on a circular arc: for (ds, 0, dtheta) the chord is ds sin(dtheta/2) / (dtheta/2), in the direction
    dtheta/2.
    """
    half = 0.5 * twist[..., 2]
    # sinc is exact near zero; np.sinc(x) = sin(pi x) / (pi x)
    chord = np.sinc(half / np.pi)
    c, s = chord * np.cos(half), chord * np.sin(half)
    return np.stack(
        (c * twist[..., 0] - s * twist[..., 1], s * twist[..., 0] + c * twist[..., 1], twist[..., 2]), axis=-1
    )


def log(pose: Array) -> Array:
    """Return the body twist (..., 3) whose `exp` is `pose`, for |theta| < 2 pi."""
    half = 0.5 * pose[..., 2]
    chord = np.sinc(half / np.pi)
    c, s = np.cos(half) / chord, np.sin(half) / chord
    return np.stack(
        (c * pose[..., 0] + s * pose[..., 1], -s * pose[..., 0] + c * pose[..., 1], pose[..., 2]), axis=-1
    )


def transform(pose: Array, points: Array) -> Array:
    """Convert points (..., 2) from the frame of `pose` (..., 3) to the parent frame of the pose."""
    c, s = np.cos(pose[..., 2]), np.sin(pose[..., 2])
    x, y = points[..., 0], points[..., 1]
    return np.stack((pose[..., 0] + c * x - s * y, pose[..., 1] + s * x + c * y), axis=-1)


def in_other_frame(z: Array, poses: Array) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return the linear equation A x = y of positions z (n, >= 2) [m] in another frame, at poses (n, 3).

    y = z_x + i z_y, and x = (c, c l, d) with the rotation and scale c of the frame, the point l on the body whose
    positions z are, and a shift d; without headings (NaN) x = (c, d).
    """
    columns = [poses[:, :2] @ (1.0, 1.0j), np.exp(1.0j * poses[:, 2]), np.ones(len(poses))]
    if not np.isfinite(poses[:, 2]).all():
        del columns[1]
    return np.stack(columns, axis=-1), z[:, :2] @ (1.0, 1.0j)


def laid_on(a: Array, b: Array) -> tuple[float, float]:
    """Return the rotation [rad] and the scale that map points a (n, 2) to points b (n, 2), by least squares.

    Both sets are first centred on their means (Umeyama 1991, in the plane). The rotation does not depend on the
    scale. If all points of a are equal, the scale is 1.
    """
    p, q = a - a.mean(axis=0), b - b.mean(axis=0)
    across, along = float((p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]).sum()), float((p * q).sum())
    square = float((p**2).sum())
    return math.atan2(across, along), math.hypot(across, along) / square if square > 0.0 else 1.0


def off_laid_on(a: Array, b: Array) -> Array:
    """Return the differences (n, 2) of points b (n, 2) from points a (n, 2), which are laid on them rigidly."""
    p, q = a - a.mean(axis=0), b - b.mean(axis=0)
    return np.asarray(q - rotated(np.full(len(p), laid_on(a, b)[0]), p))
