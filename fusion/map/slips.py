"""Wheel slips: detection by the map and by scan matching, and the recent scans that confirm a slip.

A slip changes the heading. The scan is matched with the map at several headings near the predicted one. In clutter
a few short lines match at some heading, and during a turn a clock offset looks like a slip. Therefore the decision
waits for the next scans. Then the current scan is matched with the last used scan. A slip is accepted if this
match shows a turn that the wheels did not measure, and the scan fits the map better with it. If the two scans
cannot be matched, all scans since the suspicion must fit the map much better. Until the decision no scan corrects
pose or map.

A candidate pose of a lost robot must agree with all of its `RecentScans`. In a symmetric room a single scan fits
at two poses; later scans contradict one of them.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import NamedTuple

import numpy as np

from locfuse.fusion import se2
from locfuse.fusion.data import Array, Ints
from locfuse.fusion.ekf.belief_arrays import JointBelief
from locfuse.fusion.ekf.map_frame import Pose

from .line_map import Association, LineMap
from .scan import Scan

STRIDE_M, TURN_RAD = 0.2, math.radians(15.0)  # m, rad between two scans that are kept
# limits of the trail: wheel odometry drifts over 6 m and in turns
MAX_SCANS, MAX_TURNED_RAD = 30, math.radians(90.0)
MIN_LINES = 2
SAME_ANGLE_RAD, SAME_OFFSET_M = math.radians(4.0), 0.1  # largest difference of a line from its predicted position
MIN_TRAIL_SHARE = 0.6  # least share of line length at the predicted position; below, the robot is being carried
MAX_SLIPS = 1000  # slips that are tried; two scans of 30 lines have fewer
MAX_NUMBERS = 1 << 22  # numbers at a time: two scans of 2000 lines would need terabytes
MAX_SLIP_RAD = math.radians(30.0)
MIN_SLIP_SHARE = 0.6  # share of line length that must match at the corrected heading, with at least two lines
# m, rad: uncertainty of the pose after the correction of a slip
SLIP_SIGMA_M, SLIP_SIGMA_RAD = 0.03, math.radians(1.5)
MAX_CANDIDATES = 8
RECENT_SCANS = 60  # scans
DECIDING_SCANS = 3  # scans until a slip is decided
# least increase of the matched share by a slip: if scan matching measured the turn, and by the map alone
MIN_GAIN_BY_SCANS, MIN_GAIN_BY_MAP = 0.2, 0.5
SMALL_RAD = math.radians(5.0)  # a smaller slip is decided at once, since it is within usual heading errors
AGREE_RAD = math.radians(3.0)  # between the turns of a slip by the map and by scan matching
CARRIED_SCANS = 6  # consecutive scans that suggest a slip: the robot is being carried
CONTINUING_SHARE = 0.4  # share of line length at the position predicted by earlier scans: no jump


class RecentScans:
    """Recent scans along the path, with poses by wheel odometry."""

    def __init__(self) -> None:
        self._seen: deque[tuple[Array, Scan]] = deque(maxlen=MAX_SCANS)  # pose by the wheels, scan

    def note(self, pose: Array, scan: Scan) -> bool:
        """Add a scan if the robot moved since the last one; return whether the scan was added.

        If the walls are not where wheel odometry predicts them, the robot is being carried: earlier scans are
        dropped.
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
        """Drop all scans."""
        self._seen.clear()

    def back_from(self, pose: Array) -> Iterator[tuple[Array, Scan]]:
        """Yield the poses (3,) of the scans relative to `pose`, and the scans, newest first."""
        for there, scan in reversed(self._seen):
            step = np.asarray(se2.between(pose, there))
            if abs(se2.wrap(float(step[2]))) > MAX_TURNED_RAD:
                return
            yield step, scan


def expected_share(scan: Scan, before: Scan, step: Array, slip: float = 0.0) -> float:
    """Return the share of a scan's line length that agrees with an earlier scan, moved by the motion `step` (3,).

    Headings may differ from the motion by at most `slip` [rad]: the share with the best heading is returned.
    """
    r, psi = before.z.T
    near = np.abs(scan.z[:, 0, None] - (r - step[0] * np.cos(psi) - step[1] * np.sin(psi))) < SAME_OFFSET_M
    turn = se2.wrap_all(scan.z[:, 1, None] - psi + step[2])  # (k, lines before)
    slips = turn[np.abs(turn) < slip]
    if len(slips) > MAX_SLIPS:
        slips = np.sort(slips)[np.linspace(0, len(slips) - 1, MAX_SLIPS).astype(np.intp)]
    slips = np.append(slips, 0.0)
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


Seen = tuple[float, Pose, Scan]  # time [s], pose by wheel odometry alone, scan


class PresentScan(NamedTuple):
    """Present scan, with the map and the functions that compare it with the map and with an earlier scan."""

    t: float  # s
    scan: Scan  # in the base frame
    lines: LineMap
    belief: JointBelief
    again: Callable[[], Association]  # associates the scan with the present belief
    # (3,) m, m, rad: motion by scan matching minus that by wheel odometry; None: not known
    slipped: Callable[[], Array | None]


