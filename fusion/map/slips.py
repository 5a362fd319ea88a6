"""Wheels that slip turn the robot, and the walls say by how much; a series of slips is none.

A few headings near the old one are tried on the belief itself. One slip after another within a second is no slip:
the first one was a mistake, which turned all that came after it, or somebody carries the robot. The walls from
before the series tell which: a robot that nobody carries sees them where the wheels alone expect them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

import numpy as np

from locfuse.fusion import se2
from locfuse.fusion.data import Ints
from locfuse.fusion.ekf.belief_arrays import JointBelief
from locfuse.fusion.ekf.map_frame import Pose

from .line_map import Association, LineMap
from .scan import Scan
from .scan_history import expected_share

MAX_SLIP_RAD = math.radians(30.0)
SLIP_SHARE = 0.6  # of the seen length that a slipped heading must explain, with two lines
SLIP_XY, SLIP_THETA = 0.03, math.radians(1.5)  # m, rad: what is left to correct after a slip's heading was found
CANDIDATES = 8
RECENT = 60  # scans
SERIES, CARRIED = 1.0, 4  # s between slips of one series, and slips that make it one
CONTINUES = 0.4  # share of the seen length where scans from before a jump expect it: then there was none

Seen = tuple[float, Pose, Scan]  # a scan: when [s], and where the wheels alone put the robot


class Series:
    """Slips that follow one another."""

    def __init__(self) -> None:
        self.begun = self._last = -math.inf  # s
        self._count = 0
        self._before: Sequence[Seen] = ()  # scans from before the first one
        self._from: tuple[Pose, Pose] | None = None  # where the first one found the robot: believed, by the wheels

    def goes_on(self, now: Seen, before: Sequence[Seen], believed: Pose) -> bool:
        """Take in a slip, and return whether there are so many now that none of them was one.

        `before` are the last scans before it, `believed` is the pose that it would change.
        """
        t = now[0]
        if t - self._last > SERIES or not self._count:
            self.begun, self._count, self._before, self._from = t, 0, before, (believed, now[1])
        self._last, self._count = t, self._count + 1
        if self._count < CARRIED:
            return False
        self._count = 0
        return True

    def mistaken(self, now: Seen) -> bool:
        """Return whether the walls from before the series are where the wheels alone expect them."""
        return continues(self._before, now, slip=0.0)

    def undone(self, now: Seen) -> Pose:
        """Return the pose without the series: the one before it, and on by the wheels."""
        assert self._from is not None
        believed, rolled = (np.array(pose) for pose in self._from)
        x, y, theta = se2.compose(believed, se2.between(rolled, np.array(now[1]))).tolist()
        return x, y, theta


def continues(before: Sequence[Seen], now: Seen, share: float = CONTINUES, slip: float = MAX_SLIP_RAD) -> bool:
    """Return whether this scan shows walls where one of these scans and the wheels expect them."""
    _, here, scan = now
    steps = ((old, se2.between(np.array(there), np.array(here))) for _, there, old in before if len(old.z))
    return any(expected_share(scan, old, step, slip) >= share for old, step in steps)


def after_slip(
    scan: Scan, lines: LineMap, belief: JointBelief, again: Callable[[], Association]
) -> Association | None:
    """Turn the belief by the heading change that makes most of the scan match; None, and no change, without one.

    Every heading is tried on the belief itself and the whole map: what is accepted here is what will be matched.
    `again` associates the scan with the belief as it is now.
    """
    recent = np.flatnonzero(lines.seen.max(initial=0) - lines.seen <= RECENT)
    least, found = SLIP_SHARE, None
    for turn in _turns(scan, lines, recent, belief):
        with tried(belief, turn, SLIP_XY**2, SLIP_THETA**2):
            there = again()
        share = there.share()
        if share >= least and there.matches() >= 2:
            least, found = share + 1e-9, turn
    if found is None:
        return None
    belief.shift(found, SLIP_XY**2, SLIP_THETA**2)
    return again()


@contextmanager
def tried(belief: JointBelief, turn: float, xy: float, theta: float) -> Iterator[None]:
    """Shift the belief for as long as the block lasts."""
    belief.shift(turn, xy, theta)
    try:
        yield
    finally:
        belief.shift(-turn, -xy, -theta)


def _turns(scan: Scan, lines: LineMap, recent: Ints, belief: JointBelief) -> list[float]:
    """Return the distinct heading changes that lay a seen line onto a recent one, the most supported first."""
    beta = lines.values(belief)[recent, 1]
    turns = se2.wrap_all(beta[None, :] - belief.theta - scan.z[:, 1, None])
    length = np.broadcast_to((scan.ends[:, 1] - scan.ends[:, 0])[:, None], turns.shape)
    near = np.abs(turns) < MAX_SLIP_RAD
    cells = np.round(turns[near] / math.radians(2.0)).astype(np.int64)
    support: dict[int, float] = {}
    for cell, weight in zip(cells.tolist(), length[near].tolist(), strict=True):
        support[cell] = support.get(cell, 0.0) + weight
    ranked = sorted(support, key=lambda c: (-support[c], abs(c), c))[:CANDIDATES]
    return [c * math.radians(2.0) for c in ranked if c != 0]
