"""Which map lines may a measured line be? Candidate pairs with their innovations, in plain floats or in arrays.

A scan of a few lines in a room of a few walls is too small for arrays, where NumPy's call overhead is most of the
cost; against the hundreds of lines of a building a loop would be. Both find the same pairs (tests/test_pairing).
"""

from __future__ import annotations

import math
from math import copysign, log, remainder, sqrt

import msgspec
import numpy as np

from locfuse.fusion.data import Array, Ints
from locfuse.fusion.ekf.belief_arrays import JointBelief
from locfuse.fusion.se2 import wrap_all

from .laser_mount import mount_spread
from .line_map import AnyBelief, LineMap, PlainLine, line_spread
from .scan import Scan

MAX_PAIR_ANGLE_RAD = math.radians(25.0)  # pairs further apart are not looked at
MAX_PAIR_OFFSET_M = 1.0  # m
PAIR_SIGMAS = 6.0  # added to both
FACE_SIGMAS = 3.0
FEW = 32  # map lines up to which a loop is faster than arrays
TURN, HALF_TURN, QUARTER = 2.0 * math.pi, math.pi, 0.5 * math.pi


class Pair(msgspec.Struct, frozen=True, gc=False):
    """A measured line that may be a map line. Symmetric 2 x 2 matrices are (00, 01, 11)."""

    line: int  # of the scan
    which: int  # position in the map
    column: int  # of the map line in the state, -1: frozen
    y: tuple[float, float]  # innovation, after flipping where the sign demands it
    R: tuple[float, float, float]  # of what is independent of the state: the map's covariance is, where it is none
    S: tuple[float, float, float]
    d2: float
    score: float  # d2 + ln det S
    lo: float  # m, ends of the measured segment along the map line
    hi: float
    overlap: float  # m, negative where the segments are apart
    cos: float  # of the map line's beta
    sin: float
    u: float  # dr/dbeta
    psi: float  # rad, measured, base frame, as the map line's psi is predicted: not wrapped


class _Wall(msgspec.Struct, frozen=True, gc=False):
    """A map line as the robot should see it."""

    column: int  # of the line in the state, -1: frozen
    cos: float  # of beta
    sin: float
    along: float  # m, the robot's foot point from the line's anchor
    u: float
    spread: tuple[float, float, float]  # S without R
    own: tuple[float, float, float]  # its part that is independent of the state


def candidate_pairs(scan: Scan, lines: LineMap, belief: AnyBelief, limit: float) -> list[Pair]:
    """Return the pairs on the right face whose squared distance is at most `limit`, measured line by line."""
    if scan.seat is None and len(lines) <= FEW:
        return pairs_in_floats(scan, lines, belief, limit)
    return pairs_in_arrays(scan, lines, belief, limit)


def pairs_in_floats(scan: Scan, lines: LineMap, belief: AnyBelief, limit: float) -> list[Pair]:
    """Return candidate pairs by a loop over measured lines and map lines."""
    x, y, theta = belief.x, belief.y, belief.theta
    rows = pose_rows(belief)
    known = lines.plain(belief)
    angle_slack, offset_slack = _slack(rows[0][0] + rows[1][1], rows[2][2])
    widest = max([_angle_variance(line, rows[2]) for line in known])
    places = [  # as the robot should see them
        (j, line.beta - theta, line.rho - (x - line.x) * line.cos - (y - line.y) * line.sin)
        for j, line in enumerate(known)
    ]
    los, his = lines.lo.tolist(), lines.hi.tolist()
    walls: list[_Wall | None] = [None] * len(known)
    found = []
    for k, (r, psi, r00, r01, r11, begin, end) in enumerate(scan.rows()):
        slack = min(angle_slack, sqrt(limit * (widest + r11)))  # d2 is at least what the angle alone says
        for j, bearing, distance in places:
            if not (-offset_slack < r - distance < offset_slack or -offset_slack < r + distance < offset_slack):
                continue
            turn = remainder(psi - bearing, TURN)
            forward = -QUARTER <= turn <= QUARTER
            offset = r - distance
            if not forward:  # the other sign of (r, psi)
                turn -= copysign(HALF_TURN, turn)
                offset = -r - distance
            if not (-slack < turn < slack and -offset_slack < offset < offset_slack):
                continue
            wall = walls[j]
            if wall is None:
                wall = walls[j] = _seen(known[j], x, y, rows)
            p00, p01, p11 = wall.spread
            s00, s11 = p00 + r00, p11 + r11
            cross = r01 if forward else -r01
            s01 = p01 + cross
            det = s00 * s11 - s01 * s01
            if not det > 0.0:  # no float holds it
                continue
            d2 = (s11 * offset * offset - 2.0 * s01 * offset * turn + s00 * turn * turn) / det
            if not d2 <= limit or not distance > -FACE_SIGMAS * sqrt(s00):
                continue
            lo, hi = (wall.along + begin, wall.along + end) if forward else (wall.along - end, wall.along - begin)
            l00, l01, l11 = wall.own
            found.append(
                Pair(
                    k,
                    j,
                    wall.column,
                    (offset, turn),
                    (r00 + l00, cross + l01, r11 + l11),
                    (s00, s01, s11),
                    d2,
                    d2 + log(det),
                    lo,
                    hi,
                    min(hi, his[j]) - max(lo, los[j]),
                    wall.cos,
                    wall.sin,
                    wall.u,
                    bearing + turn,
                )
            )
    return found


