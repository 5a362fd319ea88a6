"""Base classes of a sensor: its settings, its measurements, and its model in the filter."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Literal, NamedTuple, Protocol

import msgspec

from locfuse.fusion.kernels.ekf import Innovation
from locfuse.fusion.kernels.sight import SightLines

from .data import Array, Colour, Component, Ints, Jump, MapLine, Measurements, SeenAgain, Stream

Row = tuple[float, ...]
Matrix = tuple[Row, ...]
NO_COLUMNS: tuple[int, ...] = ()  # state columns of a measurement that depends only on the pose
NO_BLOCK: Matrix = ()
PoseRows = tuple[tuple[float, float, float], ...]  # (d, 3) derivatives by x [m], y [m], theta [rad] of the pose


class SensorSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Settings of all sensors; SI units, angles in degrees if the key ends in `_deg`."""

    topic: str | None = None  # not set: the only topic of a type that the sensor reads
    time_offset: float = 0.0  # s, added to the stamps of this sensor
    gate: float = 0.9999  # confidence of the chi-square gate: one good reading in 10 000 is rejected; 1: none
    outliers: Literal["reject", "inflate"] = "reject"  # beyond the gate: reject, or increase R

    only_fused: ClassVar[frozenset[str]] = frozenset({"gate", "outliers"})  # keys on which no measurement depends

    # keys that must be above 0, if a sensor has them
    positive: ClassVar[tuple[str, ...]] = ("sigma", "sigma_deg", "sigma_range")

    def __post_init__(self) -> None:
        """Raise ValueError for a sigma that is not above 0: P would become singular."""
        for key in self.positive:
            if getattr(self, key, 1.0) <= 0.0:
                raise ValueError(f"{key} = {getattr(self, key)}: no sensor is exact, it must be positive")


class WheelMotion(Protocol):
    """Relative motion of the robot by the wheels, for use in `Sensor.measure`."""

    @property
    def track(self) -> float:
        """Distance between the wheels [m]."""

    def relative(self, t_from: Array, t_to: Array) -> Array:
        """Return the poses (n, 3) at times t_to relative to the poses at t_from, (n,) [s] each."""

    def heading(self, t: Array) -> Array:
        """Return the headings (...) [rad, not wrapped] by the wheels at times t (...) [s]."""

    def slips(self, t: Array) -> Array:
        """Return variances (..., k - 1, 2) [m^2] of the left and right distance between times t (..., k) [s]."""


class Equation(NamedTuple):
    """Linear measurement equation y = H dx + noise with covariance R."""

    y: Array  # (m,)
    columns: Ints  # (c,) of the state; a column may occur twice
    H: Array  # (m, c)
    R: Array  # (m, m)


class Block(NamedTuple):
    """Named states of a sensor in the filter, such as a compass offset or a gyro bias."""

    name: str
    x: Array  # (k,) initial values
    P: Array  # (k, k) initial covariance
    drift: Array  # (k,) variance per second of the random walk of each state


class Belief(Protocol):
    """State of the filter as a model sees it: pose, covariance, and state blocks."""

    @property
    def x(self) -> float:
        """X coordinate of the pose [m]."""

    @property
    def y(self) -> float:
        """Y coordinate of the pose [m]."""

    @property
    def theta(self) -> float:
        """Heading of the pose [rad], not wrapped."""

    def pose(self) -> tuple[float, float, float]:
        """Return the pose: x [m], y [m], theta [rad, not wrapped]."""

    def block(self, name: str) -> tuple[int, Sequence[float] | Array]:
        """Return the first state column of a block, and the block's values."""

    def column(self, name: str) -> int:
        """Return the first state column of a block."""

    def value(self, column: int) -> float:
        """Return the state in a column."""

    def variance(self, H: Row, columns: tuple[int, ...] = (), H_block: Row = ()) -> float:
        """Return H P H' of one number: H (3,) by the pose, H_block (c,) by the states `columns` (c,)."""

    def compare(
        self,
        row: int,
        y: tuple[float, ...],
        H: PoseRows,
        R: Matrix,
        threshold: float,
        columns: tuple[int, ...] = (),
        H_block: Matrix = (),
    ) -> Innovation:
        """Return the innovation y (d,) of measurement `row`, with its covariance, NIS and verdict.

        S = H P H' + R and NIS = y' S^-1 y (Bar-Shalom, Li and Kirubarajan 2001, 5.4.2). H (d, 3) is by the pose,
        H_block (d, c) by the states `columns` (c,); R (d, d). By the NIS, the verdict is "accepted" or "gate", and
        no landmark is set; the model may change both. Raises LocfuseError if S is not positive definite.
        """


