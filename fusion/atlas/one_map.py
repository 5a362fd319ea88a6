"""The line map inside one run: what a scan says of the pose, and what it teaches the map."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np

from locfuse.fusion import se2
from locfuse.fusion.chi_square import chi_square
from locfuse.fusion.data import VERDICTS, Array, LocfuseError, MapLine, Measurements
from locfuse.fusion.ekf.belief_arrays import JointBelief
from locfuse.fusion.kernels.ekf import Innovation
from locfuse.fusion.kernels.sight import Rules
from locfuse.fusion.linemap.association import NO_SHARES, Association, associate
from locfuse.fusion.linemap.laser_mount import by_mount, moved_mount, seat_of
from locfuse.fusion.linemap.line_map import LineMap, about_middle
from locfuse.fusion.linemap.scan import Scan, Scans
from locfuse.fusion.linemap.standing import Standing
from locfuse.fusion.linemap.tidy import MIN_HITS, TIDY_EVERY, merge_doubles, prune, untidy
from locfuse.fusion.lines.extract import rows_in_base
from locfuse.fusion.lines.flatness import bend
from locfuse.fusion.mount import Mount
from locfuse.fusion.recovery.guard import Guard
from locfuse.fusion.sensor import Block, Model

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
        new = NEW if mode == "grow" else UNMATCHED
        self.rules = Rules(self.gate, self.joint, mode == "grow", UNMATCHED, AMBIGUOUS, new)
        self._scan = 0
        self._scans = Scans()
        self._standing = Standing()
        self._sight: Association | None = None  # the scan at hand, where it is seen as expected
        self._found: Association | None = None  # the scan at hand; None: the map begins with it
        self._late: Callable[[], Scan]  # the same in the base, by the mount as it was predicted
        self._rows = np.zeros((0, 7))  # its lines, in the base as configured: at rest the mean since the last use
        self._teach = True
        self._asked = -1  # the reading that `innovations` was asked for last
        self._of: Measurements | None = None  # whose numbers these are:
        self._first: list[int] = []
        self._t: list[float] = []
        self._uneven, self._floor, self._bend = np.zeros(2), np.zeros(2), np.zeros(2)

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

    def innovations(self, m: Measurements, i: int, belief: Any) -> Sequence[Innovation] | Association:
        """Associate the lines of scan i (eq. 13, 17, 18): each is judged; those that match correct the pose."""
        first, last = self._bounds(m, i)
        if self._found is not None:  # of another scan at this instant, whose rows are still to be used
            self._sight = None
        self._asked, self._found, self._teach = i, None, True
        if first == last:
            return []
        if len(self.map.ids) == 0:
            self._standing.forget()
        rows = self._standing.take(self._scans.read(m, first, last))
        if rows is None:
            self._teach = False
            return [Innovation.unpredicted(row, REPEATED, 2, self.gate) for row in range(first, last)]
        self._rows = rows
        if len(self.map.ids) == 0:
            offset = None if self.mount is None else moved_mount(self.mount, belief)
            self._late = partial(_in_base, rows, offset)
            return [Innovation.unpredicted(row, NEW, 2, self.gate) for row in range(first, last)]
        if self._sight is None:
            self._sight = Association(self.rules, seat_of(self.mount, belief))
        shared = self._shared(m, first, last)
        found = self._sight
        share = found.compare(belief, self.map, rows, shared)
        late = self._late = partial(_in_base, rows, None if self.mount is None else found.moved())
        if self.guard is not None and not self.guard.fits(
            self._t[i], share, belief.pose(), late, self.map.next_id
        ):
            again = partial(associate, rows, self.map, belief, found, shared)
            found, self._teach = self.guard.watch(self._t[i], late(), found, self.map, belief, again)
        if not self._teach:
            self._standing.forget()
            return [Innovation.unpredicted(row, LOST, 2, self.gate) for row in range(first, last)]
        if self.mode == "grow":
            found.refuse_alone()
        self._found = found
        found.row = first
        found.state_rows(belief)
        return found

    def _bounds(self, m: Measurements, i: int) -> tuple[int, int]:
        """Return the first line of scan i and the end; begin with a log's numbers where it is another one."""
        if m is not self._of:
            self._of, self._first, self._t = m, m.first.tolist(), m.t.tolist()
            self._uneven, self._floor = (np.array(part, np.float64) for part in self.loosened(m))
            self._bend = bend(self._uneven)
        return self._first[i], self._first[i + 1]

    def _shared(self, m: Measurements, first: int, last: int) -> Array:
        """Return what the errors of rows first:last share (k, 2, s)."""
        if not self.joint or "shared" not in m.extra:
            return NO_SHARES
        return np.ascontiguousarray(m.extra["shared"][first:last], np.float64)

    def _scan_in_base(self, belief: Any) -> Scan:
        """Return the scan at hand, put into the base by the mount as the belief has it."""
        if self.mount is None:
            return Scan(self._rows)
        return _in_base(self._rows, moved_mount(self.mount, belief))

    def learn(self, m: Measurements, i: int, belief: Any) -> None:
        """Let matched extents grow, and add what is new: all of the first scan, later only in `grow`."""
        first, last = self._bounds(m, i)
        if self.guard is not None and last > first:
            self.guard.stood(belief.pose())
        if i != self._asked:  # two scans at one instant: what is known of matches is of the last one
            return
        found, self._found = self._found, None
        if first == last or not self._teach or self.mode == "given":
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
        """Loosen uneven walls, add new lines; now and then drop worthless lines and join doubles (`grow`)."""
        uneven = self._uneven
        if uneven[0] > 0.0 or uneven[1] > 0.0:
            found.bend(belief, uneven, self._bend)
        if self.mode == "grow":
            if found.new_lines():
                scan = self._scan_in_base(belief)
                for k in found.new():
                    self._add(scan, k, belief)
            if self._scan % TIDY_EVERY == 0 and untidy(self.map, belief, self._scan):
                prune(self.map, belief, self._scan)
                merge_doubles(self.map, belief, self._scan, uneven)
        if self._floor[0] > 0.0 or self._floor[1] > 0.0:
            self.map.keep_floor(belief, self._floor)

    def loosened(self, m: Measurements) -> tuple[Array, Array]:
        """Return by which variances (2,) [m^2, rad^2] walls are uneven, and those below which no line is known.

        Of a wall that is not flat another part is seen next, so lines that were seen are loosened; where no wall
        is measured as uneven, all lines keep a floor: no wall is a plane to less. Considered lines stay.
        """
        if self.mode == "consider":
            return np.zeros(2), np.zeros(2)
        if "uneven" in m.extra:
            return m.extra["uneven"][0] if len(m.z) else np.zeros(2), np.zeros(2)
        return np.zeros(2), np.diagonal(m.floor)

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
        if self.mount is not None:  # what the reading is predicted to be falls by what the line in the base rises
            columns = self.mount.columns(belief)
            G = np.hstack((G, -G_z @ by_mount(self.mount, belief, psi)))
        column, P = -1, np.zeros((2, 2))
        if self.joint:
            column = belief.augment(value, G, noise, columns)
            if self.mode == "consider":
                belief.consider(np.array([column, column + 1]))
        else:
            P = belief.spread(G, columns) + noise
        self.map.append(anchor, value, P, column, (-half, half), self._scan)


def _in_base(rows: Array, offset: tuple[float, float, float] | None) -> Scan:
    """Return lines in the base as configured, moved by an offset x, y [m], yaw [rad] of the mount, if any."""
    return Scan(rows if offset is None else rows_in_base(rows, *offset))
