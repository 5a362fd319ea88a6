"""Columns and results: the values that flow from a log to a report.

Columns, not objects: an hour of log holds 10^5..10^6 readings, so readings, measurements and estimates are
NumPy columns. Times are integer nanoseconds (`t_ns`) at the border and float seconds since `Drive.epoch_ns`
inside; angles are radians; frames are REP-103 (x forward, y left, counter-clockwise).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from typing import Any, NamedTuple, Protocol

import msgspec
import numpy as np
from msgspec import field
from numpy.typing import NDArray

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Counts = NDArray[np.int32] | Ints  # small numbers, of which an hour holds many

END_OF_TIME = 2**62  # ns: no time beyond it is believed, and two within it differ by what 64 bits hold


class LocfuseError(Exception):
    """A file or a setting cannot be used: one line with what, where, the numbers, and what to try next.

    `str()` is the whole line, "role: message hint". Whoever needs a part of it finds it here as a value.
    """

    exit_code = 1
    typed: str | None = None  # the line in the words of the command line, where `str()` speaks Python

    def __init__(self, message: str, *, role: str = "", fixes: Sequence[str] = (), hint: str = "") -> None:
        self.role = role  # what it is about: wheels, truth, a sensor; "" for a file or the command line
        self.message = message  # what, where, the numbers
        self.fixes = tuple(fixes)  # "table.key=value": settings that help, with nothing left to fill in
        self.hint = hint  # what to try next
        super().__init__(f"{role}: {self.sentence}" if role else self.sentence)

    @property
    def sentence(self) -> str:
        """Message and hint, for a place that already names the role."""
        return f"{self.message} {self.hint}" if self.hint else self.message

    @property
    def brief(self) -> str:
        """The message alone, for a place that prints the fixes itself."""
        return self.message.rstrip(".:;?") if self.hint else self.message


class UsageError(LocfuseError):
    """The command line asks for something impossible (a flag, a `--set`, no such path)."""

    exit_code = 2


class Ragged(msgspec.Struct, frozen=True):
    """A column whose rows differ in length, such as LaserScan.ranges: row i is values[first[i]:first[i+1]]."""

    values: NDArray[Any]  # (total,)
    first: Ints  # (n + 1,)

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.first) - 1

    def __getitem__(self, i: int) -> NDArray[Any]:
        """Return row i as a view."""
        return self.values[self.first[i] : self.first[i + 1]]

    @property
    def lengths(self) -> Ints:
        """Length of every row, (n,)."""
        return np.diff(self.first)

    def matrix(self) -> NDArray[Any] | None:
        """Return the rows as one (n, m) view where all have the same length m, else None."""
        lengths = self.lengths
        if len(lengths) == 0 or (lengths != lengths[0]).any():
            return None
        return self.values[self.first[0] : self.first[-1]].reshape(len(lengths), int(lengths[0]))


# What a column of readings may be: numbers (n,) or (n, k); Ragged; or one Python value per row
# (str; tuple[str, ...] for string[]; bytes-like for uint8[] payloads such as images).
Column = NDArray[Any] | Ragged | list[Any]
Block = tuple[Ints, dict[str, Column]]


class Stream(Protocol):
    """One topic of a log, with repaired times; its fields come as columns on request.

    Row order is the log's order (log time, topic, sequence) and `t_ns` never decreases.
    """

    @property
    def topic(self) -> str:
        """Where the messages were published."""

    @property
    def msgtype(self) -> str:
        """Their type, such as sensor_msgs/msg/LaserScan."""

    @property
    def frame_id(self) -> str:
        """The frame of the first message's header, "" without one."""

    @property
    def t_ns(self) -> Ints:
        """The times of the readings, (n,) ns, never decreasing."""

    @property
    def dropped(self) -> Mapping[str, int]:
        """Messages of this topic that gave no row, by reason."""

    def columns(self, *fields: str) -> dict[str, Column]:
        """Return whole columns by dotted field path ("magnetic_field.x"), each with n rows."""

    def blocks(self, *fields: str, rows: int = 256) -> Iterator[Block]:
        """Yield (row numbers (k,), columns of these rows) with bounded memory; every row exactly once."""


