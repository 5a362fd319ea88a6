"""A scan that is associated with a map, and what the association has worked out on the way."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from locfuse.fusion.data import Array
from locfuse.fusion.ekf.belief_arrays import JointBelief
from locfuse.fusion.kernels.sight import Rules, Seat
from locfuse.fusion.map.line_map import NO_SHARES, Association, LineMap, seat_of
from locfuse.fusion.sensor import Equation

UNMATCHED, AMBIGUOUS, NEW = 3, 2, 4  # verdicts


class Pair(NamedTuple):
    """A measured line and a map line."""

    line: int
    which: int
    y: Array  # (2,)
    R: Array  # (2, 2)
    S: Array  # (2, 2)
    d2: float
    score: float
    lo: float  # m along the map line
    hi: float
    overlap: float
    psi: float  # the measured psi as it is predicted


def side_of(pair: Pair, z: Array) -> float:
    """1.0, or -1.0 where the measured line (r, psi) is read as (-r, psi + pi)."""
    return math.copysign(1.0, math.cos(pair.psi - z[1]))


class Sighted(Association):
    """An association whose room can be looked into."""

    def hold_lines(self, rows: Any, match: Any, best: Any, rival: Any, near: Any, order: Any) -> None:
        self._columns = match, best, rival, near
        super().hold_lines(rows, match, best, rival, near, order)

    def hold_pairs(self, pairs: Any, *others: Any) -> None:
        self._table = pairs
        super().hold_pairs(pairs, *others)

    def column(self, k: int) -> list[int]:
        """Of every line: the pair that matches, the best, whether it has a rival, whether it is near."""
        values: list[int] = self._columns[k][: self.lines].tolist()
        return values

    pair_of = property(lambda self: self.column(0))
    best_of = property(lambda self: self.column(1))
    ambiguous = property(lambda self: [bool(v) for v in self.column(2)])
    is_near = property(lambda self: [bool(v) for v in self.column(3)])

    @property
    def pair_list(self) -> list[Pair]:
        """The candidates, line by line."""
        return [
            Pair(
                int(p[0]),
                int(p[1]),
                p[2:4],
                symmetric(p[4:7]),
                symmetric(p[7:10]),
                *p[[10, 11, 12, 13, 14, 18]].tolist(),
            )
            for p in self._table[: self.found].copy()
        ]

    def matched(self) -> list[Pair]:
        """The pairs that match, in the order of the lines."""
        return [self.pair_list[p] for p in self.pair_of if p >= 0]


def symmetric(upper: Array) -> Array:
    return upper[[0, 1, 1, 2]].reshape(2, 2)


def sighted(
    rows: Array, lines: LineMap, belief: JointBelief, gate: float, states: bool, seat: Seat | None = None,
    shared: Array = NO_SHARES,
) -> Sighted:  # fmt: skip
    """Associate lines (n, 7) with a map, whose lines are `states` or not, and write what matches."""
    found = Sighted(Rules(gate, states, True, UNMATCHED, AMBIGUOUS, NEW), seat or seat_of(None, belief))
    found.compare(belief, lines, rows, shared)
    belief.begin()
    found.state_rows(belief)
    return found


def equation_of(found: Sighted, belief: JointBelief) -> Equation:
    """What the lines that match say together, which is queued."""
    belief.queue(found)
    return belief.equation()
