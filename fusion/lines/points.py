"""Points of chosen scans, read from the log again: only large maps need them, and only those of some scans."""

from __future__ import annotations

from itertools import chain

import msgspec
import numpy as np
from msgspec.structs import replace

from locfuse.fusion.data import Array, Block, Ints, Stream
from locfuse.fusion.sensor import WheelMotion

from .scans import Laser, equal_scans, points_in_base

SCANS_PER_BLOCK = 256  # line extraction is level-synchronous over this many scans (benchmarks: "lines per scan")


class ScanPoints(msgspec.Struct, frozen=True, eq=False, weakref=True):
    """The points of a stream of scans; reading i is row `rows[i]` of the stream."""

    stream: Stream
    fields: tuple[str, ...]
    stamps: Array  # (all rows,) s since the drive's epoch, as read
    laser: Laser
    wheels: WheelMotion
    rows: Ints  # (n,)
    _last: list[Block] = msgspec.field(default_factory=list)  # the last block that was used, one at most

    @property
    def origin(self) -> tuple[float, float]:
        """Where the laser sits on the base, x, y [m]."""
        return float(self.laser.mount[0]), float(self.laser.mount[1])

    def take(self, readings: Ints) -> ScanPoints:
        """Return the points of the readings at these positions."""
        return replace(self, rows=self.rows[readings])

    def moved(self, t_from: Array, t_to: Array) -> Array:
        """Return the poses (n, 3) at t_to relative to those at t_from, (n,) s each, by the wheels."""
        return self.wheels.relative(t_from, t_to)

    def read(self, readings: Ints) -> list[Array]:
        """Return the points (k, 2) [m, base frame] of each reading, deskewed like its lines.

        In the order of the beams; beams without a return are left out.
        """
        rows = self.rows[readings]
        wanted = np.unique(rows)
        found: dict[int, Array] = {}
        blocks = self.stream.blocks(*self.fields, rows=SCANS_PER_BLOCK)
        for block in chain(tuple(self._last), blocks):  # who asks again asks for scans soon after
            at, columns = block
            if not np.isin(at, wanted).any():
                continue
            self._last[:] = [block]
            for group, scans in equal_scans(columns):
                some = np.flatnonzero(np.isin(at[group], wanted))
                if not len(some):
                    continue
                chosen = at[group][some]
                few = {name: column[some] for name, column in scans.items()}
                points, _ = points_in_base(few, self.stamps[chosen], self.laser, self.wheels)
                found.update(
                    (row, p[np.isfinite(p[:, 0])]) for row, p in zip(chosen.tolist(), points, strict=True)
                )
            if len(found) == len(wanted):
                break
        return [found.get(row, np.zeros((0, 2))) for row in rows.tolist()]
