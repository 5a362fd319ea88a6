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
from locfuse.fusion.data import Array, MapLine, Measurements
from locfuse.fusion.ekf.belief_arrays import JointBelief
from locfuse.fusion.linemap.tracker import LineTracker
from locfuse.fusion.mount import Mount

from .anchors import NOWHERE, Anchors, Edge, inverted
from .closing import Closure, Here, find_closure
from .frozen import FrozenMap, Way, box_of, frozen

REACH, MANY = 12.0, 100  # m from the anchor, and lines, beyond which the next map begins
FIRST_ASK, ASK_AGAIN = 3.0, 1.5  # m of way in a map before it is looked for in earlier ones, and between two looks
BETWEEN = 2  # maps: the one before is not an earlier one
AGREES_XY, AGREES_THETA, AGREEING = 0.25, math.radians(2.5), 2  # m, rad within which so many looks must agree
WORSE = 16.3  # chi-square by which a closure may make all others worse
KNOWN_BETTER = 1e-3  # share by which a variance must have fallen to count as told by another sensor


class AtlasTracker(LineTracker):
    """Line maps of stretches of the way, and where they lie."""

    def __init__(self, mode: str, gate: float, recover: bool = True, mount: Mount | None = None) -> None:
        super().__init__(mode, gate, recover, mount)
        self._belief: Any = None
        self._anchors = Anchors()
        self._frozen: list[FrozenMap] = []
        self._way = Way()
        self._origin: Array = np.zeros(3)
        self._left: tuple[Array, Array] | None = None  # where in the map before the next one began, and P
        self._full = False
        self._asked_at = 0.0  # m of way
        self._seen_in: dict[int, tuple[Closure, int]] = {}  # frozen map -> the last look's closure, looks that agree
        self._loops: list[Edge] = []
        self.closed: list[float] = []  # s

    def begin(self, given: Any, belief: Any) -> None:
        """Enter a given map."""
        super().begin(given, belief)
        self._belief = belief

    def begins_map(self, m: Measurements, i: int) -> bool:
        """Return whether scan i begins a map: the first one, or the next where this one is full."""
        if self._full and m.first[i] < m.first[i + 1]:
            self._leave(self._belief)
        return super().begins_map(m, i)

    def learn(self, m: Measurements, i: int, belief: Any) -> None:
        """Teach the map at hand; leave it where the robot is far from its anchor, and look for it in earlier ones."""
        first, last = int(m.first[i]), int(m.first[i + 1])
        begins = not len(self.map)
        super().learn(m, i, belief)
        if first == last or not self._teach or self.mode != "grow" or not isinstance(belief, JointBelief):
            return
        pose = np.array(belief.pose())
        if begins:
            self._enter(pose, belief)
        self._way.note(pose, self._scan_of(m, first, last, belief))
        if self._way.length - self._asked_at >= (ASK_AGAIN if self._asked_at else FIRST_ASK):
            self._asked_at = self._way.length
            self._look(float(m.t[i]), belief)
        away = math.hypot(*(pose[:2] - self._origin[:2]))
        self._full = away > REACH or len(self.map) > MANY

    # ---- from one map to the next ----

    def _leave(self, belief: JointBelief) -> None:
        """Freeze the map at hand."""
        self._take_in_absolutes(belief)
        lines = frozen(self.map, belief)
        self._frozen.append(
            FrozenMap(len(self._anchors) - 1, lines, self._way, box_of(lines, lines.value, self._way))
        )
        self._left = np.array(belief.pose()), belief.matrix()
        belief.remove(self.map.drop(np.arange(len(self.map))))
        self._full = False

    def _enter(self, pose: Array, belief: JointBelief) -> None:
        """Begin a map at an anchor, which is the map frame."""
        frame = belief.frame_pose()
        if self._left is None:
            own = np.zeros((3, 3)) if frame is None else np.array(belief.with_frame().own)
            self._anchors.first(np.zeros(3) if frame is None else np.array(frame), own)
        else:
            z, P = self._left
            still = frame is None  # the pose was known exactly: the map frame is the map's
            self._anchors.next(len(self._anchors) - 1, 0.0 * z if still else z, 0.0 * P if still else P)
            if frame is not None:
                self._anchors.pose[-1] = frame
        self._way, self._origin, self._asked_at, self._seen_in = Way(), pose, 0.0, {}

    def _take_in_absolutes(self, belief: JointBelief) -> None:
        """Tell the graph what other sensors have said of the map frame since it began: the information gained."""
        frame = belief.frame_pose()
        if frame is None:
            return
        at = len(self._anchors) - 1
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
        at = len(self._anchors) - 1
        low, high = box_of(here.lines, here.values, here.way)
        corners = np.array([(x, y) for x in (low[0], high[0]) for y in (low[1], high[1])])
        for k, old in enumerate(self._frozen[: max(len(self._frozen) + 1 - BETWEEN, 0)]):
            expected, P = self._anchors.relative(old.anchor, at)
            slack = 3.0 * math.sqrt(max(float(P[0, 0] + P[1, 1]), 0.0))
            there = se2.transform(expected, corners)
            if (there.min(axis=0) > old.box[1] + slack).any() or (there.max(axis=0) < old.box[0] - slack).any():
                continue
            found = find_closure(Here(old.lines, old.lines.value, old.lines.P, old.way), here, expected, P)
            if found is None:
                self._seen_in.pop(k, None)
                continue
            before, looks = self._seen_in.get(k, (found, 0))
            step = se2.between(before.pose, found.pose)
            same = math.hypot(step[0], step[1]) < AGREES_XY and abs(se2.wrap(float(step[2]))) < AGREES_THETA
            self._seen_in[k] = (found, looks + 1 if same else 1)
            if self._seen_in[k][1] >= AGREEING:
                self._close(t, old.anchor, at, found, belief)

    def _close(self, t: float, of: int, at: int, found: Closure, belief: JointBelief) -> None:
        """Add a closure to the graph, unless it contradicts the others, and let the pose follow."""
        if belief.frame is None:
            return
        self._take_in_absolutes(belief)
        poses = self._anchors.pose.copy()
        edge = Edge(of, at, found.pose, inverted(found.P))
        old = [e for e in self._loops if (e.of, e.to) == (of, at)]
        for e in old:
            self._anchors.remove(e)
        before = self._anchors.cost()
        self._anchors.add(edge)
        self._anchors.solve()
        if self._anchors.cost() - before > WORSE:
            self._anchors.remove(edge)
            for e in old:
                self._anchors.add(e)
            self._anchors.pose = poses
            return
        self._loops = [e for e in self._loops if all(e is not o for o in old)] + [edge]
        if not old:
            self.closed.append(t)
        belief.know_frame(self._anchors.pose[at], self._anchors.covariance((at,)))

    # ---- results ----

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
