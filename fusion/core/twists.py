"""Way and turn that a source of speeds summed up since a pose that the state keeps: the chord of an arc.

way sinc(turn / 2) = d_x cos(d_theta / 2) + d_y sin(d_theta / 2) + noise, d the pose seen from the kept one.
"""

from math import cos, sin

from .filter import FINE, keep_pose
from .fit import folded
from .poses import see_kept
from .singles import say, settle, state_of, weigh

CHORD = 14  # chord and turn (2), their derivatives by the kept pose (2, 3) and by the pose (2, 3)


def chord(d, out):
    """Write chord [m] and turn [rad] of a pose seen from a kept one, d (21,) by `see_from`: out (14,)."""
    half = 0.5 * d[2]
    c = s = half - half
    if c == 0.0:
        c, s = cos(half), sin(half)
    bent = 0.5 * (d[1] * c - d[0] * s)
    out[0], out[1] = d[0] * c + d[1] * s, d[2]
    for j in range(3):
        out[2 + j] = c * d[3 + j] + s * d[6 + j] + bent * d[9 + j]
        out[8 + j] = c * d[12 + j] + s * d[15 + j] + bent * d[18 + j]
        out[5 + j], out[11 + j] = d[9 + j], d[18 + j]


def straight(way, turn):
    """Return the chord [m] of an arc of so long a way [m], which turns by so much [rad]."""
    half = 0.5 * turn
    if half - half != 0.0 or half == 0.0:
        return way + (half - half)
    return way * sin(half) / half


def sum_noise(variance, by_scale, value, floor):
    """Return the variance of a sum of speeds: of the readings, by their scale, and the least that there is."""
    return variance + by_scale * value * value + floor


def driven(b, w, i, d):
    """Compare way and turn since the kept pose with the belief; after a gap there are none."""
    k, last = d.singles, w.last
    if w.piece[i] != w.piece[last]:
        return FINE
    way, turn = w.z[i, 0] - w.z[last, 0], w.z[i, 1] - w.z[last, 1]
    see_kept(b, w.at_kept, d)
    chord(d.apart, d.chord)
    for row in range(2):
        for j in range(3):
            state_of(d, k + row, j, j, d.chord[8 + 3 * row + j])
            state_of(d, k + row, 3 + j, w.at_kept + j, d.chord[2 + 3 * row + j])
    forward = sum_noise(w.variance[i, 0] - w.variance[last, 0], w.by_scale, way, w.floor)
    aside = sum_noise(w.variance[i, 1] - w.variance[last, 1], w.by_scale, turn, w.turn_floor)
    say(d, k, straight(way, turn) - d.chord[0], forward, 0.0, 0)
    say(d, k + 1, folded(turn - d.chord[1]), aside, 0.0, 1)
    greatest = weigh(b, d, 2, 6, w.told, i)
    if greatest > 0.0:
        settle(d, 2, 6, w.told, i, -1.0, w.gate, w.refused)
    return greatest


def begin_way(b, w, i):
    """Keep the pose of reading i."""
    keep_pose(b.x, b.P, b.n, w.at_kept)
    w.last = i
