"""Which map line is this? Gate, face, overlap, one-to-one, and no answer where the answer is ambiguous.

A pair (measured line, map line) is a candidate when its Mahalanobis distance passes the chi-square gate, the
robot stands on the face that was seen before, and the segments overlap. Two candidates that explain a line
about equally well are no evidence at all: the line is skipped and counted as ambiguous.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import msgspec
import numpy as np

from locfuse.fusion.core import match
from locfuse.fusion.core.room import Room
from locfuse.fusion.data import Array, Ints
from locfuse.fusion.ekf.belief_arrays import JointBelief
from locfuse.fusion.sensor import Equation, Innovation, Reading, Table

from .line_map import LineMap
from .pairing import Candidates, Pair, candidate_pairs
from .scan import Scan

AMBIGUOUS = 6.0  # a second candidate within this of the best score (chi-square, 2 dof: 95 %) is a rival
ZONE = 60.0  # squared distance up to which a near line forbids calling a segment new
# A scan in which only one line matches says little about whether the match is right: it must fit nearly perfectly.
LONE = 5.0, math.radians(3.0), 0.15  # squared distance, rad, m
OVERLAP, LONGEST = 0.3, 0.5  # share of a segment's length, of so many m at most, by which it overlaps its map line


class Association(msgspec.Struct, frozen=True, gc=False):
    """The verdict for each of k measured lines: its pair, or why there is none."""

    scan: Scan
    candidates: Candidates
    fate: Ints | list[int]  # (4, k) flat, by `core.match`

    @property
    def pairs(self) -> list[Pair]:
        """All pairs, line by line."""
        return self.candidates.pairs()

    @property
    def match(self) -> list[int]:
        """The accepted pair of every line (k,), -1: none."""
        return self._row(0)

    @property
    def best(self) -> list[int]:
        """The best pair of every line (k,), -1: none."""
        return self._row(1)

    @property
    def ambiguous(self) -> list[bool]:
        """Whether two pairs explain a line as well (k,)."""
        return [flag > 0 for flag in self._row(2)]

    @property
    def near(self) -> list[bool]:
        """Whether something is too near to call the line new (k,)."""
        return [flag > 0 for flag in self._row(3)]

    def _row(self, i: int) -> list[int]:
        k = self.candidates.lines
        return list(map(int, self.fate[i * k : (i + 1) * k]))

    def share(self) -> float:
        """Return the share of the scan's line length that was matched."""
        of = self.candidates
        share: float = of.room.beside(match).functions.matched_share(of.rows, of.lines, self.fate)
        return share

    def new(self) -> list[int]:
        """Return the lines that match nothing and are near nothing that is known."""
        return new_lines(self.fate, self.candidates.lines, self.candidates.room)

    def refuse_alone(self) -> None:
        """Let a scan's only match be none where others failed to match and it does not fit nearly perfectly."""
        of = self.candidates
        of.room.beside(match).on_arrays.refuse_alone(of.numbers, of.lines, self.fate, *LONE)

    def bends(self, P: Array, uneven: Array, most: Array) -> tuple[Ints, Array]:
        """Return which states (k,) of the lines that were seen bend, and by what variance (`core.match.bends`)."""
        of = self.candidates
        at, missing = np.empty(2 * of.lines, np.intp), np.empty(2 * of.lines)
        given = P, of.numbers, self.fate, of.lines, of.columns, *uneven.tolist(), *most.tolist(), at, missing
        k = of.room.beside(match).on_arrays.bends(*given)
        return at[:k], missing[:k]

    def extend(self, lines: LineMap, scan: int) -> None:
        """Let map lines that were matched reach as far as the measured ones do, and note the scan's number."""
        of, kept = self.candidates, (lines.lo, lines.hi, lines.hits, lines.seen)
        of.room.beside(match).on_arrays.extend(of.numbers, self.fate, of.lines, *kept, scan)

    def matched(self) -> list[Pair]:
        """Return the accepted pairs, line by line."""
        return [self.candidates.pair(p) for p in self.match if p >= 0]


def new_lines(fate: Ints | list[int], lines: int, room: Room) -> list[int]:
    """Return the lines of a scan that match nothing and are near nothing that is known, by their fate."""
    is_new = room.beside(match).on_arrays.is_new
    return [i for i in range(lines) if is_new(fate, lines, i)]


