"""Compass: the robot's heading from the magnetic field; its constant offset is a state of the filter.

The field's direction in the map is not known to a tenth of a degree, and the module's 0.1° is its resolution,
not its accuracy (docs/paper.md). So theta = measured heading - offset, and the offset is estimated unless given.
A magnetometer's field is levelled first if an IMU shows that the robot tilts (magnetic.py).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar, Literal

import numpy as np

from locfuse.fusion.data import Array, Colour, Component, LocfuseError, Measurements, RowVerdict, Stream
from locfuse.fusion.kernels.ekf import Innovation
from locfuse.fusion.mount import BARE_NUMBERS, NOT_ON_BODY
from locfuse.fusion.se2 import rotated_3d, rotation_3d, wrap, wrap_all
from locfuse.fusion.sensor import (
    NO_BLOCK,
    Ask,
    Belief,
    Bias,
    Block,
    Model,
    Reversal,
    Sensor,
    SensorSettings,
    WheelMotion,
    given_or_state,
)
from locfuse.fusion.statistics import MAD_OF_NORMAL, chi_square
from locfuse.fusion.streams import arrays, count_dropped, seconds, stuck

from .magnetic import LevelledField, levelled

Convention = Literal["enu_rad", "enu_deg", "compass_rad", "compass_deg"]
OFFSET = "compass_offset"
H_HEADING = ((0.0, 0.0, 1.0),)
H_OFFSET = ((1.0,),)
# A disturbance changes the field's strength (relative) about as much as its direction [rad]: a deviation of the
# strength beyond this many sigmas is added to the heading's noise.
FIELD_SIGMAS = 3.0
STUCK_READINGS, STUCK_TURN = 10, math.radians(20.0)  # readings with one heading while the robot turns [rad]
HEADING_TOPICS = ("compass", "heading", "yaw", "azimuth", "bearing", "mag")  # topics of bare headings


class CompassSettings(SensorSettings, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Settings of [compass] in robot.toml."""

    sigma_deg: float = 3.0  # white noise of one reading
    offset_deg: float | None = None  # measured heading minus theta; not set: estimated from the drive
    sigma_offset_deg: float = 0.0  # 1 sigma of offset_deg as prior of the estimated offset; 0: exact
    offset_drift_deg: float = 0.0  # random walk of an estimated offset, degrees per sqrt(s)
    field: str | None = None  # field with the heading in a message of any type, such as "status.yaw"
    unit: Literal["rad", "deg"] | None = None  # of heading messages; not set: that of the convention
    convention: Convention = "enu_rad"  # of headings: 0 = east, ccw; or 0 = north, clockwise (an IMU in NED)
    roll_deg: float = 0.0  # mount on the base, of a magnetometer or an IMU
    pitch_deg: float = 0.0  # degrees, likewise
    yaw_deg: float = 0.0  # degrees, likewise
    hard_iron: tuple[float, float] = (0.0, 0.0)  # centre of the field's circle in the base's plane, message's unit
    soft_iron: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 1.0)  # row by row, applied after hard_iron
    level: bool = True  # if the robot tilts, an IMU of the log rotates the field into the horizontal plane
    field_tolerance: float = 0.25  # largest relative difference of the field's strength from its median

    only_fused: ClassVar[frozenset[str]] = SensorSettings.only_fused | {"sigma_offset_deg"}

    def __post_init__(self) -> None:
        """Raise ValueError if the offset's standard deviation is negative or not a number."""
        super().__post_init__()
        if not 0.0 <= self.sigma_offset_deg < math.inf:
            raise ValueError(f"sigma_offset_deg = {self.sigma_offset_deg} must be 0 (known exactly) or above")


