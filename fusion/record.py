"""What became of every measurement of one sensor in one run, in columns as narrow as the values allow."""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from itertools import chain

import numpy as np
from msgspec.structs import astuple

from .data import Audit
from .sensors.base import Innovation

MANY = 256


class Record:
    """An hour of Python objects would be hundreds of megabytes; of columns it is tens."""

    def __init__(self) -> None:
        self._waiting: list[Innovation] = []  # until there are enough of them to be turned into columns at once
        self._instants = array("i")
        self._rows = array("i")
        self._verdicts = array("b")
        self._landmarks = array("i")
        self._nis = array("d")
        self._thresholds = array("d")
        self._y = array("d")
        self._sigmas = array("d")

    def add(self, k: int, seen: Sequence[Innovation]) -> None:
        """Note the innovations of one reading at instant k."""
        self._waiting += seen
        self._instants.extend([k] * len(seen))
        if len(self._waiting) > MANY:
            self._write()

    def _write(self) -> None:
        if not self._waiting:
            return
        rows, verdicts, landmarks, nis, thresholds, y, sigmas, *_ = zip(*map(astuple, self._waiting), strict=True)
        self._waiting.clear()
        self._rows.extend(rows)
        self._verdicts.extend(verdicts)
        self._landmarks.extend(landmarks)
        self._nis.extend(nis)
        self._thresholds.extend(thresholds)
        self._y.extend(chain.from_iterable(y))
        self._sigmas.extend(chain.from_iterable(sigmas))

    def audit(self) -> Audit:
        """Return the record as columns: views, since a copy would hold everything twice for a moment."""
        self._write()
        n = max(len(self._rows), 1)
        return Audit(
            instant=np.frombuffer(self._instants, np.intc),
            row=np.frombuffer(self._rows, np.intc),
            verdict=np.frombuffer(self._verdicts, np.int8),
            landmark=np.frombuffer(self._landmarks, np.intc),
            nis=np.frombuffer(self._nis),
            threshold=np.frombuffer(self._thresholds),
            y=np.frombuffer(self._y).reshape(-1, len(self._y) // n or 1),
            sigma=np.frombuffer(self._sigmas).reshape(-1, len(self._sigmas) // n or 1),
        )
