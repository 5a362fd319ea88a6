"""The scans of a drive as the core takes them: a tracker's lines and map as `core.scans` wants them, and back.

The core takes a scan that fits the map, of a robot that drives. All else is left to the tracker's own methods,
scan by scan.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from locfuse.fusion.atlas.one_map import LineTracker
from locfuse.fusion.audit import Record
from locfuse.fusion.core import match, tables
from locfuse.fusion.core.bearings import RAY
from locfuse.fusion.core.echoes import ECHO
from locfuse.fusion.core.fixes import FIX
from locfuse.fusion.core.poses import SEEN_FROM
from locfuse.fusion.core.room import Room
from locfuse.fusion.core.singles import WIDE
from locfuse.fusion.core.twists import CHORD
from locfuse.fusion.data import Array, Ints, Measurements
from locfuse.fusion.ekf.belief_arrays import JointBelief
from locfuse.fusion.linemap.association import AMBIGUOUS, LONE, LONGEST, OVERLAP, ZONE
from locfuse.fusion.linemap.line_map import WALL
from locfuse.fusion.linemap.pairing import MAX_PAIR_ANGLE_RAD, MAX_PAIR_OFFSET_M, PAIR, PAIR_SIGMAS
from locfuse.fusion.linemap.scan import BLOCK, Where
from locfuse.fusion.linemap.standing import MAX_ROLLED_M, MAX_TURNED_RAD
from locfuse.fusion.linemap.tidy import APART, DOUBLE_ANGLE, DOUBLE_OFFSET, MIN_HITS, TIDY_EVERY, TRIAL_SCANS
from locfuse.fusion.lines.extract import LINE
from locfuse.fusion.lines.flatness import bend
from locfuse.fusion.recovery.guard import MIN_MATCHED_SHARE, WELL
from locfuse.fusion.sensor import Table

TRIED = 3  # rows that are written beside those that wait: of a reading of two, and of its place


class AtOnce:
    """The scans of one run of the filter, a table of them at a time."""

    def __init__(self, tracker: LineTracker, m: Measurements, when: Ints) -> None:
        """`when` (n,) are the instants at which the scans of `m` are due, at most one at each."""
        self.of, self._m, self._when = tracker, m, when
        self._core = Room.here(tables).on_arrays
        self.record = Record(len(m.z))
        self._rules: Any = None
        self._begin = self._end = 0  # scans of the table
        self._first: Ints = np.zeros(1, np.intp)  # (k + 1,) row of the table
        self._written: tuple[Ints, Ints, Array, Array, Array]  # verdict, landmark, told, joint, sights
        self._scans: Any = None
        self._at = self._now = 0  # where in the table the core began and ended
        self._most = int(np.diff(m.first).max(initial=0))  # lines of a scan

    @property
    def ready(self) -> bool:
        """Whether the core may take a scan now: there is a map, and nobody is lost."""
        return len(self.of.map) > 0

    def has(self, first: int, last: int) -> bool:
        """Tell whether the core has a scan to take at the instants first:last."""
        return self.ready and first <= self.next_after(first, table=False) < last

    @property
    def places(self) -> int:
        """How many lines the map has."""
        return len(self.of.map)

    def desk(self, places: int, singles: int) -> dict[str, Array]:
        """Return room for any scan, a map of so many places, and so many rows of single readings."""
        free = 0 if self.of.mount is None else len(self.of.mount.free)
        shared = self._m.extra["shared"].shape[2] if self.of.joint and "shared" in self._m.extra else 0
        return desk(singles, self._most, places, free, shared)

    def finish(self, fate: Ints, belief: JointBelief) -> None:
        """Let the tracker go on after the last scan that the core took, which showed lines of this fate."""
        self.of.finish(self._m, self._begin + self._now - 1, fate, Room.here(tables), belief)

    def next_after(self, k: int, table: bool) -> int:
        """Return the first instant from k on with a scan, or with one that is not in the `table` of one at k."""
        i = int(self._when.searchsorted(k))
        if table:
            self._load(i)
            i = self._end
        return int(self._when[i]) if i < len(self._when) else -1

    def _load(self, i: int) -> None:
        """Have scan i in the table."""
        m, n = self._m, len(self._when)
        if self._begin <= i < self._end or i >= n:
            return
        first = np.asarray(m.first, np.intp)
        end = int(np.searchsorted(first, first[i] + BLOCK, "right")) - 1
        self._begin, self._end = i, min(max(end, i + 1), n)
        self._first = first[i : self._end + 1] - first[i]
        at, scans, lines = slice(int(first[i]), int(first[self._end])), self._end - i, int(self._first[-1])
        shared = self.of.joint and "shared" in m.extra
        of_shared = m.extra["shared"][at] if shared else np.zeros((0, 2, 0))
        verdict, landmark = np.zeros(lines, np.intp), np.zeros(lines, np.intp)
        self._written = (
            verdict,
            landmark,
            np.full((lines, match.TOLD), np.nan),
            np.zeros((scans, 2)),
            np.zeros((scans, 9)),
        )
        self._scans = self._core.Scans(
            self.of.table(m, at), self._first,
            np.asarray(self._when[i : self._end], np.intp), scans, of_shared.astype(np.float64).ravel(),
            of_shared.shape[2], *self._written,
        )  # fmt: skip

    def given(self, belief: JointBelief, k: int) -> tuple[Any, ...]:
        """Return scans, map, mount, rules and way for the core from instant k on."""
        of, i = self.of, int(self._when.searchsorted(k))
        self._load(i)
        self._at = i - self._begin
        if self._rules is None:
            self._rules = self._core.Rules(**_rules(of, self._m))
        free = () if of.mount is None else of.mount.free
        at = np.array(() if of.mount is None else of.mount.columns(belief), np.intp)
        told = np.array((0.0, 0.0, 0.0) if of.mount is None else of.mount.told)
        return (
            self._scans,
            of.map.table(len(free)),
            self._core.Seat(told, np.array(free, np.intp), at, len(free)),
            self._rules,
            of.rest(self._most),
            self._core.Way(**of.way()),
        )

    @property
    def progress(self) -> tuple[Any, ...]:
        """How far the scans are, in the order of `core.scans.Progress` from the scan on."""
        return self._at, *self.of.rolled_since(), self.of.scans_taken, -1

    def taken(self, rest: Any, way: Any, progress: Any) -> None:
        """Take back what the core did: the record, and what the tracker has to know of the last scans."""
        begin, a, b, of = self._begin, self._at, progress.scan, self.of
        self._now = b
        first, when, at = self._first, self._when[self._begin : self._end], slice(self._first[a], self._first[b])
        verdict, landmark, told, joint, sights = self._written
        if at.stop > at.start:
            now = told[at]
            row = int(self._m.first[begin]) + int(at.start)
            table = Table(row, verdict[at], landmark[at], of.gate, now[:, 0], now[:, 1:3], now[:, 3:])
            self.record.add_rows(np.repeat(when[a:b], np.diff(first[a : b + 1])), table)
            self.record.joint.frombytes(joint[a:b][joint[a:b, 1] > 0.0].tobytes())
        shown = a + np.flatnonzero(np.diff(first[a : b + 1]))
        seen = shown[rest.taken :]  # those at rest come first
        if rest.taken:
            x, y, theta = sights[shown[rest.taken - 1], 6:].tolist()
            of.rested(rest.taken, (x, y, theta))
        where = Where(self._m, begin + seen, sights[seen, :3], sights[seen, 3:6], sights[seen, 6:])
        of.passed(progress, way, where, begin + progress.well if progress.well >= 0 else None)


def _rules(of: LineTracker, m: Measurements) -> dict[str, Any]:
    """Return the rules of a tracker."""
    uneven, floor = of.loosened(m)
    step = bend(uneven)
    lone_d2, lone_turn, lone_offset = LONE
    return {
        "max_turn": MAX_PAIR_ANGLE_RAD,
        "max_offset": MAX_PAIR_OFFSET_M,
        "sigmas": PAIR_SIGMAS,
        "gate": of.gate,
        "zone": ZONE,
        "rival": AMBIGUOUS,
        "share": OVERLAP,
        "longest": LONGEST,
        "unmatched": of.codes.unmatched,
        "ambiguous": of.codes.ambiguous,
        "new": of.codes.new,
        "watched": of.guard is not None,
        "least": MIN_MATCHED_SHARE,
        "well": WELL,
        "grows": of.mode == "grow",
        "joint": of.joint,
        "lone_d2": lone_d2,
        "lone_turn": lone_turn,
        "lone_offset": lone_offset,
        "tidy": TIDY_EVERY,
        "trial": TRIAL_SCANS,
        "hits": MIN_HITS,
        "double_turn": DOUBLE_ANGLE,
        "double_offset": DOUBLE_OFFSET,
        "double_apart": APART,
        "rolled": MAX_ROLLED_M,
        "turned": MAX_TURNED_RAD,
        "floor": float(floor[0]),
        "floor_turn": float(floor[1]),
        "uneven": float(uneven[0]),
        "uneven_turn": float(uneven[1]),
        "bend": float(step[0]),
        "bend_turn": float(step[1]),
        "teaches": of.maps,
    }


def desk(singles: int = 0, lines: int = 0, places: int = 0, free: int = 0, parts: int = 0) -> dict[str, Array]:
    """Return room for a scan of so many lines, a map of so many places, a mount, and so many rows of `singles`."""
    own = singles + TRIED
    m, columns = 2 * lines + own, 3 + free + 2 * lines + WIDE * own
    seated, walls = np.empty((lines, LINE)), np.empty((places, WALL + 2 * free))
    return {
        "raw": np.empty((lines, LINE)),
        "seated": seated,
        "rows": seated.ravel(),
        "wall_rows": walls,
        "walls": walls.ravel(),
        "mount": np.empty(2 + 4 * free + free * free),
        "place": np.empty(3),
        "offset": np.empty(3),
        "pose": np.empty(3),
        "triangle": np.empty(6),
        "seen": np.empty(4 * places),
        "pairs": np.empty(PAIR * lines * places),
        "fate": np.empty(4 * lines, np.intp),
        "order": np.empty(lines, np.intp),
        "shared": np.empty(2 * lines * parts),
        "at": np.empty(columns, np.intp),
        "H": np.empty((m, columns)),
        "G": np.empty((m, parts)),
        "R": np.empty((m, m)),
        "y": np.empty(m),
        "loose": np.empty(2 * max(places, lines), np.intp),
        "missing": np.empty(2 * max(places, lines)),
        "located": np.empty(9),
        "ray": np.empty(RAY),
        "chain": np.empty(6),
        "own_at": np.empty((own, WIDE), np.intp),
        "own_H": np.empty((own, WIDE)),
        "own_y": np.empty(own),
        "own_R": np.empty((own, 3)),
        "own_states": np.empty(own, np.intp),
        "follows": np.empty(own, np.intp),
        "S": np.empty((3, 3)),
        "e": np.empty(3),
        "tie": np.empty(4),
        "fix": np.empty(FIX),
        "echo": np.empty(ECHO),
        "by": np.empty(3),
        "noise": np.empty(6),
        "apart": np.empty(SEEN_FROM),
        "chord": np.empty(CHORD),
    }


def no_scans() -> tuple[Any, ...]:
    """Return what the core is given where there are none: scans, map, mount, rules and way."""
    core = Room.here(tables).on_arrays
    wholes, numbers, rows = np.zeros(1, np.intp), np.zeros(1), np.zeros((1, 1))
    return (
        core.Scans(rows, wholes, wholes, 0, numbers, 0, wholes, wholes, rows, rows, rows),
        core.Walls(wholes, rows, numbers, numbers, *(wholes,) * 4, numbers, 0, 0, False),
        core.Seat(np.zeros(3), wholes, wholes, 0),
        core.Rules(
            *(0.0,) * 8, *(0,) * 3, False, 0.0, 0.0, False, False, *(0.0,) * 3, 1, 0, 0, *(0.0,) * 11, False
        ),
        core.Rest(rows, rows, wholes, 0, 0, 0.0, 0.0, 0, wholes, wholes, numbers, 0),
        core.Way(),
    )
