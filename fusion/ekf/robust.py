"""Outliers that are kept but trusted less: an adaptive R instead of a refusal.

A reading beyond the gate is refused by default. Where a sensor's errors have heavy tails, refusing loses the
information that the heading did jump; inflating R until the reading lies on the gate keeps what it still says
(the weight of Huber's estimator at that point).
"""

from __future__ import annotations

import math

from msgspec.structs import replace

from locfuse.fusion.data import VERDICTS
from locfuse.fusion.sensor import Innovation

GATE = VERDICTS.index("gate")


def inflated(seen: Innovation) -> Innovation:
    """Return a refused scalar innovation accepted with the R that puts it on its gate; others as they are."""
    if seen.verdict != GATE or len(seen.y) != 1 or not math.isfinite(seen.nis) or seen.threshold <= 0.0:
        return seen
    (r,), S = seen.R[0], seen.sigma[0] ** 2
    needed = seen.y[0] ** 2 / seen.threshold
    R = r + needed - S
    return replace(seen, verdict=0, nis=seen.threshold, sigma=(math.sqrt(needed),), R=((R,),))
