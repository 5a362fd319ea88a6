"""Scenario of a simulated drive: room, robot, path, sensors, faults. Defaults: the paper's robot in an arena.

The default room is an arena of 8 m x 6 m with four plates, wide enough for a track of 60 cm.
"""

from __future__ import annotations

import difflib
import re
import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Literal, get_args

import msgspec
import tomli_w

from locfuse.formats.robot.robot_toml import apply_sets
from locfuse.fusion.data import LocfuseError, UsageError

from . import HERE
from .faults import Fault
from .table import Count, NotNegative, Percent, Pillar, Point, Positive, ScenarioTable, Segment, Share

Side = Literal["south", "east", "north", "west"]


class Opening(ScenarioTable, frozen=True, kw_only=True):
    """Opening in one wall of a space: a door, a niche, or glass."""

    side: Side
    at: float  # m, middle of the opening: x in a south or north wall, y in an east or west wall
    width: Positive = 1.0  # m
    kind: Literal["door", "closed", "glass"] = "door"  # closed: a niche in the outer half of the wall
    leaf_deg: float = 0.0  # opening angle of the door leaf, into the space; 0: no leaf


class Box(ScenarioTable, frozen=True, tag_field="kind", tag="box"):
    """Solid box on the floor, such as a cabinet, a sofa or a pillar."""

    at: Point  # m, its middle
    size: Point  # m, along x and y before it is turned
    turn_deg: float = 0.0
    height: Positive = 1.8  # m


class LeggedTable(ScenarioTable, frozen=True, tag_field="kind", tag="table"):
    """Table or chair with four thin round legs; its top is above the laser."""

    at: Point
    size: Point
    turn_deg: float = 0.0
    height: Positive = 0.72
    leg: Positive = 0.025  # m, radius of a leg


class SwivelChair(ScenarioTable, frozen=True, tag_field="kind", tag="chair"):
    """Office chair, one thin column at the height of the laser."""

    at: Point
    radius: Positive = 0.035
    height: Positive = 0.45


Furniture = Box | LeggedTable | SwivelChair


class Space(ScenarioTable, frozen=True, kw_only=True):
    """Corridor or room; overlapping spaces are one space without a wall between them."""

    name: str
    area: Segment  # m: west, south, east, north, on the centre lines of the walls
    openings: tuple[Opening, ...] = ()
    furniture: tuple[Furniture, ...] = ()


class Glass(ScenarioTable, frozen=True, kw_only=True):
    """Reflection of laser beams by panes: only near normal incidence, else the beam passes through."""

    within_deg: float = 8.0  # largest angle to the normal with an echo
    returns: Share = 0.8  # probability of an echo within this angle
    post_every: Positive = 1.5  # m, largest distance of the posts that hold the panes
    post: Positive = 0.06  # m, thickness of a post


class Walker(ScenarioTable, frozen=True, kw_only=True):
    """Person who walks along a path and back during the whole drive, and steps aside for the robot."""

    path: tuple[Point, ...]
    speed: Positive = 1.1  # m/s; the seed changes it by up to 20 %
    pause: float = 20.0  # s at both ends; the seed changes it by up to 50 %

    def __post_init__(self) -> None:
        if len(self.path) < 2:
            raise ValueError("a walker needs at least two points in its `path`")


class Building(ScenarioTable, frozen=True, kw_only=True):
    """Building that replaces the walls and plates of a `room`."""

    spaces: tuple[Space, ...]
    wall: Positive = 0.15  # m, thickness of every wall
    bow: float = 0.02  # m, largest deviation of a wall from its straight line
    screens: tuple[Segment, ...] = ()  # thin straight walls, in any direction
    glass: Glass = Glass()
    people: tuple[Walker, ...] = ()
    seed: int | None = None  # seed of the wall shapes and the walks; None: the seed of the drive


class Room(ScenarioTable, frozen=True, kw_only=True):
    """Room with flat outer walls, from the map's origin to `size`, lower wooden plates and pillars."""

    size: Point = (8.0, 6.0)  # m, along x and y
    walls: tuple[Segment, ...] | None = None  # None: the four sides; other walls leave, for example, a door open
    radius: Positive | None = None  # m, of one round wall about the middle of `size`, instead of the four sides
    plates: tuple[Segment, ...] = ((3, 0, 3, 1), (5, 6, 5, 5.4), (8, 3, 7, 3), (0, 5.2, 0.8, 5.2))
    height: Positive = 2.6  # m, of walls and ceiling
    plate_height: Positive = 1.2
    pillars: tuple[Pillar, ...] = ()  # red ones are distractors
    north_deg: float = 65.0  # direction of magnetic north, counter-clockwise from the map's x axis


