"""Disagreement of scan and map: finds wheel slips and kidnapping, and reports when the robot is lost.

The guard watches how much of what a scan shows is matched. New lines are no disagreement: a robot that explores
sees new walls. Disagreement is seeing *through* walls that the map has, or walls that all jump from one scan to
the next. A wheel that slipped is a wrong heading: a few near the old one are tried, and the next scans must
confirm it before it turns the pose (`slips`). What remains is a kidnapped robot, or a map that was moved:
no scan corrects pose or map, the covariance grows, and the pose is looked for on the whole map until one
place fits all that was seen since. A growing map is left after some metres (`gives_up`): the robot is adrift in a
new one until its place is recognised.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence

import numpy as np

from locfuse.fusion import se2
from locfuse.fusion.data import RELOCALISED, SLIP, Array, Jump
from locfuse.fusion.ekf.belief_arrays import JointBelief
from locfuse.fusion.ekf.map_frame import Pose

from .line_map import Association, LineMap
from .place_search import behind_walls, find_pose, walls_of
from .scan import Scan
from .slips import (
    SLIP_SIGMA_M,
    SLIP_SIGMA_RAD,
    Seen,
    Series,
    Slide,
    Suspicion,
    Trail,
    agree,
    continues,
    slip_turn,
    tried,
    with_slip,
)

MIN_MATCHED_SHARE = 0.5  # share of the seen length that must match in an ordinary scan
MIN_THROUGH_SHARE = 0.3  # share of the seen length that lies behind known walls: more is disagreement
# share of the seen length in a scan that fits; s by which being lost is dated back
WELL_SHARE, MAX_BACKDATE_S = 0.9, 3.0
MIN_DISAGREEMENT_S, MIN_DISAGREEMENT_SCANS = 0.5, 4  # s and scans of disagreement before the robot counts as lost
MIN_MOVED_M, MIN_TURNED_RAD = 0.01, math.radians(0.5)  # since the last scan: at rest nothing slips
MAX_GAP_S = 1.0  # s without a scan after which walls need not continue
# share that still matches: doors stand open in walls that are known as one
AGREEING_SHARE = 0.25
MIN_WALLS_BEHIND = 3  # seen walls that must lie behind known ones: fewer are seen through a door
# that walls must fill to contradict a map; scans before a jump that count
MIN_VIEW_RAD, SCANS_BEFORE_JUMP = math.radians(90.0), 5
# that walls must fill to show a slip: a few short lines match at some heading
MIN_SLIP_VIEW_RAD = math.radians(45.0)
SLIP_MAX_SHARE = 0.2  # a slip turns everything: where more than this share still matches, there was none
# m by which a slip ahead may move walls from one scan to the next: several, as a wide gate may fit two walls
SLIDE_SIGMAS_M = (0.03, 0.1)
MIN_SLIDE_M, MIN_SLIDE_SHARE = 0.02, 0.2  # m, share of what was rolled: less is no slip ahead
MIN_SLIDE_RATIO = 3.0  # of ahead over aside
MIN_SLIDE_GAIN = 0.1  # share of the seen length that must match beyond what did before
LOST_SIGMA_M = 5.0  # m: standard deviation of a robot that does not know where it is
PLACED_SIGMA_M, PLACED_SIGMA_RAD = 0.15, math.radians(3.0)  # m, rad: after it was found again
CARRY_M_PER_S, CARRY_RAD_PER_S = 0.5, math.radians(30.0)  # m, rad within a second: somebody may carry a lost robot
# scans in a row, from different places, that must agree on where a lost robot is
CONFIRMING_SCANS, CONFIRMING_SCANS_WITH_HEADING = 5, 3
KNOWN_HEADING_SIGMA_RAD = math.radians(10.0)  # rad: standard deviation of a heading that other sensors measure
SAME_PLACE_M, SAME_PLACE_RAD = 0.12, math.radians(4.0)  # m, rad: within which they agree

# scans along 12 m of a lost robot's way without a place: then a new map begins
MAX_LOST_SCANS = 60

Again = Callable[[], Association]  # associates the scan at hand with the belief as it is now
# (3,) m, m, rad: how much more the robot moved than its wheels say; None: not known
Slipped = Callable[[], Array | None]


class Guard:
    """Watches the agreement of scans and map over one run."""

    def __init__(self, jumps: list[Jump]) -> None:
        """`jumps` is the list to which corrections of the pose are added."""
        self._since: float | None = None
        self._scans = 0
        self._lost_from: float | None = None
        self._intervals: list[tuple[float, float]] = []
        self._jumps = jumps
        self._place: tuple[Array, Pose, int] | None = None  # belief and pose found first, scans that agree
        self._suspicion: Suspicion | None = None
        self._series = Series()
        self._slide = Slide()
        self._trail = Trail()  # since it is lost
        self._well = (0.0, 0)  # when a scan last fitted well, and the number of the first line born after it
        self._before: deque[Seen] = deque(maxlen=SCANS_BEFORE_JUMP)  # the last scans
        self._before_torn: Sequence[Seen] = ()  # the last ones before the walls jumped
        self._torn = False  # the walls jumped, and little has matched since
        self._now = 0.0
        self._after: Pose | None = None  # where the robot was believed to be once the last scan had corrected it
        self._wheels: Pose = (0.0, 0.0, 0.0)  # by the wheels alone
        self._tried = 0  # scans along the way of a lost robot
        self._adrift: float | None = None  # s: since then the robot is in a map whose place is not known

    def stood(self, pose: Pose) -> None:
        """Note the pose after a scan; the wheels predict from there."""
        self._after = pose

    def _fits(self, t: float, share: float, pose: Pose, scan: Scan, next_id: int) -> bool:
        """Return whether enough of a scan matches to use it, and store the scan then.

        `pose` is predicted, `next_id` the number of the next map line.
        """
        if self._lost_from is not None or self._suspicion is not None or not share >= MIN_MATCHED_SHARE:
            return False
        self._now = t
        self._before.append((t, self._rolled(pose), scan))
        if share >= WELL_SHARE:
            self._well = (t, next_id)
        self._since, self._torn = None, False
        self._series.ends()
        return True

    def watch(
        self,
        t: float,
        scan: Scan,
        share: float,
        found: Association,
        lines: LineMap,
        belief: JointBelief,
        again: Again,
        slipped: Slipped,
    ) -> tuple[Association, bool]:
        """Return the association to use and whether the scan may correct pose and map."""
        moved = share < WELL_SHARE and self._moved(belief.pose())
        if not moved:
            self._slide.ends()
        elif self._slid(share, lines, belief, again, slipped):
            found = again()
            share = found.share()
        if self._fits(t, share, belief.pose(), scan, lines.next_id):
            return found, True
        dt, self._now = t - self._now, t
        now = (t, self._rolled(belief.pose()), scan)
        before = tuple(self._before)
        self._before.append(now)
        if self._lost_from is not None:
            _keep_open(belief, dt)
            return self._search(t, scan, found, lines, belief, again)
        if share >= MIN_MATCHED_SHARE:
            self._series.ends()
        turn, asked = None, self._suspicion is not None
        if self._suspicion is not None:
            turn = self._weighed(self._suspicion, scan, share, lines, belief, again, slipped)
        elif moved and share < SLIP_MAX_SHARE and _view(scan) >= MIN_SLIP_VIEW_RAD:
            turn = self._suspected(scan, lines, belief, again, slipped)
            asked = turn is not None or self._suspicion is not None
        if asked and share < SLIP_MAX_SHARE and self._series.goes_on(now, before):
            self._lose(self._series.begun, lines, belief)
            return again(), False
        if turn is not None:
            return self._turned(turn, belief, again), True
        teach = self._believed(before, now, share, lines, belief)
        return again(), teach and self._suspicion is None

    def _slid(self, share: float, lines: LineMap, belief: JointBelief, again: Again, slipped: Slipped) -> bool:
        """Move the pose back or on where both wheels slipped alike; return whether they did.

        Against an obstacle or on a smooth floor walls along the way still match, and those across it do once the
        pose is where matched scans put it. Several in a row must show the slip.
        """
        slide = self._slide
        if self._lost_from is not None or self._suspicion is not None:
            slide.ends()
            return False

        def gains(sigma: float) -> bool:
            with tried(belief, (0.0, 0.0, 0.0), sigma**2, 0.0):
                return bool(again().share() >= share + MIN_SLIDE_GAIN)

        shown = slide.begun or any(gains(sigma) for sigma in SLIDE_SIGMAS_M)
        step = slipped() if shown else None
        if step is None or abs(step[2]) > SLIP_SIGMA_RAD or not self._is_ahead(step, belief.pose()):
            slide.ends()
            return False
        found = slide.goes_on(step, lines.next_id)
        if found is None:
            return False
        off, first_line = found
        x, y = se2.rotated(np.array(belief.theta), off).tolist()
        _forget_since(first_line, lines, belief)
        belief.shift((x, y, 0.0), SLIP_SIGMA_M**2, 0.0)
        self._note_slide(x, y)
        return True

    def _is_ahead(self, step: Array, pose: Pose) -> bool:
        """Return whether a slip (3,) is along the way, and large beside the way since the last scan."""
        x, y, _ = self._after or pose
        least = max(MIN_SLIDE_M, MIN_SLIDE_SHARE * math.hypot(pose[0] - x, pose[1] - y))
        return bool(abs(step[0]) >= max(least, MIN_SLIDE_RATIO * abs(step[1])))

    def _note_slide(self, x: float, y: float) -> None:
        """Note a slip ahead [m, map]; what goes on from scan to scan is one jump."""
        last = self._jumps[-1] if self._jumps else None
        if last is not None and last.kind == SLIP and not last.step[2] and self._now - last.t < MAX_GAP_S:
            x, y = x + last.step[0], y + last.step[1]
            self._jumps.pop()
        self._jumps.append(Jump(self._now, SLIP, (x, y, 0.0)))

    def _suspected(
        self, scan: Scan, lines: LineMap, belief: JointBelief, again: Again, slipped: Slipped
    ) -> float | None:
        """Return a small slip [rad] that map and matched scans confirm; a large slip must wait for more scans."""
        turn = slip_turn(scan, lines, belief, again)
        if turn is None:
            return None
        if Suspicion.waits(turn):
            self._suspicion = Suspicion(turn)
            return None
        step = slipped()
        return turn if step is not None and agree(float(step[2]), turn) else None

    def _weighed(
        self,
        suspicion: Suspicion,
        scan: Scan,
        kept: float,
        lines: LineMap,
        belief: JointBelief,
        again: Again,
        slipped: Slipped,
    ) -> float | None:
        """Compare a scan with both headings of a suspicion; return the slip [rad] once enough scans confirm it.

        Matched scans measure the turn without the map: where they match, headings of the map must agree with them.
        """
        suspicion.look(kept, with_slip(belief, suspicion.turn, again).share())
        if not suspicion.decided:
            return None
        step = slipped()
        self._suspicion, by_scans = None, None if step is None else float(step[2])
        if by_scans is not None and abs(by_scans) < SLIP_SIGMA_RAD:
            return None
        turns = [turn for turn in (suspicion.turn, slip_turn(scan, lines, belief, again)) if turn is not None]
        if by_scans is not None:
            turns = [by_scans, *(turn for turn in turns if agree(by_scans, turn))]
        shares = [with_slip(belief, turn, again).share() for turn in turns]
        best = int(np.argmax(shares))
        return turns[best] if suspicion.confirmed(shares[best] - kept, by_scans is not None) else None

    def _turned(self, turn: float, belief: JointBelief, again: Again) -> Association:
        """Turn the pose by a slip [rad]."""
        belief.shift((0.0, 0.0, turn), SLIP_SIGMA_M**2, SLIP_SIGMA_RAD**2)
        self._jumps.append(Jump(self._now, SLIP, (0.0, 0.0, turn)))
        self._since, self._torn = None, False
        return again()

    def _believed(
        self, before: Sequence[Seen], now: Seen, share: float, lines: LineMap, belief: JointBelief
    ) -> bool:
        """Return whether a scan with few matches may correct pose and map; after several, it is lost."""
        t, _, scan = now
        if _view(scan) < MIN_VIEW_RAD:  # a doorway, clutter: too little to contradict anything
            return not self._torn
        if self._torn:
            self._torn = not continues(self._before_torn, now)
        elif share < SLIP_MAX_SHARE and _jumped(before, now):
            self._torn, self._before_torn = True, before
        if self._torn:
            return self._disagree(t, lines, belief)
        if share >= AGREEING_SHARE or not _sees_through(scan, lines, belief):
            self._since = None
            return True
        return self._disagree(t, lines, belief)

    def _lose(self, since: float, lines: LineMap, belief: JointBelief) -> None:
        """Mark the robot as lost from the last scan that fitted well; map lines born after it are dropped."""
        well, _ = self._well
        self._lost_from = max(min(since, well), since - MAX_BACKDATE_S)
        if self._intervals and self._lost_from <= self._intervals[-1][1]:  # what was found was no place
            self._lost_from = min(self._lost_from, self._intervals.pop()[0])
        belief.lost, self._suspicion = True, None
        _forget_since(self._well[1], lines, belief)
        self._trail.forget()
        self._tried = 0
        belief.place((belief.x, belief.y, belief.theta), LOST_SIGMA_M**2, math.pi**2 / 3.0)

    def _rolled(self, here: Pose) -> Pose:
        """Return the pose by the wheels alone, continued from the last scan."""
        self._wheels = se2.carried(self._wheels, self._after or here, here)
        self._after = here
        return self._wheels

    def enter_map(self) -> None:
        """Continue in another map; earlier scans, in the frame of the old map, are dropped."""
        self._before.clear()
        self._since = self._after = self._suspicion = None
        self._slide.ends()
        self._torn = False

    def gives_up(self) -> bool:
        """Return whether a lost robot has driven on for long without a place on the map."""
        return self._lost_from is not None and self._tried >= MAX_LOST_SCANS

    def leave(self) -> None:
        """Leave the map at an unknown pose; the next map's place is unknown until the map is recognised."""
        self._adrift, self._lost_from = self._since_lost(), None

    def recognised(self, t: float) -> None:
        """Mark the place of the map that a lost robot began as recognised."""
        if self._adrift is not None:
            self._intervals.append((self._adrift, t))
        self._adrift = None

    def begin_anew(self, t: float, belief: JointBelief) -> None:
        """Continue with a new map, in which the robot's pose is known exactly."""
        self._before.clear()
        self._since = self._place = self._suspicion = None
        self._slide.ends()
        self._trail.forget()
        self._after = None
        if self._lost_from is not None or belief.lost:
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
        if t - self._since >= MIN_DISAGREEMENT_S and self._scans >= MIN_DISAGREEMENT_SCANS:
            self._lose(self._since, lines, belief)
        return False

    def _search(
        self, t: float, scan: Scan, found: Association, lines: LineMap, belief: JointBelief, again: Again
    ) -> tuple[Association, bool]:
        if not self._trail.note(np.array([belief.x, belief.y, belief.theta]), scan):
            return found, False  # from the same place nothing new is seen
        self._tried += 1
        pose = find_pose(scan, lines, belief, self._trail)
        if pose is None or self._lost_from is None or not self._confirmed(pose, belief):
            return found, False
        before = in_map(belief)
        belief.place(pose, PLACED_SIGMA_M**2, PLACED_SIGMA_RAD**2)
        self._jumps.append(jump(t, RELOCALISED, before, in_map(belief)))
        self._found(t, belief)
        return again(), True

    def _confirmed(self, pose: Pose, belief: JointBelief) -> bool:
        """Return whether CONFIRMING_SCANS in a row agree with the wheels' motion since the last place.

        One scan of a few walls fits somewhere by chance; several, from places a robot drove between, hardly do.
        """
        here = np.array([belief.x, belief.y, belief.theta])
        if self._place is not None:
            there, place, times = self._place
            off = np.array(pose) - se2.compose(np.array(place), se2.between(there, here))
            if math.hypot(off[0], off[1]) < SAME_PLACE_M and abs(se2.wrap(float(off[2]))) < SAME_PLACE_RAD:
                self._place = (there, place, times + 1)
                known = float(belief.matrix()[2, 2]) < KNOWN_HEADING_SIGMA_RAD**2
                return times + 1 >= (CONFIRMING_SCANS_WITH_HEADING if known else CONFIRMING_SCANS)
        self._place = (here, pose, 1)
        return False

    def _moved(self, pose: Pose) -> bool:
        """Return whether the wheels moved since the last scan."""
        x, y, theta = self._after or (math.inf, math.inf, math.inf)
        return math.hypot(pose[0] - x, pose[1] - y) > MIN_MOVED_M or abs(pose[2] - theta) > MIN_TURNED_RAD

    def intervals(self) -> list[tuple[float, float]]:
        """Return when the robot was lost, (start, end) [s]; an interval without end is open (infinite)."""
        since = self._since_lost()
        return [*self._intervals, *([] if since is None else [(since, math.inf)])]

    def _since_lost(self) -> float | None:
        return min((t for t in (self._lost_from, self._adrift) if t is not None), default=None)

    def words(self) -> list[str]:
        """Return what happened, in words."""
        words = [f"lost from {a:.1f} s to {b:.1f} s after the start, then found again" for a, b in self._intervals]
        if (since := self._since_lost()) is not None:
            lost = f"lost from {since:.1f} s after the start until the end"
            words.append(f"{lost}: no place on the map fits, or several do")
        if n := sum(jump.kind == SLIP for jump in self._jumps):
            slips = "1 wheel slip" if n == 1 else f"{n} wheel slips"
            words.append(f"{slips} recovered by the lines of the map")
        return words


