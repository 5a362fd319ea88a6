"""What a sensor is: settings (its TOML table), what it reads, its measurements, and its model in the filter."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Literal, NamedTuple, Protocol

import msgspec

from locfuse.fusion.kernels.ekf import Innovation
from locfuse.fusion.kernels.sight import Audit

from .data import (
    VERDICTS,
    Array,
    Colour,
    Component,
    Ints,
    Jump,
    LocfuseError,
    MapLine,
    Measurements,
    SeenAgain,
    Stream,
)

GATE = VERDICTS.index("gate")
Row = tuple[float, ...]
Matrix = tuple[Row, ...]
NO_COLUMNS: tuple[int, ...] = ()  # of what depends on no state but the pose
NO_BLOCK: Matrix = ()
PoseRows = tuple[tuple[float, float, float], ...]  # (d, 3) derivatives by x [m], y [m], theta [rad] of the pose


class SensorSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Keys that every sensor's table has; SI units, angles in degrees where the key ends in `_deg`."""

    topic: str | None = None  # not set: the only topic of a type the sensor reads
    time_offset: float = 0.0  # s, added to the stamps of this sensor
    gate: float = 0.9999  # confidence of the chi-square gate: one good reading in 10 000 is lost; 1 accepts all
    outliers: Literal["reject", "inflate"] = "reject"  # beyond the gate: refused, or R grown until they fit

    only_fused: ClassVar[frozenset[str]] = frozenset({"gate", "outliers"})  # keys that no measurement depends on

    # keys that must be above 0, of those that a sensor has
    positive: ClassVar[tuple[str, ...]] = ("sigma", "sigma_deg", "sigma_range")

    def __post_init__(self) -> None:
        """Refuse a sensor without noise: P would become singular, or worse by rounding."""
        for key in self.positive:
            if getattr(self, key, 1.0) <= 0.0:
                raise ValueError(f"{key} = {getattr(self, key)}: no sensor is exact, it must be positive")


class WheelMotion(Protocol):
    """Relative motion of the robot by its wheels: the only motion that `measure` may use."""

    @property
    def track(self) -> float:
        """Distance between the wheels [m]."""

    def relative(self, t_from: Array, t_to: Array) -> Array:
        """Return the pose (n, 3) at t_to relative to that at t_from, both (n,) s since the drive's epoch."""

    def heading(self, t: Array) -> Array:
        """Return the heading (...) [rad, not wrapped] by the wheels alone at times t (...) within the drive."""

    def slips(self, t: Array) -> Array:
        """Return the variances (..., k - 1, 2) [m^2] of either wheel's distance between times t (..., k) [s]."""


class Equation(NamedTuple):
    """y = H dx + noise of covariance R."""

    y: Array  # (m,)
    columns: Ints  # (c,) of the state; a column may stand there twice
    H: Array  # (m, c)
    R: Array  # (m, m)


class Reading:
    """The judged rows of a reading in columns: an object per row would be slower than the filter."""

    row: int  # of the first in Measurements.z
    lines: int  # rows of the measurements
    accepted: int  # of them, that correct the filter
    first: int  # where their equation begins in the state's table
    numbers: int  # of that equation

    def write(self, audit: Audit, at: int, instant: int, row: int) -> None:
        """Write the verdict on every row into the columns of an audit, from `at` on."""
        raise NotImplementedError

    def rows_used(self) -> list[int]:
        """Return the accepted rows of Measurements.z, in the order of their equation."""
        raise NotImplementedError


def positive(greatest: float) -> None:
    """Raise LocfuseError if an innovation covariance is not positive definite: then `greatest` is not above 0."""
    if not greatest > 0.0:
        raise LocfuseError(
            f"an innovation covariance became singular (variances of up to {-greatest:.0e}): check the values of "
            "sigma and floor in robot.toml"
        )


class Block(NamedTuple):
    """A named part of the state that a sensor owns (compass offset, gyro bias, line map)."""

    name: str
    x: Array  # (k,) start
    P: Array  # (k, k) start covariance
    drift: Array  # (k,) variance per second of its random walk


