"""Poses that somebody else estimated: in the map, or as a motion since a pose that the state keeps.

With B where the robot was at the source's pose z_B, the source's motion u = (-)z_B (+) z is the robot's own,
u = (-)B (+) p + noise, seen from B.
"""

from math import cos, sin, sqrt

from .filter import keep_pose, locate, swing
from .fit import folded
from .singles import derive, say, say_third, settle, state_of, weigh

SEEN_FROM = 21  # a pose seen from another (3), and its derivatives by the other (3, 3) and by the pose (3, 3)


def see_from(a, b, out):
    """Write pose b (3,) as it is seen from pose a (3,), and its derivatives by a and b: out (21,)."""
    c = s = a[2] - a[2]  # NaN where there is no heading
    if c == 0.0:
        c, s = cos(a[2]), sin(a[2])
    dx, dy = b[0] - a[0], b[1] - a[1]
    x, y = c * dx + s * dy, c * dy - s * dx
    out[0], out[1], out[2] = x, y, b[2] - a[2]
    out[3], out[4], out[5], out[6], out[7], out[8] = -c, -s, y, s, -c, -x
    out[12], out[13], out[14], out[15], out[16], out[17] = c, s, 0.0, -s, c, 0.0
    out[9] = out[10] = out[18] = out[19] = 0.0
    out[11], out[20] = -1.0, 1.0


def way_noise(u, by_way, turn_by_way, arm, floor, turn_floor, out):
    """Write the covariance (6: 00, 01, 02, 11, 12, 22) of what a source that drifts misses on its way u (3,).

    A turn by one radian counts as the way `arm` [m].
    """
    way = sqrt(u[0] * u[0] + u[1] * u[1]) + arm * abs(folded(u[2]))
    out[0] = out[3] = by_way * way + floor
    out[1] = out[2] = out[4] = 0.0
    out[5] = turn_by_way * way + turn_floor


def turned_noise(R, angle, out):
    """Write the covariance R (6: 00, 01, 02, 11, 12, 22) of a pose in a frame that is turned by `angle`."""
    c = s = angle - angle
    if c == 0.0:
        c, s = cos(angle), sin(angle)
    cc, cs, ss = c * c, c * s, s * s
    out[0] = cc * R[0] - 2.0 * cs * R[1] + ss * R[3]
    out[1] = cs * (R[0] - R[3]) + (cc - ss) * R[1]
    out[2] = c * R[2] - s * R[4]
    out[3] = ss * R[0] + 2.0 * cs * R[1] + cc * R[3]
    out[4] = s * R[2] + c * R[4]
    out[5] = R[5]


def posed(b, p, i, d):
    """Compare pose i with the belief, and tell what became of it; returns what `whiten` does."""
    k, states = d.singles, 6
    for j in range(6):
        d.noise[j] = p.R[i, j]
    if p.in_map:
        states = in_map(b, p, i, d)
    else:
        since_kept(b, p, i, d)
    say(d, k, d.e[0], d.noise[0], 0.0, 0)
    say(d, k + 1, d.e[1], d.noise[3], d.noise[1], 1)
    say_third(d, k + 2, folded(d.e[2]), d.noise[5], d.noise[4], d.noise[2])
    greatest = weigh(b, d, 3, states, p.told, i)
    if greatest > 0.0:
        settle(d, 3, states, p.told, i, -1.0, p.gate, p.refused)
    return greatest


def in_map(b, p, i, d):
    """Write what pose i says beyond the pose in the map, and its derivatives; return by how many states."""
    states = 3
    locate(b.x, b.P, b.frame, d.located)
    for row in range(3):
        d.e[row] = p.z[i, row] - d.located[row]
        for j in range(3):
            d.by[j] = 1.0 if j == row else 0.0
        states = derive(b, False, d.by[0], d.by[1], d.by[2], d.singles + row, d)
    return states


def since_kept(b, p, i, d):
    """Write what the motion to pose i says beyond that since the kept pose, its derivatives and its noise."""
    moved_by_source(p, i, d)
    if p.drifts[i]:
        way_noise(d.e, p.by_way, p.turn_by_way, p.arm, p.floor, p.turn_floor, d.noise)
    else:
        for j in range(6):
            d.triangle[j] = d.noise[j]
        turned_noise(d.triangle, -p.z[p.last, 2], d.noise)
    see_kept(b, p.at_kept, d)
    for row in range(3):
        d.e[row] -= d.apart[row]
        for j in range(3):
            state_of(d, d.singles + row, j, j, d.apart[12 + 3 * row + j])
            state_of(d, d.singles + row, 3 + j, p.at_kept + j, d.apart[3 + 3 * row + j])


def moved_by_source(p, i, d):
    """Write the source's own motion since its last pose over e (3,)."""
    for j in range(3):
        d.by[j], d.place[j] = p.z[p.last, j], p.z[i, j]
    see_from(d.by, d.place, d.apart)
    for j in range(3):
        d.e[j] = d.apart[j]


def see_kept(b, at, d):
    """Write the pose as it is seen from the one that the states from column `at` on keep, and its derivatives."""
    for j in range(3):
        d.by[j], d.place[j] = b.x[at + j], b.x[j]
    see_from(d.by, d.place, d.apart)


def begin_pose(b, p, i, d):
    """Keep the pose of reading i; in a frame that stands still carry on the one that is kept."""
    if not p.in_map:
        if p.drifts[i]:
            keep_pose(b.x, b.P, b.n, p.at_kept)
        else:
            moved_by_source(p, i, d)
            carry(b.x, b.P, b.n, p.at_kept, d.e)
        p.last = i


def carry(x, P, n, column, u):
    """Let three states that are a pose move on by the relative pose u (3,), which is exact."""
    heading = x[column + 2]
    c = s = heading - heading
    if c == 0.0:
        c, s = cos(heading), sin(heading)
    dx, dy = c * u[0] - s * u[1], s * u[0] + c * u[1]
    x[column] += dx
    x[column + 1] += dy
    x[column + 2] += u[2]
    swing(P, n, column, dx, dy)
