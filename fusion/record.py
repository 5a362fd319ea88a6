"""What became of every measurement of one sensor in one run, in columns as narrow as the values allow."""

from __future__ import annotations

from array import array
from collections.abc import Sequence

import numpy as np

from .data import Audit
from .sensors.base import Innovation


class Record:
    """An hour of Python objects would be hundreds of megabytes; of columns it is tens."""

    def __init__(self) -> None:
        self._width = 1
        self._places = array("i")  # instant, row, landmark
        self._verdicts = array("b")
        self._values = array("d")  # nis, threshold, y, sigma

    def add(self, k: int, seen: Sequence[Innovation]) -> None:
        """Note the innovations of one reading at instant k."""
        for row, verdict, landmark, nis, threshold, y, sigma, *_ in seen:
            self._places.extend((k, row, landmark))
            self._verdicts.append(verdict)
            self._values.extend((nis, threshold, *y, *sigma))
        if seen:
            self._width = len(seen[0].y)

    def audit(self) -> Audit:
        """Return the record as columns: views, since a copy would hold everything twice for a moment."""
        d = self._width
        places = np.frombuffer(self._places, np.intc).reshape(-1, 3)
        values = np.frombuffer(self._values).reshape(-1, 2 + 2 * d)
        return Audit(
            instant=places[:, 0],
            row=places[:, 1],
            verdict=np.frombuffer(self._verdicts, np.int8),
            landmark=places[:, 2],
            nis=values[:, 0],
            threshold=values[:, 1],
            y=values[:, 2 : 2 + d],
            sigma=values[:, 2 + d :],
        )
