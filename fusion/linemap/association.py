"""Data association: which map line is this? Gate, face, overlap, one-to-one, and no answer where it is ambiguous.

A pair (measured line, map line) is a candidate when its Mahalanobis distance passes the chi-square gate, the
robot stands on the face that was seen before, and the segments overlap. Two candidates that explain a line
about equally well are no evidence at all: the line is skipped and counted as ambiguous. The numbers are worked out
by fusion.kernels.sight, with paper eq. 13, 17, 18.
"""

from __future__ import annotations

import numpy as np

from locfuse.fusion.data import Array, Ints
from locfuse.fusion.ekf.belief_arrays import JointBelief
from locfuse.fusion.kernels import sight
from locfuse.fusion.sensor import Reading

from .line_map import LineMap

NO_SHARES = np.zeros((0, 2, 0))
RESERVE = 1.5  # times the room that is needed now


class Association(sight.Sight, Reading):
    """The lines of a scan against a map: of every line its pair, or why there is none.

    As a `Reading` of the filter it says all accepted lines together, as rows of the state's table.
    """

    def __init__(self, rules: sight.Rules, seat: sight.Seat) -> None:
        super().__init__(rules, seat)
        self._lines = self._places = self._parts = -1
        self._rows: Array = np.zeros((0, 7))
        self._offset = np.zeros(3)
        self.row = 0  # of the first line in Measurements.z
        self._states: tuple[Ints, Array] = np.zeros(0, np.intp), np.zeros(0)

    def compare(self, belief: JointBelief, lines: LineMap, rows: Array, shared: Array = NO_SHARES) -> float:
        """Associate measured lines (n, 7), in the base by the mount as configured; return the share that matches.

        `shared` (n, 2, s) is what the errors of the lines share (lines.sweep).
        """
        n, places, parts = len(rows), len(lines), shared.shape[2]
        if n > self._lines or places > self._places or parts > self._parts:
            self._make_room(n, places, parts)
        share: float = self.look(belief, lines.table(), rows, shared if parts else NO_SHARES)
        return share

    def _make_room(self, n: int, places: int, parts: int) -> None:
        n = self._lines = max(self._lines, int(RESERVE * n) + 1)
        places = self._places = max(self._places, int(RESERVE * places) + 1)
        parts = self._parts = max(self._parts, parts)
        free, whole = self.seat.free, [np.zeros(n, np.intp) for _ in range(5)]
        self._rows = np.zeros((n, 7))
        self.hold_lines(self._rows, *whole)
        pairs, walls = (
            np.zeros((n * places, sight.PAIR_COLUMNS)),
            np.zeros((places, sight.WALL_COLUMNS + 2 * free)),
        )
        self.hold_pairs(pairs, walls, np.zeros((places, 4)), np.zeros((6, 3)), np.zeros(3), self._offset)
        self.hold_shares(np.zeros((n, 2, parts)), np.zeros((2 * n, parts)))
        self._states = np.zeros(2 * n, np.intp), np.zeros(2 * n)
        self.hold_states(*self._states)

    def in_base(self) -> Array:
        """Return the measured lines in the base by the mount as it was estimated, a copy (n, 7)."""
        return self._rows[: self.lines].copy()

    def moved(self) -> tuple[float, float, float]:
        """Return what led from the lines in the base as configured to those: x, y [m], yaw [rad]."""
        x, y, yaw = self._offset.tolist()
        return x, y, yaw

    def new(self) -> list[int]:
        """Return the lines that match nothing and are near nothing that is known."""
        return [i for i in range(self.lines) if self.is_new(i)]

    def rows_used(self) -> list[int]:
        """Return the rows of Measurements.z whose lines match."""
        return [self.row + i for i in range(self.lines) if self.is_matched(i)]

    def bend(self, belief: JointBelief, uneven: Array, most: Array) -> None:
        """Loosen the walls that were seen within their unevenness (2,) [m^2, rad^2], `most` (2,) at a time."""
        states = self.bends(belief, uneven, most)
        if states:
            belief.loosen_first(*self._states, states)


def associate(
    rows: Array, lines: LineMap, belief: JointBelief, like: Association, shared: Array = NO_SHARES
) -> Association:
    """Associate measured lines anew, with the belief as it is now, by the rules of another association."""
    found = Association(like.rules, like.seat)
    found.compare(belief, lines, rows, shared)
    return found
