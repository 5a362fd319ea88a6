"""Which map line is this? Gate, face, overlap, one-to-one, and no answer where the answer is ambiguous.

A pair (measured line, map line) is a candidate when its Mahalanobis distance passes the chi-square gate, the
robot stands on the face that was seen before, and the segments overlap. Two candidates that explain a line
about equally well are no evidence at all: the line is skipped and counted as ambiguous.
"""

from __future__ import annotations

from operator import attrgetter

import msgspec

from locfuse.fusion.ekf.belief_arrays import JointBelief

from .line_map import LineMap
from .pairing import Pair, candidate_pairs
from .scan import Scan

AMBIGUOUS = 6.0  # a second candidate within this of the best score (chi-square, 2 dof: 95 %) is a rival
ZONE = 60.0  # squared distance up to which a near line forbids calling a segment new


class Association(msgspec.Struct, frozen=True, gc=False):
    """The verdict for each measured line: its pair, or why there is none."""

    pairs: list[Pair]  # the best score first
    match: list[int]  # (k,) index of the accepted pair, -1
    best: list[int]  # (k,) index of the best pair, -1
    ambiguous: list[bool]  # (k,)
    near: list[bool]  # (k,) something is too near to call the line new


def associate(scan: Scan, lines: LineMap, belief: JointBelief, gate: float) -> Association:
    """Associate measured lines with map lines at a chi-square threshold `gate` (2 degrees of freedom)."""
    pairs = sorted(candidate_pairs(scan, lines, belief, max(gate, ZONE)), key=attrgetter("score"))
    k = len(scan.z)
    match, best = [-1] * k, [-1] * k
    ambiguous, near = [False] * k, [False] * k
    rivals = [0.3 * min(length, 0.5) for length in scan.lengths()]
    for p, pair in enumerate(pairs):
        i = pair.line
        if pair.overlap > 0.0 and pair.d2 <= ZONE:
            near[i] = True
        if pair.d2 > gate or pair.overlap <= rivals[i]:
            if best[i] < 0:
                best[i] = p
        elif match[i] < 0:
            match[i] = best[i] = p
        elif pair.score - pairs[match[i]].score < AMBIGUOUS:
            ambiguous[i] = True
    _one_to_one(pairs, match, ambiguous)
    if any(ambiguous):
        match = [-1 if a else m for m, a in zip(match, ambiguous, strict=True)]
    return Association(pairs, match, best, ambiguous, near)


def _one_to_one(pairs: list[Pair], match: list[int], ambiguous: list[bool]) -> None:
    """Let each stretch of a map line be matched once; the worse of two overlapping claims is ambiguous."""
    matched = sorted([m for m in match if m >= 0])
    if len({pairs[m].which for m in matched}) == len(matched):
        return
    taken: dict[int, list[Pair]] = {}
    for p in matched:
        pair = pairs[p]
        others = taken.setdefault(pair.which, [])
        if any(min(pair.hi, other.hi) - max(pair.lo, other.lo) > 0.05 for other in others):
            ambiguous[pair.line] = True
        else:
            others.append(pair)
