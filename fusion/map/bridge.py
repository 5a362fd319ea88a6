"""From one map to the next: the walls in view lead over, with all that they have in common.

Seen from the robot, all walls share the error of its pose. It is kept in the covariance: how the walls lie to each
other is known far better than how they lie to the robot, and the next map begins with just that.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from locfuse.fusion.data import Array, Ints
from locfuse.fusion.ekf.belief_arrays import JointBelief

from .line_map import LineMap

TINY, SHARE = 1e-18, 1e-9  # m^2, rad^2; of a variance: what is known exactly can be inverted beside the rest


class Bridge(NamedTuple):
    """k walls as the robot should see them."""

    r: Array  # (k,) m, from the robot
    psi: Array  # (k,) rad, base frame
    ends: Array  # (k, 2) m along the tangent (-sin psi, cos psi)
    hits: Ints  # (k,) how often each was seen
    P: Array  # (2k, 2k) covariance of r and psi of all of them, wall by wall


def seen_from_here(lines: LineMap, at: Ints, belief: JointBelief) -> Bridge:
    """Return the walls `at` (k,) of a map, which are states, as they are seen from the pose."""
    seen = lines.predict(at, lines.values(belief), belief)
    ax, ay = lines.anchor[at].T
    along = seen.cos * (belief.y - ay) - seen.sin * (belief.x - ax)
    ends = np.stack((lines.lo[at] - along, lines.hi[at] - along), axis=-1)
    k = np.arange(len(at))
    by = np.zeros((len(at), 2, 3 + 2 * len(at)))  # the pose, then the walls, as in kernels.sight
    by[:, 0, 0], by[:, 0, 1], by[:, 1, 2] = -seen.cos, -seen.sin, -1.0
    by[k, 0, 3 + 2 * k], by[k, 0, 4 + 2 * k], by[k, 1, 4 + 2 * k] = 1.0, seen.u, 1.0
    H = by.reshape(2 * len(at), -1)
    states = np.concatenate((np.arange(3), lines.states(at)))
    P = H @ belief.covariance[np.ix_(states, states)] @ H.T
    return Bridge(seen.r, seen.psi, ends, lines.hits[at], 0.5 * (P + P.T))


def heading_among(lines: LineMap, at: Ints, belief: JointBelief) -> float:
    """Return how well the heading is known where the walls `at` (k,) are given, 1 sigma [rad].

    That is what the last scans say of it, whatever the robot and its walls have drifted together.
    """
    states = np.append(2, lines.states(at))
    P = belief.covariance[np.ix_(states, states)]
    size = np.sqrt(np.maximum(np.diagonal(P), TINY))
    unit = P / np.outer(size, size) + SHARE * np.eye(len(P))
    return float(size[0] / np.sqrt(np.linalg.inv(unit)[0, 0]))


def cross(bridge: Bridge, lines: LineMap, belief: JointBelief, scan: int) -> None:
    """Begin a map with the walls of a bridge; the pose is exactly 0. `scan` is the number of the last scan.

    Each wall's anchor is the middle of what was seen of it, so rho about it is 0 and beta is psi.
    """
    c, s = np.cos(bridge.psi), np.sin(bridge.psi)
    middle, half = bridge.ends.mean(axis=1), 0.5 * np.diff(bridge.ends, axis=1)[:, 0]
    anchors = np.stack((bridge.r * c - middle * s, bridge.r * s + middle * c), axis=-1)
    values = np.stack((np.zeros(len(c)), bridge.psi), axis=-1)
    T = np.eye(2 * len(c))
    k = 2 * np.arange(len(c))
    T[k, k + 1] = -middle
    P = T @ bridge.P @ T.T
    first = belief.augment(values.reshape(-1), np.zeros((2 * len(c), 3)), P)
    for j, (anchor, value) in enumerate(zip(anchors, values, strict=True)):
        own = slice(2 * j, 2 * j + 2)
        lines.append(anchor, value, P[own, own], first + 2 * j, (-float(half[j]), float(half[j])), scan)
    lines.hits[:] = bridge.hits
