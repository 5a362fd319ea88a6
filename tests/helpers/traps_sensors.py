"""The traps of compasses, lasers, gyros and of the truth, each as a change of a healthy drive."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation
from trap_logs import COMPASS, MS, SCAN, TRUTH, Array, Drive, S, headings, numbers, seconds, truth_headings
from traps_wheels import Trap

from locfuse.sample_logs.messages import RawMessage

VECTORS = ("angular_velocity", "linear_acceleration")
OFFSET = 0.6  # rad: where the compass' zero lies in the map
IMU = "sensor_msgs/msg/Imu"
# base -> sensor, of mounts turned by 90 deg about x, and about y
ROLLED = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
PITCHED = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])


def heading_number(drive: Drive, values: Array) -> None:
    """A heading as a bare number instead of the magnetometer."""
    drive.add(numbers("/heading", "Float64", drive.on(COMPASS), values.tolist()))
    drive.drop(COMPASS)
    del drive.tables["compass"]


def compass_degrees(drive: Drive) -> None:
    heading_number(drive, np.degrees(math.pi / 2 - headings(drive) - OFFSET) % 360)


def enu_degrees(drive: Drive) -> None:
    heading_number(drive, np.degrees(headings(drive) + OFFSET) % 360)


def compass_radians(drive: Drive) -> None:
    heading_number(drive, (math.pi / 2 - headings(drive) - OFFSET) % (2 * math.pi))


def enu_radians(drive: Drive) -> None:
    heading_number(drive, headings(drive) + OFFSET)


def turned_field(drive: Drive, R: Array) -> None:
    """The magnetometer sits on the robot as R (3, 3), base -> sensor, says; nothing else does."""

    def edit(m: RawMessage) -> RawMessage:
        field = R @ [m.fields["magnetic_field.x"], m.fields["magnetic_field.y"], -3e-5]
        values = {f"magnetic_field.{a}": v for a, v in zip("xyz", field.tolist(), strict=True)}
        return m._replace(frame_id="", fields={**m.fields, **values})

    drive.each(COMPASS, edit)


def imu(drive: Drive, R: Array, orientation: bool, **more: Any) -> None:
    """An IMU at the compass' instants: turning rate and gravity, in its own axes; with or without its yaw."""
    t, theta = truth_headings(drive)
    rate = np.gradient(theta, t)
    found = []
    for m, yaw in zip(drive.on(COMPASS), headings(drive) + OFFSET, strict=True):
        omega = R @ [0.0, 0.0, np.interp(seconds(m), t, rate)]
        up = R @ [0.0, 0.0, 9.81]
        fields: dict[str, Any] = {
            "orientation_covariance": np.full(9, 0.0 if orientation else -1.0),
            **{f"angular_velocity.{a}": float(v) for a, v in zip("xyz", omega, strict=True)},
            **{f"linear_acceleration.{a}": float(v) for a, v in zip("xyz", up, strict=True)},
        }
        if orientation:
            fields |= {f"orientation.{a}": v for a, v in zip("xyzw", _quaternion(yaw, R), strict=True)}
        found.append(m._replace(topic="/imu", msgtype=IMU, frame_id="", fields={**fields, **more}))
    drive.add(found)


def _quaternion(yaw: float, R: Array) -> list[float]:
    """Orientation x, y, z, w of a sensor (world <- base <- sensor) on a robot with this yaw."""
    c, s = math.cos(yaw), math.sin(yaw)
    q = Rotation.from_matrix(np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ R.T).as_quat()
    return [float(v) for v in q]


def pitched_imu(drive: Drive) -> None:
    """On end: its x axis points down; its driver's orientation is right, of its own axes."""
    imu(drive, PITCHED, orientation=True)
    drive.drop(COMPASS)
    del drive.tables["compass"]