def _forget_since(first: int, lines: LineMap, belief: JointBelief) -> None:
    """Drop the lines with the number `first` and later ones, unless these are all."""
    gone = np.flatnonzero(lines.ids >= first)
    if len(gone) < len(lines):
        belief.remove(lines.drop(gone))


def in_map(belief: JointBelief) -> Array:
    """Return the pose (3,) in the map."""
    frame, pose = belief.frame_pose(), np.array(belief.pose())
    return pose if frame is None else se2.compose(np.array(frame), pose)


def jump(t: float, kind: str, before: Array, after: Array) -> Jump:
    """Return the jump from one pose (3,) in the map to another one."""
    x, y, theta = (after - before).tolist()
    return Jump(t, kind, (x, y, se2.wrap(theta)))


def _jumped(before: Sequence[Seen], now: Seen) -> bool:
    """Return whether a scan continues the walls of no earlier scan, even with a slip: the robot was moved.

    A robot that explores sees new walls, but not only new ones, and not at once. In clutter lines come and go from
    scan to scan, but some scan of the last ones had them.
    """
    recent = [one for one in before if now[0] - one[0] <= MAX_GAP_S]
    if not recent or max(_view(one[2]) for one in recent) < MIN_VIEW_RAD:
        return False
    return not continues(recent, now, SLIP_MAX_SHARE)


