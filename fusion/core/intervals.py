"""Wheel motion between two times, with its covariance and its derivative by the wheels' parameters (eq. 3, 8).

Between two readings of the wheels the body's twist is constant. An interval is cut at every reading, and what each
piece does to the end of the interval adds up, seen from where the dead reckoning began.
"""

from math import atan2, cos, pi, sin

ROOM = 18  # poses at begin and end of the interval, then of a piece; what either wheel's way does to the end


def between(w, t_from, t_to, n, u, Q, J, room):
    """Write the motion u (n, 3) from each t_from (n,) to t_to (n,) [s], its covariance Q (n, 9) and J (n, 9).

    J, the derivative by (left, right, track), is left alone where it is not asked for. `room` (ROOM,) is scratch.
    """
    for i in range(n):
        first, last = reading(w.t, w.readings, t_from[i]), reading(w.t, w.readings, t_to[i])
        begin, end = passed(w.t, first, t_from[i]), passed(w.t, last, t_to[i])
        along(w, first, begin, room, 0)
        along(w, last, end, room, 3)
        for j in range(9):
            Q[i, j] = 0.0
            if w.parameters:
                J[i, j] = 0.0
        if t_to[i] > t_from[i]:
            for k in range(first, last + 1):
                piece(w, k, begin if k == first else 0.0, end if k == last else 1.0, i, Q, J, room)
        seen_from_begin(w, i, u, Q, J, room)


def reading(t, n, at):
    """Return the interval between readings t (n,) that holds a time; the first and the last go on beyond."""
    low, high = 0, n
    while low < high:
        middle = (low + high) // 2
        if at < t[middle]:
            high = middle
        else:
            low = middle + 1
    return min(max(low - 1, 0), n - 2)


def passed(t, k, at):
    """Return the share of interval k that has passed; at most one interval beyond either end."""
    return min(max((at - t[k]) / (t[k + 1] - t[k]), -1.0), 2.0)


def along(w, k, share, room, to):
    """Write the pose (3,) where a share of interval k has passed."""
    ahead, left, turned = share * w.twist[k, 0], share * w.twist[k, 1], share * w.twist[k, 2]
    arc(w.pose[k, 0], w.pose[k, 1], w.pose[k, 2], ahead, left, turned, room, to)


def arc(x, y, theta, ahead, left, turned, room, to):
    """Write the pose (3,) that a constant twist leads to: the chord of an arc, half the turn aside (eq. 3)."""
    half = 0.5 * turned
    c = s = (theta + half) - (theta + half)  # NaN where there is no heading
    if c == 0.0:
        chord = sin(half) / half if half != 0.0 else 1.0
        c, s = chord * cos(theta + half), chord * sin(theta + half)
    room[to], room[to + 1], room[to + 2] = x + c * ahead - s * left, y + s * ahead + c * left, theta + turned


def piece(w, k, begin, end, i, Q, J, room):
    """Add what the piece of interval k from share `begin` to `end` does to the end of interval i."""
    share = end - begin
    along(w, k, begin, room, 6)
    ahead, left, turned = share * w.twist[k, 0], share * w.twist[k, 1], share * w.twist[k, 2]
    arc(room[6], room[7], room[8], ahead, left, turned, room, 9)
    middle = room[8] + 0.5 * turned
    c = s = middle - middle
    if c == 0.0:
        c, s = cos(middle), sin(middle)
    # the derivative of the end by the turn: that of the chord, and the lever arm from the piece to the end
    by_x = -0.5 * (ahead * s + left * c) - (room[4] - room[10])
    by_y = 0.5 * (ahead * c - left * s) + (room[3] - room[9])
    by_wheels(w.track, middle + aside(ahead, left), by_x, by_y, room)
    if w.matches:
        add_match(w, k, share, c, s, by_x, by_y, i, Q)
    else:
        add_wheels(w, k, share, i, Q, room)
    if w.parameters:
        for j in range(3):
            J[i, 3 * j] += share * w.rolled[k, 0] * room[12 + j]
            J[i, 3 * j + 1] += share * w.rolled[k, 1] * room[15 + j]
        J[i, 2], J[i, 5], J[i, 8] = J[i, 2] - turned * by_x, J[i, 5] - turned * by_y, J[i, 8] - turned