def ned_imu(drive: Drive) -> None:
    """North, east, down: the world's axes and the sensor's, as aerial autopilots write them."""
    imu(drive, np.eye(3), orientation=True)
    flip = np.diag([1.0, -1.0, -1.0])
    world = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])  # ENU to NED

    def ned(m: Any) -> Any:
        q = [m.fields[f"orientation.{a}"] for a in "xyzw"]
        turned = Rotation.from_matrix(world @ Rotation.from_quat(q).as_matrix() @ flip).as_quat().tolist()
        fields = {f"orientation.{a}": v for a, v in zip("xyzw", turned, strict=True)}
        fields |= {f"{name}.{a}": -m.fields[f"{name}.{a}"] for name in VECTORS for a in "yz"}
        return m._replace(fields={**m.fields, **fields})

    drive.each("/imu", ned)
    drive.tables["gyro"] = {"roll_deg": 180.0}
    drive.drop(COMPASS)
    del drive.tables["compass"]


def gravity_reversed(drive: Drive) -> None:
    """A driver that gives gravity's pull, not what an accelerometer feels."""
    imu(drive, np.eye(3), orientation=False)
    drive.field("/imu", **{"linear_acceleration.z": lambda v: -v})


def imu_without_yaw(drive: Drive) -> None:
    """Most IMUs have no yaw; the compass beside it has."""
    imu(drive, np.eye(3), orientation=False)
    del drive.tables["compass"]["topic"]


def upside_down_gyro(drive: Drive) -> None:
    imu(drive, np.diag([1.0, -1.0, -1.0]), orientation=False, **{f"linear_acceleration.{a}": 0.0 for a in "xyz"})


def gyro_in_degrees(drive: Drive) -> None:
    imu(drive, np.eye(3), orientation=False)
    drive.field("/imu", **{"angular_velocity.z": math.degrees})


def field_upside_down(drive: Drive) -> None:
    turned_field(drive, np.diag([1.0, -1.0, -1.0]))


def field_rolled(drive: Drive) -> None:
    turned_field(drive, ROLLED)


def rolled_imu(drive: Drive) -> None:
    imu(drive, ROLLED, orientation=False)


def late_compass(drive: Drive) -> None:
    late(drive, COMPASS, 0.3)


COMPASS_TRAPS = (
    Trap("heading, ENU in radians", enu_radians, None, False, "compass"),
    Trap("heading, ENU in degrees", enu_degrees, "the wheels it grows counter-clockwise", True, "compass", True),
    Trap("heading, compass in degrees", compass_degrees, "the wheels it grows clockwise", True, "compass", True),
    Trap("heading, compass in radians", compass_radians, "headings grow clockwise", True, "compass"),
    Trap("a magnetometer upside-down", field_upside_down, "the field turns says that it", True, "compass"),
    Trap("a magnetometer rolled by 90 degrees", field_rolled, "the field turns says that it", True, "compass"),
    Trap("an IMU on end", pitched_imu, "compass: gravity says that it is mounted", True, "compass"),
    Trap("an IMU rolled by 90 degrees", rolled_imu, "gyro: gravity says that it is mounted", True, "gyro", True),
    Trap("an IMU in NED", ned_imu, "headings grow clockwise", True, "compass"),
    Trap("gravity of the other sign", gravity_reversed, "gives gravity with the other sign", False, "gyro"),
    Trap("an IMU without orientation", imu_without_yaw, None, False, "compass"),
    Trap("a gyro upside-down", upside_down_gyro, "turns -0.9", True, "gyro", True),
    Trap("a gyro in degrees", gyro_in_degrees, "times as far as the wheels", True, "gyro", True),
    Trap("a compass late by 0.3 s", late_compass, "stamps look 0.3", True, "compass"),
)


def late(drive: Drive, topic: str, by: float) -> None:
    drive.each(topic, lambda m: m._replace(stamp_ns=m.stamp_ns + round(by * S)))


def no_returns(word: float) -> Any:
    """Beams into the open: every fifth sector of the room gives none, and the driver says so with `word`."""

    def change(drive: Drive) -> None:
        def edit(ranges: Array) -> Array:
            values = ranges.copy()
            values[20:50] = word
            return values

        drive.field(SCAN, ranges=edit, range_max=8.0)

    return change


def saturated(drive: Drive) -> None:
    """A short-sighted laser: what is further than 5 m comes back as 5 m."""
    drive.field(SCAN, ranges=lambda r: np.minimum(r, np.float32(5.0)), range_max=5.0)