class ArrayStream(msgspec.Struct, frozen=True):
    """A Stream whose columns are already in memory: readings made by tests and by the control loop."""

    topic: str
    msgtype: str
    t_ns: Ints
    data: Mapping[str, Column]
    frame_id: str = ""
    dropped: Mapping[str, int] = field(default_factory=dict)

    def columns(self, *fields: str) -> dict[str, Column]:
        """Return the named columns."""
        return {name: self.data[name] for name in fields}

    def blocks(self, *fields: str, rows: int = 256) -> Iterator[Block]:
        """Yield everything as one block."""
        yield np.arange(len(self.t_ns)), self.columns(*fields)


class Points(Protocol):
    """The points of a laser, read from the log again on request: an hour of points is too big for memory."""

    @property
    def mount(self) -> Array:
        """Where the laser sits on the base, (3,): x, y [m], yaw [rad]."""

    def take(self, readings: Ints) -> Points:
        """Return the points of the readings at these positions."""

    def mounted(self, mount: Array) -> Points:
        """Return the points as seen by a laser that sits elsewhere, (3,)."""

    def moved(self, t_from: Array, t_to: Array) -> Array:
        """Return the poses (n, 3) at t_to relative to those at t_from, (n,) s each, by the wheels."""

    def read(self, readings: Ints) -> list[Array]:
        """Return the points (k, 2) [m] of each reading in the base frame, in the order of the beams."""


class Measurements(msgspec.Struct, frozen=True, dict=True):
    """What one sensor measured over a drive, free of any pose: ragged, since a scan gives several lines.

    Reading i holds the rows first[i]:first[i+1]; none means the reading gave no measurement ("absent").
    The covariance of row j is scale^2 * R_unit[j] + floor, so that tuning re-fuses without re-measuring.
    Where `extra` has a column "rest" (m,), this variance is in R_unit and yet not the sigma's to change.
    Where it has a column "shared" (m, d, k), rows of one reading share k errors of unit variance: their covariance
    is G_i G_j' beyond R, and G_i G_i' is in `R`.
    """

    t: Array  # (n,) s since Drive.epoch_ns, never decreasing, time_offset applied
    first: Ints  # (n + 1,)
    z: Array  # (m, d)
    R_unit: Array  # (m, d, d)
    scale: float  # the sensor's sigma
    floor: Array  # (d, d)
    extra: dict[str, Array] = field(default_factory=dict)  # more columns with m rows, e.g. segment ends
    dropped: dict[str, int] = field(default_factory=dict)  # readings refused, by reason
    points: Points | None = None  # of a laser: what else its n scans saw
    notes: tuple[str, ...] = ()  # in words: what is unusual about what was seen
    seen: object = None  # of a sensor that need not look again: what all its readings showed (Sensor.again)

    @cached_property
    def R(self) -> Array:
        """Covariance of every row, (m, d, d)."""
        return self.covariances(slice(None))

    def covariances(self, rows: slice | Ints) -> Array:
        """Return the covariances (k, d, d) of some rows, so that those of an hour are not all in memory."""
        R: Array = self.scale**2 * self.R_unit[rows] + self.floor
        if "shared" in self.extra:
            G = self.extra["shared"][rows]
            R += np.einsum("mik,mjk->mij", G, G)
        return R

    @property
    def absent(self) -> int:
        """Readings that gave no measurement."""
        return int((np.diff(self.first) == 0).sum())

    @cached_property
    def scalars(self) -> tuple[Any, Any]:
        """Value and variance (m,) of every row as memoryviews, for sensors that measure one number."""
        return _view(self.z[:, 0]), _view(self.R[:, 0, 0])

    @cached_property
    def plain(self) -> dict[str, Any]:
        """All columns as memoryviews: "t", "first", "z", "R", and those of `extra` by name.

        Their elements are read as plain Python numbers (z[i, 0]), which is faster than NumPy's one at a time.
        """
        columns = {"t": self.t, "first": self.first, "z": self.z, "R": self.R, **self.extra}
        return {name: _view(column) for name, column in columns.items()}

    def take(self, readings: Ints) -> Measurements:
        """Return the readings at these positions, in this order."""
        counts = np.diff(self.first)[readings]
        first = np.concatenate(([0], np.cumsum(counts)))
        rows = np.repeat(self.first[readings] - first[:-1], counts) + np.arange(first[-1])
        return Measurements(
            t=self.t[readings],
            first=first,
            z=self.z[rows],
            R_unit=self.R_unit[rows],
            scale=self.scale,
            floor=self.floor,
            extra={k: v[rows] for k, v in self.extra.items()},
            dropped=self.dropped,
            points=None if self.points is None else self.points.take(readings),
            notes=self.notes,
            seen=self.seen,
        )


