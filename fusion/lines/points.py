"""Points of chosen scans, read from the log again: only large maps need them, and only those of some scans."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import chain
from typing import Any, TypeVar

import msgspec
import numpy as np
from msgspec.structs import replace

from locfuse.fusion.data import Array, Block, Ints, Stream
from locfuse.fusion.sensor import WheelMotion

from .scans import Laser, equal_scans, limited, limits, points_in_base

T = TypeVar("T")

MIN_REPEATS = 20  # of the longest range of a log: fewer may be chance, and draw nothing
NEAR = 0.99  # of the longest range: where the ranges of the same wall would lie
CROWD = 3  # times as many readings of the longest range itself as near it: no wall is so exact
SCANS_PER_BLOCK = 256  # line extraction is level-synchronous over this many scans (benchmarks: "lines per scan")


class Longest:
    """The longest range of a stream of scans, and how often it is read."""

    def __init__(self) -> None:
        self.value = 0.0  # m
        self.count = 0  # of readings of exactly this
        self._near = 0  # of readings up to a hundredth shorter
        self._read = 0
        self._scans = self._unlimited = 0  # scans; those whose limits the driver did not fill in
        self._limits = (0.0, 0.0)  # m: range_min and range_max of one of these

    def add(self, scans: Mapping[str, Any]) -> None:
        """Count the ranges (k, b) [m] of k scans that lie within their limits."""
        ranges, far = scans["ranges"], limits(scans)[1]
        if not ranges.size:
            return
        unknown = np.flatnonzero(~limited(scans))
        self._scans, self._unlimited = self._scans + len(far), self._unlimited + len(unknown)
        if len(unknown):
            self._limits = float(scans["range_min"][unknown[0]]), float(scans["range_max"][unknown[0]])
        self._read += ranges.size
        longest = float(ranges.max())
        if not longest <= far.min():  # NaN, Inf, or ranges beyond range_max: no wall is there
            ranges = np.where(ranges <= far[:, None], ranges, 0.0)
            longest = float(ranges.max())
        if longest < NEAR * self.value or longest <= 0.0:
            return
        if longest > self.value:
            self._near = self._near + self.count if self.value >= NEAR * longest else 0
            self.value, self.count = longest, 0
        equal = int(np.count_nonzero(ranges == self.value))
        self.count += equal
        self._near += int(np.count_nonzero(ranges >= NEAR * self.value)) - equal

    @property
    def no_return(self) -> float | None:
        """The range [m] that means no return; None if the longest range is a wall's."""
        repeated = self.count >= MIN_REPEATS and self.count > CROWD * self._near
        return self.value if repeated else None

    @property
    def notes(self) -> tuple[str, ...]:
        """The notes on ranges that were read as no return, and on limits that are not filled in."""
        return (
            *((self._word(),) if self.no_return is not None else ()),
            *((self._open(),) if self._unlimited else ()),
        )

    def _open(self) -> str:
        near, far = self._limits
        return (
            f"range_max is {far:g} m and range_min {near:g} m in {self._unlimited} of {self._scans} scans: these "
            "limits are not filled in, and every finite range above 0 is used. If the laser sees less far, set "
            "lrf.range_max in m"
        )

    def _word(self) -> str:
        share = self.count / self._read
        return (
            f"{share:.{0 if share > 0.02 else 1}%} of its ranges are exactly {self.value:g} m, the longest: "
            f"read as no return (to keep them: --set lrf.range_max={np.ceil(self.value):g})"
        )


def left_out(laser: Laser, read: Callable[[Laser, Longest], T]) -> tuple[T, Laser, tuple[str, ...]]:
    """Read scans; if their longest range means "no return", read them again without it; return laser and notes.

    Not where `laser` says how far it sees: then the user has decided. `read` shows all ranges to what it is given.
    """
    longest = Longest()
    found = read(laser, longest)
    if laser.range_max is not None:
        return found, laser, ()
    if longest.no_return is not None:
        laser = laser._replace(range_max=float(np.nextafter(longest.no_return, 0.0)))
        found = read(laser, Longest())
    return found, laser, longest.notes


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
    def mount(self) -> Array:
        """Where the laser sits on the base, (3,): x, y [m], yaw [rad]."""
        return self.laser.mount

    def take(self, readings: Ints) -> ScanPoints:
        """Return the points of the readings at these positions."""
        return replace(self, rows=self.rows[readings])

    def mounted(self, mount: Array) -> ScanPoints:
        """Return the points as seen by a laser that sits elsewhere, (3,)."""
        return replace(self, laser=self.laser._replace(mount=mount))

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