class ModelResults(NamedTuple):
    """Maps, landmarks, jumps and loops that a model found in a run."""

    first_map: Sequence[MapLine] = ()  # after the first scan
    final_map: Sequence[MapLine] = ()
    points: Sequence[tuple[int, float, float]] = ()  # id, x, y [m, map frame] of the landmarks in an estimated map
    jumps: Sequence[Jump] = ()  # corrections of the pose without motion, such as corrected slips
    lost: Sequence[tuple[float, float]] = ()  # s: intervals in which the robot was reported as lost
    loops: Sequence[SeenAgain] = ()  # loop closures, in order of time


class Model:
    """Measurement model of one sensor in one run of the filter; it may also keep a map."""

    joint: bool = False  # whether it adds states other than its blocks during the drive
    local: bool = False  # whether it observes the pose in the local frame, not in the map frame
    maps: bool = False  # whether it may build a map, with which a local frame begins
    leads: bool = False  # whether it builds several maps, one after another; then no other model begins a frame
    teaches: bool = True  # whether readings that only listen (fuse) may correct its states

    def blocks(self) -> list[Block]:
        """Return the state blocks that this sensor adds at the start of a run."""
        return []

    def begin(self, given: Sequence[MapLine], belief: Any) -> None:
        """Load the line map of an earlier run. Raises LocfuseError if a map is needed but missing."""

    def meet(self, others: Mapping[str, Model]) -> None:
        """Link the other models of the run, by sensor name; a model may use the map of another one."""

    def rolled(self, u: Sequence[float]) -> None:
        """Process the wheel motion (x [m], y [m], theta [rad]) since the previous update time."""

    def begins_map(self, m: Measurements, i: int) -> bool:
        """Return whether reading i starts a map of this sensor, so that the local frame may begin."""
        return False

    def innovations(self, m: Measurements, i: int, belief: Any) -> Sequence[Innovation] | SightLines:
        """Return the innovations of reading i relative to the prior; those with verdict 0 correct the filter.

        A scan of lines has many rows: it stores them in columns, for speed.
        """
        raise NotImplementedError

    def learn(self, m: Measurements, i: int, belief: Any) -> None:
        """Update the model (e.g. its map) with reading i, after the correction of the pose."""

    def begin_next_map(self, belief: Any) -> None:
        """Start a new map if the present one is full; the local frame may change.

        Called after all readings of an update time, only for a model that `leads`.
        """

    def results(self, belief: Any) -> ModelResults:
        """Return maps, landmarks, jumps and loops of this run for the report; `belief` is the last one."""
        return ModelResults()

    def notes(self, belief: Any) -> list[str]:
        """Return notes on this run for the report; `belief` is the last one."""
        return []


def given_or_state(given: float | None, state: str, belief: Belief) -> tuple[float, tuple[int, ...]]:
    """Return a value and the columns of its state: `given` and none if it is configured, else the estimate."""
    if given is not None:
        return given, NO_COLUMNS
    column = belief.column(state)
    return belief.value(column), (column,)


class Ask(NamedTuple):
    """Text of `locfuse init` for a setting that a log does not contain: how to find its value."""

    words: str  # unit, and how to measure it
    needed: bool = False  # whether the sensor cannot be used without the setting
    blank: bool = False  # whether the value is left blank, since a default would look like a measured value