def clockwise(drive: Drive) -> None:
    drive.field(SCAN, angle_increment=lambda a: -a, ranges=flipped, time_increment=0.0)
    drive.field(SCAN, angle_min=lambda a: -a, angle_max=lambda a: -a)


def flipped(ranges: Array) -> Array:
    return np.ascontiguousarray(ranges[::-1])


def upside_down(drive: Drive) -> None:
    """The laser hangs: what it calls left is right; nothing says so."""
    drive.field(SCAN, ranges=flipped, time_increment=0.0)
    hide_mount(drive)


def hide_mount(drive: Drive) -> None:
    drive.drop("/tf_static")
    drive.each(SCAN, lambda m: m._replace(frame_id=""))


def tf(drive: Drive, x: float, y: float, rotation: tuple[float, float, float, float], at: int = 0) -> None:
    """Another publisher of /tf_static."""
    first = drive.messages[0]
    transform = {
        "header": {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": "base_link"},
        "child_frame_id": "laser",
        "transform": {
            "translation": {"x": x, "y": y, "z": 0.2},
            "rotation": dict(zip("xyzw", rotation, strict=True)),
        },
    }
    fields = {"transforms": [transform]}
    drive.add([RawMessage("/tf_static", "tf2_msgs/msg/TFMessage", first.log_ns + at, first.log_ns, "", fields)])


def only_tf_knows_upside_down(drive: Drive) -> None:
    upside_down(drive)
    drive.each(SCAN, lambda m: m._replace(frame_id="laser"))
    tf(drive, 0.2, 0.0, (1.0, 0.0, 0.0, 0.0))
    drive.tables["lrf"] = {"topic": SCAN}


def yawed(drive: Drive) -> None:
    """The laser's zero looks to the left."""
    drive.field(SCAN, angle_min=lambda a: a - math.pi / 2, angle_max=lambda a: a - math.pi / 2)


def backward(drive: Drive) -> None:
    """The laser's zero looks back, as that of many a cheap laser does, and nobody says so."""
    drive.field(SCAN, angle_min=lambda a: a - math.pi, angle_max=lambda a: a - math.pi)
    drive.drop("/tf_static")


def only_tf_knows_the_yaw(drive: Drive) -> None:
    yawed(drive)
    drive.drop("/tf_static")
    tf(drive, 0.2, 0.0, (0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5)))
    drive.tables["lrf"] = {"topic": SCAN}


def nobody_knows_the_yaw(drive: Drive) -> None:
    yawed(drive)
    hide_mount(drive)


def two_publishers(drive: Drive) -> None:
    """A second publisher of /tf_static puts the laser elsewhere; who of both is right nobody can say."""
    drive.drop("/tf_static")
    tf(drive, 0.2, 0.0, (0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5)))
    tf(drive, 0.2, 0.0, (0.0, 0.0, 0.0, 1.0), at=MS)
    drive.tables["lrf"] = {"topic": SCAN}


def wrong_publisher(drive: Drive) -> None:
    """The same, and the last word is wrong: the walls know better."""
    drive.drop("/tf_static")
    tf(drive, 0.2, 0.0, (0.0, 0.0, 0.0, 1.0))
    tf(drive, 0.2, 0.0, (0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5)), at=MS)
    drive.tables["lrf"] = {"topic": SCAN}


def short_metre(drive: Drive) -> None:
    drive.field(SCAN, ranges=lambda r: r * np.float32(0.9))


def two_lasers(drive: Drive) -> None:
    drive.add([m._replace(topic="/scan_filtered") for m in drive.on(SCAN)])
    del drive.tables["lrf"]["topic"]


def not_timed(drive: Drive) -> None:
    drive.field(SCAN, time_increment=0.0)


def late_laser(drive: Drive) -> None:
    late(drive, SCAN, 0.4)


def other_clock(drive: Drive) -> None:
    late(drive, SCAN, 3600.0)