class Series:
    """Counts consecutive scans that suggest a slip, to detect that the robot is being carried."""

    def __init__(self) -> None:
        self.begun = 0.0  # s
        self._scans = 0
        self._before: Sequence[Seen] = ()  # scans before the first one of the series

    def reset(self) -> None:
        """End the series."""
        self._scans = 0

    def add(self, now: Seen, before: Sequence[Seen]) -> bool:
        """Add a scan that suggests a slip; return whether the series shows that the robot is being carried.

        The robot is not carried if walls from before the series are where wheel odometry predicts them.
        """
        if not self._scans:
            self.begun, self._before = now[0], before
        self._scans += 1
        if self._scans < CARRIED_SCANS:
            return False
        self._scans = 0
        return not continues(self._before, now, slip=0.0)


class Slide:
    """Translational slip of both wheels, measured by consecutive scans until it is certain."""

    def __init__(self) -> None:
        self._scans = 0
        self._ahead = 0.0  # m, forward slip of the last scan
        self._off: Array = np.zeros(2)  # m, slip not yet corrected
        self._first_line = 0  # id of the first line added since the slip began

    @property
    def has_begun(self) -> bool:
        """Return whether the last scan showed a slip."""
        return self._scans > 0

    def reset(self) -> None:
        """End the slip: the last scan did not show it."""
        self._scans = 0

    def add(self, step: Array, next_line: int) -> tuple[Array, int] | None:
        """Add the slip (3,) since the last scan; once the slip is certain, return its effect, else None.

        The effect is the position error (2,) [m], and the id of the first map line added since the slip began.
        `next_line` is the id of the next map line. A change of direction ends the slip. Once certain, the slip is
        corrected with every further scan.
        """
        if step[0] * self._ahead < 0.0:
            self.reset()
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
    """Suspected heading slip: compares the next scans with the map at the old and the corrected heading."""

    def __init__(self, turn: float) -> None:
        """Begin with the heading change `turn` [rad] by which the scan fits the map."""
        self.turn = turn
        self.looks = 0
        self._gain = 0.0  # sum of the increases of the matched share by the corrected heading

    def add(self, kept: float, turned: float) -> None:
        """Add the matched shares of a scan at the old heading (`kept`) and at the corrected one (`turned`)."""
        self.looks += 1
        self._gain += turned - kept

    @property
    def is_decided(self) -> bool:
        """Return whether enough scans have been compared."""
        return self.looks >= DECIDING_SCANS

    def is_confirmed(self, gain: float, by_scans: bool) -> bool:
        """Return whether scans match the map so much better with the slip that it is confirmed.

        `gain` is the increase of the matched share of the last scan. The least increase is
        MIN_GAIN_BY_SCANS if scan matching measured the slip (`by_scans`); else it is MIN_GAIN_BY_MAP, for the last
        scan and for the mean of all scans.
        """
        return gain >= MIN_GAIN_BY_SCANS if by_scans else min(gain, self._gain / self.looks) >= MIN_GAIN_BY_MAP


def agree(by_scans: float, turn: float) -> bool:
    """Return whether two measurements of a heading slip [rad] are about equal.

    `by_scans` is by scan matching, `turn` by the map.
    """
    return abs(se2.wrap(by_scans - turn)) <= AGREE_RAD


def continues(
    before: Sequence[Seen], now: Seen, share: float = CONTINUING_SHARE, slip: float = MAX_SLIP_RAD
) -> bool:
    """Return whether the walls of a scan are where an earlier scan and wheel odometry predict them."""
    _, here, scan = now
    steps = ((old, se2.between(np.array(there), np.array(here))) for _, there, old in before if len(old.z))
    return any(expected_share(scan, old, step, slip) >= share for old, step in steps)


def slip_turn(present: PresentScan) -> float | None:
    """Return the heading change [rad] with which most of the scan matches the map; None if there is none.

    Each heading is tried with the full data association, on the shifted belief.
    """
    recent = np.flatnonzero(present.lines.seen.max(initial=0) - present.lines.seen <= RECENT_SCANS)
    least, found = MIN_SLIP_SHARE, None
    for turn in _turns(present.scan, present.lines, recent, present.belief):
        association = with_slip(present, turn)
        share = association.share()
        if share >= least and association.matches() >= 2:
            least, found = share + 1e-9, turn
    return found


def with_slip(present: PresentScan, turn: float) -> Association:
    """Return the association of the scan after a heading change of `turn` [rad]."""
    with tried(present.belief, (0.0, 0.0, turn), SLIP_SIGMA_M**2, SLIP_SIGMA_RAD**2):
        return present.again()


@contextmanager
def tried(belief: JointBelief, step: Pose, xy: float, theta: float) -> Iterator[None]:
    """Change the belief's pose by `step` (3,) inside a `with` block; restore it at the end of the block.

    The variances grow by xy [m^2] and theta [rad^2].
    """
    # not by `belief.shift`, which records an event and resets copies of the pose (gyro, pose, twist)
    pose, variances = belief.state[:3], np.einsum("ii->i", belief.covariance[:3, :3])
    before = pose.copy(), variances.copy()
    pose += step
    variances += (xy, xy, theta)
    try:
        yield
    finally:
        pose[:], variances[:] = before


def _turns(scan: Scan, lines: LineMap, recent: Ints, belief: JointBelief) -> list[float]:
    """Return heading changes [rad] that align a line of the scan with a recent map line, most supported first."""
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
