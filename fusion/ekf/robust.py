"""Outliers that are kept with less weight: an adaptive R instead of a rejection.

A reading beyond the gate is refused by default. Where a sensor's errors have heavy tails, refusing loses the
information that the heading did jump; inflating R until the reading lies on the gate keeps what it still says
(the weight of Huber's estimator at that point).
"""

from __future__ import annotations

import math

from locfuse.fusion.data import VERDICTS
from locfuse.fusion.kernels.ekf import Innovation, State

GATE = VERDICTS.index("gate")


def inflate(seen: Innovation, state: State) -> None:
    """Accept a rejected innovation of one number with the R that puts it on its gate; leave others unchanged."""
    if seen.verdict != GATE or seen.numbers != 1 or not math.isfinite(seen.nis) or seen.threshold <= 0.0:
        return
    needed = seen.y[0] ** 2 / seen.threshold
    state.loosen_row(seen.first, needed - seen.sigma[0] ** 2)
    seen.verdict, seen.nis, seen.sigma = 0, seen.threshold, (math.sqrt(needed),)