def _view(column: Any) -> Any:
    return memoryview(column)


class Motions(msgspec.Struct, frozen=True):
    """Pre-integrated wheel motion over n intervals, each seen from the pose at its start."""

    u: Array  # (n, 3) relative pose: exact arcs
    Q: Array  # (n, 3, 3) its covariance, in the frame of the interval's start
    J: Array  # (n, 3, p) du/d(wheel parameters), p = 0 where none are estimated


class Truth(msgspec.Struct, frozen=True):
    """Reference poses of the body frame or of a tracked body point."""

    topic: str
    t: Array  # (n,) s since Drive.epoch_ns
    xy: Array  # (n, 2) m, map frame, of the tracked point
    theta: Array | None  # (n,) rad, of the body; None where the truth has no heading
    point: tuple[float, float] = (0.0, 0.0)  # the tracked point on the body, m
    sigma: float = 0.0  # m, the truth's own standard deviation per axis
    sigma_theta: float = 0.0  # rad, that of its heading


class Drive(msgspec.Struct, frozen=True):
    """A measured log: wheel motion cut at the instants of every sensor present, measurements, truth."""

    epoch_ns: int  # the first wheel reading; all times below are seconds after it
    t: Array  # (n,) instants, increasing; the first and the last wheel reading are among them
    motions: Motions  # n intervals; motions[k] leads from instant k-1 to k, motions[0] is zero
    measurements: dict[str, Measurements]  # every sensor present in the log
    instant: dict[str, Ints]  # sensor -> (number of readings,) the instant each reading belongs to
    absent: dict[str, str]  # sensor -> why the log lacks it
    truth: Truth | None = None
    truth_motions: Motions | None = None  # from the instant before each truth stamp to that stamp
    truth_instant: Ints | None = None  # (number of truth stamps,) that instant; -1 before the drive
    dropped: dict[str, dict[str, int]] = field(default_factory=dict)  # stream -> reason -> count
    wheels: Any = None  # fusion.wheels.motion.Wheels: the odometry behind `motions`
    notes: tuple[str, ...] = ()  # in words: choices made, repairs, lags found
    repairs: tuple[str, ...] = ()  # of the wheels, in words: without "wheels: ", which they have among the notes
    # absent sensor -> settings that may bring it in
    fixes: dict[str, tuple[str, ...]] = field(default_factory=dict)

    def lacks(self, sensor: str) -> LocfuseError:
        """Return the error to raise if the drive has no measurements of a sensor."""
        why = self.absent.get(sensor, "not in this log")
        return LocfuseError(why, role=sensor, fixes=self.fixes.get(sensor, ()))


MAX_MAGNITUDE = 1e12  # m: a light hour; what is farther away was never measured
VERDICTS = ("accepted", "gate", "ambiguous", "unmatched", "new", "disturbed", "lost", "repeated")


class Audit(msgspec.Struct, frozen=True):
    """Every measurement of one sensor in one run: its prediction, its innovation, and its verdict."""

    instant: Counts  # (k,)
    row: Counts  # (k,) row in Measurements.z
    verdict: NDArray[np.int8]  # (k,) index into VERDICTS
    landmark: Counts  # (k,) id of the map feature it was compared with, -1 for none
    nis: Array  # (k,) squared Mahalanobis distance; NaN where nothing was predicted
    threshold: Array  # (k,) the gate
    y: Array  # (k, d) innovation; NaN where nothing was predicted
    sigma: Array  # (k, d) its predicted standard deviation
    # (j, 2) of readings with several accepted rows: y' S^-1 y of all of them, and its degrees of freedom
    joint: Array = field(default_factory=lambda: np.zeros((0, 2)))

    @property
    def verdicts(self) -> NDArray[np.str_]:
        """(k,) the verdicts by name: "accepted", "gate" ..."""
        return np.array(VERDICTS)[self.verdict]


# kinds of events
FAULT, LOST, REFUSED, REST = "fault", "lost", "refused", "rest"
LOOP, JUMP = "loop closed", "pose jumped"


