"""The traps of real logs, each as a change of a healthy drive."""

import math
from collections.abc import Callable, Iterable
from functools import partial
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from pose_streams import reckoned
from scipy.spatial.transform import Rotation
from trap_logs import (
    COMPASS,
    MS,
    PICTURES,
    RADIUS,
    SCAN,
    TRACK,
    TRUTH,
    WHEELS,
    Change,
    Drive,
    S,
    angles,
    dead_reckoning,
    headings,
    numbers,
    odometry,
    seconds,
    speeds,
    truth_headings,
)

from locfuse.fusion.data import Array
from locfuse.sample_logs.table import RawMessage


class Trap(NamedTuple):
    """One thing that is wrong, and what `info` must say of it."""

    name: str
    change: Change
    says: str | None = None  # words of the complaint or the note; None: it is no trap for us, and nothing is said
    spoils: bool = False
    sensors: str = "odometry"  # of the estimate that must be right
    refused: bool = False  # without the cure there is no estimate at all
    blur: float = 0.01  # m that the cure may cost: it is measured, not known


def changed(m: RawMessage, **fields: Any) -> RawMessage:
    """The message with other values of some fields."""
    return m._replace(fields={**m.fields, **fields})


def each(topic: str, edit: Callable[[RawMessage], RawMessage | None]) -> Change:
    return lambda drive: drive.each(topic, edit)


def field(topic: str, **values: Any) -> Change:
    return lambda drive: drive.field(topic, **values)


def some(topic: str, n: int, of: int, edit: Callable[[RawMessage], RawMessage]) -> Change:
    """Edit those of the wheels' readings, 25 a second, whose number is n modulo `of`."""
    return each(topic, lambda m: edit(m) if int(seconds(m) * 25) % of == n else m)


def again(topic: str, every: int) -> Change:
    """Every so many readings are recorded twice."""
    return lambda drive: drive.add(m._replace(log_ns=m.log_ns + MS) for m in drive.on(topic)[::every])


# --- wheels and odometry


def swap(m: RawMessage) -> RawMessage:
    return changed(m, **{k: tuple(m.fields[k])[::-1] for k in ("name", "position", "velocity")})


def arm(drive: Drive) -> None:
    """The arm's joints come on the same topic, in messages of their own and among the wheels'."""
    arms = list(drive.on(WHEELS)[::5])
    own = {"name": ("arm_1", "arm_2"), "position": np.array([0.3, -0.2]), "velocity": np.zeros(0)}
    drive.field(WHEELS, name=lambda n: ("arm_1", *n), position=lambda p: np.array([0.3, *p]))
    drive.add(m._replace(log_ns=m.log_ns + MS, stamp_ns=m.stamp_ns + MS, fields=own) for m in arms)


def spiked(drive: Drive) -> None:
    bad = {id(m) for m in drive.on(WHEELS)[200:203]}
    drive.each(WHEELS, lambda m: changed(m, position=m.fields["position"] + [900.0, 0.0]) if id(m) in bad else m)


def restart(m: RawMessage) -> RawMessage:
    """The base controller restarts during a halt, and counts from 0 again."""
    return m if seconds(m) < 12.0 else changed(m, position=m.fields["position"] - 37.5)


def other_names(drive: Drive) -> None:
    """Joints that are not called left and right, beside one that does not turn; robot.toml names none."""
    drive.field(WHEELS, name=("caster", "drive_l", "drive_r"), position=lambda p: np.array([0.1, *p]))
    del drive.tables["wheels"]["left"], drive.tables["wheels"]["right"]


def geometry(**values: float) -> Change:
    return lambda drive: drive.tables["wheels"].update(values)


def no_geometry(drive: Drive) -> None:
    """Joint angles and the odometry that the base made of them; robot.toml says nothing of wheels."""
    drive.add(odometry(drive, dead_reckoning(drive), speeds(drive)))
    drive.tables["wheels"] = {"topic": WHEELS}


SHAPE = """<collision><geometry><cylinder radius="{0}" length="0.02"/></geometry></collision>"""
JOINT = """<joint name="{0}_wheel_joint" type="continuous"><parent link="base_link"/><child link="{0}"/>
  <origin xyz="0 {1} 0" rpy="-1.5708 0 0"/></joint>"""


