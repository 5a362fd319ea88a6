"""Publisher check: one topic to which two nodes write in turn, by their frames or by what they measure."""

from __future__ import annotations

from collections import Counter
from typing import Any, cast

import numpy as np

from locfuse.fusion.data import Array, Ragged, Stream
from locfuse.fusion.sensors.lrf import Lrf
from locfuse.fusion.streams import in_turn, parts_of

from .finding import Finding

PUBLISHERS = "publishers"  # code of the finding on a topic to which two publishers write
MIN_CHANGES = 10  # from one publisher to the other
READ_SCANS = 200  # first scans that are compared
MAX_ANGLE_RAD = 0.01  # rad: scans whose first beams differ by less see in the same directions


def of_publishers(name: str, stream: Stream) -> list[Finding]:
    """Return a finding for each topic of a role whose messages come from two publishers in turn."""
    found = []
    for part in parts_of(stream):
        frames = np.array(getattr(part, "frames", ()))
        two = Counter(frames.tolist()).most_common(2)
        changes = int((frames[1:] != frames[:-1]).sum())
        if len(two) == 2 and changes >= max(two[1][1], MIN_CHANGES):
            how = f"mixes messages of two frames in turn, {two[0][0]} and {two[1][0]}"
        elif in_turn(_ranges(part)):
            how = "has scans that are like the one before the last, not like the last"
        else:
            continue
        words = f"{part.topic} {how}: two publishers. Record each on a topic of its own"
        found.append(Finding(name, PUBLISHERS, words, severe=True))
    return found


def _ranges(stream: Stream) -> Array:
    """Return the ranges (n, k) [m] of a laser's first scans; no rows if these see in several directions.

    Those of a laser that sends each turn in parts do.
    """
    columns: dict[str, Any] = {}
    if {"ranges", "angle_min"} <= {*Lrf.reads.get(stream.msgtype, ())}:
        columns = next((c for _, c in stream.blocks("ranges", "angle_min", rows=READ_SCANS)), columns)
    equal = cast("Ragged", columns["ranges"]).matrix() if columns else None
    if equal is None or np.ptp(columns["angle_min"]) > MAX_ANGLE_RAD:
        return np.zeros((0, 1))
    return equal.astype(np.float64)
