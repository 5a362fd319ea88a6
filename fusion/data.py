"""Data types of locfuse: log streams, measurements, drives, estimates and evaluations.

An hour of log holds 10^5 to 10^6 readings, so readings, measurements and estimates are NumPy columns. Times of
streams are integer nanoseconds (`t_ns`), other times are float seconds since `Drive.epoch_ns`. Angles are in
radians; frames are REP-103 (x forward, y left, angles counter-clockwise).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cached_property
from typing import Any, NamedTuple, Protocol

import msgspec
import numpy as np
from msgspec import field
from msgspec.structs import replace
from numpy.typing import NDArray

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Counts = NDArray[np.int32] | Ints  # 32 bits if they suffice, to save memory
Mask = NDArray[np.bool_]  # rows that fulfil a condition

END_OF_TIME = 2**62  # ns: later times are invalid; differences of valid times fit in 64 bits


class LocfuseError(Exception):
    """Error in a file or a setting: a message of one line, with a hint and settings that fix the problem.

    `str()` is the whole line, "role: message hint"; the attributes are its parts.
    """

    exit_code = 1
    typed: str | None = None  # the line with command-line options, if `str()` has Python arguments instead

    def __init__(self, message: str, *, role: str = "", fixes: Sequence[str] = (), hint: str = "") -> None:
        self.role = role  # wheels, truth or a sensor; "" for a file or the command line
        self.message = message  # what, where, the numbers
        self.fixes = tuple(fixes)  # settings that help, "table.key=value" each
        self.hint = hint  # what to try next
        super().__init__(f"{role}: {self.sentence}" if role else self.sentence)

    @property
    def sentence(self) -> str:
        """Message and hint, without the role."""
        return f"{self.message} {self.hint}" if self.hint else self.message


class UsageError(LocfuseError):
    """Error in the command line: a wrong option, a wrong `--set`, a missing path."""

    exit_code = 2


class Ragged(msgspec.Struct, frozen=True):
    """Column with rows of different lengths, such as LaserScan.ranges: row i is values[first[i]:first[i+1]]."""

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
        """Return all rows as one (n, m) view if they have the same length m, else None."""
        lengths = self.lengths
        if len(lengths) == 0 or (lengths != lengths[0]).any():
            return None
        return self.values[self.first[0] : self.first[-1]].reshape(len(lengths), int(lengths[0]))


# Types of a column of readings: numbers (n,) or (n, k); Ragged; or one Python value per row
# (str; tuple[str, ...] for string[]; bytes-like for uint8[] payloads such as images).
Column = NDArray[Any] | Ragged | list[Any]
Block = tuple[Ints, dict[str, Column]]


class Stream(Protocol):
    """One topic of a log with repaired stamps; message fields are read as columns on request.

    Rows are in the order of the log (log time, topic, sequence), and `t_ns` never decreases.
    """

    @property
    def topic(self) -> str:
        """Name of the topic."""

    @property
    def msgtype(self) -> str:
        """Message type of the topic, such as sensor_msgs/msg/LaserScan."""

    @property
    def frame_id(self) -> str:
        """frame_id in the header of the first message; "" if there is none."""

    @property
    def t_ns(self) -> Ints:
        """Stamps of the readings, (n,) ns, never decreasing."""

    @property
    def dropped(self) -> Mapping[str, int]:
        """Reason -> number of messages that have no row."""

    def columns(self, *fields: str) -> dict[str, Column]:
        """Return the columns of these fields, with n rows, by dotted field path such as "magnetic_field.x"."""

    def blocks(self, *fields: str, rows: int = 256) -> Iterator[Block]:
        """Yield (row numbers (k,), columns of these rows) with bounded memory; every row occurs exactly once."""


class ArrayStream(msgspec.Struct, frozen=True):
    """Stream whose columns are in memory, for tests and for the simulated control loop."""

    topic: str
    msgtype: str
    t_ns: Ints
    data: Mapping[str, Column]
    frame_id: str = ""
    dropped: Mapping[str, int] = {}

    def columns(self, *fields: str) -> dict[str, Column]:
        """Return columns by field path."""
        return {name: self.data[name] for name in fields}

    def blocks(self, *fields: str, rows: int = 256) -> Iterator[Block]:
        """Yield all rows as one block."""
        yield np.arange(len(self.t_ns)), self.columns(*fields)


class Points(Protocol):
    """Laser points of a drive; they are read from the log on each request, to save memory."""

    @property
    def mount(self) -> Array:
        """Pose of the laser on the base, (3,): x, y [m], yaw [rad]."""

    def take(self, readings: Ints) -> Points:
        """Return the points of the readings with these indices."""

    def mounted(self, mount: Array) -> Points:
        """Return the points for a laser with another mount (3,): x, y [m], yaw [rad]."""

    def moved(self, t_from: Array, t_to: Array) -> Array:
        """Return the poses (n, 3) at times t_to relative to those at t_from, (n,) [s] each, by the wheels."""

    def read(self, readings: Ints) -> list[Array]:
        """Return the points (k, 2) [m] of each reading, in the base frame, in the order of the beams."""


class Measurements(msgspec.Struct, frozen=True, dict=True):
    """Measurements of one sensor over a drive: n readings with m rows in total (a scan has several lines).

    Reading i has the rows first[i]:first[i+1]; a reading without rows is "absent". The covariance of row j is
    scale^2 * R_unit[j] + floor, so that `scale` can be tuned without new measurements. The column "rest" (m,) of
    `extra` is the part of R_unit (a variance) that stays constant when sigma changes. The column "shared" (m, d,
    k) of `extra` has the effects G of k unit errors that the rows of one reading share: rows i and j have the
    covariance G_i G_j', and `R` includes G_i G_i'.
    """

    t: Array  # (n,) s since Drive.epoch_ns, with time_offset, never decreasing
    first: Ints  # (n + 1,)
    z: Array  # (m, d)
    R_unit: Array  # (m, d, d)
    scale: float  # the sensor's configured sigma
    floor: Array  # (d, d)
    extra: dict[str, Array] = {}  # more columns with m rows, e.g. segment ends
    dropped: dict[str, int] = {}  # reason -> number of unused readings
    points: Points | None = None  # points of the n scans of a laser
    notes: tuple[str, ...] = ()  # notes on unusual readings
    seen: object = None  # detections in all readings, reused by Sensor.again
    two_sources: bool = False  # two publishers wrote the readings in turn, by their values

    @cached_property
    def R(self) -> Array:
        """Covariance of every row, (m, d, d)."""
        return self.covariances(slice(None))

    def covariances(self, rows: slice | Ints) -> Array:
        """Return the covariances (k, d, d) of some rows."""
        R: Array = self.scale**2 * self.R_unit[rows] + self.floor
        if "shared" in self.extra:
            G = self.extra["shared"][rows]
            R += np.einsum("mik,mjk->mij", G, G)
        return R

    @property
    def absent(self) -> int:
        """Number of readings without a measurement."""
        return int((np.diff(self.first) == 0).sum())

    @cached_property
    def scalars(self) -> tuple[Any, Any]:
        """Values (m,) and variances (m,) of a sensor that measures one number, as memoryviews."""
        values: Any = self.z[:, 0]
        variances: Any = self.R[:, 0, 0]
        return memoryview(values), memoryview(variances)

    @cached_property
    def plain(self) -> dict[str, Any]:
        """Columns as memoryviews by name: "t", "first", "z", "R", and the columns of `extra`.

        Reading their elements one by one (z[i, 0]) is faster than with NumPy.
        """
        columns: dict[str, Any] = {"t": self.t, "first": self.first, "z": self.z, "R": self.R, **self.extra}
        return {name: memoryview(column) for name, column in columns.items()}

    def take(self, readings: Ints) -> Measurements:
        """Return the readings with these indices, in this order."""
        counts = np.diff(self.first)[readings]
        first = totals(counts)
        rows = np.repeat(self.first[readings] - first[:-1], counts) + np.arange(first[-1])
        return replace(
            self,
            t=self.t[readings],
            first=first,
            z=self.z[rows],
            R_unit=self.R_unit[rows],
            extra={k: v[rows] for k, v in self.extra.items()},
            points=None if self.points is None else self.points.take(readings),
        )


class Motions(msgspec.Struct, frozen=True):
    """Pre-integrated wheel motion over n intervals, each relative to the pose at the start of the interval."""

    u: Array  # (n, 3) relative pose: exact arcs
    Q: Array  # (n, 3, 3) covariance of u, in the frame of the interval's start
    J: Array  # (n, 3, p) du/d(wheel parameters); p = 0 if none are estimated

    def corrected(self, wheels: Array | None) -> Array:
        """Return the motions (n, 3) with corrections (p,) of the wheel parameters; None: no corrections."""
        return self.u if wheels is None else self.u + self.J @ wheels


class Truth(msgspec.Struct, frozen=True):
    """Reference poses of the body frame or of a tracked body point."""

    topic: str
    t: Array  # (n,) s since Drive.epoch_ns
    xy: Array  # (n, 2) m, map frame, of the tracked point
    theta: Array | None  # (n,) rad, of the body; None if the truth has no headings
    point: tuple[float, float] = (0.0, 0.0)  # the tracked point on the body, m
    sigma: float = 0.0  # m, the truth's own standard deviation per axis
    sigma_theta: float = 0.0  # rad, standard deviation of the truth's heading
    time_offset: float = 0.0  # s, included in t
    w_first: bool = False  # whether the quaternions were recorded as w, x, y, z, and are read so
    turned: int = 0  # readings whose heading was off by 180 degrees, and was turned back

    def spans(self, t: Array) -> Mask:
        """Return the mask (n,) of the times t (n,) [s] between the first and the last pose."""
        return np.asarray((t >= self.t[0]) & (t <= self.t[-1]))


class Drive(msgspec.Struct, frozen=True):
    """Measured log: wheel motion between update times, measurements of every sensor, truth."""

    epoch_ns: int  # the first wheel reading; all times below are seconds after it
    t: Array  # (n,) update times ("instants"), increasing, with the first and the last wheel reading
    motions: Motions  # n intervals; motions[k] leads from instant k-1 to instant k, motions[0] is zero
    measurements: dict[str, Measurements]  # every sensor present in the log
    instant: dict[str, Ints]  # sensor -> (number of readings,) index of each reading's instant
    absent: dict[str, str]  # sensor -> why the log lacks it
    truth: Truth | None = None
    truth_motions: Motions | None = None  # from the instant before each truth stamp to that stamp
    truth_instant: Ints | None = None  # (number of truth stamps,) index of this instant; -1 before the drive
    dropped: dict[str, dict[str, int]] = {}  # stream -> reason -> count
    wheels: Any = None  # fusion.wheels.motion.Wheels: the odometry behind `motions`
    notes: tuple[str, ...] = ()  # notes on choices, repairs and lags
    repairs: tuple[str, ...] = ()  # notes of the wheels, without the prefix "wheels: " that they have in `notes`
    # absent sensor -> settings that may make it usable
    fixes: dict[str, tuple[str, ...]] = {}

    def at_truth(
        self, predict: Callable[[Ints, Motions], tuple[Array, Array]]
    ) -> tuple[Array | None, Array | None]:
        """Return poses (q, 3) and covariances (q, 3, 3) at the truth's stamps; NaN outside the drive.

        `predict` computes them from the indices (q,) of the update times before the stamps, and the motions from
        these times to the stamps.
        """
        if self.truth_motions is None or self.truth_instant is None:
            return None, None
        pose, P = predict(np.maximum(self.truth_instant, 0), self.truth_motions)
        outside = self.truth_instant < 0
        pose[outside], P[outside] = np.nan, np.nan
        return pose, P

    def lacks(self, sensor: str) -> LocfuseError:
        """Return the error for a sensor without measurements in this drive."""
        why = self.absent.get(sensor, "not in this log")
        return LocfuseError(why, role=sensor, fixes=self.fixes.get(sensor, ()))


MAX_MAGNITUDE = 1e12  # m: a light hour; larger coordinates are invalid
VERDICTS = ("accepted", "gate", "ambiguous", "unmatched", "new", "disturbed", "lost", "repeated")


class RowVerdict:
    """Indices into VERDICTS, as in `Audit.verdict`."""

    ACCEPTED, GATE, AMBIGUOUS, UNMATCHED, NEW, DISTURBED, LOST, REPEATED = range(len(VERDICTS))


class Audit(msgspec.Struct, frozen=True):
    """Record of one sensor's measurements in one run: k rows with prediction, innovation and verdict.

    Values of rows without a prediction are NaN.
    """

    instant: Counts  # (k,) index of the update time
    row: Counts  # (k,) row in Measurements.z
    verdict: NDArray[np.int8]  # (k,) index into VERDICTS
    landmark: Counts  # (k,) id of the map feature that the measurement was compared with; -1: none
    nis: Array  # (k,) squared Mahalanobis distance; NaN without a prediction
    threshold: Array  # (k,) the gate
    y: Array  # (k, d) innovation; NaN without a prediction
    sigma: Array  # (k, d) predicted standard deviation of the innovation
    # (j, 2) joint NIS, y' S^-1 y of all accepted rows of a reading with several, and its degrees of freedom
    joint: Array = field(default_factory=lambda: np.zeros((0, 2)))

    @property
    def verdicts(self) -> NDArray[np.str_]:
        """Names of the verdicts (k,), such as "accepted" or "gate"."""
        return np.array(VERDICTS)[self.verdict]


# kinds of events
FAULT, LOST, REFUSED, REST = "fault", "lost", "refused", "rest"
LOOP, JUMP = "loop closed", "pose jumped"


class Event(NamedTuple):
    """Event of a drive or a run, from `start` to `end` [s since the first wheel reading]."""

    start: float
    end: float
    kind: str  # FAULT, LOST, REFUSED, REST, LOOP or JUMP
    words: str
    configuration: str = ""  # of the run; "" for an event of the drive


class Component(NamedTuple):
    """Name, unit and scale of one component of a measurement or a state."""

    name: str
    unit: str  # "m", "deg", "deg/s", "%"; "" for none
    scale: float = 1.0  # factor from SI to this unit

    @property
    def label(self) -> str:
        """Name and unit for a title, such as "heading [deg]"."""
        return f"{self.name} [{self.unit}]" if self.unit else self.name

    @property
    def sign(self) -> str:
        """Unit as printed after a number: "°" for "deg"."""
        return self.unit.replace("deg", "°")


class Colour(NamedTuple):
    """Colours "#rrggbb" of one name: on a light and on a dark background."""

    light: str
    dark: str


class MapLine(msgspec.Struct, frozen=True):
    """Line of the map x cos(beta) + y sin(beta) = rho (paper eq. 14), with the two ends of the wall."""

    id: int
    rho: float
    beta: float
    ends: tuple[float, float]  # m along the tangent (-sin beta, cos beta)
    P: Array  # (2, 2) covariance of (rho, beta) without the uncertainty of the map frame
    hits: int = 0
    P_free: Array | None = None  # (2, 2) with this uncertainty; None if the frame has none

    @property
    def P_map(self) -> Array:
        """Covariance (2, 2) of (rho, beta), including the uncertainty of the map frame.

        For a map of another run, use P instead: all walls share the error of the frame, which would count as an
        independent error of each wall.
        """
        return self.P if self.P_free is None else self.P_free


class SeenAgain(NamedTuple):
    """Loop closure: a recognised place, and the pose at the later visit relative to the earlier one."""

    then: float  # s: time of the earlier visit
    now: float  # s: time of the recognition
    pose: Array  # (3,) pose of the robot now, relative to its pose then


SLIP, RELOCALISED, LOOP_TAKEN = "slip", "relocalised", "loop"  # kinds of jumps


class Jump(NamedTuple):
    """Correction of the pose without motion: a corrected slip, a relocalisation, or a loop closure."""

    t: float  # s
    kind: str  # SLIP, RELOCALISED or LOOP_TAKEN
    step: tuple[float, float, float]  # m, m, rad: change of the pose in the map


class Estimates(msgspec.Struct, frozen=True):
    """Estimates of one configuration over one drive."""

    configuration: str  # "odometry", "compass+lrf", "all": the set of sensors, smoothed or not
    sensors: tuple[str, ...]
    t: Array  # (n,) = Drive.t
    pose: Array  # (n, 3) map frame, theta unwrapped
    triangles: Array  # (n, 6) upper triangle of the pose covariance: xx, xy, xt, yy, yt, tt
    audits: dict[str, Audit]
    blocks: dict[str, Array] = {}  # name -> other states over time, (n, k)
    block_sigmas: dict[str, Array] = {}  # standard deviations of `blocks`, (n, k)
    first_map: Sequence[MapLine] = ()
    final_map: Sequence[MapLine] = ()
    points: Sequence[tuple[int, float, float]] = ()  # id, x, y [m, map frame] of landmarks that the run placed
    truth_pose: Array | None = None  # (q, 3) predicted at the truth stamps, NaN before the drive
    truth_P: Array | None = None  # (q, 3, 3)
    notes: tuple[str, ...] = ()  # notes on slips, loss and relocalisation
    jumps: tuple[Jump, ...] = ()  # in order of time
    lost: tuple[tuple[float, float], ...] = ()  # s: intervals in which the robot was lost
    # (m, 2) s: time of the earlier visit, and of its recognition; sorted by the second
    loops: Array = field(default_factory=lambda: np.zeros((0, 2)))
    # (m, 3) pose at the later time relative to the pose at the earlier time
    loop_poses: Array = field(default_factory=lambda: np.zeros((0, 3)))
    smoothed: bool = False  # whether each pose uses the whole drive; the audits are those of the filter
    rates: Mapping[str, float] = {}  # Hz: sensor -> rate, if lower than that of the log

    @property
    def name(self) -> str:
        """Unique name of the estimates in their drive: the configuration, with "-smoothed" if smoothed."""
        return result_name(self.configuration, self.smoothed)

    @property
    def slips(self) -> int:
        """Number of wheel slips that were detected and corrected."""
        return sum(jump.kind == SLIP for jump in self.jumps)

    @property
    def P(self) -> Array:
        """Covariances of the pose, (n, 3, 3), computed on each access to save memory."""
        return matrices(self.triangles)


def plausible(values: Array) -> Mask:
    """Return a mask (any shape) of the values [m, rad or degrees] that are finite and below MAX_MAGNITUDE."""
    return np.asarray(np.abs(values) < MAX_MAGNITUDE)  # false for NaN


PLANE_ROWS = (0, 1, 5)  # rows of x, y and yaw in a 6 x 6 covariance of x, y, z, roll, pitch, yaw
ODOMETRY, BY_SCANS = "odometry", "scan matching"  # configurations without a sensor: by wheels, by scans alone
BASES = (ODOMETRY, BY_SCANS)
LASER = "lrf"  # name of the laser range finder; if there are no wheels, its scans give the motion


def stretches(flags: Mask) -> list[tuple[int, int]]:
    """Return (first, last) index of each group of consecutive true values in flags (n,)."""
    edges = np.flatnonzero(np.diff(np.concatenate(([0], np.asarray(flags, np.int8), [0]))))
    return [(a, b - 1) for a, b in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)]


def consecutive(labels: Array | Ints) -> list[Ints]:
    """Return the indices of each group of consecutive equal labels (n,)."""
    return np.split(np.arange(len(labels)), np.flatnonzero(np.diff(labels)) + 1)


def spaced(*series: tuple[Array, float]) -> Ints:
    """Return the indices of chosen values; each differs from the chosen one before it by a limit or more.

    A series is (values (n,), limit); a difference in one of several series is enough. The first value is always
    chosen.
    """
    limits = [limit for _, limit in series]
    chosen, last = list[int](), tuple[float, ...]()
    for k, now in enumerate(zip(*(values.tolist() for values, _ in series), strict=True)):
        if not chosen or any(abs(a - b) >= limit for a, b, limit in zip(now, last, limits, strict=True)):
            chosen.append(k)
            last = now
    return np.array(chosen, np.int64)


def evenly(n: int, limit: int) -> Ints:
    """Return at most `limit` evenly spaced indices of 0 .. n - 1, including both ends."""
    if n <= limit:
        return np.arange(n)
    return np.unique(np.rint(np.linspace(0, n - 1, limit)).astype(np.int64))


def totals(steps: Any, dtype: Any = None) -> NDArray[Any]:
    """Return the running sums (n + 1, ...) of steps (n, ...); the first is zero."""
    sums = np.cumsum(steps, axis=0, dtype=dtype)
    return np.concatenate((np.zeros((1, *sums.shape[1:]), sums.dtype), sums))


def interpolate(at: Array, t: Array, columns: Array) -> Array:
    """Return columns (n, k), known at times t (n,), at the times `at` (...): an array (..., k)."""
    return np.stack([np.interp(at, t, column) for column in columns.T], axis=-1)


def changes(start: Array, length: float, t: Array, values: Array) -> Array:
    """Return how values (n, ...), known at times t (n,), change in a time of `length` after each time `start`."""
    if values.ndim > 1:
        return interpolate(start + length, t, values) - interpolate(start, t, values)
    return np.interp(start + length, t, values) - np.interp(start, t, values)


def result_name(configuration: str, smoothed: bool) -> str:
    """Return the name of a result in reports and file names: "all" or "all-smoothed"."""
    return f"{configuration}-smoothed" if smoothed else configuration


def matrices(triangles: Array) -> Array:
    """Return symmetric matrices (..., 3, 3) from upper triangles (..., 6): xx, xy, xt, yy, yt, tt."""
    return triangles[..., [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(*triangles.shape[:-1], 3, 3)


def upper_triangles(P: Array) -> Array:
    """Return the upper triangles (..., 6) of symmetric matrices (..., 3, 3)."""
    return P[..., [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]


NONE, NO_POINTS, NO_POSES = np.zeros(0), np.zeros((0, 2)), np.zeros((0, 3))


class RunningNis(NamedTuple):
    """Mean NIS per degree of freedom in n intervals of a drive; NaN for an interval without values."""

    t: Array  # (n,) s, middle of each interval
    mean: Array  # (n,)
    low: Array  # (n,) 95 % bounds for a consistent filter
    high: Array  # (n,)


class SensorFigures(msgspec.Struct, frozen=True):
    """Counts by verdict and mean NIS of one sensor in one configuration."""

    accepted: int
    rejected: int
    absent: int  # readings that gave no measurement
    nis: float | None  # mean NIS of accepted measurements, per degree of freedom
    joint_nis: float | None  # mean NIS of all lines of a scan together, per degree of freedom
    verdicts: dict[str, int]  # count of every verdict that occurred


class Evaluation(msgspec.Struct, frozen=True):
    """Evaluation of one configuration: deviations from truth at q truth stamps, and error figures.

    Without truth, the columns are empty and the error figures are None.
    """

    configuration: str  # that of the estimates
    sensors: dict[str, SensorFigures]
    figures: dict[str, float | None]  # name -> value in SI units, with the unit in the key
    t: Array = NONE  # (q,) s since Drive.epoch_ns
    deviation: Array = NO_POINTS  # (q, 2) estimate - truth of the tracked point, map frame [m]
    heading: Array | None = None  # (q,) estimate - truth [rad], wrapped
    along_cross: Array = NO_POINTS  # (q, 2) deviation along and left of the truth's direction [m]
    sigma: Array = NO_POSES  # (q, 3) predicted standard deviation of x, y [m], theta [rad]
    nees: Array = NONE  # (q,) NaN if P is singular, and after alignment
    distance: Array = NONE  # (q,) m travelled by the truth
    estimate_xy: Array = NO_POINTS  # (q, 2) m, estimate of the tracked point, after alignment (if any)
    align: str = "none"
    smoothed: bool = False
    # s: intervals in which the robot was lost; all figures include them
    lost: tuple[tuple[float, float], ...] = ()
    notes: tuple[str, ...] = ()  # notes of the filter on the run
    rates: Mapping[str, float] = {}  # Hz, those of the estimates
    reference: bool = False  # whether the reference solution replaces truth (whole_drive.reference)

    @property
    def name(self) -> str:
        """Name of the evaluated estimates."""
        return result_name(self.configuration, self.smoothed)

    @property
    def lost_share(self) -> float:
        """Share of the drive in which the filter reported that the robot was lost."""
        duration = self.figures.get("duration_s") or 0.0
        return min(1.0, sum(b - a for a, b in self.lost) / duration) if duration > 0.0 else 0.0
