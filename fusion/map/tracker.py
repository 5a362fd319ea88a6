"""Line map and pose in one run: corrections by scans, growth of the map, and submaps of a building.

`LineTracker` has one map. `AtlasTracker` has a sequence of submaps, connected by a graph of anchors: a submap that
the robot left is frozen, and the next one begins at a new anchor. The map frame moves to the pose
(fusion.ekf.map_frame), so that the cost of a scan does not grow with the building. If the present submap is
recognised as part of an earlier one, the loop is closed: the graph is solved again, and the pose jumps.
Hierarchical SLAM (Estrada, Neira and Tardos, IEEE T-RO 2005) with the graph of Lu and Milios (1997).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np

from locfuse.fusion import se2
from locfuse.fusion.data import LOOP_TAKEN, Array, Jump, LocfuseError, MapLine, Measurements, RowVerdict, SeenAgain
from locfuse.fusion.ekf.belief_arrays import JointBelief
from locfuse.fusion.ekf.map_frame import pose_by_frame
from locfuse.fusion.kernels.ekf import Innovation
from locfuse.fusion.kernels.sight import Rules
from locfuse.fusion.lines.extract import rows_in_base
from locfuse.fusion.lines.scans import line_process_noise
from locfuse.fusion.mount import Mount
from locfuse.fusion.scan_matching.neighbours import beyond_wheels
from locfuse.fusion.scan_matching.solve import NOWHERE
from locfuse.fusion.sensor import Block, Model, ModelResults
from locfuse.fusion.statistics import chi_square

from .guard import Guard, jump, pose_in_map
from .line_map import (
    MIN_HITS,
    NO_SHARES,
    TIDY_EVERY_SCANS,
    Association,
    LineMap,
    about_middle,
    associate,
    line_by_mount,
    merge_doubles,
    mount_states_of,
    prune,
)
from .place_search import INSISTING_LOOKS, CandidateRuns, Closure, find_closure, is_unknown
from .scan import LineReader, Scan, Standing
from .slips import PresentScan
from .small_maps import (
    Anchors,
    Edge,
    FrozenMap,
    ScanMatchedPath,
    SubmapPath,
    begin_submap,
    frozen,
    heading_among,
    inverted,
    shared_walls,
    thaw,
)

REACH_M, MAX_LINES = 12.0, 100  # m from the anchor, and lines, beyond which the next submap begins
# the next submap begins where the heading relative to the seen walls is this certain (1 sigma), or beyond this
# factor times REACH_M. A heading error at the begin would be a permanent error of the new submap's frame.
MAX_HEADING_SIGMA_RAD, MAX_REACH_FACTOR = math.radians(0.5), 1.5
# m of path in a submap before the first search for the submap in earlier ones, and between two searches
FIRST_LOOK_M, LOOK_AGAIN_M = 3.0, 1.5
BACK_REACH_SHARE = 0.8  # share of REACH_M within which the robot returns to a submap that it left
BACK_SIGMA_M, BACK_SIGMA_RAD = 0.3, math.radians(3.0)  # m, rad: largest standard deviations of its relative pose
MAX_WORSE_CHI2 = 30.0  # largest increase of the graph's chi-square by a closure
RECENT_SCANS = 3  # walls seen in this many last scans are shared with the next submap
# increase of the pose variances at the end of a submap: errors of neighbouring beams and scans are correlated, and
# clutter is extracted as walls. In a real building (aces), the heading error was 2 degrees with a sigma of 0.4
ADDED_P_SHARE, MIN_ADDED_VARIANCES = 8.0, np.square((0.02, 0.02, math.radians(0.3)))
MIN_GAIN_SHARE = 1e-3  # share by which a variance must have decreased to count as measured by another sensor


class LineTracker(Model):
    """Filter model of the laser: associates scans with a line map; `mode` is how the map is made (lrf.MapMode)."""

    local = True
    leads = True

    def __init__(self, mode: str, gate: float, recover: bool = True, mount: Mount | None = None) -> None:
        self.mode = mode
        self.mount = mount if mount is not None and mount.free else None  # None: known exactly
        self.map = LineMap()
        self.joint = mode != "first-scan"
        self.maps = mode != "given"
        # in other modes new walls are not added to the map, so scans cannot be checked against it
        self._jumps: list[Jump] = []
        self.guard = Guard(self._jumps) if recover and mode in ("grow", "given") else None
        self._first_map: list[MapLine] = []
        self.gate = chi_square(gate, 2)
        new = RowVerdict.NEW if mode == "grow" else RowVerdict.UNMATCHED
        self.rules = Rules(self.gate, self.joint, mode == "grow", RowVerdict.UNMATCHED, RowVerdict.AMBIGUOUS, new)
        self._scan = 0
        self._scans = LineReader()
        self._standing = Standing()
        self._sight: Association | None = None  # association at the predicted pose, reused from scan to scan
        self._found: Association | None = None  # association of the present scan; None: the map begins with it
        self._seen: Scan  # present scan in the base frame, by the predicted mount
        self._rows = np.zeros((0, 7))  # its lines in the base frame by the configured mount; at rest a mean
        self._usable = True  # whether the present scan may change the map
        self._fitted = -1  # last used reading
        self._asked = -1  # last reading for `innovations`
        self._of: Measurements | None = None  # the measurements of which `_first` and `_t` are columns
        self._first: list[int] = []
        self._t: list[float] = []
        self._walls = (np.zeros(2),) * 3  # variances [m^2, rad^2]: of uneven walls, least, largest increase

    def blocks(self) -> list[Block]:
        """Return the states of the laser's mount, if it is estimated."""
        return self.mount.blocks() if self.mount is not None else []

    def begin(self, given: Sequence[MapLine], belief: Any) -> None:
        """Load the lines of a given map as considered states: their covariance is used, their values stay.

        Other modes than `given` load nothing. Raises LocfuseError without lines.
        """
        if self.mode != "given":
            return
        if not given:
            fix = "add --map FILE, written by locfuse run LOG --save-map FILE"
            raise LocfuseError(f"lrf.map = given needs a map: {fix}")
        for line in given:
            anchor, half, P = about_middle(line)
            column = belief.augment(np.array([0.0, line.beta]), np.zeros((2, 3)), P)
            belief.consider(np.array([column, column + 1]))
            self.map.append(anchor, np.array([0.0, line.beta]), P, column, (-half, half), 0)
        self.map.hits = np.array([max(line.hits, MIN_HITS) for line in given])
        self._first_map = list(given)

    def begins_map(self, m: Measurements, i: int) -> bool:
        """Return whether the map is empty and scan i has lines."""
        return self.maps and not self.map.ids.size and bool(m.first[i] < m.first[i + 1])

    def rolled(self, u: Sequence[float]) -> None:
        """Add a motion by wheel odometry, to detect scans at rest."""
        self._standing.rolled(u)

    def innovations(self, m: Measurements, i: int, belief: Any) -> Sequence[Innovation] | Association:
        """Associate the lines of scan i (eq. 13, 17, 18): each gets a verdict; matching ones correct the pose."""
        first, last = self._bounds(m, i)
        if self._found is not None:  # a second scan at this update time: the rows of the first are still in use
            self._sight = None
        self._asked, self._found, self._usable = i, None, True
        if first == last:
            return []
        if len(self.map.ids) == 0:
            self._standing.forget()
        rows = self._standing.take(self._scans.read(m, first, last))
        if rows is None:
            self._usable = False
            return [Innovation.unpredicted(row, RowVerdict.REPEATED, 2, self.gate) for row in range(first, last)]
        self._rows = rows
        if len(self.map.ids) == 0:
            self._seen = self._scan_in_base(belief)
            return [Innovation.unpredicted(row, RowVerdict.NEW, 2, self.gate) for row in range(first, last)]
        if self._sight is None:
            self._sight = Association(self.rules, mount_states_of(self.mount, belief))
        shared = self._shared(m, first, last)
        found = self._sight
        share = found.compare(belief, self.map, rows, shared)
        scan = self._seen = self._scan_in_base(belief)
        if self.guard is not None:
            again = partial(associate, rows, self.map, belief, found, shared)
            slipped = partial(beyond_wheels, m, self._fitted, i)
            present = PresentScan(self._t[i], scan, self.map, belief, again, slipped)
            found, self._usable = self.guard.watch(present, share, found)
        if not self._usable:
            self._standing.forget()
            return [Innovation.unpredicted(row, RowVerdict.LOST, 2, self.gate) for row in range(first, last)]
        if self.mode == "grow":
            found.refuse_alone()
        self._found, self._fitted = found, i
        found.row = first
        found.state_rows(belief)
        return found

    def _bounds(self, m: Measurements, i: int) -> tuple[int, int]:
        """Return first row and end (exclusive) of scan i in Measurements.z; load the columns of a new log."""
        if m is not self._of:
            self._of, self._first, self._t = m, m.first.tolist(), m.t.tolist()
            uneven, floor = self.wall_noise(m)
            self._walls = uneven, floor, line_process_noise(uneven)
        return self._first[i], self._first[i + 1]

    def _shared(self, m: Measurements, first: int, last: int) -> Array:
        """Return the effects (k, 2, s) of s errors that all lines of a scan share, on the lines first:last."""
        if not self.joint or "shared" not in m.extra:
            return NO_SHARES
        return np.ascontiguousarray(m.extra["shared"][first:last], np.float64)

    def _scan_in_base(self, belief: Any) -> Scan:
        """Return the present scan in the base frame, by the estimated mount."""
        if self.mount is None:
            return Scan(self._rows)
        from_configured = se2.carried(self.mount.now(belief), self.mount.configured, (0.0, 0.0, 0.0))
        return Scan(rows_in_base(self._rows, *from_configured))

    def learn(self, m: Measurements, i: int, belief: Any) -> None:
        """Update the map by scan i: extend matched lines, and add new lines (mode `grow`, or first scan)."""
        first, last = self._first[i], self._first[i + 1]
        if self.guard is not None and last > first:
            self.guard.corrected = belief.pose()  # the wheels predict from here
        if i != self._asked:  # two scans at one update time: the association is that of the last one
            return
        found, self._found = self._found, None
        if first == last or not self._usable or self.mode == "given":
            return
        self._scan += 1
        if found is None:
            if self.guard is not None:
                self.guard.begin_anew(float(m.t[i]), belief)
            scan = self._scan_in_base(belief)
            for k in range(last - first):
                self._add(scan, k, belief)
            self._first_map = self._first_map or self.map.lines(belief)
            return
        found.extend(self._scan)
        if self.joint:
            self._revise(found, belief)

    def _revise(self, found: Association, belief: JointBelief) -> None:
        """Add variance of uneven walls; in mode `grow` add new lines, remove rare lines, merge duplicates."""
        uneven, floor, process_noise = self._walls
        if uneven[0] > 0.0 or uneven[1] > 0.0:
            self.map.raise_variances(belief, uneven, process_noise, np.flatnonzero(self.map.seen == self._scan))
        if self.mode == "grow":
            if new := found.new():
                scan = self._scan_in_base(belief)
                for k in new:
                    self._add(scan, k, belief)
            if self._scan % TIDY_EVERY_SCANS == 0:
                prune(self.map, belief, self._scan)
                merge_doubles(self.map, belief, self._scan, uneven)
        if floor[0] > 0.0 or floor[1] > 0.0:
            self.map.raise_variances(belief, floor)

    def wall_noise(self, m: Measurements) -> tuple[Array, Array]:
        """Return the process noise of seen lines and the least variance of all lines, (2,) each [m^2, rad^2].

        The next scan sees another part of an uneven wall, so seen lines get process noise. If the unevenness was
        not measured, all lines have a least variance instead, since no wall is an exact plane. In mode `consider`,
        both are zero.
        """
        if self.mode == "consider":
            return np.zeros(2), np.zeros(2)
        if "uneven" in m.extra:
            return m.extra["uneven"][0] if len(m.z) else np.zeros(2), np.zeros(2)
        return np.zeros(2), np.diagonal(m.floor)

    # ---- results ----

    def results(self, belief: Any) -> ModelResults:
        """Return the map after the first scan, the map now, jumps of the pose, and times at which it was lost."""
        lost = self.guard.intervals() if self.guard is not None else []
        return ModelResults(self._first_map, self.map.lines(belief), jumps=self._jumps, lost=lost)

    def notes(self, belief: Any) -> list[str]:
        """Return notes for the user: slips and relocalisations, and the estimated mount of the laser."""
        words = self.guard.words() if self.guard is not None else []
        return words + (self.mount.words(belief) if self.mount is not None else [])

    def _add(self, scan: Scan, k: int, belief: JointBelief) -> None:
        """Add line k of a scan to the map; its anchor point is the middle of the segment."""
        r, psi = map(float, scan.z[k])
        beta = se2.wrap(psi + belief.theta)
        c, s = math.cos(beta), math.sin(beta)
        middle = 0.5 * float(scan.ends[k, 0] + scan.ends[k, 1])
        half = 0.5 * float(scan.ends[k, 1] - scan.ends[k, 0])
        anchor = np.array([belief.x + r * c - middle * s, belief.y + r * s + middle * c])
        dx, dy = belief.x - anchor[0], belief.y - anchor[1]
        u = dy * c - dx * s
        value = np.array([r + dx * c + dy * s, beta])
        G = np.array([[c, s, u], [0.0, 0.0, 1.0]])
        G_z = np.array([[1.0, u], [0.0, 1.0]])
        noise = G_z @ scan.R[k] @ G_z.T
        columns: tuple[int, ...] = ()
        # by the mount, the derivative of the predicted measurement is minus that of the line in the base frame
        if self.mount is not None:
            columns = self.mount.columns(belief)
            G = np.hstack((G, -G_z @ line_by_mount(self.mount, belief, psi)))
        column, P = -1, np.zeros((2, 2))
        if self.joint:
            column = belief.augment(value, G, noise, columns)
            if self.mode == "consider":
                belief.consider(np.array([column, column + 1]))
        else:
            P = belief.spread(G, columns) + noise
        self.map.append(anchor, value, P, column, (-half, half), self._scan)