class Landmark(Pillar, frozen=True, kw_only=True):
    """Red pole at a known position."""

    x: float = 7.9
    y: float = 5.5
    radius: Positive = 0.08


class WheelsSpec(ScenarioTable, frozen=True, kw_only=True):
    """Two driven wheels: geometry, encoders, and noise on the ground."""

    radius: Positive = 0.05  # m, nominal: as known to the user
    track: Positive = 0.60
    radius_error: Point = (0.0, 0.0)  # left, right: true radius / radius - 1
    track_error: float = 0.0
    noise: float = 4e-4  # m: variance of each wheel's distance over ground, per metre rolled
    slots: Count = 500  # of the encoder disc; x4 decoding gives four counts per slot
    rate: Positive = 50.0  # Hz of reading counters, speed control, and /joint_states
    sampling: Positive = 10_000.0  # Hz at which the decoder samples the phases A and B


class Motor(ScenarioTable, frozen=True, kw_only=True):
    """First-order motor with a random load, and its PID speed controller."""

    no_load: Positive = 16.0  # rad/s of the wheel at full voltage
    time_constant: Positive = 0.12  # s
    gain_error: Point = (0.03, -0.02)  # left, right: relative errors, unknown to the controller
    load: float = 0.025  # relative standard deviation of the speed lost to the load
    load_time: Positive = 0.3  # s, how long a load lasts
    kp: float = 0.04  # full voltages per rad/s
    ki: float = 0.4
    kd: float = 0.001
    acceleration: Positive = 1.0  # m/s^2 at the rim, largest change of the set point


class Control(ScenarioTable, frozen=True, kw_only=True):
    """Control loop: pose estimate, period, speed and limits of path following."""

    estimator: str = "odometry"  # "truth", "odometry", "all", or sensors: "compass+lrf"
    period: Positive = 0.1  # s
    speed: Positive = 0.3  # m/s
    wait: float = 1.0  # s at rest before and after the path
    clearance: float = 0.35  # m: a wall nearer to the middle of the axle is a collision (half the robot's width)
    time_limit: Positive = 900.0  # s


class Polygon(ScenarioTable, frozen=True, tag_field="kind", tag="polygon"):
    """Closed polygon with rounded corners, driven from the start of its first straight."""

    vertices: tuple[Point, ...] = ((0.9, 1.5), (6.1, 1.5), (6.1, 4.7), (0.9, 4.7))
    radius: Positive = 0.6
    laps: Positive = 1.0


class Leg(ScenarioTable, frozen=True, kw_only=True):
    """Straight run or turn on the spot, with its own speed."""

    forward: float = 0.0  # m, negative backward
    turn_deg: float = 0.0  # counter-clockwise
    speed: Positive = 0.3  # m/s of the wheels
    pause: float = 0.5  # s at rest afterwards


class Legs(ScenarioTable, frozen=True, tag_field="kind", tag="legs"):
    """Sequence of straight runs and turns on the spot (the paper's experiments for delta)."""

    legs: tuple[Leg, ...]
    x: float = 2.0  # m, where to start
    y: float = 2.2
    theta_deg: float = 0.0


class Tour(ScenarioTable, frozen=True, tag_field="kind", tag="tour"):
    """Random path with rounded corners around the obstacles; each seed gives another one."""

    length: Positive = 20.0  # m
    radius: Positive = 0.4  # m, of the corners
    legs: Point = (1.2, 4.0)  # m, least and largest distance of successive corners
    clearance: float = 0.7  # m, least distance of corners and straights from obstacles


class Waypoints(ScenarioTable, frozen=True, tag_field="kind", tag="waypoints"):
    """Open path through given points, with rounded corners."""

    points: tuple[Point, ...]
    radius: Positive = 0.5  # m, of the corners
    turning: Positive = 0.9  # rad/s, largest turning rate: the robot slows down for corners


class CompassSpec(ScenarioTable, frozen=True, kw_only=True):
    """Two-axis magnetometer (the paper's CMPS03)."""

    enabled: bool = True
    rate: Positive = 20.0  # Hz
    phase: float = 0.013  # s, of the first reading
    field: Positive = 20e-6  # T, the earth's field in the plane
    noise_deg: float = 0.5  # white, as an angle
    resolution_deg: float = 0.1
    hard_iron: Point = (0.3e-6, -0.2e-6)  # T, of magnets on the robot
    soft_iron: tuple[float, float, float] = (1.01, 0.99, 0.005)  # gains of x and of y, and cross gain
    sigma_deg: float = 3.0  # accuracy by the data sheet, for robot.toml