def described(drive: Drive) -> None:
    """Only /robot_description knows the geometry."""
    sides = (("left", TRACK / 2), ("right", -TRACK / 2))
    parts = [f"<link name='{side}'>{SHAPE.format(RADIUS)}</link>" + JOINT.format(side, y) for side, y in sides]
    text = f'<robot name="tried"><link name="base_link"/>{"".join(parts)}</robot>'
    kind: dict[str, Any] = {"topic": "/robot_description", "msgtype": "std_msgs/msg/String"}
    drive.add([drive.messages[0]._replace(**kind, fields={"data": text})])
    drive.tables["wheels"] = {}


def tick_pair(drive: Drive) -> None:
    """An Arduino: an Int16 per wheel, without header, not in step, rolling over; and the base's own odometry."""
    no_geometry(drive)
    ticks = np.floor(angles(drive) * 2000 / (2 * np.pi))
    when, ticks = drive.on(WHEELS), (ticks + 32768) % 65536 - 32768
    later = [m._replace(log_ns=m.log_ns + 13 * MS) for m in when]
    drive.drop(WHEELS)
    drive.tables["wheels"] = {"ticks_per_revolution": 2000}
    drive.add(numbers("/left_ticks", "Int16", when, ticks[:, 0].astype(int)))
    drive.add(numbers("/right_ticks", "Int16", later, ticks[:, 1].astype(int)))


def other_geometry(drive: Drive) -> None:
    """A diameter configured as radius, and another robot's track; the driver's odometry has the right ones."""
    drive.add(odometry(drive, dead_reckoning(drive), speeds(drive)))
    drive.tables["wheels"] |= {"radius": 2.0 * RADIUS, "track": 0.6 * TRACK}


def only_odometry(drive: Drive, poses: Array | None = None) -> None:
    """These poses, else those of dead reckoning, instead of wheels."""
    drive.add(odometry(drive, dead_reckoning(drive) if poses is None else poses, speeds(drive)))
    drive.drop(WHEELS)
    drive.tables["wheels"] = {}


def blind_to_reverse(drive: Drive) -> None:
    """The driver puts wheel turns without their sign into the pose; its twist knows better."""
    step = np.diff(dead_reckoning(drive), axis=0)
    only_odometry(drive, reckoned(np.column_stack((np.hypot(step[:, 0], step[:, 1]), step[:, 2]))))


def mirror_image(drive: Drive) -> None:
    """The driver puts y into the pose with the wrong sign; its headings are right."""
    only_odometry(drive, dead_reckoning(drive) * [1.0, -1.0, 1.0])


def relocalised(drive: Drive) -> None:
    """The odometry's pose is reset to 0 half-way."""
    poses = dead_reckoning(drive)
    half = len(poses) // 2
    poses[half:, :2] -= poses[half, :2] - [0.0, 3.0]
    only_odometry(drive, poses)


def two_odometries(drive: Drive) -> None:
    only_odometry(drive)
    drive.add([m._replace(topic="/odom2") for m in drive.on("/odom")])


def twist_only(drive: Drive) -> None:
    """An odometry whose pose is never filled in."""
    only_odometry(drive, np.zeros((len(drive.on(WHEELS)), 3)))


