"""How straight are the walls? Measured without a pose: the angle between two walls is constant as the robot moves.

Where it changes by more than the fits' noise allows, the walls are not planes: plaster, door frames, things that
lean on them. That is a floor under the noise of every line: none in a simulated room, 0.5° in an old corridor.
"""

from __future__ import annotations

import math

import numpy as np

from locfuse.fusion.chi_square import MAD
from locfuse.fusion.data import Array, Ints
from locfuse.fusion.sensor import WheelMotion

from .scans import blocks, misfit, nearest, turn_of

LAG_SCANS = 20  # scans: far enough that another part of a wall is seen, near enough that it is the same wall
MAX_SIGMA_RAD = math.radians(0.6)  # standard deviation of a line's angle above which it says nothing about floors
MAX_SAME_TURN_RAD, MAX_SAME_OFFSET_M = 0.3, 0.3  # a line this near to where the wheels expect it: the same wall
MIN_PAIRS = 150  # pairs of walls
MIN_MISFIT_RATIO = 1.2  # median change over its noise from which walls are not flat; below it is chance
CHI_SQUARE_MEDIAN = 0.455  # of chi-square with one degree of freedom
OFFSET_PER_ANGLE_M = 1.3  # m per rad: 8 mm with 0.35 degrees


def wall_floor(
    t: Array, first: Ints, z: Array, variance: Array, wheels: WheelMotion, sweep: Array | None = None
) -> tuple[float, float]:
    """Return the floors of r [m] and psi [rad] that the walls need, (0, 0) if they are flat or too few.

    z (m, 2) lines of scans at t (n,), owned by first (n + 1,); variance (m,) of psi by the fit [rad^2].
    `sweep` (m, k): what psi owes to wheels that slip within a scan, which its lines share (lines.extract) [rad].
    """
    change, noise = _changes(t, first, z, variance, wheels, np.zeros((len(z), 0)) if sweep is None else sweep)
    if len(change) < MIN_PAIRS or float(np.median(np.abs(change) / np.sqrt(noise))) < MAD * MIN_MISFIT_RATIO:
        return 0.0, 0.0
    low, high = 0.0, math.radians(2.0)
    for _ in range(30):  # the floor under which the median of change^2 / variance is what it should be
        floor = 0.5 * (low + high)
        if np.median(change**2 / (noise + 4.0 * floor**2)) > CHI_SQUARE_MEDIAN:
            low = floor
        else:
            high = floor
    return float(OFFSET_PER_ANGLE_M * floor), float(floor)


def bend(uneven: Array) -> Array:
    """Return the variance (2,) by which a wall differs from scan to scan, given that of its unevenness.

    What is uneven about a wall repeats while the same part of it is seen, so it does not average out. As a random
    walk of the line that explains the change over LAG_SCANS scans, 2 `uneven`, it does not either.
    """
    return 2.0 * uneven / LAG_SCANS


def _changes(
    t: Array, first: Ints, z: Array, variance: Array, wheels: WheelMotion, sweep: Array
) -> tuple[Array, Array]:
    """Return how the angle between two walls changed over LAG_SCANS scans [rad], and its variance by the fits."""
    sure = variance < MAX_SIGMA_RAD**2
    first = np.concatenate(([0], np.cumsum(sure)))[first]  # from here on the sure lines only
    z, variance, sweep = z[sure], variance[sure], sweep[sure]
    several = np.diff(first) >= 2
    before = (
        np.flatnonzero(several[:-LAG_SCANS] & several[LAG_SCANS:]) if len(t) > LAG_SCANS else np.zeros(0, np.int64)
    )
    motion = wheels.relative(t[before], t[before + LAG_SCANS])
    change, noise = [np.zeros(0)], [np.zeros(0)]
    for at, a, b in blocks(first, before, before + LAG_SCANS):
        x, y, theta = motion[at].T[:, :, None]
        r, psi = z[a.row].transpose(2, 0, 1)
        shift = (r - x * np.cos(psi) - y * np.sin(psi))[:, :, None] - z[b.row, 0][:, None, :]
        turn = turn_of(psi - theta, z[b.row, 1])
        cost = misfit(turn, shift, (MAX_SAME_TURN_RAD, MAX_SAME_OFFSET_M), a, b)
        turned, least, j = nearest(turn, cost)
        mutual = np.take_along_axis(cost.argmin(axis=1), j, 1) == np.arange(j.shape[1])
        scan, i = np.nonzero((least < 1.0) & mutual)
        one, other = a.row[scan, i], b.row[scan, j[scan, i]]
        both = variance[one] + variance[other]
        slip = sum((np.diff(sweep[rows], axis=0) ** 2).sum(axis=1) for rows in (one, other))
        same_scan = np.diff(scan) == 0
        change.append(np.diff(turned[scan, i])[same_scan])
        noise.append((both[1:] + both[:-1] + slip)[same_scan])
    return np.concatenate(change), np.concatenate(noise)
