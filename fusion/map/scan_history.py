"""Recent scans of a lost robot with their wheel poses: a candidate place must explain all of them.

In a room whose halves look alike a single scan fits twice. As the robot drives on, one of the two places shows
walls that are not there.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator

import numpy as np

from locfuse.fusion import se2
from locfuse.fusion.data import Array

from .scan import Scan

STRIDE_M, TURN_RAD = 0.2, math.radians(15.0)  # m, rad between two scans that are kept
# scans, rad: over 6 m, or around a corner, the wheels have drifted
MAX_SCANS, MAX_TURNED_RAD = 30, math.radians(90.0)
MIN_LINES = 2
SAME_ANGLE_RAD, SAME_OFFSET_M = math.radians(4.0), 0.1  # a line is where the wheels expect it within these
CONTINUING_SHARE = 0.6  # share of the seen length that must be: less, and the robot is being carried
MAX_SLIPS = 1000  # slips that are tried; two scans of 30 lines have fewer
MAX_NUMBERS = 1 << 22  # numbers at a time: two scans of 2000 lines would need terabytes


class Trail:
    """Scans along the way of the wheels."""

    def __init__(self) -> None:
        self._seen: deque[tuple[Array, Scan]] = deque(maxlen=MAX_SCANS)  # pose by the wheels, scan

    def note(self, pose: Array, scan: Scan) -> bool:
        """Keep a scan that shows something, from a pose (3,) by the wheels that is not the last one's, or do not.

        Where the walls moved otherwise than the wheels, the robot is still being carried: what was before is void.
        """
        if len(scan.z) < MIN_LINES:
            return False
        if self._seen:
            there, before = self._seen[-1]
            step = se2.between(there, pose)
            if math.hypot(step[0], step[1]) < STRIDE_M and abs(se2.wrap(float(step[2]))) < TURN_RAD:
                return False
            if expected_share(scan, before, step) < CONTINUING_SHARE:
                self.forget()
        self._seen.append((pose, scan))
        return True

    def forget(self) -> None:
        """Forget all scans and start again."""
        self._seen.clear()

    def back_from(self, pose: Array) -> Iterator[tuple[Array, Scan]]:
        """Yield the scans, the newest first, with the pose (3,) they were taken from as seen from `pose`."""
        for there, scan in reversed(self._seen):
            step = np.asarray(se2.between(pose, there))
            if abs(se2.wrap(float(step[2]))) > MAX_TURNED_RAD:
                return
            yield step, scan


def expected_share(scan: Scan, before: Scan, step: Array, slip: float = 0.0) -> float:
    """Return the share of a scan's line length that is where an earlier scan and a step (3,) expect it.

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
    """Return slips (n,) [rad], of very many evenly some: neighbours then lie much closer than SAME_ANGLE."""
    if len(slips) <= MAX_SLIPS:
        return slips
    some: Array = np.sort(slips)[np.linspace(0, len(slips) - 1, MAX_SLIPS).astype(np.intp)]
    return some
