"""Turns by a gyro: z_i - z_before = theta - theta_before + bias dt + noise, theta_before a state."""

from .filter import FINE, keep_heading
from .singles import say, settle, state_of, weigh


def surplus(turned, dt, bias, theta, before):
    """Return by how much a gyro of this bias turned further in dt than the heading did since `before` [rad]."""
    return turned - bias * dt - (theta - before)


def turn_noise(walk, dt, by_scale, turned):
    """Return the variance of a turn: an angle random walk [rad^2 / s], and a relative error of its scale."""
    off = by_scale * turned
    return walk * dt + off * off


def turned(b, g, i, d):
    """Compare the turn since the reading before with the belief; returns what `whiten` does.

    After a gap there is none. One within the rest that gave the bias is used up.
    """
    k, last, states = d.singles, g.last, 2
    if g.piece[i] != g.piece[last]:
        return FINE
    if g.rest_begin <= g.t[last] and g.t[i] <= g.rest_end:
        g.told[i, 0], g.told[i, 3] = g.repeated, g.gate
        return FINE
    dt, by = g.t[i] - g.t[last], g.z[i] - g.z[last]
    state_of(d, k, 0, 2, 1.0)
    state_of(d, k, 1, g.at_before, -1.0)
    bias = g.bias
    if g.at_bias >= 0:
        state_of(d, k, 2, g.at_bias, dt)
        bias, states = b.x[g.at_bias], 3
    y = surplus(by, dt, bias, b.x[2], b.x[g.at_before])
    say(d, k, y, turn_noise(g.walk, dt, g.by_scale, by), 0.0, 0)
    greatest = weigh(b, d, 1, states, g.told, i)
    if greatest > 0.0:
        settle(d, 1, states, g.told, i, -1.0, g.gate, g.refused)
    return greatest


def begin_turn(b, g, i):
    """Keep the heading of reading i."""
    keep_heading(b.x, b.P, b.n, g.at_before, 0.0)
    g.last = i
