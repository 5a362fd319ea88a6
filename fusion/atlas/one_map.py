"""The line map inside one run: what a scan says of the pose, and what it teaches the map."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np

from locfuse.fusion import se2
from locfuse.fusion.chi_square import chi_square
from locfuse.fusion.core.room import Room
from locfuse.fusion.data import VERDICTS, Array, Ints, LocfuseError, MapLine, Measurements
from locfuse.fusion.ekf.belief_arrays import JointBelief
from locfuse.fusion.linemap.association import Association, Codes, SeenLines, associate, new_lines
from locfuse.fusion.linemap.laser_mount import seated, seated_shares
from locfuse.fusion.linemap.line_map import LineMap, about_middle
from locfuse.fusion.linemap.scan import Scan, Scans, Where
from locfuse.fusion.linemap.standing import Standing
from locfuse.fusion.linemap.tidy import MIN_HITS, TIDY_EVERY, merge_doubles, prune
from locfuse.fusion.lines.flatness import bend
from locfuse.fusion.mount import Mount
from locfuse.fusion.recovery.guard import SCANS, Guard
from locfuse.fusion.sensor import Block, Innovation, Model

UNMATCHED, AMBIGUOUS, NEW, LOST, REPEATED = (
    VERDICTS.index(v) for v in ("unmatched", "ambiguous", "new", "lost", "repeated")
)


class LineTracker(Model):
    """Association, extents and growth of the line map; `mode` is how the map enters the filter."""

    local = True
    leads = True

    def __init__(self, mode: str, gate: float, recover: bool = True, mount: Mount | None = None) -> None:
        self.mode = mode
        self.mount = mount if mount is not None and mount.free else None  # None: known exactly
        self.map = LineMap()
        self.joint = mode != "first-scan"
        self.maps = mode != "given"
        # only a map that holds what was seen since can say that something is wrong
        self.guard = Guard() if recover and mode in ("grow", "given") else None
        self._first_map: list[MapLine] = []
        self.gate = chi_square(gate, 2)
        self.codes = Codes(UNMATCHED, AMBIGUOUS, NEW if mode == "grow" else UNMATCHED)
        self._scan = 0
        self._scans = Scans()
        self._last: Association | None = None
        self._teach = True
        self._asked = -1  # the reading that `innovations` was asked for last
        self._standing = Standing()
        self._raw: Scan | None = None  # what that reading says: at rest the mean since the last use
        self._sight: Callable[[], Scan]  # the same in the base, by the mount as it was predicted

    def blocks(self) -> list[Block]:
        """Return what is uncertain of the laser's mount."""
        return self.mount.blocks() if self.mount is not None else []

    def begin(self, given: Sequence[MapLine], belief: Any) -> None:
        """Enter a given map: its lines are considered, so their covariance counts and they stay as they are."""
        if self.mode != "given":
            return
        if not given:
            raise LocfuseError(
                "lrf.map = given needs a map: add --map FILE, written by locfuse run LOG --save-map FILE"
            )
        for line in given:
            anchor, half, P = about_middle(line)
            column = belief.augment(np.array([0.0, line.beta]), np.zeros((2, 3)), P)
            belief.consider(np.array([column, column + 1]))
            self.map.append(anchor, np.array([0.0, line.beta]), P, column, (-half, half), 0)
        self.map.hits = np.array([max(line.hits, MIN_HITS) for line in given])
        self._first_map = list(given)

    def begins_map(self, m: Measurements, i: int) -> bool:
        """Return whether scan i is the first with lines, or the first after all of the map was lost."""
        return self.maps and not self.map.ids.size and bool(m.first[i] < m.first[i + 1])

    def rolled(self, u: Sequence[float]) -> None:
        """Take in the wheels' motion: a robot that stands still learns nothing new."""
        self._standing.rolled(u)

    def innovations(self, m: Measurements, i: int, belief: Any) -> Sequence[Innovation]:
        """Associate the lines of scan i; each becomes one innovation with its verdict."""
        first, last = int(m.first[i]), int(m.first[i + 1])
        self._asked, self._last, self._teach = i, None, True
        if first == last:
            return []
        if len(self.map) == 0:
            self._standing.forget()
        self._raw = self._standing.take(self._scans.read(m, first, last))
        if self._raw is None:
            self._teach = False
            return [Innovation.unpredicted(row, REPEATED, 2, self.gate) for row in range(first, last)]
        scan = self._scan_of(m, first, last, belief)
        self._sight = lambda: scan
        if len(self.map) == 0:
            return [Innovation.unpredicted(row, NEW, 2, self.gate) for row in range(first, last)]
        found = associate(scan, self.map, belief, self.gate)
        if self.guard is not None:
            found, self._teach = self.guard.watch(float(m.t[i]), scan, found, self.map, belief, self.gate)
        self._last = found
        if not self._teach:
            self._standing.forget()
            return [Innovation.unpredicted(first + k, LOST, 2, self.gate) for k in range(last - first)]
        if self.mode == "grow":
            found.refuse_alone()
        return self._seen(found, first, self._shared(m, first, last, belief))

    def _seen(self, found: Association, first: int, shared: Array | None = None) -> SeenLines:
        """Return what the lines from row `first` on say."""
        return SeenLines(found, first, self.map.ids, self.gate, self.codes, self.joint, shared)

    def _shared(self, m: Measurements, first: int, last: int, belief: Any) -> Array | None:
        """Return what rows first:last share (k, 2, s), put into the base as they are; None: nothing."""
        if not self.joint or "shared" not in m.extra:
            return None
        shared: Array = m.extra["shared"][first:last]
        if self.mount is not None and self._raw is not None:
            return seated_shares(shared, self._raw.z, self.mount, belief)
        return shared.astype(np.float64)

    def learn(self, m: Measurements, i: int, belief: Any) -> None:
        """Let matched extents grow, and add what is new: all of the first scan, later only in `grow`."""
        first, last = int(m.first[i]), int(m.first[i + 1])
        if self.guard is not None and last > first:
            self.guard.corrected(belief)
        if first == last or not self._teach or self.mode == "given":
            return
        if i != self._asked:  # two scans at one instant: what is known of matches is of the last one
            return
        self._scan += 1
        found = self._last
        if found is None:
            if self.guard is not None:
                self.guard.begin_anew(float(m.t[i]), belief)
            scan = self._scan_of(m, first, last, belief)
            for k in range(last - first):
                self._add(scan, k, belief)
            self._first_map = self._first_map or self.map.lines(belief)
            return
        found.extend(self.map, self._scan)
        if self.joint:
            uneven, _ = self.loosened(m)
            if uneven.any():
                belief.loosen(*found.bends(belief.arrays[1], uneven, bend(uneven)))
            self._revise(m, i, found.new() if self.mode == "grow" else [], belief)

    def _revise(self, m: Measurements, i: int, new: list[int], belief: JointBelief) -> None:
        """Add lines of scan i that are new; now and then drop what proved worthless and join doubles (`grow`)."""
        if new:
            scan = self._scan_of(m, int(m.first[i]), int(m.first[i + 1]), belief)
            for k in new:
                self._add(scan, k, belief)
        uneven, floor = self.loosened(m)
        if self.mode == "grow" and self._scan % TIDY_EVERY == 0:
            prune(self.map, belief, self._scan)
            merge_doubles(self.map, belief, self._scan, uneven)
        if floor.any():
            self.map.keep_floor(belief, floor)

    def loosened(self, m: Measurements) -> tuple[Array, Array]:
        """Return by which variances (2,) [m^2, rad^2] walls are uneven, and those below which no line is known.

        Of a wall that is not flat another part is seen next, so lines that were seen are loosened; where no wall
        is measured as uneven, all lines keep a floor: no wall is a plane to less. Considered lines stay.
        """
        if self.mode == "consider":
            return np.zeros(2), np.zeros(2)
        if "uneven" in m.extra:
            return m.extra["uneven"][0], np.zeros(2)
        return np.zeros(2), np.diagonal(m.floor)

    def _scan_of(self, m: Measurements, first: int, last: int, belief: Any) -> Scan:
        """Return what rows first:last say as one scan, put into the base by the mount as the belief has it."""
        scan = self._raw if self._raw is not None else self._scans.read(m, first, last)
        if self.mount is None:
            return scan
        return Scan(*seated(scan.rows(), self.mount, belief))

    # ---- many scans at once ----

    @property
    def scans_taken(self) -> int:
        """How many scans taught the map."""
        return self._scan

    def table(self, m: Measurements, at: slice) -> Array:
        """Return measured lines as one table (k, 7): r, psi, R as 00, 01, 11, and both ends."""
        return self._scans.read(m, at.start, at.stop).rows()

    def rolled_since(self) -> tuple[float, float, float]:
        """Return how far the wheels rolled since the last scan that was used, x, y [m], theta [rad]."""
        return self._standing.since()

    def way(self) -> dict[str, Any]:
        """Return the way through the map for `core.scans.Way`: here none is followed."""
        return {}

    def passed(self, progress: Any, way: Any, where: Where, well: int | None) -> None:
        """Take in what the core did without asking (core.tables.Progress, Way).

        `where` tells of each scan that it took, `well` is which one last fitted well.
        """
        self._scan = progress.number
        self._standing.moved((progress.x, progress.y, progress.theta))
        m, n = where.of, len(where.readings)
        if not n:
            return
        self._raw = self._scans.read(m, *where.rows(n - 1))
        self._asked, self._teach = int(where.readings[-1]), True
        self._standing.begin(self._raw)
        self._sight = partial(self._seen_before, where, n - 1)
        if self.guard is not None:
            last = range(max(n - SCANS, 0), n)
            seen = [(float(m.t[where.readings[k]]), partial(self._seen_before, where, k)) for k in last]
            self.guard.passed(where, seen, None if well is None else (float(m.t[well]), self.map.next_id))

    def rest(self, lines: int) -> Any:
        """Return the scans of a robot at rest for the core, which takes those of up to so many lines."""
        return self._standing.table(lines, REPEATED)

    def rested(self, scans: int, pose: tuple[float, float, float]) -> None:
        """Take in that so many scans only repeated what was seen, up to this pose."""
        self._standing.repeated(scans)
        if self.guard is not None:
            self.guard.stood(pose)

    def _seen_before(self, where: Where, k: int) -> Scan:
        """Return scan k of those that the core took, in the base as it was when it came."""
        scan = self._scans.read(where.of, *where.rows(k))
        return scan if self.mount is None else where.seated(k, scan)

    def finish(self, m: Measurements, i: int, fate: Ints, room: Room, belief: JointBelief) -> None:
        """Teach the map what of scan i the core left to do: it stopped after it."""
        lines = int(m.first[i + 1] - m.first[i])
        self._revise(m, i, new_lines(fate, lines, room) if self.mode == "grow" else [], belief)

    # ---- results ----

    def lines(self, belief: Any) -> tuple[list[MapLine], list[MapLine]]:
        """Return the map after the first scan and the map now."""
        return self._first_map, self.map.lines(belief)

    def slips(self) -> int:
        """Return how many slips of a wheel the walls have told."""
        return self.guard.slips if self.guard is not None else 0

    def lost_intervals(self) -> list[tuple[float, float]]:
        """Return when the robot did not know where it was, (start, end) [s]."""
        return self.guard.intervals() if self.guard is not None else []

    def notes(self, belief: Any) -> list[str]:
        """Say in words what the guard did and where the laser was found to sit."""
        words = self.guard.words() if self.guard is not None else []
        return words + (self.mount.words(belief) if self.mount is not None else [])

    def _add(self, scan: Scan, k: int, belief: JointBelief) -> None:
        """New line from (r, psi), the inverse of LineMap.predict; its anchor is the middle of the segment."""
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
        if scan.seat is not None:  # what the reading is predicted to be falls by what the line in the base rises
            columns = scan.seat.columns
            G = np.hstack((G, -G_z @ scan.seat.derivative(scan.z[k : k + 1, 1])[0]))
        column, P = -1, np.zeros((2, 2))
        if self.joint:
            column = belief.augment(value, G, noise, columns)
            if self.mode == "consider":
                belief.consider(np.array([column, column + 1]))
        else:
            P = np.array(belief.spread(G[:, :3].tolist(), columns, G[:, 3:].tolist())) + noise
        self.map.append(anchor, value, P, column, (-half, half), self._scan)
