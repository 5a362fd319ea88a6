"""Faults of a simulated drive, active between `start` and `end`, and their labels in the log.

Random streams are not shared, so a fault does not change the random numbers of other sensors. Faults act on
messages (`MessageFault`), between wheels and ground (`GroundFault`), on a sensor's mount (`Displaced`), on the
frame of the truth (`TruthStep`), and in the scene and the counters (the rest).
"""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal, NamedTuple

import msgspec
import numpy as np

from locfuse.fusion.data import Array

from .table import RED, Colour, NotNegative, Pillar, Point, Positive, ScenarioTable, Share

SensorWord = Literal["wheels", "compass", "lrf", "camera", "sonar", "gps", "truth"]
Side = Literal["left", "right"]


class Interval(ScenarioTable, frozen=True, tag_field="kind"):
    """Fault that is active from `start` to `end` [s]; by default during the whole drive."""

    start: float = 0.0
    end: float = math.inf

    def active(self, t: float) -> bool:
        """Return whether the fault is active at t [s]."""
        return self.start <= t < self.end

    def __post_init__(self) -> None:
        if self.end <= self.start:
            raise ValueError(f"end = {self.end:g} must come after start = {self.start:g}")


class Dates(NamedTuple):
    """Times of one message [s]: true time of the reading, stamp, and arrival."""

    taken: float
    stamp: float
    arrival: float


class MessageFault(Interval, frozen=True, kw_only=True):
    """Fault of a sensor's messages."""

    sensor: SensorWord

    def dated(self, dates: Dates, rng: np.random.Generator) -> Dates | None:
        """Return the times of a message with the fault; None if the message is lost."""
        raise NotImplementedError


class Dropout(MessageFault, frozen=True, kw_only=True, tag="dropout"):
    """Fault: all messages of the sensor are lost."""

    def dated(self, dates: Dates, rng: np.random.Generator) -> Dates | None:
        """Return None, since every message is lost."""
        return None


class Latency(MessageFault, frozen=True, kw_only=True, tag="latency"):
    """Fault: messages arrive late, and are stamped at arrival unless `dated_on_arrival` is false."""

    seconds: float
    dated_on_arrival: bool = True

    def dated(self, dates: Dates, rng: np.random.Generator) -> Dates | None:
        """Return the times with a later arrival, and a later stamp if it is set at arrival."""
        later = self.seconds if self.dated_on_arrival else 0.0
        return Dates(dates.taken, dates.stamp + later, dates.arrival + self.seconds)


class ClockOffset(MessageFault, frozen=True, kw_only=True, tag="clock_offset"):
    """Fault: the sensor's clock has an offset, a drift, or jitter; messages arrive in time."""

    seconds: float = 0.0  # s by which stamps are too late at `start`
    drift_ppm: float = 0.0  # growth of the offset, microseconds per second
    jitter: NotNegative = 0.0  # s, 1 sigma of each stamp; stamps keep their order

    def dated(self, dates: Dates, rng: np.random.Generator) -> Dates | None:
        """Return the times of a message, with the stamp that the faulty clock gives."""
        ahead = self.seconds + 1e-6 * self.drift_ppm * (dates.taken - self.start)
        return dates._replace(stamp=dates.stamp + ahead + self.jitter * rng.standard_normal())


class Displaced(Interval, frozen=True, kw_only=True, tag="displaced"):
    """Fault: the sensor's true mount differs from robot.toml, as after a bump.

    For the truth it moves the tracked point; for a compass only the turn has an effect.
    """

    sensor: SensorWord
    x: float = 0.0  # m, forward, left and counter-clockwise, in the base frame
    y: float = 0.0
    yaw_deg: float = 0.0
    yaw_deg_per_s: float = 0.0  # the turn continues from `start` on

    def shift(self, t: Array) -> Array:
        """Return the changes of the sensor's mount at times t (n,) [s], (n, 3): forward, left [m], turn [rad]."""
        active = (self.start <= t) & (t < self.end)
        turn = np.radians(self.yaw_deg + self.yaw_deg_per_s * np.where(active, t - self.start, 0.0))
        still = np.ones_like(t)
        return np.asarray(active[:, None] * np.stack((self.x * still, self.y * still, turn), axis=-1))


class TruthStep(Interval, frozen=True, kw_only=True, tag="truth_step"):
    """Fault: the frame of the truth moves at `start`, and back at `end`, as after a new calibration."""

    x: float = 0.0  # m, in the map frame
    y: float = 0.0
    theta_deg: float = 0.0  # about the map's origin


class Magnetic(Interval, frozen=True, kw_only=True, tag="magnetic"):
    """Fault: a magnet in the room (a motor, a steel cabinet), as a dipole in the horizontal plane."""

    x: float
    y: float
    strength: float  # T at 1 m across the axis of the dipole; along the axis it is twice this
    axis_deg: float = 0.0  # of the dipole, map frame

    def field(self, at: Array) -> Array:
        """Return the magnet's field (n, 2) [T] at points (n, 2) [m, map frame]."""
        r = at - (self.x, self.y)
        distance = np.maximum(np.hypot(r[:, 0], r[:, 1]), 0.1)[:, None]
        axis = np.array([math.cos(math.radians(self.axis_deg)), math.sin(math.radians(self.axis_deg))])
        unit = r / distance
        return np.asarray(self.strength * (3 * (unit @ axis)[:, None] * unit - axis) / distance**3)


