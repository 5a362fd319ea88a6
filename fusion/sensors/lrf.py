"""Laser range finder: scans become lines (r, psi) in the base frame, lines are matched with a line map.

The paper freezes the map of its first scan (eq. 14). Here that is one mode of four: `first-scan` (frozen),
`consider` (its covariance counts, Schmidt-Kalman), `refine` (its lines are states), `grow` (new lines join).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, ClassVar, Literal, cast

import numpy as np

from .. import se2
from ..association import Association, Scan, associate
from ..data import VERDICTS, Array, Ints, MapLine, Measurements, Ragged, Stream
from ..ekf import JointBelief, PoseBelief
from ..gates import chi_square
from ..line_map import LineMap
from ..lines import Lines, LineSettings, extract_lines, to_base
from .base import Innovation, Model, SensorSettings, WheelMotion

MapMode = Literal["first-scan", "consider", "refine", "grow"]
UNMATCHED, AMBIGUOUS, NEW = (VERDICTS.index(v) for v in ("unmatched", "ambiguous", "new"))
SCANS_PER_BLOCK = 128  # line extraction is level-synchronous over this many scans (benchmarks: "lines per scan")
SAME_TURN, SAME_SHIFT = 0.6, 0.4  # rad, m: lines of neighbouring scans further apart are different walls
KNOTS = 5  # instants of a scan at which the wheels are asked where the robot was


class LrfSettings(SensorSettings, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """[lrf]: where the laser sits, how well it measures, how its map is treated."""

    x: float = 0.0  # m, laser on the base
    y: float = 0.0
    yaw_deg: float = 0.0
    flipped: bool = False  # mounted upside-down: beams run clockwise seen from above
    sigma_range: float = 0.02  # m
    sigma_angle_deg: float = 0.25
    range_scale: float = 1.0  # true range = scale * reading + offset
    range_offset: float = 0.0  # m
    range_max: float | None = None  # m, readings beyond are not used
    deskew: bool = True  # by time_increment and the wheels
    min_points: int = 6
    min_length: float = 0.3  # m
    floor_range: float = 0.002  # m: walls are not planes to less than this
    floor_angle_deg: float = 0.05
    map: MapMode = "grow"


class Lrf:
    """Reads LaserScan."""

    name: ClassVar[str] = "lrf"
    Settings: ClassVar[type[SensorSettings]] = LrfSettings
    reads: ClassVar[Mapping[str, tuple[str, ...]]] = {
        "sensor_msgs/msg/LaserScan": (
            "angle_min",
            "angle_increment",
            "time_increment",
            "range_min",
            "range_max",
            "ranges",
        ),
    }

    def measure(self, stream: Stream, settings: LrfSettings, wheels: WheelMotion, epoch_ns: int) -> Measurements:
        """Extract the lines of every scan, deskewed to the middle of the scan, in the base frame."""
        stamps: Array = (stream.t_ns - epoch_ns) * np.float64(1e-9) + settings.time_offset
        t = stamps.copy()
        parts: list[tuple[Ints, Lines]] = []
        for rows, columns in stream.blocks(*self.reads[stream.msgtype], rows=SCANS_PER_BLOCK):
            for group, scans in _equal_scans(columns):
                at = rows[group]
                lines, t[at] = _lines(scans, stamps[at], settings, wheels)
                parts.append((at, lines))
        return _collect(parts, t, settings, dict(stream.dropped))

    def heading(self, m: Measurements) -> tuple[Array, Array]:
        """Return times (n,) and headings (n,) [rad, unwrapped, up to a constant] by lines from scan to scan.

        A line of one scan and the line nearest to it in the next are the same wall; the median change of psi is
        the robot's turn. Where no line carries over, the turn is unknown and counted as none.
        """
        turn = np.zeros(len(m.t))
        for i in range(1, len(m.t)):
            a, b, c = m.first[i - 1], m.first[i], m.first[i + 1]
            turn[i] = _turn(m.z[a:b], m.z[b:c])
        return m.t, np.cumsum(turn)

    def model(self, settings: LrfSettings) -> LrfModel:
        """Return the laser's side of a new run."""
        return LrfModel(settings)


