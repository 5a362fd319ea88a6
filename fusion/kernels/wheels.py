"""Wheel motion between two times, with its covariance and its derivative by the wheels' parameters (eq. 3, 8).

Between two readings of the wheels the body's twist is constant. An interval is cut at every reading, and what each
piece does to the end of the interval adds up, seen from where the dead reckoning began.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from locfuse.fusion.data import Array

from .arrays import view

try:
    import cython
except ImportError:  # Cython is only needed to compile
    from . import uncompiled as cython
if not cython.compiled:
    from math import atan2, pi

    from .uncompiled import cos, sin


class Odometer:
    """Wheel readings at t (n,) [s]: between two of them the twist (3) is constant, from the pose (3) on.

    Either wheel rolled as `rolled` (2) says [m], with the variance `noise` for each metre, on a `track` [m]. Where
    the way is not known (`silent`) the variance of the place [m^2] and the turning rate [rad/s] are `silence` (2),
    and where the motion was matched (`matches`) its covariance is `matched` (9). Made of `wheels.motion.Wheels`.
    """

    def __init__(self, wheels: Any) -> None:
        self.t, self.twist, self.pose = view(wheels.t), view(wheels.twist), view(wheels.pose)
        self.rolled, self.track, self.noise = view(wheels.rolled), wheels.track, wheels.noise
        self.silent, self.matches = bool(wheels.silence.any()), wheels.matched is not None
        self.silence = view(wheels.silence if self.silent else np.zeros((0, 2)))
        self.matched = view(wheels.matched.reshape(-1, 9) if self.matches else np.zeros((0, 9)))


class Intervals:
    """The motions u (n, 3) of n intervals, their covariances Q (n, 9) and derivatives J (n, 9), filled one by one.

    J is by (left, right, track), or has no columns where nobody asks for it. Interval `row` is in work: from the
    begin to the end it goes through pieces, of which (x, y, theta) is the last pose that was worked out; and what
    the ways of both wheels in a piece do to the end.
    """

    def __init__(self, u: Array, Q: Array, J: Array) -> None:
        self.u, self.Q, self.J, self.row = view(u), view(Q), view(J), 0
        self.parameters = J.shape[1] > 0
        self.x, self.y, self.theta = 0.0, 0.0, 0.0
        self.begin_x, self.begin_y, self.begin_theta = 0.0, 0.0, 0.0
        self.end_x, self.end_y, self.end_theta = 0.0, 0.0, 0.0
        self.left_x, self.left_y, self.left_theta = 0.0, 0.0, 0.0
        self.right_x, self.right_y, self.right_theta = 0.0, 0.0, 0.0


def integrate(wheels: Odometer, t_from: Array, t_to: Array, out: Intervals) -> None:
    """Write the motion from each t_from (n,) to t_to (n,) [s]."""
    for i in range(t_from.shape[0]):
        out.row = i
        first, last = reading(wheels, t_from[i]), reading(wheels, t_to[i])
        begin, end = passed(wheels, first, t_from[i]), passed(wheels, last, t_to[i])
        go_along(wheels, first, begin, out)
        out.begin_x, out.begin_y, out.begin_theta = out.x, out.y, out.theta
        go_along(wheels, last, end, out)
        out.end_x, out.end_y, out.end_theta = out.x, out.y, out.theta
        for j in range(9):
            out.Q[i, j] = 0.0
            if out.parameters:
                out.J[i, j] = 0.0
        if t_to[i] > t_from[i]:
            for k in range(first, last + 1):
                add_piece(wheels, k, begin if k == first else 0.0, end if k == last else 1.0, out)
        see_from_begin(out)


def reading(wheels: Odometer, at: float) -> int:
    """Return the interval between readings that holds a time; the first and the last go on beyond."""
    low, high = 0, wheels.t.shape[0]
    while low < high:
        middle = (low + high) // 2
        if at < wheels.t[middle]:
            high = middle
        else:
            low = middle + 1
    return min(max(low - 1, 0), wheels.t.shape[0] - 2)


def passed(wheels: Odometer, k: int, at: float) -> float:
    """Return the share of interval k that has passed; at most one interval beyond either end."""
    return min(max((at - wheels.t[k]) / (wheels.t[k + 1] - wheels.t[k]), -1.0), 2.0)


def go_along(wheels: Odometer, k: int, share: float, out: Intervals) -> None:
    """Write the pose where a share of interval k has passed."""
    ahead, left, turned = share * wheels.twist[k, 0], share * wheels.twist[k, 1], share * wheels.twist[k, 2]
    out.x, out.y, out.theta = wheels.pose[k, 0], wheels.pose[k, 1], wheels.pose[k, 2]
    go_arc(ahead, left, turned, out)


def go_arc(ahead: float, left: float, turned: float, out: Intervals) -> None:
    """Move the pose by a constant twist: the chord of an arc, half the turn aside (eq. 3)."""
    half = 0.5 * turned
    chord = sin(half) / half if half != 0.0 else 1.0
    c, s = chord * cos(out.theta + half), chord * sin(out.theta + half)
    out.x, out.y, out.theta = out.x + c * ahead - s * left, out.y + s * ahead + c * left, out.theta + turned


def add_piece(wheels: Odometer, k: int, begin: float, end: float, out: Intervals) -> None:
    """Add what the piece of interval k from share `begin` to `end` does to the end of the whole."""
    share, i = end - begin, out.row
    go_along(wheels, k, begin, out)
    ahead, left, turned = share * wheels.twist[k, 0], share * wheels.twist[k, 1], share * wheels.twist[k, 2]
    middle = out.theta + 0.5 * turned
    go_arc(ahead, left, turned, out)
    c, s = cos(middle), sin(middle)
    # the derivative of the end by the turn: that of the chord, and the lever arm from the piece to the end
    by_x = -0.5 * (ahead * s + left * c) - (out.end_y - out.y)
    by_y = 0.5 * (ahead * c - left * s) + (out.end_x - out.x)
    derive_by_wheels(wheels.track, middle + aside(ahead, left), by_x, by_y, out)
    if wheels.matches:
        add_match(wheels, k, share, middle, by_x, by_y, out)
    else:
        add_wheels(wheels, k, share, out)
    if out.parameters:
        left_way, right_way, J = share * wheels.rolled[k, 0], share * wheels.rolled[k, 1], out.J
        J[i, 0] += left_way * out.left_x
        J[i, 3] += left_way * out.left_y
        J[i, 6] += left_way * out.left_theta
        J[i, 1] += right_way * out.right_x
        J[i, 4] += right_way * out.right_y
        J[i, 7] += right_way * out.right_theta
        J[i, 2], J[i, 5], J[i, 8] = J[i, 2] - turned * by_x, J[i, 5] - turned * by_y, J[i, 8] - turned


def aside(ahead: float, left: float) -> float:
    """Return the direction of travel from the body's axis [rad], at most a quarter turn: 0 ahead and back."""
    if left == 0.0 or left - left != 0.0 or ahead - ahead != 0.0:
        return 0.0
    return atan2(-left, -ahead) if ahead < 0.0 else atan2(left, ahead + 0.0)  # which -0.0 would turn round


