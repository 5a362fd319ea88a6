"""The line map of a building: small maps, one after another, held together by a graph of anchors.

A map that the robot has left is frozen, and the next one begins at an anchor: the map frame moves on to the pose
(fusion.ekf.map_frame), so that what one scan costs does not grow with the building. Where the map at hand is found
to be a part of an earlier one, the loop is closed: the graph says where all anchors lie, and the pose jumps.
Hierarchical SLAM (Estrada, Neira and Tardos, IEEE T-RO 2005) with the graph of Lu and Milios (1997).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from locfuse.fusion import se2
from locfuse.fusion.data import Array, Ints, MapLine, Measurements, SeenAgain
from locfuse.fusion.ekf.belief_arrays import JointBelief
from locfuse.fusion.ekf.map_frame import Pose, by_frame
from locfuse.fusion.linemap.tidy import MIN_HITS
from locfuse.fusion.mount import Mount

from .anchors import NOWHERE, Anchors, Edge, inverted
from .bridge import Bridge, cross, heading_among, seen_from_here
from .closing import Closure, Here, find_closure
from .frozen import FrozenMap, Way, box_of, frozen, joint_covariance, thaw
from .looks import INSISTING, Looks, is_open
from .one_map import LineTracker
from .way_by_scans import WayByScans

REACH, MANY = 12.0, 100  # m from the anchor, and lines, beyond which the next map begins
# rad: 1 sigma of the heading among the walls in view, with which a map may be left; times the reach, beyond which
# it must be: the next map keeps for good what of its frame is wrong when it begins
TOLD, WAIT = math.radians(0.5), 1.5
FIRST_ASK, ASK_AGAIN = 3.0, 1.5  # m of way in a map before it is looked for in earlier ones, and between two looks
BACK_WITHIN = 0.8  # share of the reach within which the robot returns to a map that it left
BACK_XY, BACK_THETA = 0.3, math.radians(3.0)  # m, rad: standard deviations of where that is, at most
WORSE = 30.0  # chi-square by which a closure may make all others worse
RECENT = 3  # scans: what was seen in them leads over to the next map
# what adds to the variances of where a map ends: neighbouring beams and scans share errors that no filter counts,
# and clutter is taken for walls. In one real building (aces) headings there were 2 degrees wrong at 0.4 claimed
LESS_SURE, LEAST = 8.0, np.square((0.02, 0.02, math.radians(0.3)))
KNOWN_BETTER = 1e-3  # share by which a variance must have fallen to count as told by another sensor


class AtlasTracker(LineTracker):
    """Line maps of stretches of the way, and where they lie."""

    def __init__(self, mode: str, gate: float, recover: bool = True, mount: Mount | None = None) -> None:
        super().__init__(mode, gate, recover, mount)
        self._anchors = Anchors()
        self._frozen: list[FrozenMap] = []
        self._way = Way()
        self._at = 0  # the anchor of the map at hand
        self._origin: Array = np.zeros(3)
        self._origin_x = self._origin_y = 0.0
        self._now: tuple[Measurements, int] | None = None  # the reading at hand
        self._along: WayByScans | None = None  # from where this map began; None: it was taken up again
        self._left: tuple[Array, Array] | None = None  # where in the map before the next one began, and P
        self._full = False
        self._asked_at = 0.0  # m of way
        self._looks = Looks()  # at the frozen maps, from this one
        self._loops: list[Edge] = []
        # frozen map in which this one was seen -> m of way to look again
        self._ask_known_at: dict[int, float] = {}
        self.closed: list[SeenAgain] = []

    def learn(self, m: Measurements, i: int, belief: Any) -> None:
        """Teach the map at hand, look for it in earlier ones, and leave it where its anchor is far."""
        first, last = self._bounds(m, i)
        begins = not len(self.map.ids)
        super().learn(m, i, belief)
        self._now = m, i
        if first == last or not self._teach or self.mode != "grow":
            return
        pose = belief.pose()
        if begins and len(self.map.ids):
            self._enter(np.array(pose), belief)
        elif self._along is not None:
            self._along.went(i, pose)
        self._go_on(i, pose, belief)

    def _go_on(self, i: int, pose: Pose, belief: JointBelief) -> None:
        """Follow the way, look for the map at hand in earlier ones, and tell whether it is full."""
        if self._way.goes(pose):
            self._way.keep(self._t[i], pose, self._late())
        if self._way.length - self._asked_at >= (ASK_AGAIN if self._asked_at else FIRST_ASK):
            self._asked_at = self._way.length
            self._look(self._t[i], belief)
        away = math.hypot(pose[0] - self._origin_x, pose[1] - self._origin_y)
        self._full = away > REACH or len(self.map.ids) > MANY

    # ---- from one map to the next ----

    def turn_page(self, belief: JointBelief) -> bool:
        """Leave a map that is full; the next one begins at once, where a scan has just told the pose."""
        if self.guard is not None and self.guard.gives_up():
            self._leave(belief, bridges=False)  # the next scan begins a map, whose place nothing tells
            self.guard.leave()
            self._full = False
            return False
        full, self._full = self._full, False
        if not full:
            return False
        back = self._beside(belief)
        if back is not None:
            self._leave(belief, bridges=False)
            self._return_to(back, belief)
            return True
        leading = self._seen_last()
        if not len(leading) or not self._may_turn(leading, belief):
            return False  # no wall leads over yet, or this scan has not told the heading
        bridge = seen_from_here(self.map, leading, belief)
        self._leave(belief, bridges=True)
        self._begin_next(bridge, belief)
        return True

    def _begin_next(self, bridge: Bridge, belief: JointBelief) -> None:
        """Begin a map at the pose with walls as they are seen from there."""
        belief.begin_frame()
        self._enter(np.array(belief.pose()), belief)
        cross(bridge, self.map, belief, self._scan)

    def _leave(self, belief: JointBelief, bridges: bool) -> None:
        """Freeze the map at hand; the pose is where the next one lies, if walls lead over to it."""
        self._take_in_absolutes(belief)
        lines = frozen(self.map, belief)
        box = box_of(lines, lines.value, self._way)
        joint = joint_covariance(self.map, belief)
        self._frozen.append(FrozenMap(self._at, lines, self._way, box, self._origin, joint))
        if bridges:
            belief.loosen(np.arange(3), LESS_SURE * np.diagonal(belief.matrix()) + LEAST)
            if self._along is not None:
                self._along.end(self.mount, belief)
            if self.guard is not None:
                self.guard.turn_page()
        self._left = np.array(belief.pose()), belief.matrix()
        belief.remove(self.map.drop(np.arange(len(self.map))))

    def _seen_last(self) -> Ints:
        """Return the walls that were seen last."""
        return np.flatnonzero((self.map.seen >= self._scan - RECENT) & (self.map.hits >= MIN_HITS))

    def _may_turn(self, leading: Ints, belief: JointBelief) -> bool:
        """Return whether the heading is well known among the walls that lead over, or waiting must end."""
        x, y = (np.array(belief.pose()) - self._origin)[:2].tolist()
        return math.hypot(x, y) > WAIT * REACH or heading_among(self.map, leading, belief) < TOLD

    def _beside(self, belief: JointBelief) -> FrozenMap | None:
        """Return the map beside the one at hand, by an edge of the graph, in which the robot is; None: in none."""
        if not belief.framed:
            return None
        beside, best, found = self._anchors.beside(self._at), BACK_WITHIN * REACH, None
        for old in self._frozen:
            if old.anchor not in beside or len(old.lines) > MANY:
                continue
            R, P = self._anchors.relative(old.anchor, self._at)
            here = se2.compose(R, np.array(belief.pose()))
            away = math.hypot(*(here[:2] - old.origin[:2]))
            if away < best and float(P[0, 0] + P[1, 1]) < BACK_XY**2 and float(P[2, 2]) < BACK_THETA**2:
                best, found = away, old
        return found

    def _return_to(self, old: FrozenMap, belief: JointBelief) -> None:
        """Take up a map again: its lines are states again, and the pose is where the graph says it is in it.

        G o q stays what it is: G goes back by R, which leads from the old anchor to the last one, and q on by R.
        """
        R, P = self._anchors.relative(old.anchor, self._at)
        q, frame = np.array(belief.pose()), belief.frame_pose()
        assert belief.framed
        assert frame is not None
        back = se2.inverse(R)
        G = np.array(frame)
        columns = np.arange(belief.frame, belief.frame + 3)
        belief.transform(columns, se2.compose(G, back), by_frame(G[None], back[None])[0])
        belief.know_frame(self._anchors.pose[old.anchor], self._anchors.covariance((old.anchor,)))
        belief.transform(np.arange(3), se2.compose(R, q), se2.rotation(R[2]))
        J = by_frame(R[None], q[None])[0]
        spread = J @ P @ J.T
        belief.loosen(np.arange(3), np.abs(spread).sum(axis=1))  # no less than `spread`, and independent
        n = len(old.lines)
        first = belief.augment(old.lines.value.reshape(-1), np.zeros((2 * n, 3)), old.joint)
        thaw(old.lines, self.map, first)
        self.map.seen, self.map.born = np.full(n, self._scan), np.zeros(n, np.int64)
        self._frozen = [one for one in self._frozen if one is not old]
        self._at, self._way, self._origin, self._along = old.anchor, old.way, old.origin, None
        self._origin_x, self._origin_y, _ = self._origin.tolist()
        self._way.resume()
        self._asked_at, self._looks, self._ask_known_at = self._way.length, Looks(), {}
        if self.guard is not None:
            self.guard.turn_page()

    def _enter(self, pose: Array, belief: JointBelief) -> None:
        """Begin a map at an anchor, which is the map frame."""
        frame = belief.frame_pose()
        if self._left is None:
            own = np.zeros((3, 3)) if frame is None else np.array(belief.with_frame().own)
            self._at = self._anchors.first(np.zeros(3) if frame is None else np.array(frame), own)
        else:
            z, P = self._left
            still = frame is None  # the pose was known exactly: the map frame is the map's
            self._at = self._anchors.next(self._at, 0.0 * z if still else z, 0.0 * P if still else P)
            if frame is not None:
                self._anchors.pose[-1] = frame
        self._way, self._origin, self._asked_at, self._looks = Way(), pose, 0.0, Looks()
        self._origin_x, self._origin_y, _ = pose.tolist()
        if self._now is not None:
            m, i = self._now
            self._along = WayByScans(m, i, (pose[0], pose[1], pose[2]))
        self._ask_known_at = {}

    def _take_in_absolutes(self, belief: JointBelief) -> None:
        """Tell the graph what other sensors have said of the map frame since it began: the information gained."""
        frame = belief.frame_pose()
        if frame is None:
            return
        at = self._at
        before, now = self._anchors.covariance((at,)), np.array(belief.with_frame().own)
        if (np.diagonal(now) > (1.0 - KNOWN_BETTER) * np.diagonal(before)).all():
            return
        L = inverted(now)
        gained, turned = np.linalg.eigh(L - inverted(before))
        gained = np.where(gained > KNOWN_BETTER * np.diagonal(L).min(), gained, 0.0)
        step = np.array(frame) - self._anchors.pose[at]
        back = np.divide(1.0, gained, out=np.zeros(3), where=gained > 0.0)
        z = self._anchors.pose[at] + turned @ (back * (turned.T @ (L @ step)))
        self._anchors.add(Edge(NOWHERE, at, z, turned @ np.diag(gained) @ turned.T))
        self._anchors.solve()

    # ---- loops ----

    def _look(self, t: float, belief: JointBelief) -> None:
        """Look for the map at hand in those that were left."""
        here = Here(self.map, self.map.values(belief), self.map.covariances(belief), self._way)
        at, beside = self._at, self._anchors.beside(self._at)
        known = {e.of if e.to == at else e.to for e in self._loops if at in (e.of, e.to)}
        low, high = box_of(here.lines, here.values, here.way)
        corners = np.array([(x, y) for x in (low[0], high[0]) for y in (low[1], high[1])])
        for old in self._frozen:
            k = old.anchor
            expected, P = self._anchors.relative(k, at)
            unknown = is_open(P)
            if k in beside and k not in known and not unknown:
                continue
            if self._way.length < self._ask_known_at.get(k, 0.0):
                continue
            slack = 3.0 * math.sqrt(max(float(P[0, 0] + P[1, 1]), 0.0))
            there = se2.transform(expected, corners)
            if (there.min(axis=0) > old.box[1] + slack).any() or (there.max(axis=0) < old.box[0] - slack).any():
                continue
            found = find_closure(Here(old.lines, old.lines.value, old.lines.P, old.way), here, expected, P)
            if self._looks.agree(k, found, unknown, self._anchors):
                assert found is not None
                self._close(t, old, at, found, belief)

    def _close(self, t: float, seen: FrozenMap, at: int, found: Closure, belief: JointBelief) -> None:
        """Add a closure to the graph, unless it contradicts the others, and let the pose follow."""
        if not belief.framed:
            return
        self._take_in_absolutes(belief)
        of, poses = seen.anchor, self._anchors.pose.copy()
        edge = Edge(of, at, found.pose, inverted(found.P))
        old = [e for e in self._loops if (e.of, e.to) == (of, at)]
        for e in old:
            self._anchors.remove(e)
        before = self._anchors.cost()
        self._anchors.add(edge)
        self._anchors.solve()
        worse = self._anchors.cost() - before
        if worse > WORSE:
            self._anchors.remove(edge)
            if self._looks.count(of) < INSISTING:
                for e in old:
                    self._anchors.add(e)
                self._anchors.pose = poses
                return
            self._anchors.loosen(of, at, worse / 3.0)
            self._anchors.add(edge)
            self._anchors.solve()
        self._ask_known_at[of] = 2.0 * self._way.length
        self._loops = [e for e in self._loops if all(e is not o for o in old)] + [edge]
        if not old:
            here = se2.compose(found.pose, np.array(belief.pose()))
            sight = seen.way.nearest(here[:2])
            self.closed.append(SeenAgain(sight.t, t, se2.between(sight.pose, here)))
        belief.know_frame(self._anchors.pose[at], self._anchors.covariance((at,)))
        if self.guard is not None and not is_open(self._anchors.relative(0, at)[1]):
            self.guard.recognised(t)

    # ---- results ----

    def closed_loops(self) -> list[SeenAgain]:
        """Return the places that were recognised, in order of time."""
        return self.closed

    def lines(self, belief: Any) -> tuple[list[MapLine], list[MapLine]]:
        """Return the map after the first scan, and all maps as they lie now."""
        first, now = super().lines(belief)
        left = [line for old in self._frozen for line in old.lines.placed_at(*self._place(old))]
        return first, left + now

    def _place(self, old: FrozenMap) -> tuple[Any, Array]:
        return self._anchors.pose[old.anchor], self._anchors.covariance((old.anchor,))

    def notes(self, belief: Any) -> list[str]:
        """Say how many maps there are, and how many loops were closed."""
        words = super().notes(belief)
        if self._frozen:
            n, loops = len(self._frozen) + 1, len(self.closed)
            told = f"{loops} places were recognised" if loops != 1 else "1 place was recognised"
            closed = told if loops else "no place was recognised: no loop is closed"
            words.append(f"the map is made of {n} pieces, and {closed}")
        return words