class LrfModel(Model):
    """The line map and its association inside one run."""

    def __init__(self, settings: LrfSettings) -> None:
        self.settings = settings
        self.map = LineMap()
        self.joint = settings.map != "first-scan"
        self._first_map: list[MapLine] = []
        self._gate = chi_square(settings.gate, 2)
        self._scan = 0
        self._last: Association | None = None

    def innovations(self, m: Measurements, i: int, belief: Any) -> list[Innovation]:
        """Associate the lines of scan i; each becomes one innovation with its verdict."""
        first, last = int(m.first[i]), int(m.first[i + 1])
        self._last = None
        if first == last:
            return []
        if len(self.map) == 0:
            return [_nothing(row, NEW, self._gate) for row in range(first, last)]
        scan = _scan(m, first, last)
        self._last = found = associate(scan, self.map, belief, self._gate)
        return [self._innovation(found, k, first + k, scan) for k in range(last - first)]

    def _innovation(self, found: Association, k: int, row: int, scan: Scan) -> Innovation:
        p, verdict = found.match[k], 0
        if p < 0:
            p = found.best[k]
            if p < 0 or not found.near[k]:
                grows = self.settings.map == "grow" and not found.near[k]
                return _nothing(row, NEW if grows else UNMATCHED, self._gate)
            verdict = AMBIGUOUS if found.ambiguous[k] else UNMATCHED
        pairs = found.pairs
        which = int(pairs.which[p])
        c, s, u = (float(a[p]) for a in (pairs.prediction.cos, pairs.prediction.sin, pairs.prediction.u))
        S, R = pairs.S[p], scan.R[k] * np.array([[1.0, pairs.flip[p]], [pairs.flip[p], 1.0]])
        columns: tuple[int, ...] = ()
        H_block: tuple[tuple[float, ...], ...] = ()
        if self.map.column[which] >= 0:
            columns = (int(self.map.column[which]), int(self.map.column[which]) + 1)
            H_block = ((1.0, u), (0.0, 1.0))
        else:
            H_line = np.array([[1.0, u], [0.0, 1.0]])
            R = R + H_line @ self.map.P[which] @ H_line.T
        return Innovation(
            row,
            verdict,
            int(self.map.ids[which]),
            float(pairs.d2[p]),
            self._gate,
            (float(pairs.y[p, 0]), float(pairs.y[p, 1])),
            (math.sqrt(S[0, 0]), math.sqrt(S[1, 1])),
            ((-c, -s, 0.0), (0.0, 0.0, -1.0)),
            ((float(R[0, 0]), float(R[0, 1])), (float(R[1, 0]), float(R[1, 1]))),
            columns,
            H_block,
        )

    def learn(self, m: Measurements, i: int, belief: Any) -> None:
        """Let matched extents grow, and add what is new: all of the first scan, later only in `grow`."""
        first, last = int(m.first[i]), int(m.first[i + 1])
        if first == last:
            return
        self._scan += 1
        scan = _scan(m, first, last)
        found = self._last
        if found is None:
            for k in range(last - first):
                self._add(scan, k, belief)
            self._first_map = self.map.lines(belief)
            return
        for k, p in enumerate(found.match):
            if p >= 0:
                self._extend(int(found.pairs.which[p]), float(found.pairs.lo[p]), float(found.pairs.hi[p]))
            elif self.settings.map == "grow" and not found.near[k]:
                self._add(scan, k, belief)

    def lines(self, belief: Any) -> tuple[list[MapLine], list[MapLine]]:
        """Return the map after the first scan and the map now."""
        return self._first_map, self.map.lines(belief)

    def _extend(self, which: int, lo: float, hi: float) -> None:
        self.map.lo[which] = min(self.map.lo[which], lo)
        self.map.hi[which] = max(self.map.hi[which], hi)
        self.map.hits[which] += 1
        self.map.seen[which] = self._scan

    def _add(self, scan: Scan, k: int, belief: PoseBelief | JointBelief) -> None:
        """New line from (r, psi): maths.md "new line"; its anchor is the middle of the segment."""
        r, psi = map(float, scan.z[k])
        beta = se2.wrap(psi + belief.theta)
        c, s = math.cos(beta), math.sin(beta)
        middle = 0.5 * float(scan.ends[k, 0] + scan.ends[k, 1])
        half = 0.5 * float(scan.ends[k, 1] - scan.ends[k, 0])
        anchor = np.array([belief.x + r * c - middle * s, belief.y + r * s + middle * c])
        dx, dy = belief.x - anchor[0], belief.y - anchor[1]
        u = dy * c - dx * s
        value = np.array([r + dx * c + dy * s, beta])
        G_pose = np.array([[c, s, u], [0.0, 0.0, 1.0]])
        G_z = np.array([[1.0, u], [0.0, 1.0]])
        noise = G_z @ scan.R[k] @ G_z.T
        column, P = -1, np.zeros((2, 2))
        if self.joint and isinstance(belief, JointBelief):
            G = np.zeros((2, belief.n))
            G[:, :3] = G_pose
            column = belief.augment(value, G, noise)
            if self.settings.map == "consider":
                belief.consider(np.array([column, column + 1]))
        else:
            P = G_pose @ belief.matrix() @ G_pose.T + noise
        self.map.append(anchor, value, P, column, (-half, half), self._scan)


def _scan(m: Measurements, first: int, last: int) -> Scan:
    return Scan(m.z[first:last], m.R[first:last], m.extra["ends"][first:last])


def _turn(before: Array, after: Array) -> float:
    """Median turn of the robot [rad] between two scans' lines (k, 2), each paired with its nearest."""
    if len(before) == 0 or len(after) == 0:
        return 0.0
    turn = se2.wrap_all(before[:, 1, None] - after[None, :, 1])
    shift = before[:, 0, None] - after[None, :, 0]
    cost = (turn / SAME_TURN) ** 2 + (shift / SAME_SHIFT) ** 2
    nearest = cost.argmin(axis=1)
    rows = np.arange(len(before))
    good = cost[rows, nearest] < 1.0
    return float(np.median(turn[rows, nearest][good])) if good.any() else 0.0