class GroundFault(Interval, frozen=True, kw_only=True):
    """Fault between the wheels and the ground."""

    def moved(self, ways: Array, heading: float) -> Array:
        """Return the distances (3, k) [m]: left wheel, right wheel, and sideways to the left.

        Args:
            ways: (3, k) m, these distances without the fault.
            heading: rad, of the robot in the map.
        """
        raise NotImplementedError


class Slip(GroundFault, frozen=True, kw_only=True, tag="slip"):
    """Fault: one or both wheels move the robot less than they roll."""

    wheel: Side | Literal["both"]
    ratio: Share  # lost share of the rolled distance; 1: the wheel spins on the spot

    def moved(self, ways: Array, heading: float) -> Array:
        """Return the distances (3, k) [m], with those of slipping wheels reduced."""
        left, right = (1.0 - self.ratio * (self.wheel in {side, "both"}) for side in ("left", "right"))
        return np.asarray(ways * np.array([[left], [right], [1.0]]))


class Creep(GroundFault, frozen=True, kw_only=True, tag="creep"):
    """Fault: the robot moves sideways as it drives, by its tyres or on a slope."""

    ratio: float  # m to the left per metre forward
    downhill_deg: float | None = None  # downhill direction of a slope, map frame: then `ratio` acts downhill

    def moved(self, ways: Array, heading: float) -> Array:
        """Return the distances (3, k) [m] with sideways motion added; a slope also changes wheel distances."""
        forward = (ways[0] + ways[1]) / 2
        if self.downhill_deg is None:
            return np.asarray(ways + self.ratio * forward * np.array([[0.0], [0.0], [1.0]]))
        fall, down = self.ratio * np.abs(forward), math.radians(self.downhill_deg) - heading
        return np.asarray(ways + fall * np.array([[math.cos(down)], [math.cos(down)], [math.sin(down)]]))


class People(Interval, frozen=True, kw_only=True, tag="people"):
    """Fault: a person (two legs and a body) walks along `path` at constant speed."""

    path: tuple[Point, ...]
    colour: Colour = (40, 60, 110)
    stride: Positive = 0.7  # m, of one step

    def __post_init__(self) -> None:
        super().__post_init__()
        if math.isinf(self.end) or len(self.path) < 2:
            raise ValueError("a walk needs an `end` and at least two points in its `path`")

    def solids(self, t: float) -> tuple[Pillar, ...]:
        """Return legs and body of the person at t [s] as cylinders."""
        p = np.array(self.path)
        gone = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(p, axis=0).T))))
        way = gone[-1] * (t - self.start) / (self.end - self.start)
        x, y = float(np.interp(way, gone, p[:, 0])), float(np.interp(way, gone, p[:, 1]))
        i = min(int(np.searchsorted(gone, way, side="right")) - 1, len(p) - 2)
        ahead = (p[i + 1] - p[i]) / (gone[i + 1] - gone[i])
        swing = self.stride / 2 * math.sin(math.pi * way / self.stride)
        legs = []
        for side in (-1, 1):
            lx = x + side * (swing * ahead[0] - 0.1 * ahead[1])
            ly = y + side * (swing * ahead[1] + 0.1 * ahead[0])
            legs.append(Pillar(x=lx, y=ly, radius=0.07, top=0.8, colour=(30, 30, 45)))
        return *legs, Pillar(x=x, y=y, radius=0.2, bottom=0.8, top=1.7, colour=self.colour)


class HiddenLandmark(Interval, frozen=True, kw_only=True, tag="hidden_landmark"):
    """Fault: the landmark is covered by a grey cloth, so that the camera sees no red."""

    colour: Colour = (120, 120, 118)


class RedObject(Interval, frozen=True, kw_only=True, tag="red_object"):
    """Fault: a second red object in the room."""

    x: float
    y: float
    radius: float = 0.06
    bottom: float = 0.0
    top: float = 1.6
    colour: Colour = RED

    def pillar(self) -> Pillar:
        """Return the object as a cylinder."""
        return Pillar(x=self.x, y=self.y, radius=self.radius, bottom=self.bottom, top=self.top, colour=self.colour)


class Kidnap(Interval, frozen=True, kw_only=True, tag="kidnap"):
    """Fault: a person carries the robot by (x, y) [m] and theta_deg in the map frame."""

    x: float
    y: float
    theta_deg: float = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if math.isinf(self.end):
            raise ValueError("a kidnapping needs an `end`")


class EncoderRollover(Interval, frozen=True, kw_only=True, tag="encoder_rollover"):
    """Fault: the published counters have `bits` bits and wrap, as signed integers."""

    bits: Annotated[int, msgspec.Meta(ge=8, le=32)] = 16


class EncoderSpike(Interval, frozen=True, kw_only=True, tag="encoder_spike"):
    """Fault: readings of one counter are too large by `counts`."""

    wheel: Side
    counts: int = 5000


Fault = (
    Dropout
    | Latency
    | ClockOffset
    | Displaced
    | TruthStep
    | Magnetic
    | Slip
    | Creep
    | People
    | HiddenLandmark
    | RedObject
    | Kidnap
    | EncoderRollover
    | EncoderSpike
)


def label(fault: Fault, event: str) -> str:
    """Return the JSON label of a fault: the event ("begin" or "end") and the settings of the fault."""
    table: dict[str, Any] = msgspec.to_builtins(fault)
    if math.isinf(table["end"]):
        table["end"] = None
    return msgspec.json.encode({"event": event, **table}).decode()
