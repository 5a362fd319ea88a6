"""When the scan and the map disagree: slips are found again, being carried away is noticed, and lost is said.

The guard watches how much of what a scan shows is matched. New lines are no disagreement: a robot that explores
sees new walls. Disagreement is seeing *through* walls that the map has. A wheel that slipped is a wrong heading: a
few headings near the old one are tried. What stays is a robot that was carried off, or a map that was moved: nothing
is corrected or learnt, the covariance says so, and the pose is looked for on the whole map until one place fits.
"""

from __future__ import annotations

import math

import numpy as np

from .association import Association, Scan, associate
from .data import Array, Ints
from .ekf import PoseBelief
from .line_map import AnyBelief, LineMap
from .relocalise import find_pose, matched_share, seen_through

ENOUGH = 0.5  # share of the seen length that must match in an ordinary scan
THROUGH = 0.3  # share of the seen length that lies behind known walls: more is disagreement
SUSTAINED, SUSTAINED_SCANS = 0.5, 4  # s and scans of disagreement before the robot counts as lost
MOVED, TURNED = 0.01, math.radians(0.5)  # since the last scan: at rest nothing slips
LARGEST_SLIP = math.radians(30.0)
SLIP_SHARE = 0.6  # of the seen length that a slipped heading must explain, with two lines
SLIP_XY, SLIP_THETA = 0.1, math.radians(2.0)  # m, rad: what is left to correct after a slip's heading was found
CANDIDATES = 8
LOST_XY = 5.0  # m: standard deviation of a robot that does not know where it is
PLACED_XY, PLACED_THETA = 0.15, math.radians(3.0)  # m, rad: after it was found again
RECENT = 60  # scans


class Guard:
    """Watches the agreement of scans and map over one run."""

    def __init__(self) -> None:
        self._since: float | None = None
        self._scans = 0
        self._lost_from: float | None = None
        self._intervals: list[tuple[float, float]] = []
        self._slips = 0
        self._last = (math.inf, math.inf, math.inf)
        self._now = 0.0

    def watch(
        self, t: float, scan: Scan, found: Association, lines: LineMap, belief: AnyBelief, gate: float
    ) -> tuple[Association, bool]:
        """Return the association to use and whether the scan may correct the pose and teach the map."""
        self._now = t
        moved = self._moved(belief)
        if self._lost_from is not None:
            return self._search(t, scan, found, lines, belief, gate)
        if matched_share(found, scan) >= ENOUGH:
            self._since = None
            return found, True
        if moved:
            slipped = _slipped_heading(scan, lines, belief, gate)
            if slipped is not None:
                belief.shift(slipped, SLIP_XY**2, SLIP_THETA**2)
                self._slips += 1
                self._since = None
                return associate(scan, lines, belief, gate), True
        if seen_through(scan, lines, lines.values(belief), belief.x, belief.y, belief.theta) < THROUGH:
            self._since = None
            return found, True
        return found, self._disagree(t, belief)

    def _disagree(self, t: float, belief: AnyBelief) -> bool:
        if self._since is None:
            self._since, self._scans = t, 0
        self._scans += 1
        if t - self._since >= SUSTAINED and self._scans >= SUSTAINED_SCANS:
            self._lost_from = self._since
            belief.place((belief.x, belief.y, belief.theta), LOST_XY**2, math.pi**2 / 3.0)
        return False

    def _search(
        self, t: float, scan: Scan, found: Association, lines: LineMap, belief: AnyBelief, gate: float
    ) -> tuple[Association, bool]:
        pose = find_pose(scan, lines, belief)
        if pose is None or self._lost_from is None:
            return found, False
        belief.place(pose, PLACED_XY**2, PLACED_THETA**2)
        self._intervals.append((self._lost_from, t))
        self._lost_from = self._since = None
        return associate(scan, lines, belief, gate), True

    def _moved(self, belief: AnyBelief) -> bool:
        x, y, theta = self._last
        self._last = (belief.x, belief.y, belief.theta)
        return math.hypot(belief.x - x, belief.y - y) > MOVED or abs(belief.theta - theta) > TURNED

    def intervals(self) -> list[tuple[float, float]]:
        """Return when the robot was lost, (start, end) [s]; an interval that never ended ends with the run."""
        open_end = [] if self._lost_from is None else [(self._lost_from, self._now)]
        return [*self._intervals, *open_end]

    def words(self) -> list[str]:
        """Say what happened."""
        words = [f"lost from {a:.1f} s to {b:.1f} s after the start, then found again" for a, b in self._intervals]
        if self._lost_from is not None:
            since = f"lost from {self._lost_from:.1f} s after the start until the end"
            words.append(f"{since}: no place on the map fits, or several do")
        if self._slips:
            words.append(f"{self._slips} wheel slips recovered by the lines of the map")
        return words


def _slipped_heading(scan: Scan, lines: LineMap, belief: AnyBelief, gate: float) -> float | None:
    """Return the change of heading [rad] under which most of the scan matches recent lines, None without one."""
    recent = np.flatnonzero(lines.seen.max(initial=0) - lines.seen <= RECENT)
    turns = _turns(scan, lines, recent, belief)
    best, found = SLIP_SHARE, None
    for turn in turns:
        tried = PoseBelief((belief.x, belief.y, belief.theta + turn), _slip_triangle(belief))
        there = associate(scan, _frozen(lines, recent, belief), tried, gate)
        share = matched_share(there, scan)
        if sum(p >= 0 for p in there.match) >= 2 and share >= best:
            best, found = share + 1e-9, turn
    return found


def _slip_triangle(belief: AnyBelief) -> tuple[float, float, float, float, float, float]:
    """Pose covariance of a slipped robot: where it was known to be, plus what a slip moves."""
    P = belief.matrix()
    xy = SLIP_XY**2
    return (float(P[0, 0]) + xy, float(P[0, 1]), 0.0, float(P[1, 1]) + xy, 0.0, SLIP_THETA**2)


def _turns(scan: Scan, lines: LineMap, recent: Ints, belief: AnyBelief) -> list[float]:
    """Return the distinct heading changes that lay a seen line onto a recent one, the most supported first."""
    beta = lines.values(belief)[recent, 1]
    turns = _wrap(beta[None, :] - belief.theta - scan.z[:, 1, None])
    length = np.broadcast_to((scan.ends[:, 1] - scan.ends[:, 0])[:, None], turns.shape)
    near = np.abs(turns) < LARGEST_SLIP
    cells = np.round(turns[near] / math.radians(2.0)).astype(np.int64)
    support: dict[int, float] = {}
    for cell, weight in zip(cells.tolist(), length[near].tolist(), strict=True):
        support[cell] = support.get(cell, 0.0) + weight
    ranked = sorted(support, key=lambda c: (-support[c], abs(c), c))[:CANDIDATES]
    return [c * math.radians(2.0) for c in ranked if c != 0]


def _frozen(lines: LineMap, which: Ints, belief: AnyBelief) -> LineMap:
    """Return some lines as a map of its own with their present values, to be tried against."""
    return LineMap(
        ids=lines.ids[which],
        anchor=lines.anchor[which],
        lo=lines.lo[which],
        hi=lines.hi[which],
        hits=lines.hits[which],
        column=np.full(len(which), -1),
        value=lines.values(belief)[which],
        P=np.broadcast_to(np.diag([1e-4, 1e-5]), (len(which), 2, 2)).copy(),
        seen=lines.seen[which],
        born=lines.born[which],
    )


def _wrap(angle: Array) -> Array:
    return (angle + math.pi) % (2.0 * math.pi) - math.pi