NOT_NUMBERS = some(WHEELS, 0, 7, lambda m: changed(m, position=np.full(2, np.nan)))
WRONG_RADIUS = geometry(radius=1.15 * RADIUS, track=1.15 * TRACK)  # the track is nominal too: turning is right
WHEEL_TRAPS = (
    Trap("joints in another order", some(WHEELS, 0, 2, swap)),
    Trap("an arm on the same topic", arm, "other joints than left_wheel_joint and right_wheel_joint"),
    Trap("no velocity and no effort", field(WHEELS, velocity=np.zeros(0))),
    Trap("a first sample that is not zero", field(WHEELS, position=lambda p: p + 371.2)),
    Trap(
        "angles that wrap at pi",
        field(WHEELS, position=lambda p: (p + np.pi) % (2 * np.pi) - np.pi),
        "left counter rolled over",
    ),
    Trap("a spike that returns", spiked, "left counter jumped away and returned"),
    Trap("a counter that starts anew", each(WHEELS, restart), "counter started anew"),
    Trap("repeats with dt = 0", again(WHEELS, 5), "repeat the one before"),
    Trap("readings that are no numbers", NOT_NUMBERS, "hold NaN, Inf or a quaternion of zeros"),
    Trap(
        "a mirrored wheel",
        field(WHEELS, position=lambda p: p * [1.0, -1.0]),
        "the right wheel counts backward",
        spoils=True,
    ),
    Trap(
        "left and right swapped",
        field(WHEELS, name=lambda n: tuple(n)[::-1]),
        "left and right are swapped",
        spoils=True,
    ),
    Trap("joints of other names", other_names, "the joints of the wheels", spoils=True, refused=True),
    Trap("a wrong track", geometry(track=0.9 * TRACK), "configured 0.54 m", spoils=True),
    Trap("a larger wheel", geometry(ratio=0.88), "times the left one's", spoils=True),
    Trap("a wrong radius", WRONG_RADIUS, "they measure", spoils=True),
    Trap("wheel angles in degrees", field(WHEELS, position=np.degrees), "angles look like degrees", spoils=True),
    Trap("geometry that only /odom knows", no_geometry, "/odom was made with these", spoils=True, refused=True),
    Trap("geometry that /odom contradicts", other_geometry, "/odom was made with radius", spoils=True),
    Trap("geometry that /robot_description knows", described, "/robot_description has", spoils=True, refused=True),
    Trap("a pair of Int16 counters", tick_pair, "/odom was made with these"),
    Trap("odometry instead of wheels", only_odometry),
    Trap("an odometry blind to reverse", blind_to_reverse, "while its velocity says reverse"),
    Trap("an odometry with y to the right", mirror_image, "its path is a mirror image of its headings"),
    Trap("an odometry without poses", twist_only, "its pose never changes: its twist is used"),
    Trap("an odometry that jumps", relocalised, "its pose jumped once"),
    Trap("two odometries", two_odometries, "2 topics that fit", spoils=True, refused=True),
)

# --- clocks


def simulated_time(drive: Drive) -> None:
    """All headers start at 0, as with use_sim_time, while recording goes by the wall clock."""
    first = drive.messages[0].stamp_ns - 5 * S
    drive.messages = [m._replace(stamp_ns=m.stamp_ns - first) for m in drive.messages]


def replayed(topic: str) -> Change:
    """A log replayed and recorded again 8 days later; the stamps of one topic are zero."""

    def change(drive: Drive) -> None:
        again = [m._replace(stamp_ns=m.stamp_ns - 8 * 86400 * S) for m in drive.messages]
        drive.messages = [m._replace(stamp_ns=0) if m.topic == topic else m for m in again]

    return change


def late(topic: str, by: float, only: Callable[[RawMessage], bool] = lambda m: True) -> Change:
    """Stamps, or only those of some messages, are moved by so many seconds."""
    return each(topic, lambda m: m._replace(stamp_ns=m.stamp_ns + round(by * S)) if only(m) else m)


def scattered(topic: str, sigma: float) -> Change:
    """Stamps have an error of their own each, sigma [s]."""
    rng = np.random.default_rng(1)
    return each(topic, lambda m: m._replace(stamp_ns=m.stamp_ns + round(rng.normal(0.0, sigma) * S)))


def silent(topic: str, *gaps: tuple[float, float]) -> Change:
    """Without messages in these stretches [s]."""
    return each(topic, lambda m: None if any(a < seconds(m) < b for a, b in gaps) else m)


