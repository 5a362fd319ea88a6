"""How straight are the walls? Found without a pose: the angle between two walls stays as the robot moves.

Where it changes by more than the fits' noise allows, the walls are not planes: plaster, door frames, things that
lean on them. That is a floor under the noise of every line: none in a simulated room, 0.5° in an old corridor.
"""

from __future__ import annotations

import math

import numpy as np

from .data import Array, Ints
from .se2 import wrap_all
from .sensors.base import WheelMotion

LAG = 20  # scans: far enough that another part of a wall is seen, near enough that it is the same wall
SURE = math.radians(0.6)  # standard deviation of a line's angle above which it says nothing about floors
NEAR_TURN, NEAR_OFFSET = 0.3, 0.3  # rad, m: a line this near to where the wheels expect it is the same wall
ENOUGH = 150  # pairs of walls
MISFIT = 1.35  # median change over its noise from which walls are not flat; below it is chance
MEDIAN = 0.455  # of chi-square with one degree of freedom
OFFSET_PER_ANGLE = 1.3  # m per rad: 8 mm with 0.35 degrees


def wall_floor(t: Array, first: Ints, z: Array, variance: Array, wheels: WheelMotion) -> tuple[float, float]:
    """Return the floors of r [m] and psi [rad] that the walls ask for, (0, 0) where they are flat or too few.

    z (m, 2) lines of scans at t (n,), owned by first (n + 1,); variance (m,) of psi by the fit [rad^2].
    """
    change, noise = _changes(t, first, z, variance, wheels)
    if len(change) < ENOUGH or 1.4826 * float(np.median(np.abs(change) / np.sqrt(noise))) < MISFIT:
        return 0.0, 0.0
    low, high = 0.0, math.radians(2.0)
    for _ in range(30):  # the floor under which the median of change^2 / variance is what it should be
        floor = 0.5 * (low + high)
        if np.median(change**2 / (noise + 4.0 * floor**2)) > MEDIAN:
            low = floor
        else:
            high = floor
    return float(OFFSET_PER_ANGLE * floor), float(floor)


def _changes(t: Array, first: Ints, z: Array, variance: Array, wheels: WheelMotion) -> tuple[Array, Array]:
    """Return how the angle between two walls changed over LAG scans [rad], and its variance by the fits."""
    sure = variance < SURE**2
    motion = wheels.relative(t[:-LAG], t[LAG:]) if len(t) > LAG else np.zeros((0, 3))
    change: list[Array] = []
    noise: list[Array] = []
    for i, u in enumerate(motion):
        a = first[i] + np.flatnonzero(sure[first[i] : first[i + 1]])
        b = first[i + LAG] + np.flatnonzero(sure[first[i + LAG] : first[i + LAG + 1]])
        if len(a) < 2 or len(b) < 2:
            continue
        turn = wrap_all(z[a, 1, None] - u[2] - z[None, b, 1])
        shift = (z[a, 0] - u[0] * np.cos(z[a, 1]) - u[1] * np.sin(z[a, 1]))[:, None] - z[None, b, 0]
        cost = (turn / NEAR_TURN) ** 2 + (shift / NEAR_OFFSET) ** 2
        j, rows = cost.argmin(axis=1), np.arange(len(a))
        same = (cost[rows, j] < 1.0) & (cost.argmin(axis=0)[j] == rows)
        turned, both = turn[rows, j][same], (variance[a] + variance[b[j]])[same]
        change.append(np.diff(turned))
        noise.append(both[1:] + both[:-1])
    return np.concatenate([np.zeros(0), *change]), np.concatenate([np.zeros(0), *noise])
