"""What if a sensor were slower? Some of its readings are left out, and nothing else changes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from .data import Drive


def thinned(drive: Drive, rates: Mapping[str, float]) -> Drive:
    """Return the drive with at most `rates[sensor]` readings per second: the first of every period is kept.

    The instants stay, so that what-ifs are compared on the same grid as everything else.
    """
    measurements, instant = dict(drive.measurements), dict(drive.instant)
    for sensor, rate in rates.items():
        m = measurements[sensor]
        keep = np.flatnonzero(np.diff(np.floor(m.t * rate), prepend=-1.0) > 0)
        measurements[sensor], instant[sensor] = m.take(keep), instant[sensor][keep]
    return replace(drive, measurements=measurements, instant=instant)