class Compass(Sensor):
    """The compass: reads a magnetometer's axes, an IMU's orientation, or a heading as a bare number."""

    name = "compass"
    Settings = CompassSettings
    components = (Component("heading", "deg", math.degrees(1.0)),)
    states: ClassVar[Mapping[str, tuple[Component, ...]]] = {
        OFFSET: (Component("compass offset", "deg", math.degrees(1.0)),)
    }
    drawn = "heading"
    unlikely = (*NOT_ON_BODY, "raw")
    second_best = BARE_NUMBERS
    colour = Colour("#cb7627", "#ec8c10")
    noise_keys = ("sigma_deg",)
    bias = Bias("offset_deg", 1.0, estimated=True, sigma="sigma_offset_deg")
    drift_key = "offset_drift_deg"
    asks: ClassVar[Mapping[str, Ask]] = {
        "sigma_deg": Ask("noise of one heading"),
        "offset_deg": Ask("left out, it is estimated from the drive; locfuse calibrate finds iron"),
    }
    guesses: ClassVar[Mapping[str, str]] = {
        "convention": "guess: radians, 0 is east and counter-clockwise (enu_deg, compass_rad, compass_deg)"
    }
    reads: ClassVar[Mapping[str, tuple[str, ...]]] = {
        "sensor_msgs/msg/MagneticField": ("magnetic_field.x", "magnetic_field.y", "magnetic_field.z"),
        "sensor_msgs/msg/Imu": (*(f"orientation.{axis}" for axis in "xyzw"), "orientation_covariance"),
        **dict.fromkeys(BARE_NUMBERS, ("data",)),
    }
    named: ClassVar[Mapping[str, tuple[str, ...]]] = dict.fromkeys(BARE_NUMBERS, HEADING_TOPICS)

    def carries(self, stream: Stream) -> bool:
        """Return whether a topic holds headings that change; many IMUs leave their orientation empty."""
        if stream.msgtype != "sensor_msgs/msg/Imu":
            return True
        columns = arrays(stream, *self.reads[stream.msgtype])
        heading, _ = from_imu(columns, CompassSettings(), stream.topic, refuse=False)
        return bool(np.isfinite(heading).any() and np.ptp(heading[np.isfinite(heading)]) > 0.0)

    def measure(
        self, stream: Stream, settings: CompassSettings, wheels: WheelMotion, epoch_ns: int
    ) -> Measurements:
        """Measure headings z (n, 1) [rad], in the frame of the magnetic field."""
        fields = self.reads[stream.msgtype]
        up = stream.up if isinstance(stream, LevelledField) else None
        is_field = stream.msgtype.endswith("MagneticField")
        if is_field and not settings.roll_deg and not settings.pitch_deg and up is None:
            fields = fields[:2]  # a horizontal sensor needs no third axis
        columns = arrays(stream, *fields)
        if is_field:
            heading, strength = from_field(columns, settings, up)
        else:
            read = from_imu if stream.msgtype.endswith("Imu") else from_number
            heading, strength = read(columns, settings, stream.topic)
        t = seconds(stream.t_ns, epoch_ns, settings.time_offset)
        good = np.isfinite(heading)
        _refuse_stuck(t[good], heading[good], wheels, stream.topic)
        held = np.zeros(len(heading), dtype=bool)
        held[good] = stuck(heading[good], np.zeros(int(good.sum())), t[good], wheels.heading)
        dropped = dict(stream.dropped)
        count_dropped(dropped, not_finite=~good, stuck=held)
        good &= ~held
        n, sigma = int(good.sum()), math.radians(settings.sigma_deg)
        strength = strength[good]
        usual = float(np.median(strength)) if n else 0.0  # other strengths are disturbed by steel and motors
        strength = strength / usual if usual > 0 else np.ones_like(strength)
        steps = np.abs(np.diff(strength))
        # white noise of the strength, without slow changes
        white = float(np.median(steps)) / (MAD_OF_NORMAL * math.sqrt(2.0)) if len(steps) else 0.0
        explained = FIELD_SIGMAS * max(sigma, white)
        rest = np.square(np.maximum(np.abs(strength - 1.0) - explained, 0.0))
        return Measurements(
            t=t[good],
            first=np.arange(n + 1),
            z=heading[good, None],
            R_unit=(1.0 + rest / sigma**2).reshape(-1, 1, 1),
            scale=sigma,
            floor=np.zeros((1, 1)),
            extra={"strength": strength, "rest": rest},
            dropped=dropped,
            notes=(stream.note,) if isinstance(stream, LevelledField) else (),
        )

    def heading(self, m: Measurements) -> tuple[Array, Array]:
        """Return times (n,) [s] and compass headings (n,) [rad, unwrapped]; their constant offset is unknown."""
        return m.t, np.unwrap(m.z[:, 0])

    def reversal(self, settings: CompassSettings, msgtype: str) -> Reversal:
        """Return why headings turn opposite to the wheels: the convention, or an upside-down magnetometer."""
        if msgtype.endswith("MagneticField"):
            return super().reversal(settings, msgtype)
        frame, unit = settings.convention.split("_")
        other = {"enu": "compass", "compass": "enu"}[frame]
        return Reversal("its headings grow clockwise", {"convention": f"{other}_{unit}"})

    def concerns(self, key: str, msgtype: str) -> bool:
        """Return whether a setting applies to a message type: `convention` applies to bare numbers only."""
        return key != "convention" or msgtype.startswith("std_msgs/")

    def model(self, settings: CompassSettings) -> CompassModel:
        """Return the filter model of the compass for a new run."""
        return CompassModel(settings)