def _slack(xy: float, tt: float) -> tuple[float, float]:
    """Return the angle [rad] and the offset [m] within which a pair is worth a covariance."""
    return MAX_PAIR_ANGLE_RAD + PAIR_SIGMAS * sqrt(max(tt, 0.0)), MAX_PAIR_OFFSET_M + PAIR_SIGMAS * sqrt(
        max(xy, 0.0)
    )


def _angle_variance(line: PlainLine, P_theta: list[float]) -> float:
    """Return the variance of beta - theta [rad^2]."""
    variance = P_theta[2] + line.P[2]
    return variance if line.column < 0 else variance - 2.0 * P_theta[line.column + 1]


def pose_rows(belief: AnyBelief) -> list[list[float]]:
    """Return the covariance of x, y, theta with the whole state, 3 rows of plain floats."""
    if isinstance(belief, JointBelief):
        rows: list[list[float]] = belief.covariance[:3].tolist()
        return rows
    xx, xy, xt, yy, yt, tt = belief.P
    return [[xx, xy, xt], [xy, yy, yt], [xt, yt, tt]]


def _seen(line: PlainLine, x: float, y: float, P: list[list[float]]) -> _Wall:
    """Predict a map line and its innovation covariance without R; maths.md, "line as a state"."""
    c, s, column = line.cos, line.sin, line.column
    m00, m01, m11 = line.P
    dx, dy = x - line.x, y - line.y
    u = dx * s - dy * c
    edge = m01 + u * m11
    l00, l01, l11 = m00 + u * (m01 + edge), edge, m11
    X, Y, T = P
    xx, xy, xt, yy, yt, tt = X[0], X[1], X[2], Y[1], Y[2], T[2]
    s00 = c * c * xx + 2.0 * c * s * xy + s * s * yy + l00
    s01 = c * xt + s * yt + l01
    s11 = tt + l11
    if column >= 0:  # the line is a state: it and the pose are correlated
        i, j = column, column + 1
        r_rho, r_beta = -c * X[i] - s * Y[i], -c * X[j] - s * Y[j]
        t_rho, t_beta = -T[i], -T[j]
        s00 += 2.0 * (r_rho + u * r_beta)
        s01 += r_beta + t_rho + u * t_beta
        s11 += 2.0 * t_beta
        l00 = l01 = l11 = 0.0
    return _Wall(column, c, s, dy * c - dx * s, u, (s00, s01, s11), (l00, l01, l11))


def pairs_in_arrays(scan: Scan, lines: LineMap, belief: AnyBelief, limit: float) -> list[Pair]:
    """Return candidate pairs by arrays over all measured lines and map lines."""
    values = lines.values(belief)
    c, s = np.cos(values[:, 1]), np.sin(values[:, 1])
    dx, dy = belief.x - lines.anchor[:, 0], belief.y - lines.anchor[:, 1]
    r = values[:, 0] - dx * c - dy * s
    P = belief.matrix()
    angle_slack, offset_slack = _slack(float(P[0, 0] + P[1, 1]), float(P[2, 2]))
    turn = wrap_all(scan.z[:, 1, None] - (values[:, 1] - belief.theta))
    flip = np.where(np.abs(turn) > QUARTER, -1.0, 1.0)
    turn = np.where(flip < 0, wrap_all(turn + math.pi), turn)
    offset = flip * scan.z[:, 0, None] - r
    line, which = np.nonzero((np.abs(turn) < angle_slack) & (np.abs(offset) < offset_slack))
    seen = lines.predict(which, values, belief)
    y = np.stack((offset[line, which], turn[line, which]), axis=-1)
    flip = flip[line, which]
    R = _flipped(scan.R[line], flip)
    S = seen.spread + R
    if scan.seat is not None and isinstance(belief, JointBelief):
        S += mount_spread(scan.seat, seen.psi + y[:, 1], seen, lines.column[which], belief)
    det = S[:, 0, 0] * S[:, 1, 1] - S[:, 0, 1] ** 2
    d2 = (S[:, 1, 1] * y[:, 0] ** 2 - 2.0 * S[:, 0, 1] * y[:, 0] * y[:, 1] + S[:, 0, 0] * y[:, 1] ** 2) / det
    keep = (seen.r > -FACE_SIGMAS * np.sqrt(S[:, 0, 0])) & (d2 <= limit) & (det > 0.0)
    along = seen.cos * (belief.y - lines.anchor[which, 1]) - seen.sin * (belief.x - lines.anchor[which, 0])
    ends = np.sort(flip[:, None] * scan.ends[line], axis=1) + along[:, None]
    overlap = np.minimum(ends[:, 1], lines.hi[which]) - np.maximum(ends[:, 0], lines.lo[which])
    frozen = (lines.column[which] < 0)[:, None, None]
    own = R + np.where(frozen, line_spread(lines.P[which], seen.u), 0.0)
    columns: list[Array | Ints] = [line, which, lines.column[which], y, _upper(own), _upper(S)]
    columns += [d2, d2 + np.log(det), *ends.T, overlap, seen.cos, seen.sin, seen.u, seen.psi + y[:, 1]]
    return [
        Pair(k, j, at, tuple(e), tuple(noise), tuple(spread), *rest)
        for k, j, at, e, noise, spread, *rest in zip(*(column[keep].tolist() for column in columns), strict=True)
    ]


def _upper(M: Array) -> Array:
    """Return the entries 00, 01, 11 of symmetric matrices (p, 2, 2), as (p, 3)."""
    return M.reshape(-1, 4)[:, [0, 1, 3]]


def _flipped(R: Array, flip: Array) -> Array:
    """Covariance of (flip * r, psi), (p, 2, 2)."""
    out = R.copy()
    out[:, 0, 1] *= flip
    out[:, 1, 0] *= flip
    return out
