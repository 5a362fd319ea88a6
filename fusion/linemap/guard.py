"""When the scan and the map disagree: slips are found again, being carried away is noticed, and lost is said.

The guard watches how much of what a scan shows is matched. New lines are no disagreement: a robot that explores
sees new walls. Disagreement is seeing *through* walls that the map has, or walls that all jump from one scan to
the next. A wheel that slipped is a wrong heading: a few near the old one are tried. What stays is a robot that was
carried off, or a map that was moved: nothing is corrected or learnt, the covariance says so, and the pose is
looked for on the whole map until one place fits all that was seen since.
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

from .association import Association, associate
from .line_map import LineMap
from .relocalise import behind_walls, find_pose
from .scan import Scan
from .scan_history import Trail, expected_share

MIN_MATCHED_SHARE = 0.5  # share of the seen length that must match in an ordinary scan
THROUGH = 0.3  # share of the seen length that lies behind known walls: more is disagreement
WELL, LOOK_BACK = 0.9, 3.0  # share of the seen length in a scan that fits; s by which being lost is dated back
SUSTAINED, SUSTAINED_SCANS = 0.5, 4  # s and scans of disagreement before the robot counts as lost
MOVED, TURNED = 0.01, math.radians(0.5)  # since the last scan: at rest nothing slips
MAX_SLIP_RAD = math.radians(30.0)
SLIP_SHARE = 0.6  # of the seen length that a slipped heading must explain, with two lines
GAP = 1.0  # s without a scan after which walls need not continue
AGREES = 0.25  # share that still matches: doors stand open in walls that are known as one, and nobody is lost
WALLS_BEHIND = 3  # seen walls that must lie behind known ones: fewer are seen through a door
VIEW, SCANS = math.radians(90.0), 5  # that walls must fill to contradict a map; scans before a jump that count
CONTINUES = 0.4  # share of the seen length where scans from before a jump expect it: then there was none
SLIP_VIEW = math.radians(45.0)  # that walls must fill to show a slip: a few short lines match at some heading
HARDLY = 0.2  # a slip turns everything: where more than this share still matches, there was none
SLIP_XY, SLIP_THETA = 0.03, math.radians(1.5)  # m, rad: what is left to correct after a slip's heading was found
CANDIDATES = 8
LOST_XY = 5.0  # m: standard deviation of a robot that does not know where it is
PLACED_XY, PLACED_THETA = 0.15, math.radians(3.0)  # m, rad: after it was found again
CARRY, CARRY_TURN = 0.5, math.radians(30.0)  # m, rad within a second: somebody may carry a lost robot
RECENT = 60  # scans
SERIES, CARRIED = 1.0, 4  # s between slips of one series, and slips that make it one
CONFIRMED = 5  # scans in a row that must agree on where a lost robot is
SAME_XY, SAME_THETA = 0.12, math.radians(4.0)  # m, rad: within which they agree

Seen = tuple[float, Pose, Scan]  # a scan: when [s], and where the robot was believed to be
Late = tuple[float, Pose, Callable[[], Scan]]  # the same, the scan made when it is asked for


class Guard:
    """Watches the agreement of scans and map over one run."""

    def __init__(self) -> None:
        self._since: float | None = None
        self._scans = 0
        self._lost_from: float | None = None
        self._intervals: list[tuple[float, float]] = []
        self._slips = 0
        self._place: tuple[Array, Pose, int] | None = None  # belief and pose found first, scans that agree
        self._carried: tuple[float, float, int] | None = None  # first and last slip of a series, how many
        self._trail = Trail()  # since it is lost
        self._well = (0.0, 0)  # when a scan last fitted well, and the number of the first line born after it
        self._before: deque[Late] = deque(maxlen=SCANS)  # the last scans
        self._before_torn: list[Seen] = []  # the last ones before the walls jumped
        self._torn = False  # the walls jumped, and little has matched since
        self._last = (math.inf, math.inf, math.inf)
        self._now = 0.0

    def watch(
        self, t: float, scan: Scan, found: Association, lines: LineMap, belief: JointBelief, gate: float
    ) -> tuple[Association, bool]:
        """Return the association to use and whether the scan may correct the pose and teach the map."""
        dt, self._now = t - self._now, t
        moved = self._moved(belief)
        now = (t, (belief.x, belief.y, belief.theta), scan)
        before = tuple(self._before)
        self._before.append((t, now[1], lambda: scan))
        if self._lost_from is not None:
            _keep_open(belief, dt)
            return self._search(t, scan, found, lines, belief, gate)
        share = found.share()
        if share >= WELL:
            self._well = (t, lines.next_id)
        if share >= MIN_MATCHED_SHARE:
            self._since, self._torn = None, False
            return found, True
        if moved and share < HARDLY and _view(scan) >= SLIP_VIEW:
            slipped = _after_slip(scan, lines, belief, gate)
            if slipped is not None:
                self._since, self._torn = None, False
                return slipped, not self._carried_off(t, scan, lines, belief)
        seen = [(when, pose, late()) for when, pose, late in before]
        return found, self._believed(seen, now, share, lines, belief)

    def passed(self, seen: Sequence[Late], well: tuple[float, int] | None) -> None:
        """Take in scans that the core took, and of the last one that fitted well when it was, and the next line.

        Enough was matched of each.
        """
        self._before.extend(seen)
        self._now, self._last, _ = seen[-1]
        self._since, self._torn = None, False
        self._well = self._well if well is None else well

    def _believed(self, before: list[Seen], now: Seen, share: float, lines: LineMap, belief: JointBelief) -> bool:
        """Return whether a scan of which little is matched may correct and teach; after several it is lost."""
        t, _, scan = now
        if _view(scan) < VIEW:  # a doorway, clutter: too little to contradict anything
            return not self._torn
        if self._torn:
            self._torn = not _continues(self._before_torn, now)
        elif share < HARDLY and _jumped(before, now):
            self._torn, self._before_torn = True, before
        if self._torn:
            return self._disagree(t, lines, belief)
        if share >= AGREES or not _sees_through(scan, lines, belief):
            self._since = None
            return True
        return self._disagree(t, lines, belief)

    def _carried_off(self, t: float, scan: Scan, lines: LineMap, belief: JointBelief) -> bool:
        """Count a slip; a series of them is none: somebody carries the robot, and it is lost from the first on.

        Only where much is seen: in clutter, or by a narrow camera, some heading fits a few short lines.
        """
        self._slips += 1
        if _view(scan) < VIEW:
            return False
        first, last, count = self._carried or (t, t, 0)
        if t - last > SERIES:
            first, count = t, 0
        self._carried = (first, t, count + 1)
        if count + 1 < CARRIED:
            return False
        self._slips -= CARRIED
        self._carried = None
        self._lose(first, lines, belief)
        return True

    def _lose(self, since: float, lines: LineMap, belief: JointBelief) -> None:
        """Mark the robot as lost from the last scan that fitted well; what was learnt after it is forgotten."""
        well, born = self._well
        self._lost_from = max(min(since, well), since - LOOK_BACK)
        if self._intervals and self._lost_from <= self._intervals[-1][1]:  # what was found was no place
            self._lost_from = min(self._lost_from, self._intervals.pop()[0])
        gone = np.flatnonzero(lines.ids >= born)
        belief.lost = True
        if len(gone) < len(lines):
            belief.remove(lines.drop(gone))
        self._trail.forget()
        belief.place((belief.x, belief.y, belief.theta), LOST_XY**2, math.pi**2 / 3.0)

    def turn_page(self) -> None:
        """Go on in another map: what was seen before in this one's frame is void."""
        self._before.clear()
        self._since = self._carried = None
        self._last = (math.inf, math.inf, math.inf)
        self._torn = False

    def begin_anew(self, t: float, belief: JointBelief) -> None:
        """Begin with a map that begins now, where the robot is in it is exactly known."""
        self._before.clear()
        self._since = self._place = self._carried = None
        self._last = (math.inf, math.inf, math.inf)
        self._trail.forget()
        if self._lost_from is not None:
            self._found(t, belief)

    def _found(self, t: float, belief: JointBelief) -> None:
        if self._lost_from is not None:
            self._intervals.append((self._lost_from, t))
        self._lost_from = self._since = self._place = None
        self._torn = False
        belief.lost = False

    def _disagree(self, t: float, lines: LineMap, belief: JointBelief) -> bool:
        if self._since is None:
            self._since, self._scans = t, 0
        self._scans += 1
        if t - self._since >= SUSTAINED and self._scans >= SUSTAINED_SCANS:
            self._lose(self._since, lines, belief)
        return False

    def _search(
        self, t: float, scan: Scan, found: Association, lines: LineMap, belief: JointBelief, gate: float
    ) -> tuple[Association, bool]:
        pose = find_pose(scan, lines, belief, self._trail)
        self._trail.note(np.array([belief.x, belief.y, belief.theta]), scan)
        if pose is None or self._lost_from is None or not self._confirmed(pose, belief):
            return found, False
        belief.place(pose, PLACED_XY**2, PLACED_THETA**2)
        self._found(t, belief)
        return associate(scan, lines, belief, gate), True

    def _confirmed(self, pose: Pose, belief: JointBelief) -> bool:
        """Return whether CONFIRMED scans in a row put the robot where the wheels took it from the last place.

        One scan of a few walls fits somewhere by chance; several, from places a robot drove between, hardly do.
        """
        here = np.array([belief.x, belief.y, belief.theta])
        if self._place is not None:
            there, place, times = self._place
            off = np.array(pose) - se2.compose(np.array(place), se2.between(there, here))
            if math.hypot(off[0], off[1]) < SAME_XY and abs(se2.wrap(float(off[2]))) < SAME_THETA:
                self._place = (there, place, times + 1)
                return times + 1 >= CONFIRMED
        self._place = (here, pose, 1)
        return False

    def _moved(self, belief: JointBelief) -> bool:
        x, y, theta = self._last
        self._last = (belief.x, belief.y, belief.theta)
        return math.hypot(belief.x - x, belief.y - y) > MOVED or abs(belief.theta - theta) > TURNED

    def intervals(self) -> list[tuple[float, float]]:
        """Return when the robot was lost, (start, end) [s]; one that never ended is open (infinite)."""
        open_end = [] if self._lost_from is None else [(self._lost_from, math.inf)]
        return [*self._intervals, *open_end]

    def words(self) -> list[str]:
        """Say what happened."""
        words = [f"lost from {a:.1f} s to {b:.1f} s after the start, then found again" for a, b in self._intervals]
        if self._lost_from is not None:
            since = f"lost from {self._lost_from:.1f} s after the start until the end"
            words.append(f"{since}: no place on the map fits, or several do")
        if self._slips:
            slips = "1 wheel slip" if self._slips == 1 else f"{self._slips} wheel slips"
            words.append(f"{slips} recovered by the lines of the map")
        return words


