"""The single readings of a drive, as the core takes them, and what became of each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from locfuse.fusion.core import tables
from locfuse.fusion.core.room import Room
from locfuse.fusion.core.singles import JUDGED
from locfuse.fusion.data import Audit, Drive
from locfuse.fusion.ekf.belief_arrays import JointBelief
from locfuse.fusion.sensor import UNTOLD, Columns, Innovation, Model

KINDS = ("headings", "bearings", "echoes", "fixes", "turns", "sightings", "poses", "twists")


class ColumnRecord:
    """What became of every row of a sensor that the core knows, whoever judged it."""

    def __init__(self, of: Columns) -> None:
        self._of = of
        self.joint: list[float] = []

    def add(self, k: int, seen: Sequence[Innovation]) -> None:
        """Note the innovations of one reading."""
        for s in seen:
            self._of.told[s.row] = s.verdict, s.landmark, s.nis, s.threshold, *s.y, *s.sigma

    def audit(self) -> Audit:
        """Return the record as columns."""
        told = self._of.told
        row = np.flatnonzero(told[:, 0] != UNTOLD)
        verdict, landmark, nis, threshold = told[row, :JUDGED].T
        d = self._of.numbers
        return Audit(
            instant=np.repeat(self._of.when, np.diff(self._of.first))[row].astype(np.int32),
            row=row.astype(np.int32),
            verdict=verdict.astype(np.int8),
            landmark=landmark.astype(np.int32),
            nis=nis.copy(),
            threshold=threshold.copy(),
            y=told[row, JUDGED : JUDGED + d],
            sigma=told[row, JUDGED + d :],
            joint=np.array(self.joint).reshape(-1, 2),
        )


class Singles:
    """The sensors of a run whose readings the core takes one by one; of each kind there is one."""

    def __init__(self, drive: Drive, models: Mapping[str, Model], map_of: Model | None) -> None:
        """`map_of`: the model whose line map the core has."""
        self._of: dict[str, Columns] = {}  # by sensor
        for s, model in models.items():
            when = np.ascontiguousarray(drive.instant[s], np.intp)
            found = model.columns(drive.measurements[s], when)
            if found is not None and (found.reads is None or found.reads is map_of):
                self._of[s] = found
        self.records = {s: ColumnRecord(of) for s, of in self._of.items()}
        self.reads_map = any(of.reads is not None for of in self._of.values())
        self.waiting = sum([of.waiting for of in self._of.values()])  # rows at most
        self._none = no_singles()
        self._now: dict[str, Any] = {}

    def __contains__(self, sensor: str) -> bool:
        """Tell whether the core takes the readings of a sensor."""
        return sensor in self._of

    def until(self, k: int, last: int) -> int:
        """Return the first instant from k on, `last` at most, with a reading that the loop must take."""
        for of in self._of.values():
            if not of.ready:
                i = int(of.when.searchsorted(k))
                last = min(last, int(of.when[i])) if i < len(of.when) else last
        return last

    def tables(self, belief: JointBelief, k: int) -> list[Any]:
        """Return all kinds for the core, of which the readings from instant k on are due."""
        self._now = {}
        found = dict(self._none)
        for s, of in self._of.items():
            if of.ready:
                table = self._now[s] = found[of.kind] = of.table(belief)
                table.due = int(of.when.searchsorted(k))
        return [found[kind] for kind in KINDS]

    def taken(self, k: int) -> None:
        """Take back what the core did since instant k."""
        for s, table in self._now.items():
            of = self._of[s]
            a, b = int(of.when.searchsorted(k)), int(table.due)
            of.passed(a, b)
            whole = of.joint[a:b]
            self.records[s].joint.extend(whole[whole[:, 1] > 0.0].ravel().tolist())


def no_singles() -> dict[str, Any]:
    """Return what the core is given of kinds that nobody reads."""
    core = Room.here(tables).on_arrays
    wholes, numbers, rows = np.zeros(1, np.intp), np.zeros(1), np.zeros((1, 1))
    none = *(0.0,) * 2, 0, 0  # the gate, what is refused, and no readings
    seat = core.Seat(np.zeros(3), wholes, wholes, 0)
    return {
        "headings": core.Headings(wholes, *(numbers,) * 2, wholes, *(0.0,) * 4, wholes, 0, rows, 0, 0, -1),
        "bearings": core.Bearings(wholes, wholes, *(numbers,) * 2, rows, *(0.0,) * 8, seat, 0, 0),
        "echoes": core.Echoes(wholes, wholes, numbers, numbers, rows, 0.0, rows, *(0.0,) * 3, 0, 0),
        "fixes": core.Fixes(wholes, rows, rows, rows, *(0.0,) * 4, numbers, -1, False, *none),
        "turns": core.Turns(
            wholes, *(numbers,) * 3, rows, *(0.0,) * 3, -1, 0, *(0.0,) * 5, 0, 0, 0
        ),
        "sightings": core.Sightings(
            wholes, wholes, rows, rows, 1, wholes, wholes, rows, wholes, False, rows, *(0.0,) * 2, -1, -1,
            *(0.0,) * 3, rows, rows, rows, *none,
        ),
        "poses": core.Poses(wholes, rows, rows, wholes, rows, False, -1, *(0.0,) * 7, 0, 0, 0),
        "twists": core.Twists(wholes, rows, rows, numbers, rows, -1, *(0.0,) * 5, 0, 0, 0),
    }  # fmt: skip
