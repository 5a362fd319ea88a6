"""How much of a result is chance: the same drive after changes that should not matter.

Gates, association and map building decide by thresholds. A reading close to one falls on the other side after the
smallest change, and what comes later differs too. So a drive is fused again with times moved by a microsecond and
a few readings missing: what differs between such drives, no figure may claim.

Wheels and truth stay as they are: what a lost count rolled is in the next one, and the truth is no part of the
filter.
"""

from __future__ import annotations

import numpy as np
from msgspec.structs import replace

from locfuse.fusion.data import Array, Drive, Measurements
from locfuse.fusion.measure import recut
from locfuse.fusion.robot import Robot

MOVED_S = 1e-6  # s: times are moved by at most this, evenly distributed
DROPPED_SHARE = 0.01  # of every sensor's readings


def jittered(drive: Drive, robot: Robot, seed: int) -> Drive:
    """Return the drive with other times and fewer readings; equal for equal seeds."""
    first, last = float(drive.wheels.t[0]), float(drive.wheels.t[-1])
    found = {
        name: _jittered(m, first, last, np.random.default_rng([seed, k]))
        for k, (name, m) in enumerate(drive.measurements.items())
    }
    return recut(drive, robot, found)


def _jittered(m: Measurements, first: float, last: float, rng: np.random.Generator) -> Measurements:
    """Return the readings that are kept at random, in the order of their moved times within first and last [s]."""
    n = len(m.t)
    t: Array = np.clip(m.t + MOVED_S * rng.uniform(-1.0, 1.0, n), first, last)
    stays = np.flatnonzero(rng.random(n) >= DROPPED_SHARE)
    stays = stays[np.argsort(t[stays], kind="stable")]
    return replace(m.take(stays), t=t[stays])