class Event(NamedTuple):
    """Something that lasted from `start` to `end` [s since the first wheel reading]."""

    start: float
    end: float
    kind: str  # FAULT, LOST, REFUSED, REST, LOOP or JUMP
    words: str
    configuration: str = ""  # in which result; "" where it is of the drive itself


class Component(NamedTuple):
    """One number of a measurement or of a state, with its name and unit."""

    name: str
    unit: str  # "m", "deg", "deg/s", "%"; "" for none
    scale: float = 1.0  # from SI to that unit

    @property
    def label(self) -> str:
        """Name and unit as a title: "heading [deg]"."""
        return f"{self.name} [{self.unit}]" if self.unit else self.name

    @property
    def sign(self) -> str:
        """The unit as printed behind a number: ° for deg."""
        return self.unit.replace("deg", "°")


class Colour(NamedTuple):
    """A colour on a light page and on a dark one, "#rrggbb"."""

    light: str
    dark: str


class MapLine(msgspec.Struct, frozen=True):
    """One line of the map in normal form x cos(beta) + y sin(beta) = rho (paper eq. 14), with its extent."""

    id: int
    rho: float
    beta: float
    ends: tuple[float, float]  # m along the tangent (-sin beta, cos beta)
    P: Array  # (2, 2) covariance of (rho, beta); in a map of its own with the map frame held
    hits: int = 0
    P_free: Array | None = None  # (2, 2) the same with the map frame's own uncertainty; None: it has none

    @property
    def P_map(self) -> Array:
        """Covariance (2, 2) of (rho, beta) in the map, with the uncertainty of the map frame.

        A map that is given to another run needs P instead: one and the same frame error of all its walls would be
        taken for as many independent ones.
        """
        return self.P if self.P_free is None else self.P_free


class SeenAgain(NamedTuple):
    """A place that was recognised, and the relative pose found there."""

    then: float  # s: when it was seen before
    now: float  # s: when it was recognised
    pose: Array  # (3,) where the robot was now, seen from where it was then


SLIP, RELOCALISED, LOOP_TAKEN = "slip", "relocalised", "loop"  # kinds of jumps


class Jump(NamedTuple):
    """A correction of the pose that is no motion: a corrected slip, a relocalisation, or a closed loop."""

    t: float  # s
    kind: str  # SLIP, RELOCALISED or LOOP_TAKEN
    step: tuple[float, float, float]  # m, m, rad: by how much the pose in the map changed


class Estimates(msgspec.Struct, frozen=True):
    """The result of one configuration over one drive."""

    configuration: str  # "odometry", "compass+lrf", "all": the set of sensors, smoothed or not
    sensors: tuple[str, ...]
    t: Array  # (n,) = Drive.t
    pose: Array  # (n, 3) map frame, theta unwrapped
    triangles: Array  # (n, 6) of its covariance: xx, xy, xt, yy, yt, tt
    audits: dict[str, Audit]
    blocks: dict[str, Array] = field(default_factory=dict)  # fixed-size state blocks over time, (n, k)
    block_sigmas: dict[str, Array] = field(default_factory=dict)  # their standard deviations, (n, k)
    first_map: Sequence[MapLine] = ()
    final_map: Sequence[MapLine] = ()
    points: Sequence[tuple[int, float, float]] = ()  # id, x, y [m, map frame] of landmarks that the run placed
    truth_pose: Array | None = None  # (q, 3) predicted at the truth stamps, NaN before the drive
    truth_P: Array | None = None  # (q, 3, 3)
    notes: tuple[str, ...] = ()  # slips, being lost and found again
    jumps: tuple[Jump, ...] = ()  # in order of time
    lost: tuple[tuple[float, float], ...] = ()  # s: when the filter did not know where it was
    # (m, 2) s: when a place was seen before, and when it was recognised, in order of the second
    loops: Array = field(default_factory=lambda: np.zeros((0, 2)))
    loop_poses: Array = field(default_factory=lambda: np.zeros((0, 3)))  # (m, 3) the second seen from the first
    smoothed: bool = False  # by the whole drive, its end included; audits are the filter's
    rates: Mapping[str, float] = field(default_factory=dict)  # Hz, of sensors used at a lower rate than the log's

    @property
    def name(self) -> str:
        """The unique name of this result in its drive: the configuration, perhaps with "-smoothed"."""
        return result_name(self.configuration, self.smoothed)

    @property
    def slips(self) -> int:
        """How many wheel slips were detected and corrected."""
        return sum(jump.kind == SLIP for jump in self.jumps)

    @property
    def P(self) -> Array:
        """Covariance of the pose, (n, 3, 3), computed on each access to save memory."""
        return matrices(self.triangles)


