"""Monitor of scan-to-map agreement: corrects wheel slips, detects kidnapping, relocalises a lost robot.

The class `Guard` computes which share of each scan's line length matches the map. New lines that do not match are
normal: an exploring robot sees new walls. A scan disagrees with the map if it shows objects *behind* known walls,
or if all walls jump from one scan to the next. A wheel slip gives a wrong heading: a few headings near the
predicted one are tried, and the next scans must confirm the slip before the pose is corrected (`slips`).

If no slip explains the disagreement, the robot is lost (kidnapped). Then scans correct neither pose nor map, the
covariance grows, and the whole map is searched until exactly one pose agrees with all scans since then. If this
takes too long while the map is being built (`gives_up`), a new submap begins. Its pose is unknown until a place is
recognised.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence

import numpy as np

from locfuse.fusion import se2
from locfuse.fusion.data import RELOCALISED, SLIP, Array, Jump
from locfuse.fusion.ekf.belief_arrays import JointBelief
from locfuse.fusion.ekf.map_frame import Pose

from .line_map import Association
from .place_search import behind_walls, find_pose, walls_of
from .scan import Scan
from .slips import (
    SLIP_SIGMA_M,
    SLIP_SIGMA_RAD,
    SMALL_RAD,
    PresentScan,
    RecentScans,
    Seen,
    Series,
    Slide,
    Suspicion,
    agree,
    continues,
    slip_turn,
    tried,
    with_slip,
)

# --- shares of a scan's line length
MIN_MATCHED_SHARE = 0.5  # least matched share of an ordinary scan
MIN_THROUGH_SHARE = 0.3  # least share behind known walls with which a scan disagrees with the map
# least matched share of a good scan; s: a robot counts as lost since the last good scan, at most this long ago
GOOD_SHARE, MAX_BACKDATE_S = 0.9, 3.0
AGREEING_SHARE = 0.25  # least matched share of an agreeing scan, even if it sees through open doors
SLIP_MAX_SHARE = 0.2  # a heading slip moves all lines: no slip if a larger share still matches
# --- disagreement
MIN_DISAGREEMENT_S, MIN_DISAGREEMENT_SCANS = 0.5, 4  # s and scans of disagreement before the robot counts as lost
# least motion since the last scan: at rest no wheel slips
MIN_MOVED_M, MIN_TURNED_RAD = 0.01, math.radians(0.5)
MAX_GAP_S = 1.0  # after a longer gap between scans, the walls of both may differ
MIN_WALLS_BEHIND = 3  # least number of seen walls behind known walls: fewer are seen through a door
# angle that the walls of a scan must cover to contradict a map; earlier scans that are compared after a jump
MIN_VIEW_RAD, SCANS_BEFORE_JUMP = math.radians(90.0), 5
# angle that walls must cover to show a slip: a few short lines match at some heading
MIN_SLIP_VIEW_RAD = math.radians(45.0)
# --- slip of both wheels alike (forward)
SLIDE_SIGMAS_M = (0.03, 0.1)  # m, shift of walls between two scans: several, since a wide gate may fit two walls
MIN_SLIDE_M, MIN_SLIDE_SHARE = 0.02, 0.2  # least slip in m, and as share of the motion by wheel odometry
MIN_SLIDE_RATIO = 3.0  # least ratio of forward to sideways slip
MIN_SLIDE_GAIN = 0.1  # least increase of the matched share by the slip
# --- a lost robot
LOST_SIGMA_M = 5.0  # m: standard deviation of the position
PLACED_SIGMA_M, PLACED_SIGMA_RAD = 0.15, math.radians(3.0)  # m, rad: standard deviations after relocalisation
CARRY_M_PER_S, CARRY_RAD_PER_S = 0.5, math.radians(30.0)  # process noise within a second: the robot may be carried
# consecutive scans from different positions that must agree on the pose
CONFIRMING_SCANS, CONFIRMING_SCANS_WITH_HEADING = 5, 3
KNOWN_HEADING_SIGMA_RAD = math.radians(10.0)  # rad: largest standard deviation of a heading that counts as known
SAME_PLACE_M, SAME_PLACE_RAD = 0.12, math.radians(4.0)  # m, rad: largest differences of two equal poses
MAX_LOST_SCANS = 60  # scans (along 12 m) without relocalisation, after which a new submap begins


class Guard:
    """Monitor of the agreement of scans and map during one run."""

    def __init__(self, jumps: list[Jump]) -> None:
        """Begin; corrections of the pose will be appended to `jumps`."""
        self._since: float | None = None  # s, first scan of the present disagreement
        self._scans = 0  # of the present disagreement
        self._lost_from: float | None = None  # s
        self._intervals: list[tuple[float, float]] = []
        self._jumps = jumps
        # for the first of several agreeing scans: predicted pose, found pose; then the number of these scans
        self._place: tuple[Array, Pose, int] | None = None
        self._suspicion: Suspicion | None = None
        self._series = Series()
        self._slide = Slide()
        self._trail = RecentScans()  # scans since the robot is lost
        self._good = (0.0, 0)  # s, time of the last good scan, and id of the first line added after it
        self._before: deque[Seen] = deque(maxlen=SCANS_BEFORE_JUMP)  # last scans
        self._before_jump: Sequence[Seen] = ()  # last scans before the walls jumped
        self._jumped = False  # the walls jumped, and few have matched since
        self._now = 0.0  # s, time of the present scan
        self.corrected: Pose | None = None  # pose after the correction by the last scan
        self._wheels: Pose = (0.0, 0.0, 0.0)  # pose by wheel odometry alone
        self._tried = 0  # scans searched since the robot is lost
        self._unplaced_from: float | None = None  # s: since then the pose of the submap in the map is unknown

    def _fits(self, present: PresentScan, share: float) -> bool:
        """Return whether enough of a scan matches the map to use the scan, and store the scan if so."""
        if self._lost_from is not None or self._suspicion is not None or not share >= MIN_MATCHED_SHARE:
            return False
        self._now = present.t
        self._before.append((present.t, self._by_wheels(present.belief.pose()), present.scan))
        if share >= GOOD_SHARE:
            self._good = (present.t, present.lines.next_id)
        self._since, self._jumped = None, False
        self._series.reset()
        return True

    def watch(self, present: PresentScan, share: float, found: Association) -> tuple[Association, bool]:
        """Check how a scan agrees with the map; correct slips, and detect and relocate a lost robot.

        Return the association of the scan to use, and whether the scan may correct pose and map. `share` is the
        share of the scan's line length that matches the map by the association `found`.
        """
        t, scan, belief = present.t, present.scan, present.belief
        moved = share < GOOD_SHARE and self._has_moved(belief.pose())
        if not moved:
            self._slide.reset()
        elif self._correct_slide(present, share):
            found = present.again()
            share = found.share()
        if self._fits(present, share):
            return found, True
        dt, self._now = t - self._now, t
        now = (t, self._by_wheels(belief.pose()), scan)
        before = tuple(self._before)
        self._before.append(now)
        if self._lost_from is not None:
            _add_lost_noise(belief, dt)
            return self._search(present, found)
        if share >= MIN_MATCHED_SHARE:
            self._series.reset()
        turn, suspected = None, self._suspicion is not None
        if self._suspicion is not None:
            turn = self._test_suspicion(self._suspicion, present, share)
        elif moved and share < SLIP_MAX_SHARE and _view(scan) >= MIN_SLIP_VIEW_RAD:
            turn = self._suspected(present)
            suspected = turn is not None or self._suspicion is not None
        if suspected and share < SLIP_MAX_SHARE and self._series.add(now, before):
            self._lose(self._series.begun, present)
            return present.again(), False
        if turn is not None:
            belief.shift((0.0, 0.0, turn), SLIP_SIGMA_M**2, SLIP_SIGMA_RAD**2)
            self._jumps.append(Jump(t, SLIP, (0.0, 0.0, turn)))
            self._since, self._jumped = None, False
            return present.again(), True
        usable = self._is_usable(before, now, share, present)
        return present.again(), usable and self._suspicion is None

    def _correct_slide(self, present: PresentScan, share: float) -> bool:
        """Correct a forward slip of both wheels once consecutive scans show it; return whether it was done.

        If both wheels slip (at an obstacle, on a smooth floor), walls parallel to the motion still match; walls
        perpendicular to it match only after the correction. Several consecutive scans must show the slip.
        """
        slide, belief = self._slide, present.belief
        if self._lost_from is not None or self._suspicion is not None:
            slide.reset()
            return False

        def more_matches(sigma: float) -> bool:
            with tried(belief, (0.0, 0.0, 0.0), sigma**2, 0.0):
                return bool(present.again().share() >= share + MIN_SLIDE_GAIN)

        shown = slide.has_begun or any(more_matches(sigma) for sigma in SLIDE_SIGMAS_M)
        step = present.slipped() if shown else None
        (x, y, _), (x0, y0, _) = belief.pose(), self.corrected or belief.pose()
        least = max(MIN_SLIDE_M, MIN_SLIDE_SHARE * math.hypot(x - x0, y - y0))
        ahead = step is not None and abs(step[0]) >= max(least, MIN_SLIDE_RATIO * abs(step[1]))
        if step is None or not ahead or abs(step[2]) > SLIP_SIGMA_RAD:
            slide.reset()
            return False
        found = slide.add(step, present.lines.next_id)
        if found is None:
            return False
        off, first_line = found
        x, y = se2.rotated(np.array(belief.theta), off).tolist()
        _forget_since(first_line, present)
        belief.shift((x, y, 0.0), SLIP_SIGMA_M**2, 0.0)
        last = self._jumps[-1] if self._jumps else None
        if last is not None and last.kind == SLIP and not last.step[2] and self._now - last.t < MAX_GAP_S:
            # slips of consecutive scans count as one jump
            x, y = x + last.step[0], y + last.step[1]
            self._jumps.pop()
        self._jumps.append(Jump(self._now, SLIP, (x, y, 0.0)))
        return True

    def _suspected(self, present: PresentScan) -> float | None:
        """Search for a heading slip that explains a scan; return it [rad] if small and confirmed, else None.

        Scan matching confirms a small slip. A slip of SMALL_RAD or more is stored as a suspicion, which the next
        scans test.
        """
        turn = slip_turn(present)
        if turn is None:
            return None
        if abs(turn) >= SMALL_RAD:
            self._suspicion = Suspicion(turn)
            return None
        step = present.slipped()
        return turn if step is not None and agree(float(step[2]), turn) else None

    def _test_suspicion(self, suspicion: Suspicion, present: PresentScan, kept: float) -> float | None:
        """Match a scan at both headings of a suspected slip; return the slip [rad] once enough scans confirm it.

        Scan matching measures the turn without the map. If it succeeds, the slip by the map must agree with it.
        """
        suspicion.add(kept, with_slip(present, suspicion.turn).share())
        if not suspicion.is_decided:
            return None
        step = present.slipped()
        self._suspicion, by_scans = None, None if step is None else float(step[2])
        if by_scans is not None and abs(by_scans) < SLIP_SIGMA_RAD:
            return None
        turns = [turn for turn in (suspicion.turn, slip_turn(present)) if turn is not None]
        if by_scans is not None:
            turns = [by_scans, *(turn for turn in turns if agree(by_scans, turn))]
        shares = [with_slip(present, turn).share() for turn in turns]
        best = int(np.argmax(shares))
        return turns[best] if suspicion.is_confirmed(shares[best] - kept, by_scans is not None) else None

    def _is_usable(self, before: Sequence[Seen], now: Seen, share: float, present: PresentScan) -> bool:
        """Return whether a scan with few matches may correct pose and map; repeated disagreement sets `lost`."""
        if _view(present.scan) < MIN_VIEW_RAD:  # a doorway or clutter: too few walls to contradict the map
            return not self._jumped
        if self._jumped:
            self._jumped = not continues(self._before_jump, now)
        elif share < SLIP_MAX_SHARE and _walls_jumped(before, now):
            self._jumped, self._before_jump = True, before
        if self._jumped:
            return self._disagree(present)
        if share >= AGREEING_SHARE or not _sees_through(present):
            self._since = None
            return True
        return self._disagree(present)

    def _lose(self, since: float, present: PresentScan) -> None:
        """Mark the robot as lost since the last good scan; drop the map lines added after this scan."""
        belief, (well, first_line) = present.belief, self._good
        self._lost_from = max(min(since, well), since - MAX_BACKDATE_S)
        if self._intervals and self._lost_from <= self._intervals[-1][1]:  # the last relocalisation was wrong
            self._lost_from = min(self._lost_from, self._intervals.pop()[0])
        belief.lost, self._suspicion = True, None
        _forget_since(first_line, present)
        self._trail.forget()
        self._tried = 0
        belief.place(belief.pose(), LOST_SIGMA_M**2, math.pi**2 / 3.0)

    def _by_wheels(self, here: Pose) -> Pose:
        """Return the robot's pose by wheel odometry alone, without the corrections by scans.

        `here` is the pose predicted by the filter. The motion from the last corrected pose to `here` is that of
        the wheels.
        """
        self._wheels = se2.carried(self._wheels, self.corrected or here, here)
        self.corrected = here
        return self._wheels

    def enter_map(self) -> None:
        """Continue in another submap; drop earlier scans, which are in the frame of the old one."""
        self._before.clear()
        self._since = self.corrected = self._suspicion = None
        self._slide.reset()
        self._jumped = False

    def gives_up(self) -> bool:
        """Return whether a lost robot was searched for too long, so that a new submap should begin."""
        return self._lost_from is not None and self._tried >= MAX_LOST_SCANS

    def leave(self) -> None:
        """Leave the submap of a lost robot; the pose of the next submap is unknown until a place is recognised."""
        self._unplaced_from, self._lost_from = self._since_lost(), None

    def recognised(self, t: float) -> None:
        """Mark the pose of the present submap as known, since a place was recognised."""
        if self._unplaced_from is not None:
            self._intervals.append((self._unplaced_from, t))
        self._unplaced_from = None

    def begin_anew(self, t: float, belief: JointBelief) -> None:
        """Reset at the begin of a new submap. A lost robot counts as found: its pose in the submap is known."""
        self.enter_map()
        self._place = None
        self._trail.forget()
        if self._lost_from is not None or belief.lost:
            self._found(t, belief)

    def _found(self, t: float, belief: JointBelief) -> None:
        if self._lost_from is not None:
            self._intervals.append((self._lost_from, t))
        self._lost_from = self._since = self._place = None
        self._jumped = False
        belief.lost = False

    def _disagree(self, present: PresentScan) -> bool:
        if self._since is None:
            self._since, self._scans = present.t, 0
        self._scans += 1
        if present.t - self._since >= MIN_DISAGREEMENT_S and self._scans >= MIN_DISAGREEMENT_SCANS:
            self._lose(self._since, present)
        return False

    def _search(self, present: PresentScan, found: Association) -> tuple[Association, bool]:
        belief = present.belief
        if not self._trail.note(np.array(belief.pose()), present.scan):
            return found, False  # the robot has not moved since the last search
        self._tried += 1
        pose = find_pose(present.scan, present.lines, belief, self._trail)
        if pose is None or self._lost_from is None or not self._is_confirmed(pose, belief):
            return found, False
        before = pose_in_map(belief)
        belief.place(pose, PLACED_SIGMA_M**2, PLACED_SIGMA_RAD**2)
        self._jumps.append(jump(present.t, RELOCALISED, before, pose_in_map(belief)))
        self._found(present.t, belief)
        return present.again(), True

    def _is_confirmed(self, pose: Pose, belief: JointBelief) -> bool:
        """Return whether enough consecutive scans, connected by wheel odometry, agree on the found pose.

        A scan of a few walls fits somewhere by chance; several scans from different positions rarely do.
        """
        here = np.array(belief.pose())
        if self._place is not None:
            there, place, times = self._place
            off = np.array(pose) - se2.compose(np.array(place), se2.between(there, here))
            if math.hypot(off[0], off[1]) < SAME_PLACE_M and abs(se2.wrap(float(off[2]))) < SAME_PLACE_RAD:
                self._place = (there, place, times + 1)
                heading_known = float(belief.matrix()[2, 2]) < KNOWN_HEADING_SIGMA_RAD**2
                return times + 1 >= (CONFIRMING_SCANS_WITH_HEADING if heading_known else CONFIRMING_SCANS)
        self._place = (here, pose, 1)
        return False

    def _has_moved(self, pose: Pose) -> bool:
        """Return whether the robot moved since the last scan, by wheel odometry."""
        x, y, theta = self.corrected or (math.inf, math.inf, math.inf)
        return math.hypot(pose[0] - x, pose[1] - y) > MIN_MOVED_M or abs(pose[2] - theta) > MIN_TURNED_RAD

    def intervals(self) -> list[tuple[float, float]]:
        """Return the time intervals in which the robot was lost, (start, end) [s]; inf as end of an open one."""
        since = self._since_lost()
        return [*self._intervals, *([] if since is None else [(since, math.inf)])]

    def _since_lost(self) -> float | None:
        return min((t for t in (self._lost_from, self._unplaced_from) if t is not None), default=None)

    def words(self) -> list[str]:
        """Return notes for the user: intervals in which the robot was lost, and the number of wheel slips."""
        words = [f"lost from {a:.1f} s to {b:.1f} s after the start, then found again" for a, b in self._intervals]
        if (since := self._since_lost()) is not None:
            lost = f"lost from {since:.1f} s after the start until the end"
            words.append(f"{lost}: no place on the map fits, or several do")
        if n := sum(jump.kind == SLIP for jump in self._jumps):
            slips = "1 wheel slip" if n == 1 else f"{n} wheel slips"
            words.append(f"{slips} recovered by the lines of the map")
        return words


def _forget_since(first: int, present: PresentScan) -> None:
    """Remove the map lines with ids >= `first` from map and state, unless no line would remain."""
    gone = np.flatnonzero(present.lines.ids >= first)
    if len(gone) < len(present.lines):
        present.belief.remove(present.lines.drop(gone))


def pose_in_map(belief: JointBelief) -> Array:
    """Return the belief's pose (3,) in the map frame, also if the belief uses a local frame."""
    frame, pose = belief.frame_pose(), np.array(belief.pose())
    return pose if frame is None else se2.compose(np.array(frame), pose)