class AtlasTracker(LineTracker):
    """Filter model of the laser with submaps along the path, and the graph of their poses."""

    def __init__(self, mode: str, gate: float, recover: bool = True, mount: Mount | None = None) -> None:
        super().__init__(mode, gate, recover, mount)
        self._anchors = Anchors()
        self._frozen: list[FrozenMap] = []
        self._path = SubmapPath()
        self._at = 0  # anchor of the present submap
        self._origin: Array = np.zeros(3)  # pose at which the present submap began
        self._now: tuple[Measurements, int] | None = None  # present reading
        # path in the present submap; None after a return to a frozen submap
        self._matched_path: ScanMatchedPath | None = None
        self._left: tuple[Array, Array] | None = None  # pose at which the last submap was left, and its covariance
        self._full = False
        self._searched_at = 0.0  # m of path
        self._looks = CandidateRuns()  # candidate closures of the present submap
        self._loops: list[Edge] = []
        # anchor of a frozen submap with a closure -> m of path until the next search there
        self._search_again_at: dict[int, float] = {}
        self.closed: list[SeenAgain] = []

    def learn(self, m: Measurements, i: int, belief: Any) -> None:
        """Update the present submap by scan i, extend its path, search for it in earlier ones."""
        begins = not len(self.map.ids)
        super().learn(m, i, belief)
        self._now = m, i
        if self._first[i] == self._first[i + 1] or not self._usable or self.mode != "grow":
            return
        pose = belief.pose()
        if begins and len(self.map.ids):
            self._enter(np.array(pose), belief)
        elif self._matched_path is not None:
            self._matched_path.add(i, pose)
        if self._path.extend(pose):
            self._path.keep(self._t[i], pose, self._seen)
        if self._path.length - self._searched_at >= (LOOK_AGAIN_M if self._searched_at else FIRST_LOOK_M):
            self._searched_at = self._path.length
            self._search(self._t[i], belief)
        away = math.hypot(pose[0] - self._origin.item(0), pose[1] - self._origin.item(1))
        self._full = away > REACH_M or len(self.map.ids) > MAX_LINES

    # ---- from one map to the next ----

    def begin_next_map(self, belief: JointBelief) -> None:
        """Leave a full submap and begin the next one."""
        if self.guard is not None and self.guard.gives_up():
            self._leave(belief, connected=False)  # the next scan begins a submap of unknown pose
            self.guard.leave()
            self._full = False
            return
        full, self._full = self._full, False
        if not full:
            return
        back = self._neighbour(belief)
        if back is not None:
            self._leave(belief, connected=False)
            self._return_to(back, belief)
            return
        recent = np.flatnonzero((self.map.seen >= self._scan - RECENT_SCANS) & (self.map.hits >= MIN_HITS))
        x, y = (np.array(belief.pose()) - self._origin)[:2].tolist()
        far = math.hypot(x, y) > MAX_REACH_FACTOR * REACH_M
        if not len(recent) or not (far or heading_among(self.map, recent, belief) < MAX_HEADING_SIGMA_RAD):
            return  # no wall would connect both submaps, or the heading is too uncertain
        shared = shared_walls(self.map, recent, belief)
        self._leave(belief, connected=True)
        belief.begin_frame()
        self._enter(np.array(belief.pose()), belief)
        begin_submap(shared, self.map, belief, self._scan)

    def _leave(self, belief: JointBelief, connected: bool) -> None:
        """Freeze the present submap, and remove its lines from the state.

        `connected`: the next submap begins at the robot's pose and shares walls with this one.
        """
        self._add_absolute_edge(belief)
        self._frozen.append(frozen(self._at, self.map, self._path, self._origin, belief))
        if connected:
            belief.add_variance(np.arange(3), ADDED_P_SHARE * np.diagonal(belief.matrix()) + MIN_ADDED_VARIANCES)
            if self._matched_path is not None:
                self._matched_path.end(self.mount, belief)
            if self.guard is not None:
                self.guard.enter_map()
        self._left = np.array(belief.pose()), belief.matrix()
        belief.remove(self.map.drop(np.arange(len(self.map))))

    def _neighbour(self, belief: JointBelief) -> FrozenMap | None:
        """Return the neighbouring frozen submap in which the robot is; None without one."""
        if not belief.framed:
            return None
        beside, best, found = self._anchors.beside(self._at), BACK_REACH_SHARE * REACH_M, None
        for old in self._frozen:
            if old.anchor not in beside or len(old.lines) > MAX_LINES:
                continue
            R, P = self._anchors.relative(old.anchor, self._at)
            here = se2.compose(R, np.array(belief.pose()))
            away = math.hypot(*(here[:2] - old.origin[:2]))
            if away < best and float(P[0, 0] + P[1, 1]) < BACK_SIGMA_M**2 and float(P[2, 2]) < BACK_SIGMA_RAD**2:
                best, found = away, old
        return found

    def _return_to(self, old: FrozenMap, belief: JointBelief) -> None:
        """Continue in the frozen submap `old`: its lines become states, and its anchor becomes the local frame.

        The graph gives R, the pose of the present anchor relative to the old one.
        """
        R, P = self._anchors.relative(old.anchor, self._at)
        q = np.array(belief.pose())
        belief.change_frame(R)
        belief.know_frame(self._anchors.pose[old.anchor], self._anchors.covariance(old.anchor))
        J = pose_by_frame(R[None], q[None])[0]
        spread = J @ P @ J.T
        at_least = np.abs(spread).sum(axis=1)  # a diagonal covariance that is at least `spread`
        belief.add_variance(np.arange(3), at_least)
        n = len(old.lines)
        first = belief.augment(old.lines.value.reshape(-1), np.zeros((2 * n, 3)), old.joint)
        thaw(old.lines, self.map, first)
        self.map.seen, self.map.born = np.full(n, self._scan), np.zeros(n, np.int64)
        self._frozen = [one for one in self._frozen if one is not old]
        self._at, self._path, self._origin, self._matched_path = old.anchor, old.path, old.origin, None
        self._path.resume()
        self._searched_at, self._looks, self._search_again_at = self._path.length, CandidateRuns(), {}
        if self.guard is not None:
            self.guard.enter_map()

    def _enter(self, pose: Array, belief: JointBelief) -> None:
        """Begin a submap at the robot pose `pose` (3,), with a new anchor, whose pose becomes the map frame's."""
        frame = belief.frame_pose()
        if self._left is None:
            own = np.zeros((3, 3)) if frame is None else belief.frame_covariance()
            self._at = self._anchors.append(NOWHERE, np.zeros(3) if frame is None else np.array(frame), own)
        else:
            z, P = self._left
            if frame is None:  # the map frame is the map itself
                z, P = 0.0 * z, 0.0 * P
            self._at = self._anchors.append(self._at, z, P)
            if frame is not None:
                self._anchors.pose[-1] = frame
        self._path, self._origin, self._searched_at, self._looks = SubmapPath(), pose, 0.0, CandidateRuns()
        if self._now is not None:
            m, i = self._now
            self._matched_path = ScanMatchedPath(m, i, (pose[0], pose[1], pose[2]))
        self._search_again_at = {}

    def _add_absolute_edge(self, belief: JointBelief) -> None:
        """Add an edge from NOWHERE to the present anchor, with the absolute measurements during this submap.

        Its information is the increase of the map frame's information since the submap began. If that is too
        small, no edge is added.
        """
        frame = belief.frame_pose()
        if frame is None:
            return
        at = self._at
        before, now = self._anchors.covariance(at), belief.frame_covariance()
        if (np.diagonal(now) > (1.0 - MIN_GAIN_SHARE) * np.diagonal(before)).all():
            return
        L = inverted(now)
        gained, turned = np.linalg.eigh(L - inverted(before))
        gained = np.where(gained > MIN_GAIN_SHARE * np.diagonal(L).min(), gained, 0.0)
        step = np.array(frame) - self._anchors.pose[at]
        back = np.divide(1.0, gained, out=np.zeros(3), where=gained > 0.0)
        z = self._anchors.pose[at] + turned @ (back * (turned.T @ (L @ step)))
        self._anchors.add(Edge(NOWHERE, at, z, turned @ np.diag(gained) @ turned.T))
        self._anchors.solve()

    # ---- loops ----

    def _search(self, t: float, belief: JointBelief) -> None:
        """Search for the present submap in the frozen ones, and close loops."""
        here = frozen(self._at, self.map, self._path, self._origin, belief)
        at, beside = self._at, self._anchors.beside(self._at)
        known = {e.of if e.to == at else e.to for e in self._loops if at in (e.of, e.to)}
        low, high = here.box
        corners = np.array([(x, y) for x in (low[0], high[0]) for y in (low[1], high[1])])
        for old in self._frozen:
            k = old.anchor
            expected, P = self._anchors.relative(k, at)
            unknown = is_unknown(P)
            if k in beside and k not in known and not unknown:
                continue
            if self._path.length < self._search_again_at.get(k, 0.0):
                continue
            slack = 3.0 * math.sqrt(max(float(P[0, 0] + P[1, 1]), 0.0))
            there = se2.transform(expected, corners)
            if (there.min(axis=0) > old.box[1] + slack).any() or (there.max(axis=0) < old.box[0] - slack).any():
                continue
            found = find_closure(old, here, expected, P)
            if self._looks.add(k, found, unknown, self._anchors):
                assert found is not None
                self._close(t, old, at, found, belief)

    def _close(self, t: float, seen: FrozenMap, at: int, found: Closure, belief: JointBelief) -> None:
        """Add a loop closure to the graph, unless it contradicts the others; correct the pose."""
        if not belief.framed:
            return
        self._add_absolute_edge(belief)
        of, poses = seen.anchor, self._anchors.pose.copy()
        edge = Edge(of, at, found.pose, inverted(found.P))
        old = [e for e in self._loops if (e.of, e.to) == (of, at)]
        for e in old:
            self._anchors.remove(e)
        before = self._anchors.cost()
        self._anchors.add(edge)
        self._anchors.solve()
        worse = self._anchors.cost() - before
        if worse > MAX_WORSE_CHI2:
            self._anchors.remove(edge)
            if self._looks.count(of) < INSISTING_LOOKS:
                for e in old:
                    self._anchors.add(e)
                self._anchors.pose = poses
                return
            self._anchors.scale_covariances(of, at, worse / 3.0)
            self._anchors.add(edge)
            self._anchors.solve()
        self._search_again_at[of] = 2.0 * self._path.length
        self._loops = [e for e in self._loops if all(e is not o for o in old)] + [edge]
        if not old:
            here = se2.compose(found.pose, np.array(belief.pose()))
            sight = seen.path.nearest(here[:2])
            self.closed.append(SeenAgain(sight.t, t, se2.between(sight.pose, here)))
        before_loop = pose_in_map(belief)
        belief.know_frame(self._anchors.pose[at], self._anchors.covariance(at))
        self._jumps.append(jump(t, LOOP_TAKEN, before_loop, pose_in_map(belief)))
        if self.guard is not None and not is_unknown(self._anchors.relative(0, at)[1]):
            self.guard.recognised(t)

    # ---- results ----

    def results(self, belief: Any) -> ModelResults:
        """Return the results of the present submap; lines of all other submaps and closed loops are added."""
        found, left = super().results(belief), list[MapLine]()
        for old in self._frozen:
            pose, P = self._anchors.pose[old.anchor], self._anchors.covariance(old.anchor)
            left += old.lines.lines_in_map(pose, P)
        return found._replace(final_map=[*left, *found.final_map], loops=self.closed)

    def notes(self, belief: Any) -> list[str]:
        """Return notes for the user: also the number of submaps and of closed loops."""
        words = super().notes(belief)
        if self._frozen:
            n, loops = len(self._frozen) + 1, len(self.closed)
            closed = f"{loops} revisited place{'s' if loops > 1 else ''}" if loops else "no revisited place"
            words.append(f"{n} submaps, {closed}")
        return words