CLOCK_TRAPS = (
    Trap(
        "stamps that run backwards",
        late(WHEELS, -0.4, lambda m: 9.0 < seconds(m) < 9.35),
        "dated by recording time instead (8 backwards)",
    ),
    Trap("stamps of zero", some(WHEELS, 0, 9, lambda m: m._replace(stamp_ns=0)), "zero)"),
    Trap(
        "absurd stamps",
        some(WHEELS, 0, 9, lambda m: m._replace(stamp_ns=m.stamp_ns + 3600 * S)),
        "off the stream's clock)",
    ),
    Trap(
        "stamps with microseconds for nanoseconds",
        each(SCAN, lambda m: m._replace(stamp_ns=m.stamp_ns // S * S + m.stamp_ns % S // 1000)),
        "they hold microseconds",
    ),
    Trap(
        "stamps that are all zero",
        each(WHEELS, lambda m: m._replace(stamp_ns=0)),
        "log time (all header stamps are zero)",
    ),
    Trap("stamps that are all the same", each(WHEELS, lambda m: m._replace(stamp_ns=S)), "stamps are the same"),
    Trap(
        "stamps that stand still",
        each(SCAN, lambda m: m._replace(stamp_ns=m.stamp_ns // S * S)),
        "have the header stamp of the one before",
        True,
        "lrf",
    ),
    Trap(
        "stamps that are all zero beside another clock's",
        replayed(WHEELS),
        "less the 691200.027 s (median) that the stamps of the other topics are behind it",
    ),
    Trap("header and log time are two clocks", simulated_time, "two clocks; header stamps are used"),
    Trap("a silence", silent(WHEELS, (8.0, 8.9)), "a gap of 0.9 s"),
    Trap("a truth that repeats", again(TRUTH, 3), "repeat the one before"),
)

# --- compasses and gyros

VECTORS = ("angular_velocity", "linear_acceleration")
OFFSET = 0.6  # rad: where the compass' zero lies in the map
IMU = "sensor_msgs/msg/Imu"
# base -> sensor, of mounts turned by 90 deg about x, and about y
ROLLED = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
PITCHED = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
UPSIDE_DOWN = np.diag([1.0, -1.0, -1.0])


def without_compass(drive: Drive) -> None:
    drive.drop(COMPASS)
    del drive.tables["compass"]


def number(unit: Callable[[Array], Array], turn: float, clockwise: bool) -> Change:
    """A heading as a bare number instead of the magnetometer, wrapped where it is in `turn`."""

    def change(drive: Drive) -> None:
        enu = headings(drive) + OFFSET
        values = unit(math.pi / 2 - enu if clockwise else enu)
        values = values % turn if turn else values
        drive.add(numbers("/heading", "Float64", drive.on(COMPASS), values.tolist()))
        without_compass(drive)

    return change


def turned_field(R: Array) -> Change:
    """The magnetometer sits on the robot as R (3, 3), base -> sensor, says; nothing else does."""

    def edit(m: RawMessage) -> RawMessage:
        field = R @ [m.fields["magnetic_field.x"], m.fields["magnetic_field.y"], -3e-5]
        values = {f"magnetic_field.{a}": v for a, v in zip("xyz", field.tolist(), strict=True)}
        return changed(m, **values)._replace(frame_id="")

    return each(COMPASS, edit)


def imu(drive: Drive, R: Array, orientation: bool, **more: Any) -> None:
    """An IMU at the compass' instants: turning rate and gravity, in its own axes; with or without its yaw."""
    t, theta = truth_headings(drive)
    rate = np.gradient(theta, t)
    found = []
    for m, yaw in zip(drive.on(COMPASS), headings(drive) + OFFSET, strict=True):
        omega, up = R @ [0.0, 0.0, np.interp(seconds(m), t, rate)], R @ [0.0, 0.0, 9.81]
        fields: dict[str, Any] = {
            "orientation_covariance": np.full(9, 0.0 if orientation else -1.0),
            **{f"angular_velocity.{a}": float(v) for a, v in zip("xyz", omega, strict=True)},
            **{f"linear_acceleration.{a}": float(v) for a, v in zip("xyz", up, strict=True)},
        }
        if orientation:  # world <- base <- sensor
            q = (Rotation.from_euler("z", yaw) * Rotation.from_matrix(R.T)).as_quat().tolist()
            fields |= {f"orientation.{a}": v for a, v in zip("xyzw", q, strict=True)}
        found.append(m._replace(topic="/imu", msgtype=IMU, frame_id="", fields={**fields, **more}))
    drive.add(found)


def pitched_imu(drive: Drive) -> None:
    """On end: its x axis points down; its driver's orientation is right, of its own axes."""
    imu(drive, PITCHED, orientation=True)
    without_compass(drive)


def ned_imu(drive: Drive) -> None:
    """North, east, down: the world's axes and the sensor's, as aerial autopilots write them."""
    imu(drive, np.eye(3), orientation=True)
    world = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])  # ENU to NED

    def ned(m: Any) -> Any:
        q = [m.fields[f"orientation.{a}"] for a in "xyzw"]
        turned = Rotation.from_matrix(world @ Rotation.from_quat(q).as_matrix() @ UPSIDE_DOWN).as_quat().tolist()
        fields = {f"orientation.{a}": v for a, v in zip("xyzw", turned, strict=True)}
        return changed(m, **fields, **{f"{name}.{a}": -m.fields[f"{name}.{a}"] for name in VECTORS for a in "yz"})

    drive.each("/imu", ned)
    drive.tables["gyro"] = {"roll_deg": 180.0}
    without_compass(drive)


def imu_without_yaw(drive: Drive) -> None:
    """Most IMUs have no yaw; the compass beside it has."""
    imu(drive, np.eye(3), orientation=False)
    del drive.tables["compass"]["topic"]


def gyro(R: Array, **edited: Any) -> Change:
    """An IMU without its yaw, some of its fields changed."""

    def change(drive: Drive) -> None:
        imu(drive, R, orientation=False)
        drive.field("/imu", **{name.replace("__", "."): edit for name, edit in edited.items()})

    return change


COMPASS_TRAPS = (
    Trap("heading, ENU in radians", number(np.asarray, 0.0, False), None, False, "compass"),
    Trap(
        "heading, ENU in degrees",
        number(np.degrees, 360.0, False),
        "the wheels it grows counter-clockwise",
        True,
        "compass",
        True,
    ),
    Trap(
        "heading, compass in degrees",
        number(np.degrees, 360.0, True),
        "the wheels it grows clockwise",
        True,
        "compass",
        True,
    ),
    Trap(
        "heading, compass in radians",
        number(np.asarray, 2 * math.pi, True),
        "headings grow clockwise",
        True,
        "compass",
    ),
    Trap("a magnetometer upside-down", turned_field(UPSIDE_DOWN), "the field turns says that it", True, "compass"),
    Trap(
        "a magnetometer rolled by 90 degrees",
        turned_field(ROLLED),
        "the field turns says that it",
        True,
        "compass",
    ),
    Trap("an IMU on end", pitched_imu, "compass: gravity says that it is mounted", True, "compass"),
    Trap("an IMU rolled by 90 degrees", gyro(ROLLED), "gyro: gravity says that it is mounted", True, "gyro", True),
    Trap("an IMU in NED", ned_imu, "headings grow clockwise", True, "compass"),
    Trap(
        "gravity of the other sign",
        gyro(np.eye(3), linear_acceleration__z=lambda v: -v),  # the pull itself
        "gives gravity with the other sign",
        False,
        "gyro",
    ),
    Trap("an IMU without orientation", imu_without_yaw, None, False, "compass"),
    Trap(
        "a gyro upside-down",
        gyro(UPSIDE_DOWN, **{f"linear_acceleration__{a}": 0.0 for a in "xyz"}),
        "turns -0.9",
        True,
        "gyro",
        True,
    ),
    Trap(
        "a gyro in degrees",
        gyro(np.eye(3), angular_velocity__z=math.degrees),
        "times as far as the wheels",
        True,
        "gyro",
        True,
    ),
    Trap(
        "a gyro that turns too far",
        gyro(np.eye(3), angular_velocity__z=lambda v: 1.1 * v),
        "too far by the headings of",
        False,
        "gyro",
    ),
    Trap("a compass late by 0.3 s", late(COMPASS, 0.3), "stamps look 0.3", True, "compass"),
)

# --- lasers


def no_returns(word: float) -> Change:
    """Beams into the open: every fifth sector of the room gives none, and the driver says so with `word`."""

    def edit(ranges: Array) -> Array:
        values = ranges.copy()
        values[20:50] = word
        return values

    return field(SCAN, ranges=edit, range_max=8.0)


def freezes(topic: str) -> Change:
    """One reading comes again and again for a second, under new stamps."""
    held: dict[str, RawMessage] = {}

    def edit(m: RawMessage) -> RawMessage:
        return m._replace(fields=held.setdefault(topic, m).fields) if 4.0 <= seconds(m) < 5.0 else m

    return each(topic, edit)


def flipped(ranges: Array) -> Array:
    return np.ascontiguousarray(ranges[::-1])


def clockwise(drive: Drive) -> None:
    drive.field(SCAN, angle_increment=lambda a: -a, ranges=flipped, time_increment=0.0)
    drive.field(SCAN, angle_min=lambda a: -a, angle_max=lambda a: -a)


def in_frame(drive: Drive, frame: str) -> None:
    """Only this frame, if any, says where the laser sits; what /tf_static said is gone."""
    drive.drop("/tf_static")
    drive.each(SCAN, lambda m: m._replace(frame_id=frame))


def upside_down(drive: Drive) -> None:
    """The laser hangs: what it calls left is right; nothing says so."""
    drive.field(SCAN, ranges=flipped, time_increment=0.0)
    in_frame(drive, "")


def yawed(by: float) -> Change:
    """The laser's zero looks elsewhere, and nobody says so."""

    def change(drive: Drive) -> None:
        drive.field(SCAN, angle_min=lambda a: a - by, angle_max=lambda a: a - by)
        in_frame(drive, "")

    return change


PLACED, HANGING = (0.0, 0.0, 0.0, 1.0), (1.0, 0.0, 0.0, 0.0)
LEFT = (0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5))


def tf(drive: Drive, rotation: Iterable[float], at: int = 0) -> None:
    """Another publisher of /tf_static."""
    first = drive.messages[0]
    place = {"translation": {"x": 0.2, "y": 0.0, "z": 0.2}, "rotation": dict(zip("xyzw", rotation, strict=True))}
    stamp = {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": "base_link"}
    fields = {"transforms": [{"header": stamp, "child_frame_id": "laser", "transform": place}]}
    drive.add([RawMessage("/tf_static", "tf2_msgs/msg/TFMessage", first.log_ns + at, first.log_ns, "", fields)])


def told_by_tf(change: Change | None, *rotations: Iterable[float]) -> Change:
    """Only publishers of /tf_static say how the laser sits; the last one counts."""

    def both(drive: Drive) -> None:
        if change is not None:
            change(drive)
        in_frame(drive, "laser")
        for i, rotation in enumerate(rotations):
            tf(drive, rotation, at=i * MS)
        drive.tables["lrf"] = {"topic": SCAN}

    return both


def short_metre(drive: Drive) -> None:
    drive.field(SCAN, ranges=lambda r: r * np.float32(0.9))


def two_lasers(drive: Drive) -> None:
    drive.add([m._replace(topic="/scan_filtered") for m in drive.on(SCAN)])
    del drive.tables["lrf"]["topic"]


QUARTER = math.pi / 2
LONG_RANGES = field(SCAN, ranges=lambda r: r + np.float32(0.08))
# a short-sighted laser: what is further than 5 m comes back as 5 m
SATURATED = field(SCAN, ranges=lambda r: np.minimum(r, np.float32(5.0)), range_max=5.0)
MILLIMETRES = field(SCAN, **dict.fromkeys(("ranges", "range_min", "range_max"), lambda m: 1000.0 * m))

LASER_TRAPS = (
    Trap("a laser without time_increment", field(SCAN, time_increment=0.0), "time_increment is 0", False, "lrf"),
    Trap(
        "a time_increment in the wrong unit",
        field(SCAN, time_increment=lambda dt: 1000.0 * dt),
        "by time_increment a scan lasts",
        False,
        "lrf",
    ),
    Trap("no return as NaN", no_returns(math.nan), "without a return: 17% NaN", False, "lrf"),
    Trap("no return as 0", no_returns(0.0), "without a return: 17% zero", False, "lrf"),
    Trap("no return beyond range_max", no_returns(9.0), "without a return: 17% beyond range_max", False, "lrf"),
    Trap(
        "no return as range_max, or as one other range",
        SATURATED,
        "exactly 5 m, the longest: read as no return",
        False,
        "lrf",
    ),
    Trap(
        "a range_max that is too small", field(SCAN, range_max=1.0), "differ as walls do", True, "lrf", blur=0.02
    ),
    Trap("a range_max that is not filled in", field(SCAN, range_max=0.0), "not filled in", False, "lrf"),
    Trap(
        "an angle_max that contradicts the increment",
        field(SCAN, angle_max=lambda a: a - 0.2),
        "angle_increment is used",
        False,
        "lrf",
    ),
    Trap("a laser that freezes while the robot drives", freezes(SCAN), "repeat the one before", False, "lrf"),
    Trap("scans that were recorded twice", again(SCAN, 2), "repeat the one before", False, "lrf"),
    Trap("a laser that scans clockwise", clockwise, "clockwise", False, "lrf"),
    Trap("a laser upside-down", upside_down, "mounted upside-down", True, "lrf"),
    Trap(
        "upside-down, said by /tf_static",
        told_by_tf(upside_down, HANGING),
        "upside-down by /tf_static",
        False,
        "lrf",
    ),
    Trap("a yawed laser", yawed(QUARTER), "not of 0 deg as", True, "lrf", blur=0.02),
    Trap("a laser that looks back", yawed(math.pi), "not of 0 deg as", True, "lrf", blur=0.02),
    Trap("yawed, said by /tf_static", told_by_tf(yawed(QUARTER), LEFT), "yaw 90° by /tf_static", False, "lrf"),
    Trap(
        "two publishers of /tf_static",
        told_by_tf(None, LEFT, PLACED),
        "contradict; the last one counts",
        False,
        "lrf",
    ),
    Trap(
        "a wrong publisher of /tf_static",
        told_by_tf(None, PLACED, LEFT),
        "not of 90 deg as",
        True,
        "lrf",
        blur=0.02,
    ),
    Trap("a laser late by 0.4 s", late(SCAN, 0.4), "stamps look 0.4", True, "lrf"),
    Trap("a laser whose stamps scatter by 0.03 s", scattered(SCAN, 0.03), "stamps scatter by 0.027", False, "lrf"),
    Trap("a laser on another clock", late(SCAN, 3600.0), "stamped 3600.0 s after the wheels", True, "lrf", True),
    Trap("a laser whose ranges are short", short_metre, "it measures 9.", True, "lrf"),
    Trap("a laser whose ranges are all 8 cm long", LONG_RANGES, "as if every range were", True, "lrf"),
    Trap("a laser whose ranges are in mm", MILLIMETRES, "its ranges look like mm", True, "lrf"),
    Trap("two lasers", two_lasers, "2 topics that fit", False, "lrf"),
)

# --- the truth


def marker(m: RawMessage) -> RawMessage:
    """The tracked body sits 0.25 m ahead and 0.1 m left of the axle's middle."""
    theta = 2 * math.atan2(m.fields["pose.orientation.z"], m.fields["pose.orientation.w"])
    c, s = math.cos(theta), math.sin(theta)
    x, y = m.fields["pose.position.x"] + 0.25 * c - 0.1 * s, m.fields["pose.position.y"] + 0.25 * s + 0.1 * c
    return changed(m, **{"pose.position.x": x, "pose.position.y": y})


def jump(m: RawMessage) -> RawMessage:
    """The tracker takes another body for the robot, three times for a moment."""
    away = int(seconds(m) * 10) % 90 in {40, 41}
    return changed(m, **{"pose.position.x": m.fields["pose.position.x"] + 4.0 * away})


def no_heading(m: RawMessage) -> RawMessage:
    """The tracker knows no heading: the identity stands in its place."""
    return changed(m, **{"pose.orientation.z": 0.0, "pose.orientation.w": 1.0})


def w_first(m: RawMessage) -> RawMessage:
    """The tracker writes its quaternion as w, x, y, z."""
    q = [m.fields[f"pose.orientation.{axis}"] for axis in "wxyz"]
    return changed(m, **{f"pose.orientation.{axis}": value for axis, value in zip("xyzw", q, strict=True)})


def elsewhere(drive: Drive) -> None:
    """The drive starts somewhere else than nothing says: at 0."""
    del drive.tables["start"]


def points_only(drive: Drive) -> None:
    elsewhere(drive)
    kind: dict[str, Any] = {"topic": "/mocap/robot", "msgtype": "geometry_msgs/msg/PointStamped"}
    places = [{f"point.{a}": m.fields[f"pose.position.{a}"] for a in "xy"} for m in drive.on(TRUTH)]
    found = [m._replace(**kind, fields=place) for m, place in zip(drive.on(TRUTH), places, strict=True)]
    drive.drop(TRUTH)
    drive.add(found)
    del drive.tables["truth"]


def two_bodies(drive: Drive) -> None:
    """Another robot, whose name is first, drives the same tour from the end to the beginning."""
    own = drive.on(TRUTH)
    drive.add(m._replace(topic="/mocap/alpha", fields=n.fields) for m, n in zip(own, own[::-1], strict=True))
    drive.add(m._replace(topic="/mocap/robot") for m in own)
    drive.drop(TRUTH)
    del drive.tables["truth"]


TRUTH_TRAPS = (
    Trap("a tracked marker off the axle", each(TRUTH, marker), "it swings as the body point", spoils=True),
    Trap(
        "gaps in the truth",
        silent(TRUTH, (8.0, 10.0), (14.0, 15.0)),
        "2 gaps, the longest 2.1 s: no errors are computed there",
    ),
    Trap("a truth that freezes while the robot drives", freezes(TRUTH), "repeat the one before"),
    Trap("a truth on a clock of its own", late(TRUTH, 0.5), "stamps look 0.5", spoils=True),
    Trap("a truth without headings", each(TRUTH, no_heading), "its heading never changes"),
    Trap(
        "a truth whose quaternions begin with w", each(TRUTH, w_first), "turn about the x axis: read as w, x, y, z"
    ),
    Trap("jumps of metres in the truth", each(TRUTH, jump), "by more than the wheels rolled", spoils=True),
    Trap("two tracked bodies", two_bodies, "2 topics that fit", spoils=True, refused=True),
    Trap("a start that is not set", elsewhere, "m and 20.0 deg from where the drive starts", spoils=True),
    Trap("a start by points only", points_only, "from where the drive starts", spoils=True),
)

# --- cameras

Picture = NDArray[np.uint8]
PADDING = 16  # bytes after each row


def decoded(m: RawMessage) -> Picture:
    picture = cv2.imdecode(np.frombuffer(bytes(m.fields["data"]), np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None
    return np.asarray(picture, np.uint8)


def every(n: int, edit: Callable[[RawMessage], bytes]) -> Change:
    """Change the data of every n-th picture."""

    def change(drive: Drive) -> None:
        bad = {id(m) for m in drive.on(PICTURES)[1::n]}
        drive.each(PICTURES, lambda m: changed(m, data=edit(m)) if id(m) in bad else m)

    return change


def smaller(m: RawMessage) -> bytes:
    return bytes(cv2.imencode(".jpg", cv2.resize(decoded(m), (120, 120)))[1].tobytes())


def raw(drive: Drive, encoding: str, pixels: Callable[[Picture], Picture]) -> None:
    """sensor_msgs/Image, its rows padded, instead of JPEG."""

    def edit(m: RawMessage) -> RawMessage:
        image = pixels(decoded(m))
        height, width = image.shape[:2]
        rows = np.pad(image.reshape(height, -1), ((0, 0), (0, PADDING)))
        size: dict[str, Any] = {"height": height, "width": width, "step": rows.shape[1]}
        fields = {"encoding": encoding, "data": rows.tobytes(), **size}
        return m._replace(topic="/image_raw", msgtype="sensor_msgs/msg/Image", fields=fields)

    drive.each(PICTURES, edit)
    del drive.tables["camera"]["topic"]


PADDED = partial(raw, encoding="rgb8", pixels=lambda p: np.ascontiguousarray(p[..., ::-1]))
CONFUSED = partial(raw, encoding="rgb8", pixels=lambda p: p)  # the driver means bgr8: what is red comes as blue
CAMERA_TRAPS = (
    Trap("pictures in rows with padding", PADDED, None, False, "camera"),
    Trap("rgb for bgr", CONFUSED, "in red: rgb is taken for bgr", True, "camera"),
    Trap(
        "truncated JPEGs",
        every(5, lambda m: bytes(m.fields["data"])[: len(m.fields["data"]) // 3]),
        "cannot be decoded: truncated",
        False,
        "camera",
    ),
    Trap("pictures that change size", every(6, smaller), "they change size: 240 x 240", False, "camera"),
)
