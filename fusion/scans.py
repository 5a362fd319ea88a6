"""From laser scans to lines in the base frame: one laser's readings, deskewed to the middle of each scan."""

from __future__ import annotations

from typing import Any, NamedTuple, cast

import numpy as np

from . import se2
from .data import Array, Ints, Ragged
from .lines import Lines, LineSettings, extract_lines, to_base
from .sensors.base import WheelMotion
from .side_by_side import blocks, misfit, nearest, turn_of

MAX_BEAMS = 100_000  # of one scan: no 2D laser has more
BEAMS_AT_ONCE = 1 << 19  # lines are extracted from scans of at most so many beams together: memory is bounded
KNOTS = 5  # instants of a scan at which the wheels are asked where the robot was
SAME_TURN, SAME_SHIFT = 0.6, 0.4  # rad, m: lines of neighbouring scans further apart are different walls


class Laser(NamedTuple):
    """Where the laser sits and how its readings become ranges."""

    mount: Array  # (3,) x, y [m], yaw [rad] on the base
    flipped: bool  # mounted upside-down: beams run clockwise seen from above
    scale: float  # true range = scale * reading + offset
    offset: float  # m
    range_max: float | None  # m, readings beyond are not used
    deskew: bool
    lines: LineSettings


def equal_scans(columns: dict[str, Any]) -> list[tuple[Ints, dict[str, Any]]]:
    """Split a block into groups of scans with equally many beams: (positions, columns with ranges (k, b)).

    Groups hold at most BEAMS_AT_ONCE beams; scans of more than MAX_BEAMS are left out.
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
    """Count the scans of a block that have more than MAX_BEAMS beams."""
    return int((cast("Ragged", columns["ranges"]).lengths > MAX_BEAMS).sum())


def lines_in_base(scans: dict[str, Any], stamps: Array, laser: Laser, wheels: WheelMotion) -> tuple[Lines, Array]:
    """Return the lines of k scans in the base frame, and the instants (k,) [s] at which they hold."""
    beams = scans["ranges"].shape[1]
    angles = scans["angle_min"][:, None] + scans["angle_increment"][:, None] * np.arange(beams)
    if laser.flipped:
        angles = -angles
    raw = scans["ranges"].astype(np.float64)
    far = np.minimum(scans["range_max"], laser.range_max or np.inf)[:, None]
    valid = np.isfinite(raw) & (raw >= scans["range_min"][:, None]) & (raw <= far) & (raw > 0.0)
    ranges = np.where(valid, laser.scale * raw + laser.offset, np.nan)
    t, offsets = deskew(scans["time_increment"].astype(np.float64), beams, stamps, laser, wheels)
    lines = extract_lines(ranges, angles, laser.lines, offsets)
    x, y, yaw = laser.mount.tolist()
    z, R_unit, ends = to_base(lines.z, lines.R_unit, lines.ends, x, y, yaw)
    return Lines(lines.first, z, R_unit, ends, lines.points, lines.chi2, lines.span), t


def deskew(
    increment: Array, beams: int, stamps: Array, laser: Laser, wheels: WheelMotion
) -> tuple[Array, Array | None]:
    """Return each scan's middle instant and each beam's pose seen from it, (n, b, 3) in the laser's frame.

    The wheels are asked at a few knots and the poses between are interpolated: over a quarter of a scan a
    robot's arc leaves its chord by micrometres.
    """
    if not laser.deskew or beams < 2 or not np.any(increment > 0.0):
        return stamps, None
    duration = np.clip(increment, 0.0, 1.0 / beams) * (beams - 1)
    middle = stamps + 0.5 * duration
    at = stamps[:, None] + duration[:, None] * np.linspace(0.0, 1.0, KNOTS)
    base = wheels.relative(np.repeat(middle, KNOTS), at.ravel())
    poses = se2.compose(se2.inverse(laser.mount), se2.compose(base, laser.mount))
    poses = poses.reshape(len(stamps), KNOTS, 3)
    share = np.linspace(0.0, KNOTS - 1.0, beams)
    low = np.minimum(share.astype(np.int64), KNOTS - 2)
    f = (share - low)[None, :, None]
    return middle, (1.0 - f) * poses[:, low] + f * poses[:, low + 1]


def in_order(parts: list[tuple[Ints, Lines]], n: int) -> tuple[Ints, Array, Array, Array]:
    """Put the lines of all blocks into reading order: first (n + 1,), z, R_unit, ends."""
    counts = np.zeros(n, dtype=np.int64)
    for at, lines in parts:
        counts[at] = np.diff(lines.first)
    first = np.concatenate(([0], np.cumsum(counts)))
    total = int(first[-1])
    z, R_unit, ends = np.empty((total, 2)), np.empty((total, 2, 2)), np.empty((total, 2))
    for at, lines in parts:
        per_scan = np.diff(lines.first)
        rows = np.repeat(first[at] - lines.first[:-1], per_scan) + np.arange(len(lines.z))
        z[rows], R_unit[rows], ends[rows] = lines.z, lines.R_unit, lines.ends
    return first, z, R_unit, ends


def turns(first: Ints, z: Array, variance: Array) -> Array:
    """Return the robot's turn [rad] since the scan before, (n,), by lines z (m, 2) that `first` (n + 1,) owns.

    A line of one scan and the line nearest to it in the next are the same wall; the median change of psi, weighed
    by the `variance` (m,) of either's psi, is the turn: short walls say little, and a wrong pair cannot say much.
    Where no line carries over, the turn is unknown and counted as none.
    """
    out = np.zeros(len(first) - 1)
    scans = np.arange(len(out))
    for at, a, b in blocks(first, scans[:-1], scans[1:]):
        turn = turn_of(z[a.row, 1], z[b.row, 1])
        shift = z[a.row, 0][:, :, None] - z[b.row, 0][:, None, :]
        turned, cost, j = nearest(turn, misfit(turn, shift, (SAME_TURN, SAME_SHIFT), a, b))
        both = variance[a.row] + variance[np.take_along_axis(b.row, j, 1)]
        out[at + 1] = _medians(turned, np.where(cost < 1.0, 1.0 / both, 0.0))
    return out


def _medians(values: Array, weights: Array) -> Array:
    """Return the weighted median of each row (k, w), 0 where nothing has weight.

    Where half the weight lies between the middles of two values' weights, the median is between the values alike:
    equal weights give the ordinary median, two values their weighted mean.
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
