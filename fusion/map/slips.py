"""Slips of the wheels, and the recent scans that confirm or contradict the motion by the wheels.

A slip turns the robot. The map shows by how much: headings near the old one are tried on the belief itself.
In clutter a few short lines match at some heading, and while the robot turns a clock that is off looks like a
slip. So the next scans are awaited; then the scan at hand is matched with the last one that was used, and a slip
counts where it has turned more than the wheels report and fits the map better so. Where the two do not match, all
scans since must fit the map much better. Until then no scan corrects pose or map.

A candidate place of a lost robot must explain all scans of its `Trail`. In a room whose halves look alike a
single scan fits twice; as the robot drives on, one of the two places shows walls that are not there.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

import numpy as np

from locfuse.fusion import se2
from locfuse.fusion.data import Array, Ints
from locfuse.fusion.ekf.belief_arrays import JointBelief
from locfuse.fusion.ekf.map_frame import Pose

from .line_map import Association, LineMap
from .scan import Scan

STRIDE_M, TURN_RAD = 0.2, math.radians(15.0)  # m, rad between two scans that are kept
# scans, rad: over 6 m, or around a corner, the wheels have drifted
MAX_SCANS, MAX_TURNED_RAD = 30, math.radians(90.0)
MIN_LINES = 2
SAME_ANGLE_RAD, SAME_OFFSET_M = math.radians(4.0), 0.1  # a line is where the wheels expect it within these
MIN_TRAIL_SHARE = 0.6  # share of the seen length that must be: less, and the robot is being carried
MAX_SLIPS = 1000  # slips that are tried; two scans of 30 lines have fewer
MAX_NUMBERS = 1 << 22  # numbers at a time: two scans of 2000 lines would need terabytes
MAX_SLIP_RAD = math.radians(30.0)
MIN_SLIP_SHARE = 0.6  # of the seen length that a slipped heading must explain, with two lines
# m, rad: what is left to correct after a slip's heading was found
SLIP_SIGMA_M, SLIP_SIGMA_RAD = 0.03, math.radians(1.5)
MAX_CANDIDATES = 8
RECENT_SCANS = 60  # scans
DECIDING_SCANS = 3  # scans until a slip is decided
# shares that must match beyond the old heading's: of a turn that matched scans measure, and by the map alone
MIN_GAIN, SURE_GAIN = 0.2, 0.5
SMALL_RAD = math.radians(5.0)  # a heading may be off by so much without a slip: below, no further scans are asked
AGREE_RAD = math.radians(3.0)  # between the turns of a slip by the map and by matched scans
CARRIED_SCANS = 6  # scans in a row that ask for a slip: the robot is carried
CONTINUING_SHARE = 0.4  # share of the seen length where scans from before a jump expect it: then there was none


class Trail:
    """Scans along the path by the wheels."""

    def __init__(self) -> None:
        self._seen: deque[tuple[Array, Scan]] = deque(maxlen=MAX_SCANS)  # pose by the wheels, scan

    def note(self, pose: Array, scan: Scan) -> bool:
        """Keep a scan with lines, if its pose (3,) by the wheels differs from the last one's.

        Where the walls moved otherwise than the wheels, the robot is still carried: earlier scans are dropped.
        """
        if len(scan.z) < MIN_LINES:
            return False
        if self._seen:
            there, before = self._seen[-1]
            step = se2.between(there, pose)
            if math.hypot(step[0], step[1]) < STRIDE_M and abs(se2.wrap(float(step[2]))) < TURN_RAD:
                return False
            if expected_share(scan, before, step) < MIN_TRAIL_SHARE:
                self.forget()
        self._seen.append((pose, scan))
        return True

    def forget(self) -> None:
        """Forget all scans and start again."""
        self._seen.clear()

    def back_from(self, pose: Array) -> Iterator[tuple[Array, Scan]]:
        """Yield the scans, newest first, with their poses (3,) relative to `pose`."""
        for there, scan in reversed(self._seen):
            step = np.asarray(se2.between(pose, there))
            if abs(se2.wrap(float(step[2]))) > MAX_TURNED_RAD:
                return
            yield step, scan


def expected_share(scan: Scan, before: Scan, step: Array, slip: float = 0.0) -> float:
    """Return the share of a scan's line length that an earlier scan and a step (3,) predict.

    With the heading change of up to `slip` [rad] that suits it best: wheels slip.
    """
    r, psi = before.z.T
    near = np.abs(scan.z[:, 0, None] - (r - step[0] * np.cos(psi) - step[1] * np.sin(psi))) < SAME_OFFSET_M
    turn = se2.wrap_all(scan.z[:, 1, None] - psi + step[2])  # (k, lines before)
    slips = np.append(_few(turn[np.abs(turn) < slip]), 0.0)
    i, j = np.nonzero(near)
    lines, first = np.unique(i, return_index=True)
    found = np.zeros((len(slips), len(scan.z)), np.bool_)
    at_once = max(1, MAX_NUMBERS // max(len(i), 1))
    for at in range(0, len(slips) if len(i) else 0, at_once):
        some = slice(at, at + at_once)
        suits = np.abs(turn[i, j] - slips[some, None]) < SAME_ANGLE_RAD  # (slips, pairs)
        found[some, lines] = np.logical_or.reduceat(suits, first, axis=1)
    length = scan.ends[:, 1] - scan.ends[:, 0]
    return float((found @ length).max() / length.sum())


def _few(slips: Array) -> Array:
    """Return at most MAX_SLIPS of the slips (n,) [rad], evenly spread."""
    if len(slips) <= MAX_SLIPS:
        return slips
    some: Array = np.sort(slips)[np.linspace(0, len(slips) - 1, MAX_SLIPS).astype(np.intp)]
    return some


Seen = tuple[float, Pose, Scan]  # a scan: when [s], and where the wheels alone put the robot


class Series:
    """Scans in a row that each suggest a slip."""

    def __init__(self) -> None:
        self.begun = 0.0  # s
        self._scans = 0
        self._before: Sequence[Seen] = ()  # scans from before the first one

    def ends(self) -> None:
        """End the series: the next scan that suggests a slip is the first."""
        self._scans = 0

    def goes_on(self, now: Seen, before: Sequence[Seen]) -> bool:
        """Add a scan that suggests a slip; return whether there are so many that the robot is being carried.

        Where the walls from before them are where the wheels expect them, it is not carried.
        """
        if not self._scans:
            self.begun, self._before = now[0], before
        self._scans += 1
        if self._scans < CARRIED_SCANS:
            return False
        self._scans = 0
        return not continues(self._before, now, slip=0.0)


class Slide:
    """A slip of both wheels ahead that the last scans show, until enough of them in a row do."""

    def __init__(self) -> None:
        self._scans = 0
        self._ahead = 0.0  # m, of the last scan
        self._off: Array = np.zeros(2)  # m, not yet taken back
        self._first_line = 0  # the number of the first line born since it began

    @property
    def begun(self) -> bool:
        """Whether the last scan showed it."""
        return self._scans > 0

    def ends(self) -> None:
        """Forget it: the last scan did not show it."""
        self._scans = 0

    def goes_on(self, step: Array, next_line: int) -> tuple[Array, int] | None:
        """Add the slip (3,) since the last scan; None until it is sure.

        Then return the error (2,) [m] of the pose, and the number of the first map line born since the slip began.
        `next_line` is the number of the next map line. A robot cannot slip ahead and back at once. A slip that is
        sure continues with each scan.
        """
        if step[0] * self._ahead < 0.0:
            self.ends()
        if not self._scans:
            self._off, self._first_line = np.zeros(2), next_line
        self._scans += 1
        self._ahead, self._off = float(step[0]), self._off + step[:2]
        if self._scans < DECIDING_SCANS:
            return None
        found = self._off, self._first_line
        self._off, self._first_line = np.zeros(2), next_line
        return found


class Suspicion:
    """A slip suggested by a scan, until the next scans are compared with both headings."""

    def __init__(self, turn: float) -> None:
        """Begin with the turn [rad] by which the scan fits the map."""
        self.turn = turn
        self.looks = 0
        self._gain = 0.0  # shares of the seen length that match at the turned heading beyond those at the old one

    def look(self, kept: float, turned: float) -> None:
        """Add a scan with its matched shares at the old and at the turned heading."""
        self.looks += 1
        self._gain += turned - kept

    @staticmethod
    def waits(turn: float) -> bool:
        """Return whether a turn [rad] is so large that the next scans must confirm it."""
        return abs(turn) >= SMALL_RAD

    @property
    def decided(self) -> bool:
        """Whether enough scans have been compared."""
        return self.looks >= DECIDING_SCANS

    def confirmed(self, gain: float, by_scans: bool) -> bool:
        """Return whether a slip is confirmed; `gain` is the growth of the last scan's matched share.

        A little is enough where matched scans measured it (`by_scans`); else all scans since then must gain much.
        """
        return gain >= MIN_GAIN if by_scans else min(gain, self._gain / self.looks) >= SURE_GAIN


def agree(by_scans: float | None, turn: float) -> bool:
    """Return whether matched scans show about the same turn [rad]; None: they do not match."""
    return by_scans is not None and abs(se2.wrap(by_scans - turn)) <= AGREE_RAD


def continues(
    before: Sequence[Seen], now: Seen, share: float = CONTINUING_SHARE, slip: float = MAX_SLIP_RAD
) -> bool:
    """Return whether this scan shows walls where an earlier scan and the wheels predict them."""
    _, here, scan = now
    steps = ((old, se2.between(np.array(there), np.array(here))) for _, there, old in before if len(old.z))
    return any(expected_share(scan, old, step, slip) >= share for old, step in steps)


def slip_turn(scan: Scan, lines: LineMap, belief: JointBelief, again: Callable[[], Association]) -> float | None:
    """Return the heading change [rad] with which most of the scan matches; None without one.

    Every heading is tried on the belief itself and the whole map: what is accepted here is what will be matched.
    `again` associates the scan with the belief as it is now.
    """
    recent = np.flatnonzero(lines.seen.max(initial=0) - lines.seen <= RECENT_SCANS)
    least, found = MIN_SLIP_SHARE, None
    for turn in _turns(scan, lines, recent, belief):
        there = with_slip(belief, turn, again)
        share = there.share()
        if share >= least and there.matches() >= 2:
            least, found = share + 1e-9, turn
    return found


def with_slip(belief: JointBelief, turn: float, again: Callable[[], Association]) -> Association:
    """Return the association of the present scan with the heading turned by a slip [rad]."""
    with tried(belief, (0.0, 0.0, turn), SLIP_SIGMA_M**2, SLIP_SIGMA_RAD**2):
        return again()


@contextmanager
def tried(belief: JointBelief, step: Pose, xy: float, theta: float) -> Iterator[None]:
    """Shift the belief by a step (3,) with variances xy [m^2], theta [rad^2] inside this context, unrecorded."""
    # in place: `shift` would make copies of the pose (gyro, pose, twist) exact copies again, and record it
    pose, variances = belief.state[:3], np.einsum("ii->i", belief.covariance[:3, :3])
    before = pose.copy(), variances.copy()
    pose += step
    variances += (xy, xy, theta)
    try:
        yield
    finally:
        pose[:], variances[:] = before


def _turns(scan: Scan, lines: LineMap, recent: Ints, belief: JointBelief) -> list[float]:
    """Return the distinct heading changes that align a seen line with a recent one, most supported first."""
    beta = lines.values(belief)[recent, 1]
    turns = se2.wrap_all(beta[None, :] - belief.theta - scan.z[:, 1, None])
    length = np.broadcast_to((scan.ends[:, 1] - scan.ends[:, 0])[:, None], turns.shape)
    near = np.abs(turns) < MAX_SLIP_RAD
    cells = np.round(turns[near] / math.radians(2.0)).astype(np.int64)
    support: dict[int, float] = {}
    for cell, weight in zip(cells.tolist(), length[near].tolist(), strict=True):
        support[cell] = support.get(cell, 0.0) + weight
    ranked = sorted(support, key=lambda c: (-support[c], abs(c), c))[:MAX_CANDIDATES]
    return [c * math.radians(2.0) for c in ranked if c != 0]
