"""Tidying a growing map: lines that were seen too rarely are removed, doubles are merged.

Joining two lines that are one wall is how loops close: the constraint "these are equal" is a measurement with a
stated noise, and the filter carries it into every state that depends on either.
"""

from __future__ import annotations

import math

import numpy as np

from locfuse.fusion.data import Array, Ints
from locfuse.fusion.ekf.belief_arrays import JointBelief
from locfuse.fusion.kernels import sight
from locfuse.fusion.se2 import wrap

from .line_map import LineMap

TIDY_EVERY_SCANS = 10  # scans
MIN_HITS = 4
TRIAL_SCANS = 15  # scans after its birth in which a line must earn its hits
# further apart is two walls, whatever the covariance
DOUBLE_ANGLE_RAD, DOUBLE_OFFSET_M = math.radians(8.0), 0.25
MAX_GAP_M = 0.3  # m along the wall between two pieces that may still be one
MAY_BE_ONE = sight.Doubles(MIN_HITS, TRIAL_SCANS, DOUBLE_ANGLE_RAD, DOUBLE_OFFSET_M, MAX_GAP_M)
DOUBLE_D2 = 9.2  # chi-square with 2 degrees of freedom at 99 %
FLAT_SIGMAS = np.array([0.005, math.radians(0.2)])  # m, rad: how well two pieces of one flat wall agree


def untidy(lines: LineMap, belief: JointBelief, scan: int) -> bool:
    """Return whether `prune` or `merge_doubles` may find anything."""
    n = len(lines)
    return sight.untidy(belief, lines.table(), MAY_BE_ONE, scan, np.empty((n, 4)), np.empty(n, np.intp))


def prune(lines: LineMap, belief: JointBelief, scan: int) -> None:
    """Drop lines that are TRIAL_SCANS scans old and were hardly seen since: people, poles, bad fits."""
    walls = lines.table()
    gone = np.array([j for j in range(len(lines)) if sight.worthless(walls, j, scan, MAY_BE_ONE)], np.int64)
    if len(gone):
        belief.remove(lines.drop(gone))


def merge_doubles(lines: LineMap, belief: JointBelief, scan: int, uneven: Array) -> None:
    """Join recently seen lines with any line that is statistically the same wall, facing the same way.

    `uneven` (2,) is the variance [m^2, rad^2] by which a piece of wall is off its line: two pieces differ by both.
    """
    R = np.diag(np.maximum(FLAT_SIGMAS**2, 2.0 * uneven))
    recent = np.flatnonzero(scan - lines.seen <= TRIAL_SCANS)[::-1]
    while len(recent):
        values = lines.values(belief)
        recent = recent[[len(_near(lines, values, j)) > 0 for j in recent.tolist()]]
        pairs = ((j, i) for j in recent.tolist() if (i := _double_of(lines, belief, j, R)) is not None)
        found = next(pairs, None)
        if found is None:
            return
        j, i = found
        _join(lines, belief, min(i, j), max(i, j), R)
        recent = recent[recent < j]


def _near(lines: LineMap, values: Array, j: int) -> Ints:
    """Return which lines (k,) may be one wall with line j, by their positions."""
    rows, found = np.concatenate((values, lines.anchor), axis=1), np.empty(len(lines), np.intp)
    return found[: sight.neighbours(rows, lines.table(), j, MAY_BE_ONE, found)]


def _double_of(lines: LineMap, belief: JointBelief, j: int, R: Array) -> int | None:
    """Return the line that is most clearly the same wall as line j, None where there is none."""
    values = lines.values(belief)
    best, found = DOUBLE_D2, None
    for i in _near(lines, values, j).tolist():
        y, H, _, _ = _difference(lines, values, i, j)
        S = H @ _joint(lines, belief, i, j) @ H.T + R
        d2 = float(y @ np.linalg.solve(S, y))
        if d2 < best:
            best, found = d2, i
    return found


def _difference(lines: LineMap, values: Array, i: int, j: int) -> tuple[Array, Array, float, float]:
    """Return y = line i - line j about i's anchor, dy/d(i, j) with the sign of H, and j's extent along i."""
    rho, beta = values[j]
    c, s = math.cos(beta), math.sin(beta)
    ax, ay = lines.anchor[j] - lines.anchor[i]
    turn = wrap(float(values[i, 1] - beta))
    y = np.array([values[i, 0] - (rho + ax * c + ay * s), turn])
    H = np.array([[-1.0, 0.0, 1.0, ay * c - ax * s], [0.0, -1.0, 0.0, 1.0]])
    along = ay * math.cos(values[i, 1]) - ax * math.sin(values[i, 1])
    return y, H, float(lines.lo[j] + along), float(lines.hi[j] + along)


def _columns(lines: LineMap, i: int, j: int) -> Ints:
    a, b = int(lines.column[i]), int(lines.column[j])
    return np.array([a, a + 1, b, b + 1])


def _joint(lines: LineMap, belief: JointBelief, i: int, j: int) -> Array:
    columns = _columns(lines, i, j)
    P: Array = belief.covariance[np.ix_(columns, columns)]
    return P


def _join(lines: LineMap, belief: JointBelief, i: int, j: int, R: Array) -> None:
    """Correct by the equality of lines i and j, then keep i with the extent of both."""
    y, H, lo, hi = _difference(lines, lines.values(belief), i, j)
    belief.know(y.tolist(), R.tolist(), _columns(lines, i, j).tolist(), H.tolist())
    lines.lo[i], lines.hi[i] = min(lines.lo[i], lo), max(lines.hi[i], hi)
    lines.hits[i] += lines.hits[j]
    lines.seen[i] = max(lines.seen[i], lines.seen[j])
    lines.born[i] = min(lines.born[i], lines.born[j])
    belief.remove(lines.drop(np.array([j])))