def _nothing(row: int, verdict: int, gate: float) -> Innovation:
    """Return an innovation without a prediction: nothing in the map was near."""
    nan = math.nan
    return Innovation(row, verdict, -1, nan, gate, (nan, nan), (nan, nan), (), ())


def _equal_scans(columns: dict[str, Any]) -> list[tuple[Ints, dict[str, Any]]]:
    """Split a block into groups of scans with equally many beams: (positions, columns with ranges (k, b))."""
    ranges = cast("Ragged", columns["ranges"])
    scalars = {k: v for k, v in columns.items() if k != "ranges"}
    matrix = ranges.matrix()
    if matrix is not None:
        return [(np.arange(len(ranges)), {**scalars, "ranges": matrix})]
    groups = []
    for beams in np.unique(ranges.lengths).tolist():
        at = np.flatnonzero(ranges.lengths == beams)
        rows = np.stack([ranges[i] for i in at.tolist()]) if beams else np.zeros((len(at), 0))
        groups.append((at, {**{k: v[at] for k, v in scalars.items()}, "ranges": rows}))
    return groups


def _lines(
    scans: dict[str, Any], stamps: Array, settings: LrfSettings, wheels: WheelMotion
) -> tuple[Lines, Array]:
    """Return the lines of k scans in the base frame and the instants they hold at."""
    beams = scans["ranges"].shape[1]
    index = np.arange(beams)
    angles = scans["angle_min"][:, None] + scans["angle_increment"][:, None] * index
    if settings.flipped:
        angles = -angles
    raw = scans["ranges"].astype(np.float64)
    far = np.minimum(scans["range_max"], settings.range_max or np.inf)[:, None]
    valid = np.isfinite(raw) & (raw >= scans["range_min"][:, None]) & (raw <= far) & (raw > 0.0)
    ranges = np.where(valid, settings.range_scale * raw + settings.range_offset, np.nan)
    mount = np.array([settings.x, settings.y, math.radians(settings.yaw_deg)])
    t, offsets = _deskew(scans["time_increment"].astype(np.float64), beams, stamps, mount, settings, wheels)
    lines = extract_lines(
        ranges,
        angles,
        LineSettings(
            sigma_range=settings.sigma_range,
            sigma_angle=math.radians(settings.sigma_angle_deg),
            min_points=settings.min_points,
            min_length=settings.min_length,
        ),
        offsets,
    )
    z, R_unit, ends = to_base(lines.z, lines.R_unit, lines.ends, *mount)
    return Lines(lines.first, z, R_unit, ends, lines.points, lines.chi2, lines.span), t


def _deskew(
    increment: Array, beams: int, stamps: Array, mount: Array, settings: LrfSettings, wheels: WheelMotion
) -> tuple[Array, Array | None]:
    """Return each scan's middle instant and each beam's pose seen from it, (n, b, 3) in the laser's frame.

    The wheels are asked at a few knots and the poses between are interpolated: over a quarter of a scan a
    robot's arc leaves its chord by micrometres.
    """
    if not settings.deskew or beams < 2 or not np.any(increment > 0.0):
        return stamps, None
    duration = np.clip(increment, 0.0, 1.0 / beams) * (beams - 1)
    middle = stamps + 0.5 * duration
    knots = np.linspace(0.0, 1.0, KNOTS)
    at = stamps[:, None] + duration[:, None] * knots
    base = wheels.relative(np.repeat(middle, KNOTS), at.ravel())
    laser = se2.compose(se2.inverse(mount), se2.compose(base, mount)).reshape(len(stamps), KNOTS, 3)
    share = np.linspace(0.0, KNOTS - 1.0, beams)
    low = np.minimum(share.astype(np.int64), KNOTS - 2)
    f = (share - low)[None, :, None]
    return middle, (1.0 - f) * laser[:, low] + f * laser[:, low + 1]


def _collect(
    parts: list[tuple[Ints, Lines]], t: Array, settings: LrfSettings, dropped: dict[str, int]
) -> Measurements:
    """Put the lines of all blocks into time order."""
    counts = np.zeros(len(t), dtype=np.int64)
    for at, lines in parts:
        counts[at] = np.diff(lines.first)
    first = np.concatenate(([0], np.cumsum(counts)))
    total = int(first[-1])
    z, R_unit = np.empty((total, 2)), np.empty((total, 2, 2))
    ends = np.empty((total, 2))
    for at, lines in parts:
        per_scan = np.diff(lines.first)
        rows = np.repeat(first[at] - lines.first[:-1], per_scan) + np.arange(len(lines.z))
        z[rows], R_unit[rows], ends[rows] = lines.z, lines.R_unit, lines.ends
    floor = np.diag([settings.floor_range**2, math.radians(settings.floor_angle_deg) ** 2])
    return Measurements(t, first, z, R_unit, settings.sigma_range, floor, {"ends": ends}, dropped)
