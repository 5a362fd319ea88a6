"""Points of laser scans, read again from the log when needed, since most runs need those of a few scans only."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any, TypeVar

import msgspec
import numpy as np
from msgspec.structs import replace

from locfuse.fusion.data import Array, Block, Ints, Mask, Stream
from locfuse.fusion.sensor import WheelMotion

from .scans import Laser, equal_scans, limited, limits, points_in_base

T = TypeVar("T")

# the longest range of a log means "no return" if it occurs at least MIN_REPEATS times, and more than CROWD_FACTOR
# times as often as other ranges above NEAR_SHARE times the longest: a wall gives different ranges
MIN_REPEATS, NEAR_SHARE, CROWD_FACTOR = 20, 0.99, 3
SCANS_PER_BLOCK = 256  # scans processed at once (benchmarks: "lines per scan")


# a beam that sees the robot: largest range, largest difference from its first range, m; least share within that
MAX_BODY_M, SAME_M, MIN_SAME_SHARE = 0.6, 0.05, 0.95
# least number of scans; largest share of such beams; largest median share of equal ranges of the other beams
MIN_BODY_SCANS, MAX_BLOCKED_SHARE, MAX_USUAL_SHARE = 50, 0.5, 0.3


class Longest:
    """Longest range in a stream of scans, which may mean "no return", and the beams that see the robot itself."""

    def __init__(self) -> None:
        self._first: Array = np.zeros(0)  # (b,) m, first range of each beam; NaN without one
        self._seen: Ints = np.zeros(0, np.int64)  # (b,) number of ranges of each beam
        self._same: Ints = np.zeros(0, np.int64)  # (b,) number of those near its first range
        self.value = 0.0  # m
        self.count = 0  # number of ranges equal to `value`
        self._near = 0  # number of other ranges of at least NEAR_SHARE * value
        self._read = 0
        self._scans = self._unlimited = 0  # number of scans; number of scans without valid limits
        self._limits = (0.0, 0.0)  # m: range_min and range_max of one scan without valid limits

    def add(self, scans: Mapping[str, Any]) -> None:
        """Count the ranges (k, b) [m] of k scans that are within the limits of their scan."""
        ranges, far = scans["ranges"], limits(scans)[1]
        if not ranges.size:
            return
        self._add_beams(ranges)
        unknown = np.flatnonzero(~limited(scans))
        self._scans, self._unlimited = self._scans + len(far), self._unlimited + len(unknown)
        if len(unknown):
            self._limits = float(scans["range_min"][unknown[0]]), float(scans["range_max"][unknown[0]])
        self._read += ranges.size
        longest = float(ranges.max())
        if not longest <= far.min():  # NaN, Inf, or ranges above range_max do not come from a wall
            ranges = np.where(ranges <= far[:, None], ranges, 0.0)
            longest = float(ranges.max())
        if longest < NEAR_SHARE * self.value or longest <= 0.0:
            return
        if longest > self.value:
            self._near = self._near + self.count if self.value >= NEAR_SHARE * longest else 0
            self.value, self.count = longest, 0
        equal = int(np.count_nonzero(ranges == self.value))
        self.count += equal
        self._near += int(np.count_nonzero(ranges >= NEAR_SHARE * self.value)) - equal

    def _add_beams(self, ranges: Array) -> None:
        """Count the ranges (k, b) [m] of each beam that are near its first range."""
        if not len(self._first):
            b = ranges.shape[1]
            self._first = np.full(b, np.nan)
            self._seen, self._same = np.zeros(b, np.int64), np.zeros(b, np.int64)
        if len(self._first) != ranges.shape[1]:
            return
        valid = np.isfinite(ranges) & (ranges > 0.0)
        new = np.flatnonzero(np.isnan(self._first) & valid.any(axis=0))
        self._first[new] = ranges[valid[:, new].argmax(axis=0), new]
        self._seen += valid.sum(axis=0)
        with np.errstate(invalid="ignore"):
            self._same += (np.abs(ranges - self._first) < SAME_M).sum(axis=0)

    @property
    def blocked(self) -> Mask | None:
        """Return the mask (b,) of beams that see the robot: always the same near range while others change."""
        if not self._scans >= MIN_BODY_SCANS:
            return None
        share = self._same / np.maximum(self._seen, 1)
        body = (self._first < MAX_BODY_M) & (share >= MIN_SAME_SHARE) & (self._seen > 0.5 * self._scans)
        others = share[~body & (self._seen > 0)]
        if not body.any() or body.mean() > MAX_BLOCKED_SHARE or not len(others):
            return None
        mask: Mask = body
        return mask if float(np.median(others)) < MAX_USUAL_SHARE else None

    @property
    def no_return(self) -> float | None:
        """Return the range [m] that means "no return"; None if the longest range comes from a wall."""
        repeated = self.count >= MIN_REPEATS and self.count > CROWD_FACTOR * self._near
        return self.value if repeated else None

    def laser(self, laser: Laser) -> Laser:
        """Return the laser without the beams that see the robot, and without the range that means "no return"."""
        if self.blocked is not None:
            laser = laser._replace(blocked=self.blocked)
        if laser.range_max is None and self.no_return is not None:
            laser = laser._replace(range_max=float(np.nextafter(self.no_return, 0.0)))
        return laser

    def notes(self, laser: Laser) -> tuple[str, ...]:
        """Return notes for the user: on unused beams and ranges of a laser, and on invalid limits."""
        words = []
        if (blocked := self.blocked) is not None:
            near = float(np.median(self._first[blocked]))
            words.append(
                f"{blocked.sum()} of {len(blocked)} beams read {near:.2f} m in all scans while others change: "
                "they see the robot itself and are left out"
            )
        if laser.range_max is not None:
            return tuple(words)
        if self.no_return is not None:
            share = self.count / self._read
            words.append(
                f"{share:.{0 if share > 0.02 else 1}%} of its ranges are exactly {self.value:g} m, the longest: "
                f"read as no return (to keep them: --set lrf.range_max={np.ceil(self.value):g})"
            )
        if self._unlimited:
            near, far = self._limits
            words.append(
                f"range_max is {far:g} m and range_min {near:g} m in {self._unlimited} of {self._scans} scans: "
                "these limits are not filled in, and every finite range above 0 is used. If the laser sees less "
                "far, set lrf.range_max in m"
            )
        return tuple(words)


def left_out(laser: Laser, read: Callable[[Laser, Longest], T]) -> tuple[T, Laser, tuple[str, ...]]:
    """Read the scans of a log, without ranges that mean "no return"; return the output of `read`, laser and notes.

    `read` reads the scans and adds all their ranges to its `Longest`. If the longest range means "no return", the
    scans are read again with a `range_max` below this range, and the returned laser has this `range_max`. If the
    user configured `range_max`, all ranges up to it are used. Beams that see the robot itself are left out too.
    """
    longest = Longest()
    found = read(laser, longest)
    understood = longest.laser(laser)
    if understood is not laser:
        found = read(understood, Longest())
    return found, understood, longest.notes(laser)


def understood(laser: Laser, some: Iterable[Mapping[str, Any]]) -> Laser:
    """Return the laser without beams and ranges that show no walls, by some scans of equal numbers of beams."""
    longest = Longest()
    for scans in some:
        longest.add(scans)
    return longest.laser(laser)


class ScanPoints(msgspec.Struct, frozen=True, eq=False, weakref=True):
    """Points of n selected scans of a stream, read from the log when needed.

    Reading i is the message `rows[i]` of the stream.
    """

    stream: Stream
    fields: tuple[str, ...]
    stamps: Array  # (all rows,) s since the drive's epoch, as in the log
    laser: Laser
    wheels: WheelMotion
    rows: Ints  # (n,)
    _last: list[Block] = []  # the block used last; at most one
    _next: list[Iterator[Block]] = []  # the blocks after it; at most one iterator

    @property
    def mount(self) -> Array:
        """Return the laser mount on the base, (3,): x, y [m], yaw [rad]."""
        return self.laser.mount

    def take(self, readings: Ints) -> ScanPoints:
        """Return the points of the readings with indices (k,)."""
        return replace(self, rows=self.rows[readings])

    def mounted(self, mount: Array) -> ScanPoints:
        """Return the same points for another laser mount (3,)."""
        return replace(self, laser=self.laser._replace(mount=mount))

    def moved(self, t_from: Array, t_to: Array) -> Array:
        """Return the poses (n, 3) at times t_to relative to those at t_from, (n,) [s] each, by wheel odometry."""
        return self.wheels.relative(t_from, t_to)

    def read(self, readings: Ints) -> list[Array]:
        """Read the points (k, 2) [m, base frame] of each reading, deskewed like the lines of the reading.

        Points are in beam order; beams without a return are left out.
        """
        rows = self.rows[readings]
        wanted = np.unique(rows)
        found: dict[int, Array] = {}
        for block in self._blocks(int(wanted[0]) if len(wanted) else 0):
            at, columns = block
            if not np.isin(at, wanted).any():
                continue
            self._last[:] = [block]
            for group, scans in equal_scans(columns):
                some = np.flatnonzero(np.isin(at[group], wanted))
                if not len(some):
                    continue
                chosen = at[group][some]
                columns_of = {name: column[some] for name, column in scans.items()}
                points, _ = points_in_base(columns_of, self.stamps[chosen], self.laser, self.wheels)
                found |= {row: p[np.isfinite(p[:, 0])] for row, p in zip(chosen.tolist(), points, strict=True)}
            if len(found) == len(wanted):
                break
        return [found.get(row, np.zeros((0, 2))) for row in rows.tolist()]

    def _blocks(self, first: int) -> Iterator[Block]:
        """Yield the block used last, the blocks after it unless row `first` is earlier, and then all blocks.

        Callers often read the same or later scans next. A pass from the beginning would unpack the file up to
        these scans.
        """
        if last := tuple(self._last):
            yield last[0]
            if first >= last[0][0][0]:
                for block in self._next[0]:  # "yield from" would close this iterator together with the generator
                    yield block
        self._next[:] = [self.stream.blocks(*self.fields, rows=SCANS_PER_BLOCK)]
        for block in self._next[0]:
            yield block
