"""A Rerun stream on the log's clock: columns of a drive, and static data."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import rerun as rr

from locfuse.fusion.data import Array, Drive, Ints

DRIVE, TIME, STEP = "drive", "log time", "step"  # s since the start, the log's own clock, update time
MIN_DATE_NS = 10**17  # 1973: a smaller clock counts from the robot's start and is shown as a duration


class TimelineRecorder:
    """Writes columns on all timelines: seconds since the start, log time, update time."""

    def __init__(self, stream: rr.RecordingStream, drive: Drive) -> None:
        self._stream, self._epoch_ns, self._updates = stream, drive.epoch_ns, drive.t

    def send(self, path: str, t: Array, *columns: Any, lengths: Sequence[int] | Ints | None = None) -> None:
        """Write component columns with one row at each t (n,) s; `lengths` (n,) splits them into ragged rows."""
        if len(t) == 0:
            return
        parts = [part for group in columns for part in (group if lengths is None else group.partition(lengths))]
        since_ns = np.rint(t * 1e9).astype(np.int64)
        ns = self._epoch_ns + since_ns
        dated = self._epoch_ns >= MIN_DATE_NS
        when = {"timestamp": ns.astype("datetime64[ns]")} if dated else {"duration": ns.astype("timedelta64[ns]")}
        step = np.maximum(np.searchsorted(self._updates, t, side="right") - 1, 0)
        times = [
            rr.TimeColumn(DRIVE, duration=since_ns.astype("timedelta64[ns]")),
            rr.TimeColumn(TIME, **when),
            rr.TimeColumn(STEP, sequence=step),
        ]
        self._stream.send_columns(path, times, parts, strict=True)

    def static(self, path: str, *archetypes: Any) -> None:
        """Write static data, such as colours."""
        self._stream.log(path, *archetypes, static=True, strict=True)


def part(name: str) -> str:
    """Return a name as one part of an entity path, escaped for Rerun's grammar."""
    return "".join(c if c.isalnum() or c in "_-." else f"\\{c}" for c in name)
