"""A recording stream that knows the log's clock, and remembers how many rows each entity must have."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ..fusion.data import Array, Drive, Ints

if TYPE_CHECKING:
    import rerun as rr

TIME, STEP = "log time", "step"
PLAUSIBLE_DATE_NS = 10**17  # 1973: a smaller clock counts from the robot's start and is shown as a duration


class Recorder:
    """Sends columns on both timelines: the log's time, and the step (instant of the drive) in force then."""

    def __init__(self, stream: rr.RecordingStream, drive: Drive) -> None:
        self.stream = stream
        self.rows: Counter[str] = Counter()  # entity -> rows sent, for reading back
        self._epoch_ns = drive.epoch_ns
        self._instants = drive.t

    def send(self, path: str, t: Array, *columns: Any, lengths: Sequence[int] | Ints | None = None) -> None:
        """Send component columns with one row at each t (n,) s; `lengths` (n,) cuts them into ragged rows."""
        if len(t) == 0:
            return
        parts = [part for group in columns for part in (group if lengths is None else group.partition(lengths))]
        self.stream.send_columns(path, self._times(t), parts, strict=True)
        self.rows[path] += len(t)

    def static(self, path: str, *archetypes: Any) -> None:
        """Send what holds at all times, such as colours."""
        self.stream.log(path, *archetypes, static=True, strict=True)

    def nanoseconds(self, t: Array) -> Ints:
        """Return t (n,) s since the drive's epoch as the log's own time."""
        return self._epoch_ns + np.rint(t * 1e9).astype(np.int64)

    def step(self, t: Array) -> Ints:
        """Return the last instant at or before each t (n,)."""
        return np.maximum(np.searchsorted(self._instants, t, side="right") - 1, 0)

    def _times(self, t: Array) -> list[rr.TimeColumn]:
        import rerun as rr

        ns = self.nanoseconds(t)
        dated = self._epoch_ns >= PLAUSIBLE_DATE_NS
        when = (
            rr.TimeColumn(TIME, timestamp=ns.astype("datetime64[ns]"))
            if dated
            else rr.TimeColumn(TIME, duration=ns.astype("timedelta64[ns]"))
        )
        return [when, rr.TimeColumn(STEP, sequence=self.step(t))]


def part(name: str) -> str:
    """Return a name as one part of an entity path: what Rerun would read as grammar is escaped."""
    return "".join(c if c.isalnum() or c in "_-." else f"\\{c}" for c in name)
