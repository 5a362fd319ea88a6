"""What became of every measurement of one sensor in one run, as flat floats until the run ends."""

from __future__ import annotations

from array import array
from collections.abc import Sequence

import numpy as np

from .data import Audit
from .sensors.base import Innovation

FIXED = 6  # numbers before y and sigma


class Record:
    """An hour of Python objects would be hundreds of megabytes; of floats it is tens."""

    def __init__(self) -> None:
        self._width = 1
        self._values = array("d")

    def add(self, k: int, seen: Sequence[Innovation]) -> None:
        """Note the innovations of one reading at instant k."""
        extend = self._values.extend
        for row, verdict, landmark, nis, threshold, y, sigma, *_ in seen:
            extend((k, row, verdict, landmark, nis, threshold, *y, *sigma))
        if seen:
            self._width = len(seen[0].y)

    def audit(self) -> Audit:
        """Return the record as columns."""
        d = self._width
        values = np.frombuffer(self._values).reshape(-1, FIXED + 2 * d)
        instant, row, landmark = (values[:, i].astype(np.int64) for i in (0, 1, 3))
        return Audit(
            instant=instant,
            row=row,
            verdict=values[:, 2].astype(np.int8),
            landmark=landmark,
            nis=values[:, 4].copy(),  # a view would keep everything alive
            threshold=values[:, 5].copy(),
            y=values[:, FIXED : FIXED + d].copy(),
            sigma=values[:, FIXED + d :].copy(),
        )