class Belief(Protocol):
    """The part of the filter's state that a model may read: pose, covariance, and its own block."""

    @property
    def x(self) -> float:
        """X of the pose [m]."""

    @property
    def y(self) -> float:
        """Y of the pose [m]."""

    @property
    def theta(self) -> float:
        """Heading of the pose [rad], not wrapped."""

    def pose(self) -> tuple[float, float, float]:
        """Return x [m], y [m] and theta [rad, not wrapped] of the pose."""

    def block(self, name: str) -> tuple[int, Sequence[float] | Array]:
        """Return (first state column, values) of a block."""

    def column(self, name: str) -> int:
        """Return the first state column of a block."""

    def value(self, column: int) -> float:
        """Return the state at a column."""

    def variance(self, H: Row, columns: tuple[int, ...] = (), H_block: Row = ()) -> float:
        """Return H P H' for one derivative H (3,) by the pose and H_block (c,) by the states `columns` (c,)."""

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
        """Compare the innovation y (d,) of measurement `row` with the gate `threshold`.

        S = H P H' + R and NIS = y' S^-1 y (Bar-Shalom, Li and Kirubarajan 2001, 5.4.2). H (d, 3) is by the pose,
        H_block (d, c) by the states `columns` (c,), R (d, d). The verdict is "accepted" or "gate" by the NIS, and
        no landmark is named: a sensor that knows better sets them. Raises LocfuseError where S is not positive.
        """


class Model:
    """One sensor in one run of the filter; keeps what it estimates (a map), never the pose."""

    joint: bool = False  # whether it adds states while driving, beyond its blocks
    local: bool = False  # whether it observes the pose in the run's local frame, as lines of its own map do
    maps: bool = False  # whether it may make a map of its own, with which a local frame begins
    leads: bool = False  # whether its maps begin one after another: where it is used, no other begins a frame
    teaches: bool = True  # whether the states that it names are its own: then readings that listen correct them

    def blocks(self) -> list[Block]:
        """Return the state blocks this sensor adds at the start."""
        return []

    def begin(self, given: Sequence[MapLine], belief: Any) -> None:
        """Load a map that was made before this run. Raises LocfuseError if it is needed and missing."""

    def meet(self, others: Mapping[str, Model]) -> None:
        """Receive the other models of the run, by sensor name; a model may use the map of another one."""

    def rolled(self, u: Sequence[float]) -> None:
        """Receive the wheels' motion (x [m], y [m], theta [rad]) since the instant before, in its frame."""

    def begins_map(self, m: Measurements, i: int) -> bool:
        """Return whether reading i is the first of a map of its own: the local frame may begin at its instant."""
        return False

    def innovations(self, m: Measurements, i: int, belief: Any) -> Sequence[Innovation] | Reading:
        """Compare reading i with the prior belief. Verdict 0 ("accepted") corrects the filter."""
        raise NotImplementedError

    def learn(self, m: Measurements, i: int, belief: Any) -> None:
        """Update the model by reading i (new map lines), after the correction of the pose."""

    def begin_next_map(self, belief: Any) -> bool:
        """Replace a map that is full by the next one, after all readings of an instant were used.

        Only asked of a model that `leads`. Return whether it did: the local frame may have moved on.
        """
        return False

    def lines(self, belief: Any) -> tuple[list[MapLine], list[MapLine]]:
        """Return the map after the first scan and the map at the end, for the report."""
        return [], []

    def points(self, belief: Any) -> list[tuple[int, float, float]]:
        """Return id and place x, y [m, map frame] of every landmark that the run placed."""
        return []

    def jumps(self) -> list[Jump]:
        """Return the corrections of the pose that are no motion."""
        return []

    def lost_intervals(self) -> list[tuple[float, float]]:
        """Return when the robot was lost by this sensor, (start, end) [s]."""
        return []

    def closed_loops(self) -> list[SeenAgain]:
        """Return the places that were recognised, in order of time."""
        return []

    def notes(self, belief: Any) -> list[str]:
        """Return notes on this run for its report, given the last belief."""
        return []