class Bias(NamedTuple):
    """Setting that corrects a constant error of a sensor's readings."""

    key: str  # setting, in the unit of the sensor's first component
    sign: float  # sign of the setting's change for a positive mean innovation
    estimated: bool = False  # whether the filter estimates the error if the setting is left out
    sigma: str | None = None  # setting of the error's standard deviation, same unit; above 0 the error is a state


class Reversal(NamedTuple):
    """Reason why a sensor turns opposite to the wheels, and the settings that fix it."""

    why: str
    sets: Mapping[str, Any] = {}


class FoundStart(NamedTuple):
    """Pose of the robot at the first wheel reading, found by a sensor with a known map."""

    pose: Array  # (3,) x, y [m], theta [rad], map frame
    sigma_xy: float  # m
    sigma_theta: float  # rad


class Sensor(ABC):
    """Base class of a sensor: one file in `fusion/sensors` and one line in the registry there.

    It must define `name`, `Settings`, `reads`, `noise_keys`, `components`, `colour`, `measure` and `model`. An
    instance has no state: the estimates of a run are in its `Model`.
    """

    # ---- description of the sensor, and its topics ----

    name: ClassVar[str]  # name in `--sensors`, and of the table in robot.toml
    Settings: ClassVar[type[SensorSettings]]  # settings of that table, with their defaults
    reads: ClassVar[Mapping[str, tuple[str, ...]]]  # message type -> paths of the fields that `measure` reads
    # message type -> words, one of which the topic must contain, for types of bare numbers
    named: ClassVar[Mapping[str, tuple[str, ...]]] = {}
    # message types that are used by default only if the log has none of the other types
    second_best: ClassVar[tuple[str, ...]] = ()
    several: ClassVar[bool] = False  # whether all topics of these types form one sensor, such as a ring of sonars
    # whether topics of one type with different frames form one sensor, such as several cameras
    several_frames: ClassVar[bool] = False
    in_blocks: ClassVar[bool] = False  # whether the readings are read in blocks, to save memory
    costly: ClassVar[bool] = False  # whether `locfuse info` leaves the sensor out because measuring takes long
    # why the sensor is used only if its topic is configured; "": it is used by default
    asked_only: ClassVar[str] = ""
    # words of topics that come last if several fit; None: several topics are an error
    unlikely: ClassVar[tuple[str, ...] | None] = None
    extra: ClassVar[bool] = False  # whether the sensor is left out, without an error, if its topic is unclear
    # sensor that this one depends on -> reason, such as "held against the map of lrf"
    needs: ClassVar[Mapping[str, str]] = {}

    def carries(self, stream: Stream) -> bool:
        """Return whether a topic has readings of this sensor; called if several topics are possible."""
        return True

    def missing(self, settings: Any) -> str | None:
        """Return a message about a required setting that is missing; None if none is missing."""
        return None

    # ---- how it measures ----

    @abstractmethod
    def measure(self, stream: Stream, settings: Any, wheels: WheelMotion, epoch_ns: int) -> Measurements:
        """Return the measurements of a stream, independent of the robot's pose, in SI units and time order.

        Raises LocfuseError for unusable readings.
        """

    def again(self, before: Measurements, settings: Any, epoch_ns: int) -> Measurements | None:
        """Return the result of `measure` with `settings`, computed from `before`, its result with other settings.

        None if `measure` must be called again.
        """
        return None

    @abstractmethod
    def model(self, settings: Any) -> Model:
        """Return the filter model of this sensor for a new run."""

    def start(self, m: Measurements, settings: Any, wheels: WheelMotion) -> FoundStart | None:
        """Return the robot's start pose from the readings and a known map; None for a sensor without a known map.

        Raises LocfuseError if the start is ambiguous.
        """
        return None

    def heading(self, m: Measurements) -> tuple[Array, Array] | None:
        """Return times (n,) [s] and headings (n,) [rad, unwrapped, up to a constant] from this sensor alone.

        None for a sensor that does not measure turns. Used to find clock lags, mirrored wheels and the track.
        """
        return None

    def misfit(self, m: Measurements, settings: Any, poses: Array) -> float | None:
        """Return the spread of the readings about their predictions from poses (n, 3), in any unit.

        None if poses do not determine the readings. Used to compare the clocks of truth and sensor.
        """
        return None

    # whether an unchanged heading means that the turn is unknown (a scan that matches no line)
    heading_holds: ClassVar[bool] = False

    def reversal(self, settings: Any, msgtype: str) -> Reversal:
        """Return the reason why this sensor may turn opposite to the wheels, and the settings that fix it."""
        if not hasattr(settings, "roll_deg"):
            return Reversal("its sense of turning is wrong")
        return Reversal("it is mounted upside-down", {"roll_deg": (settings.roll_deg + 180.0) % 360.0})

    # ---- its noise and its errors ----

    # settings of the noise of one reading; the first in the unit of the first component (deg, else SI)
    noise_keys: ClassVar[tuple[str, ...]]
    measures_by_sigma: ClassVar[bool] = False  # whether measurements depend on sigma, as lines of a scan do
    bias: ClassVar[Bias | None] = None  # setting that corrects a constant error
    # setting of the random walk of that error, per sqrt(s), if it is estimated
    drift_key: ClassVar[str | None] = None
    scale_key: ClassVar[str | None] = None  # setting that measured distances are multiplied by

    def brings_covariance(self, m: Measurements) -> bool:
        """Return whether the readings contain their own covariance, so that no sigma has to be tuned.

        Default: whether the extra column "has_covariance" is nonzero in any row.
        """
        return "has_covariance" in m.extra and bool(m.extra["has_covariance"].any())

    def claimed(self, m: Measurements) -> dict[str, float]:
        """Return the sigmas (rms) that messages claim, by noise key; {} if they do not, or for no position."""
        if not self.locates or not self.brings_covariance(m):
            return {}
        mean = m.R.mean(axis=0)
        variances = [float(mean[i, i]) * c.scale**2 for i, c in enumerate(self.components)]
        parts = variances[:2], variances[2:]  # of a position, of a heading
        return {key: math.sqrt(sum(part) / len(part)) for key, part in zip(self.noise_keys, parts, strict=False)}

    # ---- its mount ----

    placed: ClassVar[bool] = False  # whether `locfuse info` warns if the mount on the base is unknown

    def mount(self, settings: Any) -> tuple[float, float, float]:
        """Return the mount on the base: x [m], y [m], yaw [rad]; zeros for a sensor without these settings."""
        if not hasattr(settings, "x") or not hasattr(settings, "y"):
            return 0.0, 0.0, 0.0
        return settings.x, settings.y, math.radians(getattr(settings, "yaw_deg", 0.0))

    # ---- texts of `locfuse init` and `locfuse info` ----

    asks: ClassVar[Mapping[str, Ask]] = {}  # setting -> how its owner can find its value
    guesses: ClassVar[Mapping[str, str]] = {}  # setting that no log contains -> meaning of its default

    def concerns(self, key: str, msgtype: str) -> bool:
        """Return whether a setting applies to messages of this type ("": no topic)."""
        return True

    sees: ClassVar[str] = "value"  # noun for one measurement: line, echo
    blind_is_severe: ClassVar[bool] = False  # whether readings without measurements mean wrong settings

    # ---- display of the sensor ----

    components: ClassVar[tuple[Component, ...]]  # names, units and scales of the d numbers of a measurement (d,)
    # state block -> names, units and scales of its numbers
    states: ClassVar[Mapping[str, tuple[Component, ...]]] = {}
    colour: ClassVar[Colour]  # colour of this sensor in all figures
    # picture of a measurement on the map: ray along the heading, ray to a landmark, wall segments; "": none
    drawn: ClassVar[Literal["heading", "bearing", "segments", ""]] = ""

    def landmark(self, settings: Any) -> tuple[float, float] | None:
        """Return the position of the landmark (x, y) [m, map frame] for a sensor of one landmark, else None."""
        return None

    locates: ClassVar[bool] = False  # whether the sensor observes the position, not only turns or motion
