"""Lines of laser scans in the base frame, deskewed to the middle of each scan."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple, cast

import numpy as np
from msgspec.structs import replace

from locfuse.fusion import se2
from locfuse.fusion.data import Array, Ints, Mask, Ragged, totals
from locfuse.fusion.se2 import wrap_all
from locfuse.fusion.sensor import WheelMotion
from locfuse.fusion.statistics import MAD_OF_NORMAL
from locfuse.fusion.streams import in_turn

from .extract import (
    Lines,
    LineSettings,
    extract_lines,
    in_base,
    motion_of,
    noise_of,
    of_rows,
    rows_in_base,
    rows_of,
)

# of a LaserScan
SCAN_FIELDS = ("angle_min", "angle_increment", "time_increment", "range_min", "range_max", "ranges")
LARGEST_INCREMENT_S = 1e9
MAX_SWEEP_PERIODS = 1.2  # periods of the scans that a sweep can last, with uneven stamps
CELLS_AT_ONCE = 1 << 18  # pairs of lines compared at once, to save memory
# m: limits of a valid range, without 0 and Inf
LEAST_RANGE_M, LARGEST_RANGE_M = np.nextafter(0.0, 1.0), np.finfo(np.float64).max
MAX_BEAMS = 100_000  # largest number of beams of a scan: no 2D laser has more
COMPARED_SCANS = 200  # first scans of a topic that are compared with each other
MAX_SAME_ANGLE_RAD = 0.01  # scans whose first beams differ by less see in the same directions
MAX_LINES = 500  # largest number of lines of a scan: an update with n lines takes 32 n^2 bytes and n^3 time
BEAMS_AT_ONCE = 1 << 19  # beams processed at once, to save memory
KNOTS_PER_SCAN = 5  # times within a scan at which the robot's pose is computed
MIN_MOVED_M, MIN_TURNED_RAD = 0.02, math.radians(1.0)  # after more motion, equal scans are copies
STANDING_MPS, STANDING_RADPS = 0.005, 0.005  # largest drift of the odometry at standstill
MAX_SAME_TURN_RAD, MAX_SAME_SHIFT_M = 0.6, 0.4  # largest differences of the line of one wall in consecutive scans


class Padded(NamedTuple):
    """Row numbers of the lines of k readings as a table (k, w), padded for readings with fewer lines."""

    row: Ints  # (k, w) row in Measurements.z; 0 in padding
    there: Mask  # (k, w) False in padding


def blocks(first: Ints, before: Ints, after: Ints) -> Iterator[tuple[Ints, Padded, Padded]]:
    """Yield (indices (k,), lines of readings before[indices], lines of readings after[indices]) block by block."""
    counts = np.diff(first)
    if not len(before) or not first[-1]:
        return
    widest = int(counts.max())
    for at in np.array_split(np.arange(len(before)), len(before) * widest**2 // CELLS_AT_ONCE + 1):
        yield at, _padded(first, counts, before[at]), _padded(first, counts, after[at])


def _padded(first: Ints, counts: Ints, readings: Ints) -> Padded:
    nth = np.arange(max(int(counts[readings].max()), 1))
    there = nth < counts[readings, None]
    return Padded(np.where(there, first[readings, None] + nth, 0), there)


def misfit(turn: Array, shift: Array, scale: tuple[float, float], a: Padded, b: Padded) -> Array:
    """Return the normalised squared distance of each line of a from each line of b, (k, w_a, w_b).

    Two lines with a value below 1 may match; in padding the value is inf. `turn` [rad] and `shift` [m] are the
    differences of the lines, `scale` (rad, m) the largest differences of matching lines.
    """
    cost = (turn / scale[0]) ** 2 + (shift / scale[1]) ** 2
    return np.where(a.there[:, :, None] & b.there[:, None, :], cost, np.inf)


def turn_of(a: Array, b: Array) -> Array:
    """Return the angle [rad] from each line of b (k, w_b) to each line of a (k, w_a), (k, w_a, w_b)."""
    return wrap_all(a[:, :, None] - b[:, None, :])


def nearest(values: Array, cost: Array) -> tuple[Array, Array, Ints]:
    """Return for each line of a its nearest line in b: element of `values`, cost, and index, (k, w_a) each.

    `values` and `cost` (k, w_a, w_b) are those of pairs of lines; the nearest line has the lowest cost.
    """
    j = cost.argmin(axis=2)
    at = j[:, :, None]
    return np.take_along_axis(values, at, 2)[:, :, 0], np.take_along_axis(cost, at, 2)[:, :, 0], j


class Laser(NamedTuple):
    """Laser mount, and settings that correct the readings."""

    mount: Array  # (3,) x, y [m], yaw [rad] on the base
    flipped: bool  # mounted upside-down: beams run clockwise seen from above
    scale: float  # true range = scale * reading + offset
    offset: float  # m
    range_max: float | None  # m, larger ranges are not used; None: by the scans
    deskew: bool
    lines: LineSettings
    backward: bool = False  # whether the last beam of a scan is measured first, for any sign of time_increment
    period: float = math.inf  # s, of the scans: no sweep is longer
    blocked: Mask | None = None  # (b,) beams that see the robot itself

    def at_rate(self, t_ns: Ints) -> Laser:
        """Return the laser with the period of scans at times t_ns (n,)."""
        return self._replace(period=scan_period(t_ns))


def scan_period(t_ns: Ints) -> float:
    """Return the median time [s] between scans at times t_ns (n,); inf for a single scan."""
    steps = np.diff(t_ns)
    return 1e-9 * float(np.median(steps[steps > 0])) if (steps > 0).any() else math.inf


def equal_scans(columns: dict[str, Any]) -> list[tuple[Ints, dict[str, Any]]]:
    """Split a block of scans into groups with equal numbers of beams b; return a list of groups.

    A group is (indices (k,) of its scans in the block, columns of these scans, with `ranges` as a matrix (k, b)).
    It has at most BEAMS_AT_ONCE beams; scans of more than MAX_BEAMS are left out.
    """
    ranges = cast("Ragged", columns["ranges"])
    scalars = {k: v for k, v in columns.items() if k != "ranges"}
    matrix = ranges.matrix()
    if matrix is not None and matrix.size <= BEAMS_AT_ONCE and matrix.shape[1] <= MAX_BEAMS:
        return [(np.arange(len(ranges)), {**scalars, "ranges": matrix})]
    groups = []
    for beams in np.unique(ranges.lengths[ranges.lengths <= MAX_BEAMS]).tolist():
        same = np.flatnonzero(ranges.lengths == beams)
        for at in np.array_split(same, len(same) * beams // BEAMS_AT_ONCE + 1):
            rows = np.stack([ranges[i] for i in at.tolist()]) if beams else np.zeros((len(at), 0))
            groups.append((at, {**{k: v[at] for k, v in scalars.items()}, "ranges": rows}))
    return groups


def too_many_beams(columns: dict[str, Any]) -> int:
    """Count the scans of a block with more than MAX_BEAMS beams."""
    return int((cast("Ragged", columns["ranges"]).lengths > MAX_BEAMS).sum())


def repeats(ranges: Ragged, before: bytes, least: int) -> tuple[Mask, bytes]:
    """Return flags (k,) of the scans that equal the scan before, and the bytes of the last scan.

    `before` are the bytes of the scan before the first of these k scans. A scan with fewer than `least` returns
    never counts as equal.
    """
    same = np.zeros(len(ranges), bool)
    for i in range(len(ranges)):
        data = ranges[i].tobytes()
        same[i] = data == before and int((np.isfinite(ranges[i]) & (ranges[i] > 0.0)).sum()) >= least
        before = data
    return same, before


def frozen(
    same: Mask, t: Array, wheels: WheelMotion, least_m: float = 0.0, turned_rad: float = MIN_TURNED_RAD
) -> Mask:
    """Return flags (n,) of the scans that are copies of an earlier scan although the robot has moved since then.

    t (n,) [s] are their times, `same` (n,) flags of scans equal to the scan before. A noise-free simulated laser
    gives equal scans at standstill, so drift of the odometry at standstill does not count as motion. Nor does a
    way of `least_m`, or a turn of `turned_rad`, that the sensor does not resolve.
    """
    first = np.maximum.accumulate(np.where(same, 0, np.arange(len(same))))  # first of consecutive equal scans
    at = np.flatnonzero(same)
    if not len(at):
        return same
    u, dt = wheels.relative(t[first[at]], t[at]), t[at] - t[first[at]]
    moved = np.hypot(u[:, 0], u[:, 1]) > MIN_MOVED_M + least_m + STANDING_MPS * dt
    moved |= np.abs(u[:, 2]) > turned_rad + STANDING_RADPS * dt
    return same & np.isin(first, first[at[moved]])


def lines_in_base(scans: dict[str, Any], stamps: Array, laser: Laser, wheels: WheelMotion) -> tuple[Lines, Array]:
    """Extract the lines of k scans in the base frame, and the times (k,) [s] to which they are deskewed."""
    ranges, angles = returns(scans, laser)
    increment = scans["time_increment"].astype(np.float64)
    t, offsets = deskew(increment, ranges.shape[1], stamps, laser, wheels)
    motion = None if offsets is None else motion_of(laser.mount)
    lines = extract_lines(ranges, angles, laser.lines, offsets, motion=motion)
    x, y, yaw = laser.mount.tolist()
    z, R_unit, ends = of_rows(rows_in_base(rows_of(lines.z, lines.R_unit, lines.ends), x, y, yaw))
    sweep: Array = np.zeros((len(z), 2, 0), np.float32)  # no shared errors without deskewing
    if offsets is not None:
        scan = np.repeat(np.arange(len(t)), np.diff(lines.first))
        by_base = in_base(lines.sweep, lines.z, laser.mount)
        sweep = noise_of(by_base, scan, t, sweep_time(increment, ranges.shape[1], laser.period), wheels)
    return replace(lines, z=z, R_unit=R_unit, ends=ends, sweep=sweep), t


def points_in_base(scans: dict[str, Any], stamps: Array, laser: Laser, wheels: WheelMotion) -> tuple[Array, Array]:
    """Return the points (k, b, 2) [m] of k scans in the base frame, and times (k,) [s].

    A beam without a return gives NaN.
    """
    ranges, angles = returns(scans, laser)
    t, offsets = deskew(scans["time_increment"].astype(np.float64), ranges.shape[1], stamps, laser, wheels)
    points = np.stack((ranges * np.cos(angles), ranges * np.sin(angles)), axis=-1)
    if offsets is not None:
        points = se2.transform(offsets, points)
    return se2.transform(laser.mount, points), t


def from_two_lasers(scans: Mapping[str, Any]) -> bool:
    """Return whether scans in the order of the log come from two lasers in turn, by their ranges.

    Scans that begin in several directions are those of one laser that sends each turn in parts.
    """
    if np.ptp(scans["angle_min"]) > MAX_SAME_ANGLE_RAD:
        return False
    ranges = scans["ranges"].matrix()
    return ranges is not None and in_turn(ranges[:COMPARED_SCANS].astype(np.float64))


def limited(scans: Mapping[str, Any]) -> Mask:
    """Return flags (k,) of the scans with valid limits: range_max is above range_min."""
    return np.asarray(np.asarray(scans["range_max"]) > np.asarray(scans["range_min"]))  # False for NaN


def limits(scans: Mapping[str, Any]) -> tuple[Array, Array]:
    """Return the smallest and largest valid range (k,) [m] of each scan.

    Without valid limits in a scan, all positive finite ranges are valid.
    """
    near, far = (np.asarray(scans[name], np.float64) for name in ("range_min", "range_max"))
    known = limited(scans)
    least = np.where(known, np.maximum(near, LEAST_RANGE_M), LEAST_RANGE_M)
    return least, np.where(known, np.minimum(far, LARGEST_RANGE_M), LARGEST_RANGE_M)


def returns(scans: dict[str, Any], laser: Laser) -> tuple[Array, Array]:
    """Return ranges [m] (NaN without a return) and angles [rad, laser frame] of k scans, (k, b) each.

    The beams are in the order of measurement.
    """
    taken = np.s_[::-1] if laser.backward else np.s_[:]
    beams = np.arange(scans["ranges"].shape[1])[taken]
    angles = scans["angle_min"][:, None] + scans["angle_increment"][:, None] * beams
    if laser.flipped:
        angles = -angles
    ranges = scans["ranges"][:, taken].astype(np.float64)  # a copy
    near, far = limits(scans)
    far = far if laser.range_max is None else np.full_like(far, laser.range_max)
    invalid = ~((near[:, None] <= ranges) & (ranges <= far[:, None]))  # also true for NaN
    if laser.blocked is not None and len(laser.blocked) == ranges.shape[1]:
        invalid |= laser.blocked[taken]
    ranges *= laser.scale
    ranges += laser.offset
    ranges[invalid] = np.nan
    return ranges, angles


def deskew(
    increment: Array, beams: int, stamps: Array, laser: Laser, wheels: WheelMotion
) -> tuple[Array, Array | None]:
    """Return the middle time of each scan (n,), and the laser pose of each beam relative to this time, (n, b, 3).

    The poses are in the laser frame at the middle time; None without deskewing. Wheel odometry gives them at
    KNOTS_PER_SCAN times; between these they are interpolated linearly, with an error of some micrometres.
    """
    if not laser.deskew or beams < 2 or not np.any(np.abs(increment) > 0.0):
        return stamps, None
    duration = sweep_time(increment, beams, laser.period)
    middle = stamps + 0.5 * duration
    at = stamps[:, None] + duration[:, None] * np.linspace(0.0, 1.0, KNOTS_PER_SCAN)
    base = wheels.relative(np.repeat(middle, KNOTS_PER_SCAN), at.ravel())
    poses = se2.compose(se2.inverse(laser.mount), se2.compose(base, laser.mount))
    poses = poses.reshape(len(stamps), KNOTS_PER_SCAN, 3)
    share = np.linspace(0.0, KNOTS_PER_SCAN - 1.0, beams)
    low = np.minimum(share.astype(np.int64), KNOTS_PER_SCAN - 2)
    f = (share - low)[None, :, None]
    return middle, (1.0 - f) * poses[:, low] + f * poses[:, low + 1]


def sweep_time(increment: Array, beams: int, period: float) -> Array:
    """Return the time from the first to the last beam, (n,) s, at most 1 s; 0 if the increment is NaN.

    `period` [s] is that of the scans. A longer sweep is impossible: the increment is in another unit (ms, us), so
    a power of 10 is divided out, or it is the time of the whole scan. The sign is not used, as `Laser.backward` is
    the order of the beams; but a negative increment that is too long means "unknown": 0.
    """
    unknown = -increment * beams > MAX_SWEEP_PERIODS * period
    each = np.fmin(np.where(unknown, 0.0, np.fmax(np.abs(increment), 0.0)), LARGEST_INCREMENT_S)
    times = np.maximum(each * beams / (MAX_SWEEP_PERIODS * period), 1.0)
    whole = (each > 0.5 * period) & (each < MAX_SWEEP_PERIODS * period) & (times > 1.0)
    right = each / np.where(whole, beams, 10.0 ** np.ceil(np.log10(times)))
    return np.fmin(right, 1.0 / beams) * (beams - 1)


class Gathered:
    """Lines of a log, collected block by block."""

    def __init__(self) -> None:
        self._at: list[Ints] = []
        self._counts: list[Ints] = []
        self._z, self._R_unit, self._ends = [np.empty((0, 2))], [np.empty((0, 2, 2))], [np.empty((0, 2))]
        self._sweep: list[Array] = []
        self.curved = self.straight = 0  # number of walls left out as curved, and number of lines
        self.two_sources = False  # whether the first scans come from two lasers in turn
        self.giants = self.crowded = 0  # unused scans: over MAX_BEAMS beams; over MAX_LINES lines

    def add(self, at: Ints, lines: Lines) -> None:
        """Add the lines of the readings with indices `at` (k,)."""
        counts = np.diff(lines.first)
        kept: slice | Mask = np.s_[:]
        crowded = counts > MAX_LINES
        if crowded.any():
            kept = np.repeat(~crowded, counts)
            counts = np.where(crowded, 0, counts)
            self.crowded += int(crowded.sum())
        self.curved, self.straight = self.curved + int(lines.curved.sum()), self.straight + int(counts.sum())
        self._at.append(at)
        self._counts.append(counts)
        self._z.append(lines.z[kept])
        self._R_unit.append(lines.R_unit[kept])
        self._ends.append(lines.ends[kept])
        self._sweep.append(lines.sweep[kept])

    def in_order(self, n: int) -> tuple[Ints, Array, Array, Array, Array]:
        """Return the lines of n readings in order: first (n + 1,), z, R_unit, ends, sweep.

        Reading i has the rows first[i]:first[i + 1]. The collected parts are freed.
        """
        at, counts = (np.concatenate([np.empty(0, np.int64), *pieces]) for pieces in (self._at, self._counts))
        of_reading = np.zeros(n, dtype=np.int64)
        of_reading[at] = counts
        first = totals(of_reading)
        rows = None
        if (np.diff(at) < 0).any():
            rows = np.repeat(first[at] - np.cumsum(counts) + counts, counts) + np.arange(first[-1])
        # pieces without shared errors get zeros
        widest = max([piece.shape[2] for piece in self._sweep], default=0)
        wide: list[Array] = [p if p.shape[2] else np.zeros((*p.shape[:2], widest), p.dtype) for p in self._sweep]
        self._sweep = wide or [np.empty((0, 2, 0), np.float32)]
        columns = self._z, self._R_unit, self._ends, self._sweep
        z, R_unit, ends, sweep = (_joined(pieces, rows) for pieces in columns)
        return first, z, R_unit, ends, sweep


def _joined(pieces: list[Array], rows: Ints | None) -> Array:
    """Join arrays into one, and clear the list `pieces` to save memory.

    Line k of the joined array moves to row `rows[k]`, (m,); None: the order stays.
    """
    whole = np.concatenate(pieces)
    pieces.clear()
    if rows is None:
        return whole
    ordered = np.empty_like(whole)
    ordered[rows] = whole
    return ordered


def turns(first: Ints, z: Array, variance: Array) -> Array:
    """Estimate the robot's turn [rad] between the scan before and each scan, (n,), from lines z (m, 2) of n scans.

    The lines of scan i begin at row first[i]. Each line is paired with the nearest line of the next scan. The turn
    is the median change of psi, weighted by the `variance` (m,) of psi, so that short walls and wrong pairs have
    little effect. Without pairs the turn is 0.
    """
    out = np.zeros(len(first) - 1)
    scans = np.arange(len(out))
    for at, a, b in blocks(first, scans[:-1], scans[1:]):
        turn = turn_of(z[a.row, 1], z[b.row, 1])
        shift = z[a.row, 0][:, :, None] - z[b.row, 0][:, None, :]
        turned, cost, j = nearest(turn, misfit(turn, shift, (MAX_SAME_TURN_RAD, MAX_SAME_SHIFT_M), a, b))
        both = variance[a.row] + variance[np.take_along_axis(b.row, j, 1)]
        out[at + 1] = _medians(turned, np.where(cost < 1.0, 1.0 / both, 0.0))
    return out


def _medians(values: Array, weights: Array) -> Array:
    """Return the weighted median of each row (k, w); 0 if all weights of a row are zero.

    The median is interpolated between values by cumulative weight: equal weights give the ordinary median, and two
    values give their weighted mean.
    """
    order = np.argsort(np.where(weights > 0.0, values, np.inf), axis=1)
    values, weights = np.take_along_axis(values, order, 1), np.take_along_axis(weights, order, 1)
    middle = np.cumsum(weights, axis=1) - 0.5 * weights
    half = 0.5 * weights.sum(axis=1)
    above = np.minimum((middle < half[:, None]).sum(axis=1), weights.shape[1] - 1)
    below = np.maximum(above - 1, 0)
    rows = np.arange(len(values))
    low, high = middle[rows, below], middle[rows, above]
    share = np.divide(half - low, high - low, out=np.ones_like(half), where=high > low)
    found = values[rows, below] + share * (values[rows, above] - values[rows, below])
    return np.where(half > 0.0, found, 0.0)


# ---- unevenness of walls ----  The angle between two walls does not depend on the pose. If it changes by more
# than the noise of the fits, the walls are not flat (rough plaster, door frames). This gives the least noise of
# each line: 0 in a simulated room, 0.5° in an old corridor.

LAG_SCANS = 20  # distance in scans of two compared lines of a wall, to see another part of the wall
MAX_SIGMA_RAD = math.radians(0.6)  # largest standard deviation of the angle of a used line
# largest differences of a wall from its position predicted by wheel odometry
MAX_WALL_TURN_RAD, MAX_WALL_OFFSET_M = 0.3, 0.3
MIN_PAIRS = 150  # least number of pairs of walls
MIN_MISFIT_RATIO = 1.2  # median change / its noise, above which walls are uneven
CHI_SQUARE_MEDIAN = 0.455  # median of a chi-square distribution with one degree of freedom
OFFSET_PER_ANGLE_M = 1.3  # m per rad: 8 mm with 0.35 degrees


def wall_floor(
    t: Array, first: Ints, z: Array, variance: Array, wheels: WheelMotion, sweep: Array | None = None
) -> tuple[float, float]:
    """Return the standard deviations of r [m] and psi [rad] caused by the unevenness of walls.

    They are (0, 0) for flat walls, or too few lines. z (m, 2) are the lines of scans at times t (n,), those of
    scan i from row first[i] on. `variance` (m,) is that of psi by the fit [rad^2]. `sweep` (m, k) is the effect
    [rad] on psi of wheel slip within a scan, which its lines share (lines.extract).
    """
    change, noise = _changes(t, first, z, variance, wheels, np.zeros((len(z), 0)) if sweep is None else sweep)
    least = MAD_OF_NORMAL * MIN_MISFIT_RATIO
    if len(change) < MIN_PAIRS or float(np.median(np.abs(change) / np.sqrt(noise))) < least:
        return 0.0, 0.0
    low, high = 0.0, math.radians(2.0)
    for _ in range(30):  # bisection: median of change^2 / variance = CHI_SQUARE_MEDIAN
        floor = 0.5 * (low + high)
        if np.median(change**2 / (noise + 4.0 * floor**2)) > CHI_SQUARE_MEDIAN:
            low = floor
        else:
            high = floor
    return float(OFFSET_PER_ANGLE_M * floor), float(floor)


def line_process_noise(uneven: Array) -> Array:
    """Return the process noise (2,) per scan of a line on an uneven wall: variances [m^2, rad^2].

    The error by unevenness, of variance `uneven` (2,), is constant while the same part of a wall is seen, so it
    must not average out. It is modelled as a random walk of the line with the variance 2 `uneven` over LAG_SCANS
    scans.
    """
    return 2.0 * uneven / LAG_SCANS


def _changes(
    t: Array, first: Ints, z: Array, variance: Array, wheels: WheelMotion, sweep: Array
) -> tuple[Array, Array]:
    """Return the changes [rad] of the angle between two walls over LAG_SCANS scans, for many pairs of walls.

    Also return the variances [rad^2] of these changes by line fits and wheel slip. The arguments are those of
    `wall_floor`.
    """
    exact = variance < MAX_SIGMA_RAD**2
    first = totals(exact)[first]  # from here on, only lines with an exact angle are used
    z, variance, sweep = z[exact], variance[exact], sweep[exact]
    several = np.diff(first) >= 2
    before = (
        np.flatnonzero(several[:-LAG_SCANS] & several[LAG_SCANS:]) if len(t) > LAG_SCANS else np.zeros(0, np.int64)
    )
    motion = wheels.relative(t[before], t[before + LAG_SCANS])
    change, noise = [np.zeros(0)], [np.zeros(0)]
    for at, a, b in blocks(first, before, before + LAG_SCANS):
        x, y, theta = motion[at].T[:, :, None]
        r, psi = z[a.row].transpose(2, 0, 1)
        shift = (r - x * np.cos(psi) - y * np.sin(psi))[:, :, None] - z[b.row, 0][:, None, :]
        turn = turn_of(psi - theta, z[b.row, 1])
        cost = misfit(turn, shift, (MAX_WALL_TURN_RAD, MAX_WALL_OFFSET_M), a, b)
        turned, least, j = nearest(turn, cost)
        mutual = np.take_along_axis(cost.argmin(axis=1), j, 1) == np.arange(j.shape[1])
        scan, i = np.nonzero((least < 1.0) & mutual)
        one, other = a.row[scan, i], b.row[scan, j[scan, i]]
        both = variance[one] + variance[other]
        slip = sum((np.diff(sweep[rows], axis=0) ** 2).sum(axis=1) for rows in (one, other))
        same_scan = np.diff(scan) == 0
        change.append(np.diff(turned[scan, i])[same_scan])
        noise.append((both[1:] + both[:-1] + slip)[same_scan])
    return np.concatenate(change), np.concatenate(noise)