class LrfSpec(ScenarioTable, frozen=True, kw_only=True):
    """2D laser range finder at the front of the robot."""

    enabled: bool = True
    rate: Positive = 10.0
    phase: float = 0.031
    x: float = 0.20  # m, on the robot
    y: float = 0.0
    z: float = 0.25
    yaw_deg: float = 0.0
    beams: Count = 181
    field_of_view_deg: Positive = 180.0
    duration: Positive = 0.025  # s, from the first ray to the last
    range_min: float = 0.04
    range_max: Positive = 80.0
    sigma_range: float = 0.03
    sigma_angle_deg: float = 0.25
    scale: Positive = 1.0  # measured range / true range; not in robot.toml
    lost: Share = 0.002  # share of rays that never return
    pattern: NotNegative = 0.0  # m, 1 sigma of an error of each beam that is constant during the drive


class CameraSpec(ScenarioTable, frozen=True, kw_only=True):
    """Camera that looks up into a hyperbolic mirror Z^2/b^2 - rho^2/a^2 = 1."""

    enabled: bool = True
    rate: Positive = 2.0
    phase: float = 0.171
    latency: float = 0.03  # s from exposure to arrival of the image
    x: float = 0.10  # m, on the robot
    y: float = 0.0
    z: float = 0.9  # of the mirror's focus
    yaw_deg: float = 0.0
    size: tuple[int, int] = (480, 480)  # px, width and height
    centre: Point = (241.5, 238.2)  # px, where the mirror's axis meets the image
    focal: Positive = 320.0  # px
    mirror_a: Positive = 28.095  # mm
    mirror_b: Positive = 23.4125
    inner: Positive = 62.0  # px: the image inside this radius shows the robot itself
    outer: Positive = 232.0  # px, radius of the mirror's rim
    zero_deg: float = 0.0  # viewing direction of "down" in the image (column 0 of the panorama), from forward
    clockwise: bool = False  # True: "right" in the image is right of the robot, as in an unmirrored image
    brightness: float = 1.0
    noise: float = 4.0  # grey levels
    blur: float = 0.7  # px
    quality: Percent = 75  # of the JPEG
    sigma_deg: float = 0.5  # accuracy that a user expects, for robot.toml
    calibrated: bool = True  # robot.toml has centre, inner, outer, zero_deg and clockwise


class SonarSpec(ScenarioTable, frozen=True, kw_only=True):
    """Ultrasonic ranger: measures the nearest object in its cone."""

    name: str
    x: float
    y: float = 0.0
    z: float = 0.3
    yaw_deg: float = 0.0
    rate: Positive = 10.0
    phase: float = 0.043
    field_of_view_deg: Positive = 20.0
    range_min: float = 0.03
    range_max: Positive = 4.0
    sigma: float = 0.02


class GpsSpec(ScenarioTable, frozen=True, kw_only=True):
    """Satellite receiver, for a scene without a roof."""

    enabled: bool = False
    rate: Positive = 1.0
    phase: float = 0.057
    latitude: float = 21.0380  # of the map's origin
    longitude: float = 105.7820
    altitude: float = 12.0  # m
    east_deg: float = 0.0  # direction of east, counter-clockwise from the map's x axis
    sigma: float = 1.5  # m, of each horizontal axis


class StartSpec(ScenarioTable, frozen=True, kw_only=True):
    """Start pose in robot.toml: the sum of true pose, `error`, and a random error with the given sigmas."""

    sigma_xy: NotNegative = 0.0  # m, of x and of y
    sigma_theta_deg: NotNegative = 0.0
    error: tuple[float, float, float] = (0.0, 0.0, 0.0)  # m, m, deg: error of the user, not known to the filter


class TruthSpec(ScenarioTable, frozen=True, kw_only=True):
    """Recorded truth pose: rate and white noise."""

    rate: Positive = 50.0
    phase: float = 0.007
    noise: NotNegative = 0.0  # m, 1 sigma of x and of y
    noise_deg: NotNegative = 0.0  # 1 sigma of the heading


class Scenario(ScenarioTable, frozen=True, kw_only=True):
    """Complete description of a simulated drive."""

    title: str = ""
    seed: int = 1
    room: Room = Room()
    landmark: Landmark = Landmark()
    wheels: WheelsSpec = WheelsSpec()
    motor: Motor = Motor()
    control: Control = Control()
    path: Polygon | Legs | Tour | Waypoints = msgspec.field(default_factory=Polygon)
    compass: CompassSpec = CompassSpec()
    lrf: LrfSpec = LrfSpec()
    camera: CameraSpec = CameraSpec()
    sonar: tuple[SonarSpec, ...] = ()
    gps: GpsSpec = GpsSpec()
    truth: TruthSpec = TruthSpec()
    start: StartSpec = StartSpec()
    faults: tuple[Fault, ...] = ()
    building: Building | None = None  # replaces walls and plates of `room`, and has its `size`

    def __post_init__(self) -> None:
        if self.building is not None and self.camera.enabled:
            raise ValueError("the camera cannot draw a building: set camera.enabled = false")