def aside(ahead, left):
    """Return the direction of travel from the body's axis [rad], at most a quarter turn: 0 ahead and back."""
    if left == 0.0 or left - left != 0.0 or ahead - ahead != 0.0:
        return 0.0
    return atan2(-left, -ahead) if ahead < 0.0 else atan2(left, ahead + 0.0)  # which -0.0 would turn round


def by_wheels(track, direction, by_x, by_y, room):
    """Write the derivatives of the end by the way of either wheel: eq. 8 in its right form (docs/paper.md)."""
    c = s = direction - direction
    if c == 0.0:
        c, s = cos(direction), sin(direction)
    room[12], room[13], room[14] = 0.5 * c - by_x / track, 0.5 * s - by_y / track, -1.0 / track
    room[15], room[16], room[17] = 0.5 * c + by_x / track, 0.5 * s + by_y / track, 1.0 / track


def add_wheels(w, k, share, i, Q, room):
    """Add the noise of both wheels, in proportion to the distance rolled, and of what they did unseen."""
    for side in range(2):
        at, variance = 12 + 3 * side, w.noise * abs(share * w.rolled[k, side])
        add(Q, i, variance, room[at], room[at + 1], room[at + 2])
    if w.silent:
        # a whole silence leaves no doubt about the heading, the difference of the sums; a part of it does
        most = min(w.silence[k, 1] * (share * (w.t[k + 1] - w.t[k])), pi)
        Q[i, 0] += share * w.silence[k, 0]
        Q[i, 4] += share * w.silence[k, 0]
        Q[i, 8] += (1.0 - share) * most * most / 3.0


def add(Q, i, variance, x, y, theta):
    """Add the covariance of an error along (x, y, theta) to the upper triangle of Q."""
    Q[i, 0] += variance * x * x
    Q[i, 1] += variance * x * y
    Q[i, 2] += variance * x * theta
    Q[i, 4] += variance * y * y
    Q[i, 5] += variance * y * theta
    Q[i, 8] += variance * theta * theta


def add_match(w, k, share, c, s, by_x, by_y, i, Q):
    """Add the share of the covariance of a twist that scans were matched for, with the lever arm to the end."""
    P, tt = w.matched, w.matched[k, 8]
    xt, yt = c * P[k, 2] - s * P[k, 5], s * P[k, 2] + c * P[k, 5]
    Q[i, 0] += share * (c * c * P[k, 0] - 2.0 * c * s * P[k, 1] + s * s * P[k, 4] + by_x * (2.0 * xt + by_x * tt))
    Q[i, 1] += share * (c * s * (P[k, 0] - P[k, 4]) + (c * c - s * s) * P[k, 1])
    Q[i, 1] += share * (by_x * yt + by_y * xt + by_x * by_y * tt)
    Q[i, 2] += share * (xt + by_x * tt)
    Q[i, 4] += share * (s * s * P[k, 0] + 2.0 * c * s * P[k, 1] + c * c * P[k, 4] + by_y * (2.0 * yt + by_y * tt))
    Q[i, 5] += share * (yt + by_y * tt)
    Q[i, 8] += share * tt


def seen_from_begin(w, i, u, Q, J, room):
    """Write the end of interval i as it is seen from its begin, and turn what else is known of it there."""
    theta = room[2]
    c = s = theta - theta
    if c == 0.0:
        c, s = cos(theta), sin(theta)
    dx, dy = room[3] - room[0], room[4] - room[1]
    u[i, 0], u[i, 1], u[i, 2] = c * dx + s * dy, c * dy - s * dx, room[5] - room[2]
    xx, xy, xt, yy, yt = Q[i, 0], Q[i, 1], Q[i, 2], Q[i, 4], Q[i, 5]
    Q[i, 0] = c * c * xx + 2.0 * c * s * xy + s * s * yy
    Q[i, 1] = c * s * (yy - xx) + (c * c - s * s) * xy
    Q[i, 2] = c * xt + s * yt
    Q[i, 4] = s * s * xx - 2.0 * c * s * xy + c * c * yy
    Q[i, 5] = c * yt - s * xt
    Q[i, 3], Q[i, 6], Q[i, 7] = Q[i, 1], Q[i, 2], Q[i, 5]
    if w.parameters:
        for j in range(3):
            J[i, j], J[i, 3 + j] = c * J[i, j] + s * J[i, 3 + j], c * J[i, 3 + j] - s * J[i, j]