def associate(scan: Scan, lines: LineMap, belief: JointBelief, gate: float) -> Association:
    """Associate measured lines with map lines at a chi-square threshold `gate` (2 degrees of freedom)."""
    of = candidate_pairs(scan, lines, belief, max(gate, ZONE))
    fate, how = of.room.wholes(4 * of.lines), (gate, ZONE, AMBIGUOUS, OVERLAP, LONGEST)
    core = of.room.beside(match).functions
    core.match(of.numbers, of.found, of.rows, of.lines, *how, fate, of.room.wholes(of.lines))
    return Association(scan, of, fate)


class Codes(NamedTuple):
    """The verdicts (indices into VERDICTS) of lines that match nothing."""

    unmatched: int
    ambiguous: int
    new: int  # of what is near no map line


class SeenLines(Reading):
    """What a scan says of the pose and of the map, by its association."""

    def __init__(
        self,
        found: Association,
        first: int,
        ids: Ints,
        gate: float,
        codes: Codes,
        joint: bool,
        shared: Array | None,
    ) -> None:
        """`first` is the row of the first line in Measurements.z, `ids` (J,) those of map lines.

        `joint`: the map's lines are states. `shared` (k, 2, s) is what lines share (lines.sweep), in the base.
        """
        self._found, self._first, self._gate, self._joint = found, first, gate, joint
        self._shared = np.zeros((0, 2, 0)) if shared is None else shared
        of = found.candidates
        self._verdict, self._landmark = np.empty(of.lines, np.intp), np.empty(of.lines, np.intp)
        self._told = np.full((of.lines, match.TOLD), np.nan)
        columns = self._verdict, self._landmark, self._told
        self.accepted: int = of.room.beside(match).on_arrays.judge(
            of.numbers, found.fate, of.lines, ids, *codes, 0, *columns
        )
        self.numbers = 2 * self.accepted

    def __len__(self) -> int:
        """Return the number of lines."""
        return len(self._verdict)

    def table(self) -> Table:
        """Return what became of every line."""
        told = self._told
        return Table(self._first, self._verdict, self._landmark, self._gate, told[:, 0], told[:, 1:3], told[:, 3:])

    def equation(self) -> Equation:
        """Return what the matched lines say together."""
        return self._equation(0, self.accepted)[0]

    def _equation(self, row: int, k: int) -> tuple[Equation, Array]:
        """Return what the k pairs in a row of the fate say, and what they share, (2 k, s)."""
        of, seat, parts = self._found.candidates, self._found.scan.seat, self._shared.shape[2]
        at_mount = np.array(() if seat is None else seat.columns, np.intp)
        width = 3 + len(at_mount) + (2 * k if self._joint else 0)
        y, at, H, R = np.empty(2 * k), np.empty(width, np.intp), np.zeros((2 * k, width)), np.zeros((2 * k, 2 * k))
        G, shared = np.empty((2 * k, parts)), self._shared.ravel()
        mount = of.mount, len(at_mount), at_mount
        of.room.beside(match).on_arrays.equation(
            of.numbers, self._found.fate, row, of.lines, of.columns, self._joint, *mount, of.rows, shared, parts,
            at, H, G, R, y,
        )  # fmt: skip
        return Equation(y, at, H, R), G

    def rows(self) -> list[Innovation]:
        """Return every line as an innovation."""
        found = []
        best = self._found.best
        paired = [i for i, p in enumerate(best) if p >= 0]
        (_, at, H, R), G = self._equation(1, len(paired))
        seat = 3 if self._found.scan.seat is None else 3 + len(self._found.scan.seat.columns)
        place = {i: slice(2 * n, 2 * n + 2) for n, i in enumerate(paired)}
        for i, verdict in enumerate(self._verdict.tolist()):
            if self._landmark[i] < 0:
                found.append(Innovation.unpredicted(self._first + i, verdict, 2, self._gate))
                continue
            of = place[i]
            own = [*range(seat + of.start, seat + of.stop), *range(3, seat)] if self._joint else [*range(3, seat)]
            nis, y0, y1, *sigma = self._told[i].tolist()
            found.append(
                Innovation(
                    row=self._first + i,
                    verdict=verdict,
                    landmark=int(self._landmark[i]),
                    nis=nis,
                    threshold=self._gate,
                    y=(y0, y1),
                    sigma=tuple(sigma),
                    H=tuple(map(tuple, H[of, :3].tolist())),
                    R=tuple(map(tuple, R[of, of].tolist())),
                    columns=tuple(at[own].tolist()),
                    H_block=tuple(map(tuple, H[of][:, own].tolist())) if own else (),
                    shared=G[of].tolist() if G.size and not verdict else (),
                )
            )
        return found