def derive_by_wheels(track: float, direction: float, by_x: float, by_y: float, out: Intervals) -> None:
    """Write the derivatives of the end by the way of either wheel: eq. 8 in its right form (docs/paper.md)."""
    c, s = cos(direction), sin(direction)
    out.left_x, out.left_y, out.left_theta = 0.5 * c - by_x / track, 0.5 * s - by_y / track, -1.0 / track
    out.right_x, out.right_y, out.right_theta = 0.5 * c + by_x / track, 0.5 * s + by_y / track, 1.0 / track


def add_wheels(wheels: Odometer, k: int, share: float, out: Intervals) -> None:
    """Add the noise of both wheels, in proportion to the distance rolled, and of what they did unseen."""
    left = wheels.noise * abs(share * wheels.rolled[k, 0])
    right = wheels.noise * abs(share * wheels.rolled[k, 1])
    add_error(out, left, out.left_x, out.left_y, out.left_theta)
    add_error(out, right, out.right_x, out.right_y, out.right_theta)
    if wheels.silent:
        # a whole silence leaves no doubt about the heading, the difference of the sums; a part of it does
        most = min(wheels.silence[k, 1] * (share * (wheels.t[k + 1] - wheels.t[k])), pi)
        out.Q[out.row, 0] += share * wheels.silence[k, 0]
        out.Q[out.row, 4] += share * wheels.silence[k, 0]
        out.Q[out.row, 8] += (1.0 - share) * most * most / 3.0


