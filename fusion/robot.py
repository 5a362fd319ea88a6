"""Settings of robot.toml that belong to no sensor: wheels, start and truth.

Values are in SI units, angles in degrees if the key ends in `_deg`. Tables of sensors are defined with their
sensors.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, ClassVar, Literal

import msgspec
from msgspec import field
from msgspec.structs import replace

from .data import LocfuseError, MapLine
from .sensor import SensorSettings

Order = Literal["auto", "stamp", "recorded"]
Preset = Literal["default", "paper"]
Mirrored = Literal["none", "left", "right", "both"]
Steering = Literal["angle", "rate", "heading"]
# limits of the start's sigmas: beside larger variances, small ones are lost in double precision
MAX_START_SIGMA_M = 1e5
MAX_START_SIGMA_DEG = 3600.0
MAX_NOISE_M = 1e3  # largest wheel noise, for the same reason
Moment = Annotated[float, msgspec.Meta(ge=0.0)] | Literal["scan"]
MIN_SCALE = 1e-3
Scale = Annotated[float, msgspec.Meta(ge=MIN_SCALE, le=1e3)]
TurnScale = Annotated[float, msgspec.Meta(ge=-1e3, le=1e3)]
PerMetre = Annotated[float, msgspec.Meta(ge=0.0, le=MAX_NOISE_M)]
VIRTUAL_TRACK = 0.3  # m: track of the two virtual wheels that replace an odometry topic


class WheelSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Settings of [wheels] in robot.toml: geometry, encoders and noise of the wheels."""

    topic: str | None = None  # not set: found
    left_topic: str | None = None  # topic of the left wheel alone (std_msgs numbers)
    right_topic: str | None = None  # topic of the right wheel alone
    left: str | None = None  # joint name
    right: str | None = None  # joint name
    radius: float | None = None  # m, mean of both wheels
    ratio: float = 1.0  # radius of the right wheel / radius of the left wheel; of an odometry: a turn per metre
    track: float | None = None  # m between the wheels' contact points
    scale: Scale = 1.0  # distance of the robot / distance by an odometry topic
    turn_scale: TurnScale = 1.0  # turn of the robot / turn by an odometry topic; below 0: its y points right too
    x: float = 0.0  # m, position on the base of the body whose poses an odometry topic has
    y: float = 0.0  # m, its position to the left
    yaw_deg: float = 0.0  # direction of this body on the base, counter-clockwise from forward
    wheelbase: float | None = None  # m between the axles; needed for a steering angle
    steering: Steering = "angle"  # meaning of the steering value: an angle [rad], a turn rate [rad/s], a heading
    steering_topic: str | None = None  # topic with the steering position of a car; not set: found
    erpm_per_mps: float | None = None  # electrical revolutions per minute of the car's motor at 1 m/s
    servo_gain: float | None = None  # servo position = gain * angle [rad] + offset
    servo_offset: float = 0.0  # servo position of straight wheels
    ticks_per_revolution: float | None = None  # set: wheel positions are in ticks, else in radians
    mirrored: Mirrored = "none"  # wheels whose counter falls while the robot drives forward
    rollover: float | None = None  # range of the counter, in its unit; 0: it never rolls over; not set: found
    max_speed: float | None = None  # m/s of a wheel; readings that mean a higher speed are faults; not set: found
    reverse_by_twist: bool = True  # reverse an odometry's pose that moves ahead while its twist is backward
    noise: PerMetre = 4e-4  # m: variance [m^2] per metre that a wheel rolls (k in docs/paper.md, eq. 9)
    time_offset: float = 0.0  # s
    estimate: bool = False  # whether the scale of each wheel and the track are states
    sigma_scale: float = 0.02  # prior standard deviation of the estimated scales, relative
    sigma_track: float = 0.2  # prior standard deviation of the estimated track, relative

    # keys on which no measurement depends
    only_fused: ClassVar[frozenset[str]] = frozenset({"noise", "estimate", "sigma_scale", "sigma_track"})

    @property
    def is_of_driver(self) -> bool:
        """Whether the radius and track of the odometry driver apply.

        They do if robot.toml has neither radius nor wheelbase.
        """
        return self.radius is None and self.wheelbase is None

    @property
    def scales(self) -> tuple[float, float, float]:
        """Factors that correct an odometry's motion: forward, left, turn."""
        return self.scale, math.copysign(self.scale, self.turn_scale), self.turn_scale

    @property
    def shares(self) -> tuple[float, float]:
        """Radii of the left and of the right wheel, each divided by the mean radius."""
        left = 2.0 / (1.0 + self.ratio)
        return left, left * self.ratio


class StartSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Settings of [start] in robot.toml: pose in the map at the first wheel reading, or at a later time."""

    x: float = 0.0  # m
    y: float = 0.0  # m
    theta_deg: float = 0.0  # degrees, heading
    sigma_xy: Annotated[float, msgspec.Meta(ge=0.0, le=MAX_START_SIGMA_M)] = 0.0  # m, 1 sigma per axis
    sigma_theta_deg: Annotated[float, msgspec.Meta(ge=0.0, le=MAX_START_SIGMA_DEG)] = 0.0  # degrees, 1 sigma
    at: Moment = 0.0  # time of this pose: s after the first wheel reading, or "scan": at the first scan

    @property
    def pose(self) -> tuple[float, float, float]:
        """Pose at the start: x, y [m], theta [rad], map frame."""
        return self.x, self.y, math.radians(self.theta_deg)

    @property
    def variances(self) -> tuple[float, float, float]:
        """Variances of the start pose: x, y [m^2] and theta [rad^2]."""
        return self.sigma_xy**2, self.sigma_xy**2, math.radians(self.sigma_theta_deg) ** 2


class TruthSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Settings of [truth] in robot.toml: topic of the reference, and tracked point on the base."""

    topic: str | None = None  # or a .tum or .csv file, or two frames of /tf: "/tf:map:base_link"
    body: str | None = None  # name of the rigid body, if motion capture tracks several
    origin: tuple[float, float] | None = None  # for satellite fixes: latitude, longitude [deg] of the map's origin
    east_deg: float = 0.0  # for satellite fixes: direction of east in the map, counter-clockwise from its x axis
    x: float = 0.0  # m, position of the tracked point on the base
    y: float = 0.0  # m, position of the tracked point on the base
    yaw_deg: float = 0.0  # direction of the tracked body on the base, counter-clockwise from forward
    time_offset: float = 0.0  # s, added to the truth's stamps
    sigma: Annotated[float, msgspec.Meta(ge=0.0)] = 0.0  # m, standard deviation per axis
    sigma_theta_deg: Annotated[float, msgspec.Meta(ge=0.0)] = 0.0  # standard deviation of the truth's heading
    max_speed: float | None = None  # m/s: readings that jump away at a higher speed and return are not used


class Robot(msgspec.Struct, frozen=True):
    """All settings of one robot (robot.toml)."""

    wheels: WheelSettings = field(default_factory=WheelSettings)
    start: StartSettings = field(default_factory=StartSettings)
    truth: TruthSettings = field(default_factory=TruthSettings)
    sensors: Mapping[str, SensorSettings] = {}
    order: Order = "auto"
    preset: Preset = "default"
    lines: tuple[MapLine, ...] = ()  # a line map to localise in (lrf.map = given)
    start_given: bool = False

    def settings(self, sensor: str) -> Any:
        """Return the settings of one sensor."""
        if sensor not in self.sensors:
            raise LocfuseError(f"no settings for sensor {sensor!r}")
        return self.sensors[sensor]

    def begun_at(self, pose: Sequence[float], sigma_xy: float, sigma_theta: float) -> Robot:
        """Return the robot with a start pose x, y [m], theta [rad] and standard deviations [m, rad]."""
        x, y, theta = map(float, pose)
        turn, spread = math.degrees(theta), math.degrees(sigma_theta)
        found = replace(self.start, x=x, y=y, theta_deg=turn, sigma_xy=sigma_xy, sigma_theta_deg=spread)
        return replace(self, start=found, start_given=True)
