"""Publisher check: one topic to which two nodes write in turn, by their frames or by what they measure."""

from __future__ import annotations

from collections import Counter

import numpy as np

from locfuse.fusion.data import Stream
from locfuse.fusion.streams import parts_of

from .finding import Finding

PUBLISHERS = "publishers"  # code of the finding on a topic to which two publishers write
MIN_CHANGES = 10  # from one publisher to the other


def of_publishers(name: str, stream: Stream, two_sources: bool = False) -> list[Finding]:
    """Return a finding for each topic of a role whose messages come from two publishers in turn.

    `two_sources`: the values of the readings show it (Measurements.two_sources).
    """
    found = []
    for part in parts_of(stream):
        frames = np.array(getattr(part, "frames", ()))
        two = Counter(frames.tolist()).most_common(2)
        changes = int((frames[1:] != frames[:-1]).sum())
        if len(two) == 2 and changes >= max(two[1][1], MIN_CHANGES):
            how = f"mixes messages of two frames in turn, {two[0][0]} and {two[1][0]}"
        elif two_sources:
            how = "has scans that are like the one before the last, not like the last"
        else:
            continue
        words = f"{part.topic} {how}: two publishers. Record each on a topic of its own"
        found.append(Finding(name, PUBLISHERS, words, severe=True))
    return found