LASER_TRAPS = (
    Trap("a laser without time_increment", not_timed, "time_increment is 0", False, "lrf"),
    Trap("no return as NaN", no_returns(math.nan), "NaN: nothing came back", False, "lrf"),
    Trap("no return as 0", no_returns(0.0), "zero: nothing came back", False, "lrf"),
    Trap("no return beyond range_max", no_returns(9.0), "beyond range_max: nothing came back", False, "lrf"),
    Trap(
        "no return as range_max, or as one other range",
        saturated,
        "exactly 5 m, the longest: read as no return",
        False,
        "lrf",
    ),
    Trap("a laser that scans clockwise", clockwise, "clockwise", False, "lrf"),
    Trap("a laser upside-down", upside_down, "mounted upside-down", True, "lrf"),
    Trap(
        "upside-down, said by /tf_static",
        only_tf_knows_upside_down,
        "upside-down by /tf_static",
        False,
        "lrf",
    ),
    Trap("a yawed laser", nobody_knows_the_yaw, "not of 0 deg as", True, "lrf", blur=0.02),
    Trap("a laser that looks back", backward, "not of 0 deg as", True, "lrf", blur=0.02),
    Trap("yawed, said by /tf_static", only_tf_knows_the_yaw, "yaw 90° by /tf_static", False, "lrf"),
    Trap("two publishers of /tf_static", two_publishers, "contradict; the last one counts", False, "lrf"),
    Trap("a wrong publisher of /tf_static", wrong_publisher, "not of 90 deg as", True, "lrf", blur=0.02),
    Trap("a laser late by 0.4 s", late_laser, "stamps look 0.4", True, "lrf"),
    Trap("a laser on another clock", other_clock, "stamped 3600.0 s after the wheels", True, "lrf"),
    Trap("a laser whose ranges are short", short_metre, "it measures 9.", True, "lrf"),
    Trap("two lasers", two_lasers, "2 topics that fit", False, "lrf"),
)


def marker(drive: Drive) -> None:
    """The tracked body sits 0.25 m ahead and 0.1 m left of the axle's middle."""

    def edit(m: RawMessage) -> RawMessage:
        theta = 2 * math.atan2(m.fields["pose.orientation.z"], m.fields["pose.orientation.w"])
        c, s = math.cos(theta), math.sin(theta)
        x, y = m.fields["pose.position.x"], m.fields["pose.position.y"]
        moved = {"pose.position.x": x + 0.25 * c - 0.1 * s, "pose.position.y": y + 0.25 * s + 0.1 * c}
        return m._replace(fields={**m.fields, **moved})

    drive.each(TRUTH, edit)


def jumps(drive: Drive) -> None:
    """The tracker takes another body for the robot, three times for a moment."""
    drive.each(
        TRUTH,
        lambda m: (
            m._replace(fields={**m.fields, "pose.position.x": m.fields["pose.position.x"] + 4.0})
            if int(seconds(m) * 10) % 90 in {40, 41}
            else m
        ),
    )


def elsewhere(drive: Drive) -> None:
    """The drive starts somewhere else than nothing says: at 0."""
    del drive.tables["start"]


def points_only(drive: Drive) -> None:
    elsewhere(drive)
    found = [
        m._replace(
            topic="/mocap/robot",
            msgtype="geometry_msgs/msg/PointStamped",
            fields={"point.x": m.fields["pose.position.x"], "point.y": m.fields["pose.position.y"]},
        )
        for m in drive.on(TRUTH)
    ]
    drive.drop(TRUTH)
    drive.add(found)
    del drive.tables["truth"]


def blind_spots(drive: Drive) -> None:
    drive.each(TRUTH, lambda m: None if 8.0 < seconds(m) < 10.0 or 14.0 < seconds(m) < 15.0 else m)


TRUTH_TRAPS = (
    Trap("a tracked marker off the axle", marker, "it swings as the body point", spoils=True),
    Trap("gaps in the truth", blind_spots, "2 gaps, the longest 2.1 s: no errors are computed there"),
    Trap("a truth on a clock of its own", lambda d: late(d, TRUTH, 0.5), "stamps look 0.5", spoils=True),
    Trap("jumps of metres in the truth", jumps, "by more than the wheels rolled", spoils=True),
    Trap("a start that is not set", elsewhere, "m and 20.0 deg from where the drive starts", spoils=True),
    Trap("a start by points only", points_only, "from where the drive starts", spoils=True),
)