def _view(scan: Scan) -> float:
    """Return the angle [rad] that the walls of a scan cover, seen from the robot."""
    r = np.abs(scan.z[:, :1])
    bearings = np.arctan2(scan.ends, np.maximum(r, 1e-6))
    return float((bearings[:, 1] - bearings[:, 0]).sum())


def _sees_through(scan: Scan, lines: LineMap, belief: JointBelief) -> bool:
    """Return whether much of the scan, and several walls of it, lie behind known walls.

    One wall may be seen through a door of a wall that is known as one; what was never seen contradicts nothing.
    """
    behind = behind_walls(scan, walls_of(lines, lines.values(belief)), belief.pose())
    length = scan.ends[:, 1] - scan.ends[:, 0]
    return bool(
        (behind * length).sum() >= MIN_THROUGH_SHARE * length.sum() and (behind > 0.5).sum() >= MIN_WALLS_BEHIND
    )


def _keep_open(belief: JointBelief, dt: float) -> None:
    """Add noise to the pose of a lost robot, whose wheels may turn in the air."""
    theta = float(belief.matrix()[2, 2])
    fades = min(CARRY_RAD_PER_S**2 * dt, max(math.pi**2 / 3.0 - theta, 0.0))
    belief.shift((0.0, 0.0, 0.0), CARRY_M_PER_S**2 * dt, fades)