def _jumped(before: Sequence[Seen], now: Seen) -> bool:
    """Return whether the walls of this scan continue those of none of the scans before it, a slip allowed for.

    A robot that explores sees new walls, but not only new ones, and not at once. In clutter lines come and go from
    scan to scan, but some scan of the last ones had them.
    """
    recent = [one for one in before if now[0] - one[0] <= GAP]
    if not recent or max(_view(one[2]) for one in recent) < VIEW:
        return False
    return not _continues(recent, now, HARDLY)


def _view(scan: Scan) -> float:
    """Return the angle that the walls of a scan fill, as seen from the robot [rad]."""
    r = np.abs(scan.z[:, :1])
    bearings = np.arctan2(scan.ends, np.maximum(r, 1e-6))
    return float((bearings[:, 1] - bearings[:, 0]).sum())


def _continues(before: Sequence[Seen], now: Seen, share: float = CONTINUES) -> bool:
    """Return whether this scan shows walls where one of these scans and the wheels expect them."""
    _, here, scan = now
    steps = ((old, se2.between(np.array(there), np.array(here))) for _, there, old in before if len(old.z))
    return any(expected_share(scan, old, step, MAX_SLIP_RAD) >= share for old, step in steps)


def _sees_through(scan: Scan, lines: LineMap, belief: JointBelief) -> bool:
    """Return whether much of the scan, and several walls of it, lie behind known walls.

    One wall may be seen through a door of a wall that is known as one; what was never seen contradicts nothing.
    """
    behind = behind_walls(scan, lines, lines.values(belief), (belief.x, belief.y, belief.theta))
    length = scan.ends[:, 1] - scan.ends[:, 0]
    return bool((behind * length).sum() >= THROUGH * length.sum() and (behind > 0.5).sum() >= WALLS_BEHIND)