class CompassModel(Model):
    """z = theta + offset + noise; H = [0 0 1 | 1]: by the pose (x, y, theta) and the offset."""

    def __init__(self, settings: CompassSettings) -> None:
        self.settings = settings
        self.tolerance = settings.field_tolerance
        self.offset = math.radians(settings.offset_deg or 0.0)
        is_exact = settings.offset_deg is not None and not settings.sigma_offset_deg
        self.given = self.offset if is_exact else None
        self.threshold = chi_square(settings.gate, 1)

    def blocks(self) -> list[Block]:
        """Return the state block of the heading offset; empty if the offset is known exactly."""
        if self.given is not None:
            return []
        drift = math.radians(self.settings.offset_drift_deg) ** 2
        known = self.settings.offset_deg is not None
        variance = math.radians(self.settings.sigma_offset_deg) ** 2 if known else math.pi**2 / 3.0
        return [Block(OFFSET, np.array([self.offset]), np.array([[variance]]), np.array([drift]))]

    def innovations(self, m: Measurements, i: int, belief: Belief) -> list[Innovation]:
        """Return the innovation of heading i; its verdict is "disturbed" if the field's strength is unusual."""
        z, variances = m.scalars
        offset, columns = given_or_state(self.given, OFFSET, belief)
        H_block = H_OFFSET if columns else NO_BLOCK
        y, R = wrap(z[i] - belief.theta - offset), ((variances[i],),)
        seen = belief.compare(i, (y,), H_HEADING, R, self.threshold, columns, H_block)
        if abs(m.plain["strength"][i] - 1.0) > self.tolerance:
            seen.verdict = RowVerdict.DISTURBED
        return [seen]


def _refuse_stuck(t: Array, heading: Array, wheels: WheelMotion, topic: str) -> None:
    """Raise LocfuseError if the heading never changes while the robot turns."""
    if len(t) < STUCK_READINGS or np.ptp(heading) > 0.0:
        return
    turn = wheels.relative(np.full(len(t), t[0]), t)[:, 2]
    if np.ptp(turn) > STUCK_TURN:
        raise LocfuseError(
            f"{topic} says {math.degrees(heading[0]):.1f} deg in all {len(t)} readings while the wheels "
            f"turned the robot by up to {math.degrees(np.ptp(turn)):.0f} deg: no compass writes there",
            role="compass",
        )


def from_field(
    columns: dict[str, Array], settings: CompassSettings, up: Array | None = None
) -> tuple[Array, Array]:
    """Return headings (n,) [rad] from a magnetometer's field, and the strengths (n,) of its horizontal part.

    theta = phi_B - atan2(m_y, m_x), corrected for iron on the robot; `up` (n, 3), base frame, levels the field.
    """
    x, y = columns["magnetic_field.x"], columns["magnetic_field.y"]
    m = np.column_stack((x, y, columns.get("magnetic_field.z", np.zeros_like(x))))
    m = m @ rotation_3d(settings.roll_deg, settings.pitch_deg, settings.yaw_deg).T
    m[:, :2] = (m[:, :2] - settings.hard_iron) @ np.reshape(settings.soft_iron, (2, 2)).T
    ahead, left = m[:, :2].T if up is None else levelled(m, up)
    return -np.arctan2(left, ahead), np.hypot(ahead, left)


def from_imu(
    columns: dict[str, Array], settings: CompassSettings, topic: str, refuse: bool = True
) -> tuple[Array, Array]:
    """Return the yaws (n,) [rad] of the base from an IMU's orientation, NaN where it is missing.

    Also return ones (n,), in place of field strengths. A first covariance element of -1 means no orientation.
    """
    q = np.column_stack([columns[f"orientation.{a}"] for a in "xyzw"])
    said = columns["orientation_covariance"][:, 0] == -1.0
    none = said | ((q**2).sum(axis=1) < 0.25)
    if refuse and len(q) and none.all():
        why = "orientation_covariance[0] is -1" if said.all() else "its quaternions are zeros"
        raise LocfuseError(f"{topic} carries no orientation ({why})", role="compass")
    # the base's x axis in the IMU's axes, turned into the world
    ahead = rotated_3d(q, rotation_3d(settings.roll_deg, settings.pitch_deg, settings.yaw_deg)[0])
    yaw = np.arctan2(ahead[:, 1], ahead[:, 0])
    if settings.convention.startswith("compass"):  # its world is north, east, down: headings grow clockwise
        yaw = wrap_all(math.pi / 2 - yaw)
    return np.where(none, np.nan, yaw), np.ones(len(q))


def from_number(columns: dict[str, Array], settings: CompassSettings, topic: str) -> tuple[Array, Array]:
    """Return headings (n,) [rad] from bare numbers in the configured convention and unit.

    Also return ones (n,), in place of field strengths.
    """
    value = columns["data"].astype(np.float64)
    value[~np.isfinite(value)] = np.nan
    convention: str = settings.convention
    if settings.unit is not None:
        convention = f"{convention.partition('_')[0]}_{settings.unit}"
    finite = np.abs(value[np.isfinite(value)])
    largest = float(finite.max()) if len(finite) else 0.0
    if convention.endswith("rad") and largest > 4.0 * math.pi:
        raise LocfuseError(
            f"{topic} reaches {largest:.0f}, which is no angle in radians.",
            role="compass",
            hint="Set compass.convention=enu_deg or compass_deg",
        )
    angle = np.radians(value) if convention.endswith("deg") else value
    return wrap_all(math.pi / 2 - angle if convention.startswith("compass") else angle), np.ones_like(value)
