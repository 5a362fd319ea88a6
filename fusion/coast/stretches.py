"""Stretches of a drive on which the core takes all instants at once: single readings, scans that fit the map.

What comes of it is what instant by instant comes of it (tests/fusion/test_coast.py). All else (other sensors, a
scan that hardly fits, new lines, settings that the core does not know) stays with the loop in `fuse`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from locfuse.fusion.atlas.one_map import LineTracker
from locfuse.fusion.audit import Record
from locfuse.fusion.core import coast as interpreted
from locfuse.fusion.core import tables
from locfuse.fusion.core.room import Room
from locfuse.fusion.data import Drive, Ints
from locfuse.fusion.ekf.belief_arrays import AT_ONCE, NO_STATES, JointBelief
from locfuse.fusion.sensor import Model, positive
from locfuse.fusion.sensors.registry import REGISTRY
from locfuse.fusion.track import Track

from .readings import ColumnRecord, Singles
from .scans import AtOnce, desk, no_scans

AnyRecord = Record | ColumnRecord
MOST = 1 << 16  # instants at once: Ctrl-C waits for them


class Stretches:
    """Which instants of a drive can be taken at once, and how."""

    def __init__(
        self, drive: Drive, models: Mapping[str, Model], belief: JointBelief, slow: Sequence[str] = ()
    ) -> None:
        """`slow`: sensors that need the loop whatever they read."""
        named = [(s, models[s]) for s in REGISTRY if s in models and s not in slow]
        self.scanner, self._scans = _scans(drive, named)
        self._singles = Singles(drive, dict(named), None if self._scans is None else self._scans.of)
        taken = [*(() if self.scanner is None else (self.scanner,)), *self._singles.records]
        self._whole = any(model.joint for model in models.values())
        busy = [np.array([len(drive.t)])]
        busy += [drive.instant[s] for s in models if s not in taken]
        busy += [_twice(drive.instant[s]) for s in taken]
        self._busy: list[int] = np.unique(np.concatenate(busy)).tolist()
        self._next = 0
        self._core, self._tables = Room.here(interpreted).on_arrays, Room.here(tables).on_arrays
        self._motions = np.ascontiguousarray(drive.motions.u)
        drifting = np.concatenate([np.zeros(0, np.intp), *(c for c, _ in belief.drifting)])
        drift = np.concatenate([np.zeros(0), *(d for _, d in belief.drifting)])
        Q, dt = (
            np.ascontiguousarray(drive.motions.Q).reshape(len(drive.t), -1),
            np.diff(drive.t, prepend=drive.t[:1]),
        )
        J, by = NO_STATES, belief.moved_by
        if by[1]:
            J = np.ascontiguousarray(drive.motions.J).reshape(len(drive.t), 3 * by[1])
        self._wheels = self._tables.Wheels(self._motions, Q, dt, drifting, drift, len(drift), J, *by)
        self._no_scans = no_scans()
        self._taken: AtOnce | None = None  # whose scans the core took last
        self._desk: Any = None
        self._fate: Ints = np.zeros(0, np.intp)
        self._desk_for = (-1, -1)  # map lines and states that there is room for
        self._left = -1  # the instant that the core has predicted, and left to the loop

    def until(self, k: int) -> int:
        """Return the first instant from k on that needs the loop, or where enough is taken at once."""
        if k == self._left:
            return k
        while self._busy[self._next] < k:
            self._next += 1
        last = min(self._busy[self._next], k + MOST)
        if self._scans is not None:
            scan = self._scans.next_after(k, table=self._scans.ready)
            last = min(last, scan) if scan >= 0 else last
        return self._singles.until(k, last)

    def coast(self, belief: JointBelief, first: int, last: int, track: Track) -> Stop:
        """Take the belief from instant `first` until `last` or where the loop must go on, and record that."""
        track.make_room(last)
        taken = self._taken = self._scans if self._scans is not None and self._scans.has(first, last) else None
        scans = self._without_scans() if taken is None else taken.given(belief, first)
        begun = (0, 0.0, 0.0, 0.0, 0, -1) if taken is None else taken.progress
        progress = self._tables.Progress(first, interpreted.DONE, *begun)
        x, P = belief.arrays
        state = self._tables.Belief(x, P, belief.n, belief.in_frame, *belief.kept)
        of = state, self._wheels, self._readings(belief, first)
        positive(self._core.coast(*of, *scans, self._room(len(x)), self._notes(track), progress, last))
        track.n = reached = progress.instant
        self._left = reached if progress.why == interpreted.BEFORE else -1
        if taken is not None:
            taken.taken(scans[-2], scans[-1], progress)
        self._singles.taken(first)
        predicted = reached + (progress.why != interpreted.DONE)
        rolled: list[float] = self._motions[first:predicted].sum(axis=0).tolist()
        return Stop(reached, progress.why == interpreted.AFTER, rolled)

    def records(self) -> dict[str, AnyRecord]:
        """Return what becomes of the readings, by sensor: whoever judges one notes it there."""
        found: dict[str, AnyRecord] = {}
        if self.scanner is not None and self._scans is not None:
            found[self.scanner] = self._scans.record
        return found | self._singles.records

    def left(self, k: int) -> bool:
        """Tell whether the belief has been predicted to instant k, and nothing else was done there."""
        return k == self._left

    def takes(self, model: Model) -> bool:
        """Tell whether a model's scans were taken last, and so how far the wheels rolled between them."""
        return self._taken is not None and self._taken.of is model

    def finish(self, belief: JointBelief) -> None:
        """Let the scanner go on after the scan at which the core stopped."""
        if self._scans is not None:
            self._scans.finish(self._fate, belief)

    def _readings(self, belief: JointBelief, k: int) -> Any:
        """Return all single readings, of which those from instant k on are due."""
        return self._tables.Readings(*self._singles.tables(belief, k), self._whole)

    def _without_scans(self) -> tuple[Any, ...]:
        """Return what the core is given where no scan is due: the map, if somebody else reads it."""
        if self._scans is None or not self._singles.reads_map:
            return self._no_scans
        scans, _, *rest = self._no_scans
        return scans, self._scans.of.map.table(), *rest

    def _notes(self, track: Track) -> Any:
        """Return where the core notes the track."""
        (pose, triangle, values), states = track.columns, track.states
        return self._tables.Notes(np.empty(9), pose, triangle, states, len(states), values)

    def _room(self, size: int) -> Any:
        """Return room for a scan and a heading, which suits the map and the state as they are."""
        places, states = self._desk_for
        needed = 0 if self._scans is None else self._scans.places
        if places < needed or states != size:
            self._desk_for = max(places, 2 * needed), size
            singles = self._singles.waiting
            arrays = desk(singles) if self._scans is None else self._scans.desk(self._desk_for[0], singles)
            self._fate = np.asarray(arrays["fate"], np.intp)
            self._desk = self._tables.Desk(**arrays, V=np.empty((len(arrays["y"]) + AT_ONCE, size)))
        return self._desk


class Stop(NamedTuple):
    """Where the core stopped."""

    instant: int  # that is next, or of a scan that is to be finished
    finish: bool
    rolled: Sequence[float]  # by the wheels, x, y [m], theta [rad], component by component


def _twice(when: Ints) -> Ints:
    """Return the instants at which two readings share one prior."""
    found: Ints = when[1:][np.diff(when) == 0]
    return found


def _scans(drive: Drive, models: Sequence[tuple[str, Model]]) -> tuple[str | None, AtOnce | None]:
    """Return the first sensor whose readings the core takes as scans, and these."""
    for s, model in models:
        if isinstance(model, LineTracker):
            return s, AtOnce(model, drive.measurements[s], drive.instant[s])
    return None, None