def add_error(out: Intervals, variance: float, x: float, y: float, theta: float) -> None:
    """Add the covariance of an error along (x, y, theta) to the upper triangle of Q."""
    Q, i = out.Q, out.row
    Q[i, 0] += variance * x * x
    Q[i, 1] += variance * x * y
    Q[i, 2] += variance * x * theta
    Q[i, 4] += variance * y * y
    Q[i, 5] += variance * y * theta
    Q[i, 8] += variance * theta * theta


def add_match(
    wheels: Odometer, k: int, share: float, heading: float, by_x: float, by_y: float, out: Intervals
) -> None:
    """Add the share of the covariance of a twist that scans were matched for, with the lever arm to the end."""
    P, Q, i, c, s = wheels.matched, out.Q, out.row, cos(heading), sin(heading)
    xt, yt, tt = c * P[k, 2] - s * P[k, 5], s * P[k, 2] + c * P[k, 5], P[k, 8]
    Q[i, 0] += share * (c * c * P[k, 0] - 2.0 * c * s * P[k, 1] + s * s * P[k, 4] + by_x * (2.0 * xt + by_x * tt))
    Q[i, 1] += share * (c * s * (P[k, 0] - P[k, 4]) + (c * c - s * s) * P[k, 1])
    Q[i, 1] += share * (by_x * yt + by_y * xt + by_x * by_y * tt)
    Q[i, 2] += share * (xt + by_x * tt)
    Q[i, 4] += share * (s * s * P[k, 0] + 2.0 * c * s * P[k, 1] + c * c * P[k, 4] + by_y * (2.0 * yt + by_y * tt))
    Q[i, 5] += share * (yt + by_y * tt)
    Q[i, 8] += share * tt


def see_from_begin(out: Intervals) -> None:
    """Write the end of an interval as it is seen from its begin, and turn what else is known of it there."""
    u, Q, J, i = out.u, out.Q, out.J, out.row
    c, s = cos(out.begin_theta), sin(out.begin_theta)
    dx, dy = out.end_x - out.begin_x, out.end_y - out.begin_y
    u[i, 0], u[i, 1], u[i, 2] = c * dx + s * dy, c * dy - s * dx, out.end_theta - out.begin_theta
    xx, xy, xt, yy, yt = Q[i, 0], Q[i, 1], Q[i, 2], Q[i, 4], Q[i, 5]
    Q[i, 0] = c * c * xx + 2.0 * c * s * xy + s * s * yy
    Q[i, 1] = c * s * (yy - xx) + (c * c - s * s) * xy
    Q[i, 2] = c * xt + s * yt
    Q[i, 4] = s * s * xx - 2.0 * c * s * xy + c * c * yy
    Q[i, 5] = c * yt - s * xt
    Q[i, 3], Q[i, 6], Q[i, 7] = Q[i, 1], Q[i, 2], Q[i, 5]
    if out.parameters:
        for j in range(3):
            J[i, j], J[i, 3 + j] = c * J[i, j] + s * J[i, 3 + j], c * J[i, 3 + j] - s * J[i, j]
