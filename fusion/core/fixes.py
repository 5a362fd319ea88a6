"""A fix by satellites: how the place on the earth depends on the pose, and on the tie between map and earth.

(east, north) = R(e) (p - p_ref) + (c, d) + noise, p the antenna's place in the map, e the direction of east.
"""

from math import cos, sin

from .filter import locate
from .singles import derive, say, settle, state_of, weigh

FIX = 16  # h (2,), its derivatives by the pose (2, 3) and by the tie (2, 4), row by row


def fix(x, y, theta, lever_x, lever_y, from_x, from_y, tie, known, out):
    """Write the fix [m] of an antenna at `lever` on the base, seen from p_ref = `from`, and its derivatives.

    The tie (4,) is (cos e, sin e, c, d), in which the fix is linear, or where e is `known` (e, 1, c, d).
    """
    c = s = theta - theta  # NaN where there is no heading
    if c == 0.0:
        c, s = cos(theta), sin(theta)
    lx, ly = c * lever_x - s * lever_y, s * lever_x + c * lever_y
    dx, dy = x + lx - from_x, y + ly - from_y
    a, b = tie[0], tie[1]
    if known:
        a = b = tie[0] - tie[0]
        if a == 0.0:
            a, b = cos(tie[0]), sin(tie[0])
    out[0], out[1] = a * dx + b * dy + tie[2], a * dy - b * dx + tie[3]
    out[2], out[3], out[4] = a, b, b * lx - a * ly
    out[5], out[6], out[7] = -b, a, b * ly + a * lx
    out[8], out[9], out[10], out[11] = dx, dy, 1.0, 0.0
    out[12], out[13], out[14], out[15] = dy, -dx, 0.0, 1.0
    if known:
        out[8], out[9], out[12], out[13] = a * dy - b * dx, 0.0, -a * dx - b * dy, 0.0


def locate_fix(b, f, i, d):
    """Compare fix i with the belief, and tell what became of it; returns what `whiten` does."""
    k, states = d.singles, 0
    locate(b.x, b.P, b.frame, d.located)
    x, y, theta = d.located[0], d.located[1], d.located[2]
    for j in range(4):
        d.tie[j] = b.x[f.at + j] if f.at >= 0 else f.tie[j]
    fix(x, y, theta, f.lever_x, f.lever_y, f.from_x, f.from_y, d.tie, f.known, d.fix)
    for row in range(2):
        states = derive(b, False, d.fix[2 + 3 * row], d.fix[3 + 3 * row], d.fix[4 + 3 * row], k + row, d)
        if f.at >= 0:
            for j in range(4):
                state_of(d, k + row, states + j, f.at + j, d.fix[8 + 4 * row + j])
            states += 4
    say(d, k, f.z[i, 0] - d.fix[0], f.R[i, 0], 0.0, 0)
    say(d, k + 1, f.z[i, 1] - d.fix[1], f.R[i, 2], f.R[i, 1], 1)
    greatest = weigh(b, d, 2, states, f.told, i)
    if greatest > 0.0:
        settle(d, 2, states, f.told, i, -1.0, f.gate, f.refused)
    return greatest
