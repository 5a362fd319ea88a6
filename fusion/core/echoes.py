"""The echo of a sonar: which wall of the line map must have answered, and how far away it is.

With the sonar at p and the wall n.(q - a) = rho it is rho - n.(p - a) (eq. 17 without its sign).
"""

from math import atan2, cos, log, pi, sin, sqrt, tan

from .filter import FINE
from .fit import folded
from .singles import derive, say, settle, state_of, weigh

OVERHANG = 0.05  # m: a wall may go on this far beyond what was seen of it
CLEAR = 3.0  # standard deviations by which something may stand nearer before it is the one to answer
CLUTTER = 0.25  # share of the echoes that come from something the map lacks, anywhere before the wall
SQUARE = 1e-6  # cosine from which an edge of the cone meets a wall at all
FAR = 1e300  # m
ECHO = 6  # distance [m], -n by x and y, by the heading, by beta, and the variance of a wall that is no state


def answering(x, w, px, py, theta, lever_x, lever_y, yaw, half, widen, sigma, out):
    """Return the nearest wall that stands square to the cone; -1: there is none, or something stands nearer.

    A robot at (px, py, theta) carries the sonar at `lever` and `yaw`, which hears `half` an angle to either side;
    walls count up to `widen` beyond. `sigma` [m] is that of an echo. Written is out (6,), as ECHO says.
    """
    c = s = theta - theta  # NaN where there is no heading
    if c == 0.0:
        c, s = cos(theta), sin(theta)
    lx, ly = c * lever_x - s * lever_y, s * lever_x + c * lever_y
    cone = max(min(half, pi), 0.0)  # none is wider than all around, whatever a message says
    best, nearest = -1, FAR
    for j in range(w.places):
        rho, beta = rho_of(x, w, j), beta_of(x, w, j)
        off = folded(beta - theta - yaw)
        if off - off != 0.0:  # no angle
            continue
        n_x, n_y = cos(beta), sin(beta)
        dx, dy = px + lx - w.anchors[j, 0], py + ly - w.anchors[j, 1]
        distance, foot = rho - dx * n_x - dy * n_y, dy * n_x - dx * n_y
        if not distance > 0.0:
            continue
        on_it = w.low[j] - OVERHANG <= foot <= w.high[j] + OVERHANG
        if abs(off) <= cone + widen and on_it:
            if best < 0 or distance < out[0]:
                best = j
                out[0], out[1], out[2], out[3], out[4] = distance, -n_x, -n_y, n_x * ly - n_y * lx, -foot
        else:
            nearest = min(nearest, slanted(w, j, distance, foot, off, cone))
    if best < 0 or nearest < out[0] - CLEAR * sigma:
        return -1
    out[5] = 0.0
    if not w.states:
        at, u = w.width * best, out[4]
        out[5] = w.fixed[at + 4] + u * (2.0 * w.fixed[at + 5] + u * w.fixed[at + 6])
    return best


def rho_of(x, w, j):
    """Return rho of wall j."""
    return x[w.columns[j]] if w.states else w.fixed[w.width * j]


def beta_of(x, w, j):
    """Return beta of wall j."""
    return x[w.columns[j] + 1] if w.states else w.fixed[w.width * j + 1]


def slanted(w, j, distance, foot, off, half):
    """Return the distance at which an edge of the cone meets wall j, or at which the wall ends in the cone."""
    nearest = FAR
    for side in range(2):
        edge = half if side else -half
        slope = cos(off - edge)
        if slope > SQUARE:
            met = foot + distance * tan(edge - off)
            if w.low[j] <= met <= w.high[j]:
                nearest = min(nearest, distance / slope)
        along = (w.high[j] if side else w.low[j]) - foot
        if abs(folded(atan2(along, distance) + off)) <= half:
            nearest = min(nearest, sqrt(distance * distance + along * along))
    return nearest


def likelier(distance, sigma):
    """Return the squared distance up to which N(y; 0, sigma) outweighs clutter, uniform over `distance` [m]."""
    odds = (1.0 - CLUTTER) / CLUTTER * distance / (sqrt(2.0 * pi) * sigma)
    if not odds > 1.0:
        return 0.0
    return 2.0 * log(odds)


def hear(b, w, e, i, d):
    """Compare echo i with the wall that must have answered; returns what `whiten` does."""
    row, k, states = e.first[i], d.singles, 0
    if row == e.first[i + 1] or w.places == 0:
        return FINE
    wall = answering(
        b.x, w, b.x[0], b.x[1], b.x[2], e.cones[row, 0], e.cones[row, 1], e.cones[row, 2], e.cones[row, 3],
        e.widen, sqrt(max(e.r[row], 0.0)), d.echo,
    )  # fmt: skip
    if wall < 0:
        e.told[row, 0], e.told[row, 3] = e.unmatched, e.gate
        return FINE
    states = derive(b, True, d.echo[1], d.echo[2], d.echo[3], k, d)
    if w.states:
        state_of(d, k, 3, w.columns[wall], 1.0)
        state_of(d, k, 4, w.columns[wall] + 1, d.echo[4])
        states = 5
    say(d, k, e.z[row] - d.echo[0], e.r[row] + d.echo[5], 0.0, 0)
    greatest = weigh(b, d, 1, states, e.told, row)
    if greatest > 0.0:
        gate = min(e.gate, likelier(d.echo[0], e.told[row, 5]))
        settle(d, 1, states, e.told, row, w.ids[wall], gate, e.refused)
    return greatest
