"""The headings of a drive, as the core takes them, and what became of each."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from locfuse.fusion.core import coast
from locfuse.fusion.data import Audit, Drive, Ints
from locfuse.fusion.sensor import GATE, Headings, Innovation, Model

NOTHING = Headings(np.zeros(0), np.zeros(0), np.zeros(0, np.intp), GATE, 0.0, 0.0, None)


class HeadingRecord:
    """What became of every heading of a run, whoever judged it (compare audit.Record)."""

    def __init__(self, when: Ints, threshold: float) -> None:
        self._when, self._threshold = when, threshold
        self.told = np.empty((len(when), coast.HEARD))  # verdict, NIS, y, sigma
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


def headings_of(drive: Drive, models: Sequence[tuple[str, Model]]) -> tuple[str | None, Headings]:
    """Return the first sensor whose readings are headings, and these."""
    for s, model in models:
        found = model.headings(drive.measurements[s])
        if found is not None:
            return s, found
    return None, NOTHING
