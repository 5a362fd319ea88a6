"""Which map line is this? Gate, face, overlap, one-to-one, and no answer where the answer is ambiguous.

A pair (measured line, map line) is a candidate when its Mahalanobis distance passes the chi-square gate, the
robot stands on the face that was seen before, and the segments overlap. Two candidates that explain a line
about equally well are no evidence at all: the line is skipped and counted as ambiguous.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from .data import Array, Ints
from .ekf import JointBelief
from .laser_mount import Seat, mount_spread
from .line_map import AnyBelief, LineMap, Prediction

NEAR_ANGLE = math.radians(25.0)  # pairs further apart are not looked at
NEAR_OFFSET = 1.0  # m
NEAR_SIGMAS = 6.0  # added to both
AMBIGUOUS = 6.0  # a second candidate within this of the best score (chi-square, 2 dof: 95 %) is a rival
FACE_SIGMAS = 3.0
ZONE = 60.0  # squared distance up to which a near line forbids calling a segment new


class Scan(NamedTuple):
    """Measured lines of one scan in the base frame, k of them."""

    z: Array  # (k, 2) r, psi
    R: Array  # (k, 2, 2)
    ends: Array  # (k, 2) along the tangent (-sin psi, cos psi)
    seat: Seat | None = None  # where the laser's mount is uncertain


@dataclass(frozen=True)
class Pairs:
    """Candidate pairs (p,): measured line `line`, map line position `which`."""

    line: Ints
    which: Ints
    y: Array  # (p, 2) innovation, after flipping where the sign demands it
    flip: Array  # (p,) +1, or -1 where (r, psi) was read as (-r, psi + pi)
    S: Array  # (p, 2, 2)
    d2: Array  # (p,)
    score: Array  # (p,) d2 + ln det S
    overlap: Array  # (p,) m, negative where the segments are apart
    lo: Array  # (p,) ends of the measured segment along the map line
    hi: Array
    prediction: Prediction  # of `which`


@dataclass(frozen=True)
class Association:
    """The verdict for each measured line: its pair, or why there is none."""

    pairs: Pairs
    match: list[int]  # (k,) index of the accepted pair, -1
    best: list[int]  # (k,) index of the best pair, -1
    ambiguous: list[bool]  # (k,)
    near: list[bool]  # (k,) something is too near to call the line new


def associate(scan: Scan, lines: LineMap, belief: AnyBelief, gate: float) -> Association:
    """Associate measured lines with map lines at a chi-square threshold `gate` (2 degrees of freedom)."""
    pairs = candidate_pairs(scan, lines, belief)
    k = len(scan.z)
    match, best = [-1] * k, [-1] * k
    ambiguous, near = [False] * k, [False] * k
    rivals = np.minimum(scan.ends[:, 1] - scan.ends[:, 0], 0.5) * 0.3
    fits = (pairs.d2 <= gate) & (pairs.overlap > rivals[pairs.line])
    near_pair = (pairs.d2 <= ZONE) & (pairs.overlap > 0.0)
    for p in np.argsort(pairs.score, kind="stable").tolist():
        i = int(pairs.line[p])
        near[i] = near[i] or bool(near_pair[p])
        if not fits[p]:
            if best[i] < 0:
                best[i] = p
            continue
        if match[i] < 0:
            match[i] = best[i] = p
        elif pairs.score[p] - pairs.score[match[i]] < AMBIGUOUS:
            ambiguous[i] = True
    _one_to_one(pairs, match, ambiguous)
    return Association(
        pairs, [-1 if a else m for m, a in zip(match, ambiguous, strict=True)], best, ambiguous, near
    )


def _one_to_one(pairs: Pairs, match: list[int], ambiguous: list[bool]) -> None:
    """Let each stretch of a map line be matched once; the worse of two overlapping claims is ambiguous."""
    taken: dict[int, list[int]] = {}
    for p in sorted((m for m in match if m >= 0), key=lambda p: (float(pairs.score[p]), p)):
        others = taken.setdefault(int(pairs.which[p]), [])
        if any(min(pairs.hi[p], pairs.hi[q]) - max(pairs.lo[p], pairs.lo[q]) > 0.05 for q in others):
            ambiguous[int(pairs.line[p])] = True
        else:
            others.append(p)


def candidate_pairs(scan: Scan, lines: LineMap, belief: AnyBelief) -> Pairs:
    """Return the pairs that are near enough to be worth a covariance, on the right face."""
    values = lines.values(belief)
    c, s = np.cos(values[:, 1]), np.sin(values[:, 1])
    dx, dy = belief.x - lines.anchor[:, 0], belief.y - lines.anchor[:, 1]
    r = values[:, 0] - dx * c - dy * s
    P = belief.matrix()
    angle_slack = NEAR_ANGLE + NEAR_SIGMAS * math.sqrt(max(float(P[2, 2]), 0.0))
    offset_slack = NEAR_OFFSET + NEAR_SIGMAS * math.sqrt(max(float(P[0, 0] + P[1, 1]), 0.0))
    turn = _wrap(scan.z[:, 1, None] - (values[:, 1] - belief.theta))
    flip = np.where(np.abs(turn) > 0.5 * math.pi, -1.0, 1.0)
    turn = np.where(flip < 0, _wrap(turn + math.pi), turn)
    offset = flip * scan.z[:, 0, None] - r
    line, which = np.nonzero((np.abs(turn) < angle_slack) & (np.abs(offset) < offset_slack))
    prediction = lines.predict(which, values, belief)
    y = np.stack((offset[line, which], turn[line, which]), axis=-1)
    flip = flip[line, which]
    S = prediction.spread + _flipped(scan.R[line], flip)
    if scan.seat is not None and isinstance(belief, JointBelief):
        S += mount_spread(scan.seat, prediction.psi + y[:, 1], prediction, lines.column[which], belief)
    det = S[:, 0, 0] * S[:, 1, 1] - S[:, 0, 1] ** 2
    d2 = (S[:, 1, 1] * y[:, 0] ** 2 - 2.0 * S[:, 0, 1] * y[:, 0] * y[:, 1] + S[:, 0, 0] * y[:, 1] ** 2) / det
    lo, hi = _extent(scan, line, flip, prediction, lines, which, belief)
    overlap = np.minimum(hi, lines.hi[which]) - np.maximum(lo, lines.lo[which])
    seen_face = prediction.r > -FACE_SIGMAS * np.sqrt(S[:, 0, 0])
    keep = np.flatnonzero(seen_face)
    return Pairs(
        line[keep],
        which[keep],
        y[keep],
        flip[keep],
        S[keep],
        d2[keep],
        (d2 + np.log(det))[keep],
        overlap[keep],
        lo[keep],
        hi[keep],
        Prediction(*(a[keep] for a in prediction)),
    )


def _extent(
    scan: Scan,
    line: Ints,
    flip: Array,
    prediction: Prediction,
    lines: LineMap,
    which: Ints,
    belief: AnyBelief,
) -> tuple[Array, Array]:
    """Ends of each measured segment along its map line, m from the anchor.

    The segment's own foot point turns with the innovation; along the line only the robot's place counts, so
    the ends are (p - a).tangent + t, and a flipped line runs the other way.
    """
    along = prediction.cos * (belief.y - lines.anchor[which, 1]) - prediction.sin * (
        belief.x - lines.anchor[which, 0]
    )
    a, b = flip * scan.ends[line, 0] + along, flip * scan.ends[line, 1] + along
    return np.minimum(a, b), np.maximum(a, b)


def _flipped(R: Array, flip: Array) -> Array:
    """Covariance of (flip * r, psi), (p, 2, 2)."""
    out = R.copy()
    out[:, 0, 1] *= flip
    out[:, 1, 0] *= flip
    return out


def _wrap(angle: Array) -> Array:
    return (angle + math.pi) % (2.0 * math.pi) - math.pi
