"""The bearings of a drive, as the core takes them, and what became of each candidate."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from locfuse.fusion.core import bearings as interpreted
from locfuse.fusion.core import tables
from locfuse.fusion.core.room import Room
from locfuse.fusion.data import Audit, Drive, Ints
from locfuse.fusion.ekf.belief_arrays import JointBelief
from locfuse.fusion.sensor import UNTOLD, Bearings, Innovation, Model


class Pictures:
    """The pictures of one run of the filter, whoever judges one: the record of them, and the core's table."""

    def __init__(self, bearings: Bearings, first: Ints, when: Ints) -> None:
        """`when` (n,) are the instants at which the pictures are due, `first` (n + 1,) their candidates."""
        self._of, self._when = bearings, np.asarray(when, np.intp)
        self._first = np.ascontiguousarray(first, np.intp)
        self._told = np.full((len(bearings.z), interpreted.POINTED), UNTOLD)
        self.joint: list[float] = []
        self._table: Any = None

    def table(self, belief: JointBelief, k: int) -> Any:
        """Return the pictures for the core, of which those from instant k on are due."""
        if self._table is None:
            of, core = self._of, Room.here(tables).on_arrays
            at = np.array(() if of.mount is None else of.mount.columns(belief), np.intp)
            told, free = ((0.0, 0.0, 0.0), ()) if of.mount is None else (of.mount.told, of.mount.free)
            seat = core.Seat(np.array(told), np.array(free, np.intp), at, len(free))
            judged = of.threshold, of.margin, *map(float, of.verdicts)
            self._table = core.Bearings(
                self._when, self._first, of.z, of.variance, self._told, *of.point, of.nearest, *judged, seat,
                len(self._when), 0,
            )  # fmt: skip
        self._table.due = int(self._when.searchsorted(k))
        return self._table

    def add(self, k: int, seen: Sequence[Innovation]) -> None:
        """Note the innovations of one picture."""
        for s in seen:
            self._told[s.row] = s.verdict, s.landmark, s.nis, s.y[0], s.sigma[0]

    def audit(self) -> Audit:
        """Return the record as columns."""
        row = np.flatnonzero(self._told[:, 0] != UNTOLD)
        verdict, landmark, nis, y, sigma = self._told[row].T
        n = len(row)
        return Audit(
            instant=np.repeat(self._when, np.diff(self._first))[row].astype(np.int32),
            row=row.astype(np.int32),
            verdict=verdict.astype(np.int8),
            landmark=landmark.astype(np.int32),
            nis=nis.copy(),
            threshold=np.full(n, self._of.threshold),
            y=y[:, None].copy(),
            sigma=sigma[:, None].copy(),
        )


def pictures_of(drive: Drive, models: Sequence[tuple[str, Model]]) -> tuple[str | None, Pictures]:
    """Return the first sensor whose readings are bearings of a known point, and these."""
    for s, model in models:
        m = drive.measurements[s]
        found = model.bearings(m)
        if found is not None:
            return s, Pictures(found, m.first, drive.instant[s])
    return None, Pictures(NOTHING, np.zeros(1, np.intp), np.zeros(0, np.intp))


NOTHING = Bearings(np.zeros(0), np.zeros(0), (0.0, 0.0), 0.0, 0.0, 0.0, (0, 0, 0), None)
