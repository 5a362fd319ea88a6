"""Range and bearing to landmarks with ids (Thrun, Burgard and Fox 2005, 6.6.2), whose places may be states.

range = |d| (1 - k (1 - cos b)) + offset + noise with b as it was measured, d from the detector to the landmark.
"""

from math import cos, sin, sqrt

from .bearings import bearing
from .filter import FINE, locate
from .fit import folded
from .singles import derive, fit_of, say, settle, state_of, variance, weigh

LEAST_SHARE = 0.1  # of a distance that a depth is taken for at least: a detector looks ahead
TOUCHING = 1e-3  # m: nearer than this a bearing has no direction


def by_range(ray, x, y, share, out):
    """Write the derivative by the pose (3,) of a `share` of the distance along a ray of `bearing`."""
    r = share * ray[7]
    out[0], out[1], out[2] = ray[2] * r, -ray[1] * r, -(x * ray[4] + y * ray[5]) * r


def shortened(angle):
    """Return 1 - cos of a bearing [rad]: what share a depth along the axis falls short of a distance."""
    c = angle - angle  # NaN where there is no bearing
    if c == 0.0:
        c = cos(angle)
    return 1.0 - c


def share_of(depth, short):
    """Return the share of the distance that a range is, of which a share `depth` is depth along the axis."""
    return max(1.0 - depth * short, LEAST_SHARE)


def placed(x, y, theta, mount_x, mount_y, yaw, distance, angle, out):
    """Write where a landmark stands (2,) that a robot at (x, y, theta) detects at this distance and bearing."""
    c = s = theta - theta
    turn = theta + yaw + angle
    t = u = turn - turn
    if c == 0.0 and t == 0.0:
        c, s, t, u = cos(theta), sin(theta), cos(turn), sin(turn)
    out[0] = x + c * mount_x - s * mount_y + distance * t
    out[1] = y + s * mount_x + c * mount_y + distance * u


def unknown(g, i):
    """Tell whether reading i shows a landmark whose place is to become a state."""
    found = 0
    for row in range(g.first[i], g.first[i + 1]):
        if g.made and g.columns[g.which[row]] < 0:
            found += 1
    return found > 0


def detect(b, g, i, whole, d):
    """Compare the detections of reading i with the belief; returns what `whiten` does.

    How well they fit as a `whole` is noted, where that is asked.
    """
    before, accepted, greatest = d.singles, 0, FINE
    locate(b.x, b.P, b.frame, d.located)
    for row in range(g.first[i], g.first[i + 1]):
        n = d.singles
        greatest = detect_one(b, g, row, d)
        if not greatest > 0.0:
            return greatest
        if d.singles > n:
            accepted += 1
    if whole and accepted > 1:
        greatest = fit_of(b, d, before, d.singles, g.joint, i)
    return greatest


def detect_one(b, g, row, d):
    """Compare one detection with the place of its landmark."""
    k, mark, local = d.singles, g.which[row], g.made
    if local:
        x, y, theta = b.x[0], b.x[1], b.x[2]
        to_x, to_y = b.x[g.columns[mark]], b.x[g.columns[mark] + 1]
    else:
        x, y, theta = d.located[0], d.located[1], d.located[2]
        to_x, to_y = g.places[mark, 0], g.places[mark, 1]
    d.place[0], d.place[1], d.place[2] = x, y, theta
    lever_x, lever_y = g.mounts[row, 0], g.mounts[row, 1]
    if not bearing(d.place, to_x, to_y, lever_x, lever_y, g.mounts[row, 2], TOUCHING, d.ray):
        return FINE
    states = derive(b, local, d.ray[1], d.ray[2], 0.0, k, d)
    bend = variance(b.P, d, k, states)  # not linear in the position: second-order (sigma of it / distance)^4
    states = derive(b, local, d.ray[1], d.ray[2], d.ray[3], k, d)
    say(d, k, folded(g.z[row, 0] - d.ray[0]), g.R[row, 0] + bend * bend, 0.0, 0)
    if g.numbers > 1:
        offset = b.x[g.at_offset] if g.at_offset >= 0 else g.offset
        depth = b.x[g.at_depth] if g.at_depth >= 0 else g.depth
        short = shortened(g.z[row, 0])
        share = share_of(depth, short)
        by_range(d.ray, lever_x, lever_y, share, d.by)
        derive(b, local, d.by[0], d.by[1], d.by[2], k + 1, d)
        say(d, k + 1, g.z[row, 1] - share * d.ray[7] - offset, g.R[row, 2], g.R[row, 1], 1)
        states = add_states(g, mark, short, states, k, d)
        distance = (g.z[row, 1] - offset) / share
        if not g.made:
            keep_place(b, g, row, distance, k + 2, d)
    greatest = weigh(b, d, g.numbers, states, g.told, row)
    if greatest > 0.0:
        settle(d, g.numbers, states, g.told, row, g.ids[mark], g.gate, g.refused)
    return greatest


def add_place(g, mark, states, k, d):
    """Add the place of a landmark: what moves it moves what is seen as the robot does, the other way."""
    for row in range(k, k + 2):
        state_of(d, row, states, g.columns[mark], -d.own_H[row, 0])
        state_of(d, row, states + 1, g.columns[mark] + 1, -d.own_H[row, 1])
    return states + 2


def add_states(g, mark, short, states, k, d):
    """Add to rows k (bearing) and k + 1 (range) the states beside the pose; return how many there are then."""
    if g.made:
        states = add_place(g, mark, states, k, d)
    if g.at_offset >= 0:
        state_of(d, k, states, g.at_offset, 0.0)
        state_of(d, k + 1, states, g.at_offset, 1.0)
        states += 1
    if g.at_depth >= 0:
        state_of(d, k, states, g.at_depth, 0.0)
        state_of(d, k + 1, states, g.at_depth, -short * d.ray[7])
        states += 1
    return states


def keep_place(b, g, row, distance, k, d):
    """Write where detection `row` puts its landmark, with its sigma, if the robot's own place is known so well."""
    greatest = 0.0
    for axis in range(2):
        states = derive(b, False, 1.0 - axis, 1.0 * axis, 0.0, k, d)
        greatest = max(greatest, variance(b.P, d, k, states))
    if not greatest <= g.most * g.most:
        return
    lever_x, lever_y, yaw = g.mounts[row, 0], g.mounts[row, 1], g.mounts[row, 2]
    placed(d.place[0], d.place[1], d.place[2], lever_x, lever_y, yaw, distance, g.z[row, 0], d.by)
    across = distance * g.sigma_bearing
    g.placed[row, 0], g.placed[row, 1] = d.by[0], d.by[1]
    g.placed[row, 2] = sqrt(greatest + g.sigma_range * g.sigma_range + across * across)