def plausible(values: Array) -> NDArray[np.bool_]:
    """Return where values (any shape; m, rad or degrees) are finite and their squares do not overflow."""
    small: NDArray[np.bool_] = np.abs(values) < MAX_MAGNITUDE  # so is no NaN
    return small


ODOMETRY, BY_SCANS = "odometry", "scan matching"  # configurations without a sensor: by wheels, by scans alone
BASES = (ODOMETRY, BY_SCANS)


def stretches(flags: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return (first, last) index of every run of true values in flags (n,)."""
    edges = np.flatnonzero(np.diff(np.concatenate(([0], np.asarray(flags, np.int8), [0]))))
    return [(a, b - 1) for a, b in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)]


def result_name(configuration: str, smoothed: bool) -> str:
    """Return the name of a result in reports and of its files: "all", or "all-smoothed"."""
    return f"{configuration}-smoothed" if smoothed else configuration


def matrices(triangles: Array) -> Array:
    """Return symmetric (..., 3, 3) from upper triangles (..., 6): xx, xy, xt, yy, yt, tt."""
    return triangles[..., [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(*triangles.shape[:-1], 3, 3)


def upper_triangles(P: Array) -> Array:
    """Return (..., 6) from (..., 3, 3)."""
    return P[..., [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]


NONE, NO_POINTS, NO_POSES = np.zeros(0), np.zeros((0, 2)), np.zeros((0, 3))


class RunningNis(NamedTuple):
    """Mean NIS per degree of freedom of intervals of a drive; NaN for an interval without values."""

    t: Array  # (n,) s, middle of each stretch
    mean: Array  # (n,)
    low: Array  # (n,) 95 % bounds of innovations that are white and as large as they should be
    high: Array  # (n,)


class SensorFigures(msgspec.Struct, frozen=True):
    """Counts and figures of one sensor's measurements in one configuration."""

    accepted: int
    rejected: int
    absent: int  # readings that gave no measurement
    nis: float | None  # mean squared Mahalanobis distance of what was accepted, per degree of freedom
    joint_nis: float | None  # as `nis`, of readings as a whole: of all lines of a scan at once
    verdicts: dict[str, int]  # count of every verdict that occurred


class Evaluation(msgspec.Struct, frozen=True):
    """One configuration judged: deviations from truth at the truth's stamps, and its figures.

    Without truth the columns are empty and the error figures None.
    """

    configuration: str  # as of the estimates
    sensors: dict[str, SensorFigures]
    figures: dict[str, float | None]  # flat, SI units with the unit in the key
    t: Array = NONE  # (q,) s since Drive.epoch_ns
    deviation: Array = NO_POINTS  # (q, 2) estimate - truth of the tracked point, map frame [m]
    heading: Array | None = None  # (q,) estimate - truth [rad], wrapped
    along_cross: Array = NO_POINTS  # (q, 2) deviation along and left of the truth's direction [m]
    sigma: Array = NO_POSES  # (q, 3) predicted standard deviation of x, y [m], theta [rad]
    nees: Array = NONE  # (q,) NaN where P is singular or after alignment
    distance: Array = NONE  # (q,) m travelled by the truth
    estimate_xy: Array = NO_POINTS  # (q, 2) tracked point of the estimate, aligned as asked
    align: str = "none"
    smoothed: bool = False
    lost: tuple[tuple[float, float], ...] = ()  # s: when the filter said that it was lost; all figures include it
    notes: tuple[str, ...] = ()  # what the filter said of the run
    rates: Mapping[str, float] = field(default_factory=dict)  # Hz, as of the estimates
    reference: bool = False  # judged against the whole drive's solution, not against truth (judge.against)

    @property
    def name(self) -> str:
        """The name of the estimates that were judged."""
        return result_name(self.configuration, self.smoothed)

    @property
    def lost_share(self) -> float:
        """The share of the drive for which the filter reported that it was lost."""
        duration = self.figures.get("duration_s") or 0.0
        return min(1.0, sum(b - a for a, b in self.lost) / duration) if duration > 0.0 else 0.0