# --- Scenario files: found by name or path, merged with their base, changed by settings, validated


def names() -> list[str]:
    """Return the names of the scenarios in the package."""
    return sorted(f.stem for f in HERE.glob("*.toml"))


def load(name: str, settings: Iterable[str] = ()) -> Scenario:
    """Return the scenario of a TOML file or of a name, with `table.key=value` settings applied.

    Raises:
        LocfuseError: the file is not a scenario; the message has the wrong key and the most similar one.
        UsageError: no such scenario, or a setting that does not fit.
    """
    tables = _tables(name)
    convert(tables, name, LocfuseError)
    for setting in settings:
        tables = merge(tables, apply_sets([setting]))
    return convert(tables, f"{name} with --set", UsageError)


def dumps(scenario: Scenario) -> str:
    """Return a scenario as TOML with all keys."""
    return tomli_w.dumps(_without_none(msgspec.to_builtins(scenario)))


def merge(tables: Mapping[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
    """Return `tables` updated recursively with `above`; a table that changes its `kind` is replaced as a whole."""
    merged = dict(tables)
    for key, value in above.items():
        old = merged.get(key)
        merged[key] = value
        if isinstance(old, Mapping) and isinstance(value, Mapping):
            other_kind = value.get("kind", old.get("kind")) != old.get("kind")
            merged[key] = value if other_kind else merge(old, value)
    return merged


def _tables(name: str) -> dict[str, Any]:
    path = Path(name)
    if not path.is_file() and name not in names():
        near = difflib.get_close_matches(name, names(), 1)
        hint = f"did you mean {near[0]}?" if near else f"shipped ones: {', '.join(names())}"
        raise UsageError(f"no scenario {name}: neither a file nor a name; {hint}")
    try:
        text = (path if path.is_file() else HERE / f"{name}.toml").read_text(encoding="utf-8")
        tables = tomllib.loads(text)
    except (OSError, UnicodeDecodeError) as error:
        raise LocfuseError(f"{name} cannot be read as a scenario: {error}") from error
    except tomllib.TOMLDecodeError as error:
        raise LocfuseError(f"{name} is not TOML: {error}") from error
    base = tables.pop("base", None)
    return tables if base is None else merge(_tables(str(base)), tables)


def convert(tables: Mapping[str, Any], where: str, kind: type[LocfuseError]) -> Scenario:
    """Convert tables to a Scenario. Raises `kind`, an error that names the wrong key and the most similar one."""
    try:
        return msgspec.convert(tables, Scenario)
    except msgspec.ValidationError as error:
        problem = str(error)
        if found := UNKNOWN.search(problem):
            known = {name for table in _tables_at(found["path"] or "") for name in table.__struct_fields__}
            what = f"no key {found['key']} in {(found['path'] or '.')[1:] or 'a scenario'}"
        elif found := BAD_KIND.search(problem):
            known = {str(table.__struct_config__.tag) for table in _tables_at(found["path"])}
            what = f"no kind {found['key']} of {found['path'][1:]}"
        else:
            raise kind(f"{where}: {problem[:1].lower()}{problem[1:].replace('`$.', '`')}") from error
        near = difflib.get_close_matches(found["key"], known, 1)
        hint = f"did you mean {near[0]}?" if near else "known: " + ", ".join(sorted(known))
        raise kind(f"{where}: {what}; {hint}") from error


UNKNOWN = re.compile(r"unknown field `(?P<key>[^`]*)`(?: - at `\$(?P<path>[^`]*)`)?")
BAD_KIND = re.compile(r"Invalid value '(?P<key>[^']*)' - at `\$(?P<path>[^`]*)\.kind`")


def _tables_at(path: str) -> list[type[ScenarioTable]]:
    """Return the types of table possible at a path of a msgspec error, such as `.faults[0]`."""
    found: list[type[ScenarioTable]] = [Scenario]
    for step in filter(None, path.replace("[...]", "").split(".")):
        name = re.sub(r"\[\d+\]", "", step)
        types = [f.type for table in found for f in msgspec.structs.fields(table) if f.name == name]
        found = [table for t in types for table in _structs(t)]
    return found


def _structs(of: Any) -> list[type[ScenarioTable]]:
    if isinstance(of, type) and issubclass(of, ScenarioTable):
        return [of]
    return [table for part in get_args(of) for table in _structs(part)]


def _without_none(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _without_none(v) for k, v in value.items() if v is not None}
    return [_without_none(v) for v in value] if isinstance(value, list | tuple) else value
