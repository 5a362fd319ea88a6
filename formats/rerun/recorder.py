"""What a recording will hold, noted on the log's clock, and how many rows each of its entities must have."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from locfuse.fusion.data import Array, Drive, Ints

from .deferred import made, rr

if TYPE_CHECKING:
    from rerun import RecordingStream


DRIVE, TIME, STEP = "drive", "log time", "step"  # s since the start, the log's own clock, instant
PLAUSIBLE_DATE_NS = 10**17  # 1973: a smaller clock counts from the robot's start and is shown as a duration


class Rows(NamedTuple):
    """Component columns of one entity over time."""

    path: str
    times: list[Any]
    columns: tuple[Any, ...]
    lengths: Sequence[int] | Ints | None  # cuts the columns into ragged rows

    def send(self, stream: RecordingStream) -> None:
        """Hand the rows to Rerun."""
        groups = made(self.columns)
        cut = self.lengths
        parts = [part for group in groups for part in (group if cut is None else group.partition(cut))]
        stream.send_columns(self.path, made(self.times), parts, strict=True)


class Fixed(NamedTuple):
    """What holds at all times, such as colours."""

    path: str
    archetypes: tuple[Any, ...]

    def send(self, stream: RecordingStream) -> None:
        """Hand it to Rerun."""
        stream.log(self.path, *made(self.archetypes), static=True, strict=True)


class Recorder:
    """Notes columns on all timelines: seconds since the start, the log's time, the instant of the drive then."""

    def __init__(self, drive: Drive) -> None:
        self.rows: Counter[str] = Counter()  # entity -> rows noted, for reading back
        self._noted: deque[Rows | Fixed] = deque()
        self._epoch_ns = drive.epoch_ns
        self._instants = drive.t

    def send(self, path: str, t: Array, *columns: Any, lengths: Sequence[int] | Ints | None = None) -> None:
        """Note component columns with one row at each t (n,) s; `lengths` (n,) cuts them into ragged rows."""
        if len(t) == 0:
            return
        self._noted.append(Rows(path, self._times(t), columns, lengths))
        self.rows[path] += len(t)

    def static(self, path: str, *archetypes: Any) -> None:
        """Note what holds at all times."""
        self._noted.append(Fixed(path, archetypes))

    def write(self, stream: RecordingStream) -> None:
        """Hand everything noted so far to Rerun, and let go of it."""
        while self._noted:
            self._noted.popleft().send(stream)

    def nanoseconds(self, t: Array) -> Ints:
        """Return t (n,) s since the drive's epoch as the log's own time."""
        return self._epoch_ns + np.rint(t * 1e9).astype(np.int64)

    def step(self, t: Array) -> Ints:
        """Return the last instant at or before each t (n,)."""
        return np.maximum(np.searchsorted(self._instants, t, side="right") - 1, 0)

    def _times(self, t: Array) -> list[Any]:
        ns = self.nanoseconds(t)
        dated = self._epoch_ns >= PLAUSIBLE_DATE_NS
        when = (
            rr.TimeColumn(TIME, timestamp=ns.astype("datetime64[ns]"))
            if dated
            else rr.TimeColumn(TIME, duration=ns.astype("timedelta64[ns]"))
        )
        since = rr.TimeColumn(DRIVE, duration=np.rint(t * 1e9).astype("timedelta64[ns]"))
        return [since, when, rr.TimeColumn(STEP, sequence=self.step(t))]


def part(name: str) -> str:
    """Return a name as one part of an entity path: what Rerun would read as grammar is escaped."""
    return "".join(c if c.isalnum() or c in "_-." else f"\\{c}" for c in name)
