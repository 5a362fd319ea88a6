"""What happened when, as texts beside the map: rest, lost, loops closed, refused in a row, labelled faults."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from locfuse.fusion.data import FAULT, LOST, REFUSED, Event

from .deferred import rr
from .recorder import Recorder, part

EVENTS = "events"
LEVELS = {LOST: "ERROR", FAULT: "WARN", REFUSED: "WARN"}  # what asks for attention first; the rest is INFO


def draw_events(to: Recorder, events: Sequence[Event]) -> None:
    """Send each event where it begins, and where it ends if it lasted; one entity for each kind."""
    for kind in dict.fromkeys(e.kind for e in events):
        some = [line for e in events if e.kind == kind for line in _lines(e)]
        some.sort()
        t = np.array([at for at, _ in some])
        texts = [text for _, text in some]
        level = [LEVELS.get(kind, "INFO")] * len(some)
        to.send(f"{EVENTS}/{part(kind)}", t, rr.TextLog.columns(text=texts, level=level))


def _lines(event: Event) -> list[tuple[float, str]]:
    who = f"{event.configuration}: " if event.configuration else ""
    begin = (event.start, f"{event.kind}: {who}{event.words}")
    if event.end <= event.start:
        return [begin]
    return [begin, (event.end, f"{event.kind} ends: {who}{event.words}")]
