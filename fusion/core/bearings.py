"""The bearing of a known point: what is predicted, and which of a picture's candidates shows the point.

z = atan2(dy, dx) - theta - yaw + noise, (dx, dy) from the camera to the point, in the map; the camera's place and
yaw on the base may be states.
"""

from math import atan2, cos, sin, sqrt

from .filter import FINE, locate
from .fit import folded
from .singles import JUDGED, derive, say, state_of, variance, wait

RAY = 8  # the bearing, its derivatives by pose and mount, and the distance


def bearing(pose, to_x, to_y, x, y, yaw, nearest, out):
    """Write the bearing [rad, not wrapped] of a point from a camera at x, y, yaw on the base, and its derivatives.

    These are by the pose (x, y, theta) and by the camera's x, y, yaw; last comes the distance [m]: out (8,).
    Returns whether there is one: a camera nearer to the point than `nearest` [m] is inside it.
    """
    c = s = pose[2] - pose[2]  # NaN where there is no heading
    if c == 0.0:
        c, s = cos(pose[2]), sin(pose[2])
    dx = to_x - pose[0] - c * x + s * y
    dy = to_y - pose[1] - s * x - c * y
    q = dx * dx + dy * dy
    if not q >= nearest * nearest or not q > 0.0:
        return False
    ahead, aside = dx * c + dy * s, dy * c - dx * s
    out[0] = atan2(dy, dx) - pose[2] - yaw
    out[1], out[2], out[3] = dy / q, -dx / q, -1.0 - (x * ahead + y * aside) / q
    out[4], out[5], out[6], out[7] = aside / q, -ahead / q, -1.0, sqrt(q)
    return True


def sight(b, g, i, d):
    """Compare the candidates of picture i with the belief, and tell what became of each.

    Where one shows the point, its row waits for the correction. Returns what `whiten` does.
    """
    if g.first[i] == g.first[i + 1]:
        return FINE
    locate(b.x, b.P, b.frame, d.located)
    for j in range(3):
        d.place[j] = g.seat.told[j]
    for j in range(g.seat.free):
        d.place[g.seat.which[j]] = b.x[g.seat.at[j]]
    if not bearing(d.located, g.x, g.y, d.place[0], d.place[1], d.place[2], g.nearest, d.ray):
        return FINE
    k = d.singles
    states = derive(b, False, d.ray[1], d.ray[2], 0.0, k, d)
    bend = variance(b.P, d, k, states)
    more = bend * bend  # the bearing is not linear in the position: second-order (sigma of it / distance)^4
    states = derive(b, False, d.ray[1], d.ray[2], d.ray[3], k, d)
    for j in range(g.seat.free):
        state_of(d, k, states, g.seat.at[j], d.ray[4 + g.seat.which[j]])
        states += 1
    least = judge_each(g, i, d.ray[0], variance(b.P, d, k, states), more)
    if not least > 0.0:
        return least
    best = choose(g.told, g.first[i], g.first[i + 1], g.gate, g.margin, g.refused, g.ambiguous, g.unmatched)
    if g.told[best, 0] == 0.0:
        say(d, k, g.told[best, JUDGED], g.r[best] + more, 0.0, 0)
        wait(d, 1, states)
    return FINE


def judge_each(g, i, predicted, variance, more):
    """Write NIS, innovation and sigma of every candidate of picture i; return 1, or a variance that is none."""
    for row in range(g.first[i], g.first[i + 1]):
        S, y = variance + (g.r[row] + more), g.z[row] - predicted
        none = S - S  # 0, or NaN of a variance that is no number
        if none == 0.0 and not S > 0.0:
            return S
        y = folded(y)
        g.told[row, 2], g.told[row, 3] = y * y / S + none, g.gate
        g.told[row, JUDGED], g.told[row, JUDGED + 1] = y, sqrt(S)
    return FINE


def choose(told, first, last, gate, margin, refused, ambiguous, unmatched):
    """Give the candidates first:last of one picture, of which NIS is told, verdict and landmark (0 or -1).

    At most one is accepted: the best, within `gate`, unless another within it is worse by no more than `margin`.
    Returns the best.
    """
    best, second = first, -1
    for row in range(first + 1, last):
        if told[row, 2] < told[best, 2]:
            best = row
    for row in range(first, last):
        if row != best and (second < 0 or told[row, 2] < told[second, 2]):
            second = row
    verdict = 0.0
    if not told[best, 2] <= gate:
        verdict = refused
    elif second >= 0 and told[second, 2] <= min(gate, told[best, 2] + margin):
        verdict = ambiguous
    for row in range(first, last):
        told[row, 0], told[row, 1] = unmatched, -1.0
        if verdict == ambiguous and told[row, 2] <= gate:
            told[row, 0] = ambiguous
    told[best, 0], told[best, 1] = verdict, 0.0
    return best
