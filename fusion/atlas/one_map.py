"""The line map inside one run: what a scan says of the pose, and what it teaches the map."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from locfuse.fusion import se2
from locfuse.fusion.chi_square import chi_square
from locfuse.fusion.data import VERDICTS, Array, LocfuseError, MapLine, Measurements
from locfuse.fusion.ekf.belief_arrays import JointBelief
from locfuse.fusion.linemap.association import Association, Codes, SeenLines, associate
from locfuse.fusion.linemap.laser_mount import seated, seated_shares
from locfuse.fusion.linemap.line_map import LineMap, about_middle
from locfuse.fusion.linemap.scan import Scan, Scans
from locfuse.fusion.linemap.standing import Standing
from locfuse.fusion.linemap.tidy import MIN_HITS, merge_doubles, prune
from locfuse.fusion.lines.flatness import bend
from locfuse.fusion.mount import Mount
from locfuse.fusion.recovery.guard import Guard
from locfuse.fusion.sensor import Block, Innovation, Model

UNMATCHED, AMBIGUOUS, NEW, LOST, REPEATED = (
    VERDICTS.index(v) for v in ("unmatched", "ambiguous", "new", "lost", "repeated")
)
TIDY_EVERY = 10  # scans
# A scan in which only one line matches says little about whether the match is right: it must fit nearly perfectly.
LONE_D2, LONE_ANGLE, LONE_OFFSET = 5.0, math.radians(3.0), 0.15


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
        self._gate = chi_square(gate, 2)
        self._scan = 0
        self._scans = Scans()
        self._last: Association | None = None
        self._teach = True
        self._asked = -1  # the reading that `innovations` was asked for last
        self._standing = Standing()
        self._raw: Scan | None = None  # what that reading says: at rest the mean since the last use

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
            return [Innovation.unpredicted(row, REPEATED, 2, self._gate) for row in range(first, last)]
        if len(self.map) == 0:
            return [Innovation.unpredicted(row, NEW, 2, self._gate) for row in range(first, last)]
        scan = self._scan_of(m, first, last, belief)
        found = associate(scan, self.map, belief, self._gate)
        if self.guard is not None:
            found, self._teach = self.guard.watch(float(m.t[i]), scan, found, self.map, belief, self._gate)
        self._last = found
        if not self._teach:
            self._standing.forget()
            return [Innovation.unpredicted(first + k, LOST, 2, self._gate) for k in range(last - first)]
        if self.mode == "grow":
            _refuse_a_lone_match(found)
        return self._seen(found, first, self._shared(m, first, last, belief))

    def _seen(self, found: Association, first: int, shared: Array | None = None) -> SeenLines:
        """Return what the lines from row `first` on say."""
        codes = Codes(UNMATCHED, AMBIGUOUS, NEW if self.mode == "grow" else UNMATCHED)
        return SeenLines(found, first, self.map.ids, self._gate, codes, self.joint, shared)

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
        if self.guard is not None:
            self.guard.corrected(belief)
        first, last = int(m.first[i]), int(m.first[i + 1])
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
            self._revise(m, first, last, found, belief)
            self._keep_floor(m, belief)

    def _revise(self, m: Measurements, first: int, last: int, found: Association, belief: JointBelief) -> None:
        """Let lines that are states bend; in `grow` add what is new, drop what proved worthless, join doubles."""
        uneven = m.extra["uneven"][first] if "uneven" in m.extra else np.zeros(2)
        if uneven.any():
            self._bend(found, uneven, belief)
        if self.mode != "grow":
            return
        new = found.new()
        if new:
            scan = self._scan_of(m, first, last, belief)
            for k in new:
                self._add(scan, k, belief)
        if self._scan % TIDY_EVERY == 0:
            prune(self.map, belief, self._scan)
            merge_doubles(self.map, belief, self._scan, uneven)

    def _bend(self, found: Association, uneven: Array, belief: JointBelief) -> None:
        """Loosen the lines that were seen: of a wall that is not flat another part is seen next (wall_floor).

        A wall stays within its unevenness, so a line that is known no better is left alone: loosened for ever, the
        walls of a small room would let the robot drift among them.
        """
        seen = np.array(sorted({pair.column for pair in found.matched()}))
        if self.mode == "consider" or len(seen) == 0:
            return
        columns = np.concatenate((seen, seen + 1))
        room = np.repeat(uneven, len(seen)) - np.diagonal(belief.covariance)[columns]
        belief.loosen(columns, np.clip(room, 0.0, np.repeat(bend(uneven), len(seen))))

    def _keep_floor(self, m: Measurements, belief: JointBelief) -> None:
        """Know no line better than its floor, whatever was averaged: no wall is a plane to less than that.

        Walls that are less even than that are loosened step by step instead (`_bend`).
        """
        if self.mode == "consider" or "uneven" in m.extra:
            return
        self.map.keep_floor(belief, m.floor)

    def _scan_of(self, m: Measurements, first: int, last: int, belief: Any) -> Scan:
        """Return what rows first:last say as one scan, put into the base by the mount as the belief has it."""
        scan = self._raw if self._raw is not None else self._scans.read(m, first, last)
        if self.mount is None:
            return scan
        return Scan(*seated(scan.rows(), self.mount, belief))

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


def _refuse_a_lone_match(found: Association) -> None:
    """Turn a scan's only match into none where others failed to match and it does not fit nearly perfectly."""
    matched = [k for k, p in enumerate(found.match) if p >= 0]
    if len(matched) != 1 or len(found.match) == 1:
        return
    (pair,) = found.matched()
    offset, turn = pair.y
    if pair.d2 > LONE_D2 or abs(turn) > LONE_ANGLE or abs(offset) > LONE_OFFSET:
        found.refuse(pair.line)
