"""Stretches of a drive on which nothing but headings is read: the core takes all of their instants at once.

What comes of it is what instant by instant comes of it (tests/fusion/test_coast.py). Everything else - scans, an
instant with two headings, settings that the core does not know - stays with the loop in `fuse`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from locfuse.fusion.core import coast as interpreted
from locfuse.fusion.core.room import Room
from locfuse.fusion.ekf.belief_arrays import AT_ONCE, JointBelief, positive
from locfuse.fusion.sensors.registry import REGISTRY

from .data import Array, Audit, Drive, Ints
from .sensor import GATE, Headings, Innovation, Model
from .track import Track

MOST = 1 << 16  # instants at once: Ctrl-C waits for them
NOTHING = Headings(np.zeros(0), np.zeros(0), np.zeros(0, np.intp), GATE, 0.0, 0.0, None)


class HeadingRecord:
    """What became of every heading of a run, whoever judged it (compare audit.Record)."""

    def __init__(self, when: Ints, threshold: float) -> None:
        self._when, self._threshold = when, threshold
        self.told = np.empty((len(when), interpreted.HEARD))  # verdict, NIS, y, sigma
        self.joint: list[float] = []

    def add(self, k: int, seen: Sequence[Innovation]) -> None:
        """Note the innovation of one reading."""
        for s in seen:
            self.told[s.row] = s.verdict, s.nis, s.y[0], s.sigma[0]

    def audit(self) -> Audit:
        """Return the record as columns."""
        verdict, nis, y, sigma = self.told.T
        n = len(self._when)
        return Audit(
            instant=self._when.astype(np.int32),
            row=np.arange(n, dtype=np.int32),
            verdict=verdict.astype(np.int8),
            landmark=np.full(n, -1, np.int32),
            nis=nis.copy(),
            threshold=np.full(n, self._threshold),
            y=y[:, None].copy(),
            sigma=sigma[:, None].copy(),
        )


class Stretches:
    """Which instants of a drive can be taken at once, and how."""

    def __init__(
        self, drive: Drive, models: Mapping[str, Model], belief: JointBelief, slow: Sequence[str] = ()
    ) -> None:
        """`slow`: sensors that need the loop whatever they read."""
        named = [(s, models[s]) for s in REGISTRY if s in models and s not in slow]
        self.sensor, self._of = _headings(drive, named)
        when = drive.instant[self.sensor] if self.sensor is not None else ()
        self._when: Ints = np.array(when, np.intp)
        self.record = HeadingRecord(self._when, self._of.threshold)
        busy = [drive.instant[s] for s in models if s != self.sensor]
        busy.append(self._when[1:][np.diff(self._when) == 0])  # two headings share one prior
        self._busy: list[int] = np.append(np.unique(np.concatenate(busy)), len(drive.t)).tolist()
        self._next = 0
        u, Q = (np.ascontiguousarray(a).reshape(len(drive.t), -1) for a in (drive.motions.u, drive.motions.Q))
        self._motions = u, Q, np.diff(drive.t, prepend=drive.t[:1])
        drifting = np.concatenate([np.zeros(0, np.intp), *(c for c, _ in belief.drifting)])
        drift = np.concatenate([np.zeros(0), *(d for _, d in belief.drifting)])
        self._drifts = drifting, drift, len(drift)
        self._core = Room.here(interpreted).on_arrays
        self._room: tuple[Any, ...] = ()
        self._room_for = (-2, 0)  # first column of the map frame, and the states that there is room for

    def until(self, k: int) -> int:
        """Return the first instant from k on that needs the loop, or where enough is taken at once."""
        while self._busy[self._next] < k:
            self._next += 1
        return min(self._busy[self._next], k + MOST)

    def coast(self, belief: JointBelief, first: int, last: int, track: Track) -> Sequence[float]:
        """Take the belief through instants first:last, and record them.

        Returns by how much the wheels moved, x, y [m], theta [rad], component by component.
        """
        x, P = belief.arrays
        frame = belief.in_frame
        if self._room_for != (frame, len(x)):
            self._make_room(belief, frame, len(x))
        begin, end = (0, 0) if self.sensor is None else self._when.searchsorted((first, last)).tolist()
        track.make_room(last)
        pose, triangle, values = track.columns
        of, record = self._of, (pose, triangle, track.states, len(track.states), values, self.record.told)
        judged = of.z, of.variance, of.usable, of.threshold, float(GATE), float(of.unused), of.offset
        given = x, P, belief.n, frame, first, last, *self._motions, *self._drifts, self._when, begin, end
        positive(self._core.coast(*given, *judged, *self._room, *record))
        track.n = last
        moved: list[float] = self._motions[0][first:last].sum(axis=0).tolist()
        return moved

    def _make_room(self, belief: JointBelief, frame: int, size: int) -> None:
        """Find the states whose sum a heading is, and make room for its correction."""
        own = () if self._of.block is None else (belief.block(self._of.block)[0],)
        at = np.array([2, *own, *(() if frame < 0 else (frame + 2,))])
        rows: tuple[Array, ...] = np.empty(9), np.empty(1), np.empty((1, 1)), np.ones((1, len(at)))
        self._room = at, len(at), *rows, np.zeros((AT_ONCE, size))
        self._room_for = frame, size


def _headings(drive: Drive, models: Sequence[tuple[str, Model]]) -> tuple[str | None, Headings]:
    """Return the first sensor whose readings are headings, and these."""
    for s, model in models:
        found = model.headings(drive.measurements[s])
        if found is not None:
            return s, found
    return None, NOTHING