class Ask(NamedTuple):
    """The text of `locfuse init` for a key that no log shows: how to find its value."""

    words: str  # unit, and how to measure it
    needed: bool = False  # whether nothing of this table can be used without the key
    blank: bool = False  # whether its default is no answer: zero looks as if somebody had measured it


class Bias(NamedTuple):
    """The key of robot.toml that corrects a constant error of the readings."""

    key: str  # in the unit of the sensor's first component
    sign: float  # of the key's change by the mean innovation (measured - predicted)
    estimated: bool = False  # whether the filter estimates it where the key is left out
    sigma: str | None = None  # the key of its standard deviation, in the same unit: above 0 the error is a state


class Reversal(NamedTuple):
    """Why a sensor turns opposite to the wheels, and the settings that correct it."""

    why: str
    sets: Mapping[str, Any] = {}


class FoundStart(NamedTuple):
    """The robot's pose at the first wheel reading, found by a sensor with a known map."""

    pose: Array  # (3,) x, y [m], theta [rad], map frame
    sigma_xy: float  # m
    sigma_theta: float  # rad


class Sensor(ABC):
    """A sensor: one file in `fusion/sensors` and one line in the registry there, with all its code.

    It gives `name`, `Settings`, `reads`, `noise_keys`, `components`, `colour`, `measure` and `model`. What else it
    may say has a default. An instance holds nothing: what a run estimates lies in its `Model`.
    """

    # ---- what it is, and what it reads ----

    name: ClassVar[str]
    """Its word in `--sensors`, and its table in robot.toml."""

    Settings: ClassVar[type[SensorSettings]]
    """The keys of that table, with their defaults."""

    reads: ClassVar[Mapping[str, tuple[str, ...]]]
    """Message type -> paths of the fields that `measure` reads."""

    named: ClassVar[Mapping[str, tuple[str, ...]]] = {}
    """Message type -> words, one of which its topic must hold: a bare number does not say what it is."""

    second_best: ClassVar[tuple[str, ...]] = ()
    """Message types that are read unasked only where the log holds none of its other types."""

    several: ClassVar[bool] = False
    """All topics of its types are one sensor: a ring of sonars."""

    several_frames: ClassVar[bool] = False
    """All topics of one of its types are one sensor where each has a frame of its own: cameras of a robot."""

    in_blocks: ClassVar[bool] = False
    """Its readings are too big to be in memory at once."""

    costly: ClassVar[bool] = False
    """Measuring takes so long that `locfuse info` leaves it out."""

    asked_only: ClassVar[str] = ""
    """Why it is used only where its topic is named: it may repeat what another sensor says. "": it is not."""

    unlikely: ClassVar[tuple[str, ...] | None] = None
    """Words of topics that come last where several fit and one is taken unasked; None: several are an error."""

    extra: ClassVar[bool] = False
    """It lies beside the paper's sensors: where its topic is unclear it is absent, and the others run."""

    needs: ClassVar[Mapping[str, str]] = {}
    """Sensor without which this one says nothing -> why: "held against the map of lrf"."""

    def carries(self, stream: Stream) -> bool:
        """Return whether a topic of its types holds readings of this sensor; used if several topics fit."""
        return True

    def missing(self, settings: Any) -> str | None:
        """Return the setting that is missing and how to find it, or None."""
        return None

    # ---- how it measures ----

    @abstractmethod
    def measure(self, stream: Stream, settings: Any, wheels: WheelMotion, epoch_ns: int) -> Measurements:
        """Turn readings into measurements free of any pose, in SI units and time order.

        Raises LocfuseError where they cannot be understood.
        """

    def again(self, before: Measurements, settings: Any, epoch_ns: int) -> Measurements | None:
        """Return the result of `measure` under new settings, computed from the result under other settings.

        None where the readings have to be looked at again.
        """
        return None

    @abstractmethod
    def model(self, settings: Any) -> Model:
        """Return its model for a new run of the filter."""

    def start(self, m: Measurements, settings: Any, wheels: WheelMotion) -> FoundStart | None:
        """Return the start of the drive by its readings and a known map; None for a sensor without such a map.

        Raises LocfuseError where the readings leave several starts.
        """
        return None

    def heading(self, m: Measurements) -> tuple[Array, Array] | None:
        """Return times (n,) [s] and headings (n,) [rad, unwrapped, up to a constant] by its own turning.

        None where it does not turn by itself. Clock lags, mirrored wheels and the track are found by it.
        """
        return None

    def misfit(self, m: Measurements, settings: Any, poses: Array) -> float | None:
        """Return how badly its readings fit the robot's poses (n, 3) at their times: a spread in any unit.

        None where poses do not say what it should read. A truth's clock is held against a sensor's by it.
        """
        return None

    heading_holds: ClassVar[bool] = False
    """Whether an unchanged heading means that the turn is unknown (a scan that matches no line)."""

    def reversal(self, settings: Any, msgtype: str) -> Reversal:
        """Return why its heading turns opposite to the wheels, and the settings that fix it."""
        if not hasattr(settings, "roll_deg"):
            return Reversal("its sense of turning is wrong")
        return Reversal("it is mounted upside-down", {"roll_deg": (settings.roll_deg + 180.0) % 360.0})

    # ---- its noise and its errors ----

    noise_keys: ClassVar[tuple[str, ...]]
    """Settings that say how exact one reading is; the first in the unit of its first component (deg, else SI)."""

    measures_by_sigma: ClassVar[bool] = False
    """Another sigma means other measurements: lines are cut by it."""

    bias: ClassVar[Bias | None] = None
    """The setting that takes out a constant error."""

    drift_key: ClassVar[str | None] = None
    """The setting by which that error, estimated, may drift: a random walk, per sqrt(s)."""

    scale_key: ClassVar[str | None] = None
    """The setting by which what it measures in metres is multiplied."""

    def brings_covariance(self, m: Measurements) -> bool:
        """Return whether readings come with their own covariance: then no sigma is tuned.

        By default where a column "has_covariance" of their extra ones marks such rows.
        """
        return "has_covariance" in m.extra and bool(m.extra["has_covariance"].any())

    # ---- where it sits ----

    placed: ClassVar[bool] = False
    """`locfuse info` warns where nothing tells where it sits on the base."""

    def mount(self, settings: Any) -> tuple[float, float, float]:
        """Return its mount on the base: x [m], y [m], yaw [rad]; 0 where it has no keys x, y, yaw_deg."""
        if not hasattr(settings, "x") or not hasattr(settings, "y"):
            return 0.0, 0.0, 0.0
        return settings.x, settings.y, math.radians(getattr(settings, "yaw_deg", 0.0))

    # ---- what `locfuse init` and `locfuse info` say of it ----

    asks: ClassVar[Mapping[str, Ask]] = {}
    """Key -> what its owner has to find out."""

    guesses: ClassVar[Mapping[str, str]] = {}
    """Key that no log states and whose default holds until somebody says otherwise -> what the default means."""

    def concerns(self, key: str, msgtype: str) -> bool:
        """Return whether a key applies to messages of this type ("" without a topic)."""
        return True

    sees: ClassVar[str] = "value"
    """What one reading measures, in one word: line, echo."""

    blind_is_severe: ClassVar[bool] = False
    """Readings that measure nothing mean that it is set up wrongly, not that nothing was there."""

    # ---- how it is shown ----

    components: ClassVar[tuple[Component, ...]]
    """Names, units and scales of the d numbers of a measurement (d,)."""

    states: ClassVar[Mapping[str, tuple[Component, ...]]] = {}
    """State block -> names, units and scales of its numbers."""

    colour: ClassVar[Colour]
    """Its own in every figure, whatever else a log holds."""

    drawn: ClassVar[Literal["heading", "bearing", "segments", ""]] = ""
    """What a measurement is on the map: a ray ahead, a ray to what it saw, pieces of walls; "" is nothing."""

    def landmark(self, settings: Any) -> tuple[float, float] | None:
        """Return the point of the map that it measures to, (x, y) [m]; None without one."""
        return None

    locates: ClassVar[bool] = False
    """Whether it says where the robot is, and not only how it turns or moves: it can judge other sensors."""

    @property
    def measures_metres(self) -> bool:
        """Whether its distances depend on the same scale as the wheels'."""
        return any(c.unit == "m" for c in self.components)
