"""A scenario is data: room, robot, path, sensors, faults. Its defaults are the paper's robot in a wooden arena.

The room is the 8 m x 6 m arena the design was tried in, with two plates moved: a robot whose wheels are
60 cm apart would have driven into the ones at (5, 4.8) and (0.8, 4).
"""

from __future__ import annotations

import msgspec

Point = tuple[float, float]  # m, map frame
Segment = tuple[float, float, float, float]  # x1, y1, x2, y2 [m], map frame


class Table(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A TOML table whose unknown keys are errors."""


class Room(Table, frozen=True):
    """Flat walls around the origin's first quadrant, lower wooden plates inside."""

    size: Point = (8.0, 6.0)  # m, along x and y
    walls: tuple[Segment, ...] | None = None  # None: the four sides; give them to leave a door open
    plates: tuple[Segment, ...] = ((3, 0, 3, 1), (5, 6, 5, 5.2), (8, 3, 7, 3), (0, 5.2, 0.8, 5.2))
    height: float = 2.6  # m, of walls and ceiling
    plate_height: float = 1.2
    north_deg: float = 65.0  # where magnetic north lies, counter-clockwise from the map's x axis


class Pillar(Table, frozen=True):
    """A vertical cylinder."""

    x: float
    y: float
    radius: float = 0.06
    bottom: float = 0.0
    top: float = 1.6
    colour: tuple[int, int, int] = (200, 20, 30)  # red, green, blue


class Wheels(Table, frozen=True):
    """Two driven wheels, their encoders, and how they meet the ground."""

    radius: float = 0.05  # m, what the user knows
    track: float = 0.60
    radius_error: Point = (0.0, 0.0)  # left, right: true radius / radius - 1
    track_error: float = 0.0
    noise: float = 4e-4  # m: variance of the ground way per metre rolled, per wheel
    slots: int = 500  # of the encoder disc; x4 decoding gives four counts each
    rate: float = 50.0  # Hz, counters read, speed controlled, /joint_states published
    sampling: float = 10_000.0  # Hz, at which the decoder looks at the phases A and B


class Motor(Table, frozen=True):
    """A first-order motor and its PID speed controller."""

    no_load: float = 16.0  # rad/s of the wheel at full voltage
    time_constant: float = 0.12  # s
    gain_error: Point = (0.03, -0.02)  # left, right: what the controller does not know
    load: float = 0.02  # relative standard deviation of the load, and how long it lasts
    load_time: float = 0.3  # s
    kp: float = 0.04  # volt fraction per rad/s
    ki: float = 0.4
    kd: float = 0.001
    acceleration: float = 1.0  # m/s^2 at the rim, limit of the set point


class Control(Table, frozen=True):
    """What closes the loop: the follower steers on this pose estimate."""

    estimator: str = "odometry"  # "truth", "odometry", "all", "compass+lrf", ...
    period: float = 0.1  # s
    speed: float = 0.3  # m/s
    wait: float = 1.0  # s of standing still before and after
    clearance: float = 0.3  # m: a wall nearer than this to the axle's middle is a collision
    time_limit: float = 600.0  # s


class Path(Table, frozen=True):
    """A closed polygon with rounded corners, driven from the start of its first straight."""

    vertices: tuple[Point, ...] = ((0.9, 1.5), (6.1, 1.5), (6.1, 4.7), (0.9, 4.7))
    radius: float = 0.6
    laps: float = 1.0


class Compass(Table, frozen=True):
    """A two-axis magnetometer (the paper's CMPS03)."""

    enabled: bool = True
    rate: float = 20.0
    phase: float = 0.013  # s, of the first reading
    field: float = 20e-6  # T, horizontal
    noise_deg: float = 0.5  # white, as heading
    resolution_deg: float = 0.1
    hard_iron: Point = (0.3e-6, -0.2e-6)  # T, on the robot
    soft_iron: Point = (1.01, 0.99)  # gain of the two axes
    sigma_deg: float = 3.0  # what its data sheet says, for robot.toml


class Lrf(Table, frozen=True):
    """A 2D laser range finder on the front of the robot."""

    enabled: bool = True
    rate: float = 10.0
    phase: float = 0.031
    x: float = 0.20
    y: float = 0.0
    z: float = 0.25
    yaw_deg: float = 0.0
    beams: int = 181
    field_of_view_deg: float = 180.0
    duration: float = 0.025  # s, from the first ray to the last
    range_min: float = 0.04
    range_max: float = 80.0
    sigma_range: float = 0.03
    sigma_angle_deg: float = 0.25
    lost: float = 0.002  # share of rays that do not return


class Truth(Table, frozen=True):
    """The reference pose, without noise."""

    rate: float = 50.0
    phase: float = 0.007


class Scenario(Table, frozen=True):
    """Everything a drive is made of, but the seed."""

    title: str = ""
    seed: int = 1
    room: Room = Room()
    landmark: Pillar = Pillar(x=7.9, y=5.5)
    wheels: Wheels = Wheels()
    motor: Motor = Motor()
    control: Control = Control()
    path: Path = Path()
    compass: Compass = Compass()
    lrf: Lrf = Lrf()
    truth: Truth = Truth()