def jump(t: float, kind: str, before: Array, after: Array) -> Jump:
    """Return the jump between two poses (3,) in the map frame."""
    x, y, theta = (after - before).tolist()
    return Jump(t, kind, (x, y, se2.wrap(theta)))


def _walls_jumped(before: Sequence[Seen], now: Seen) -> bool:
    """Return whether the robot was moved: no recent scan predicts the walls of the scan `now`.

    A predicted scan may have slipped in heading. Without a recent scan with a wide view the answer is False. An
    exploring robot sees new walls, but some known ones too. In clutter, lines appear and disappear from scan to
    scan, but one of the last scans had them.
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


def _sees_through(present: PresentScan) -> bool:
    """Return whether much of a scan, and several of its walls, lie behind known walls.

    A single wall may be seen through an open door of a known wall. Unknown areas do not contradict a scan.
    """
    scan, walls = present.scan, walls_of(present.lines, present.lines.values(present.belief))
    behind = behind_walls(scan, walls, present.belief.pose())
    length = scan.ends[:, 1] - scan.ends[:, 0]
    much = (behind * length).sum() >= MIN_THROUGH_SHARE * length.sum()
    return bool(much and (behind > 0.5).sum() >= MIN_WALLS_BEHIND)


def _add_lost_noise(belief: JointBelief, dt: float) -> None:
    """Add process noise to the pose of a lost robot, which may be carried."""
    theta = float(belief.matrix()[2, 2])
    added = min(CARRY_RAD_PER_S**2 * dt, max(math.pi**2 / 3.0 - theta, 0.0))
    belief.shift((0.0, 0.0, 0.0), CARRY_M_PER_S**2 * dt, added)