def _keep_open(belief: JointBelief, dt: float) -> None:
    """Let what is known of a lost pose fade: its wheels may hang in the air; a compass keeps it up to date."""
    theta = float(belief.matrix()[2, 2])
    fades = min(CARRY_TURN**2 * dt, max(math.pi**2 / 3.0 - theta, 0.0))
    belief.shift(0.0, CARRY**2 * dt, fades)


def _after_slip(scan: Scan, lines: LineMap, belief: JointBelief, gate: float) -> Association | None:
    """Turn the belief by the heading change that makes most of the scan match; None, and no change, without one.

    Every heading is tried on the belief itself and the whole map: what is accepted here is what will be matched.
    """
    recent = np.flatnonzero(lines.seen.max(initial=0) - lines.seen <= RECENT)
    least, found = SLIP_SHARE, None
    for turn in _turns(scan, lines, recent, belief):
        with tried(belief, turn, SLIP_XY**2, SLIP_THETA**2):
            there = associate(scan, lines, belief, gate)
        share = there.share()
        if share >= least and sum(p >= 0 for p in there.match) >= 2:
            least, found = share + 1e-9, turn
    if found is None:
        return None
    belief.shift(found, SLIP_XY**2, SLIP_THETA**2)
    return associate(scan, lines, belief, gate)


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
