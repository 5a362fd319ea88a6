"""The traps of wheels, of odometry topics and of clocks, each as a change of a healthy drive."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from trap_logs import (
    MS,
    RADIUS,
    TRACK,
    TRUTH,
    WHEELS,
    Change,
    Drive,
    S,
    angles,
    dead_reckoning,
    numbers,
    odometry,
    seconds,
    speeds,
)

from locfuse.sample_logs.messages import RawMessage


class Trap(NamedTuple):
    """One thing that is wrong, and what `info` must say of it."""

    name: str
    change: Change
    says: str | None = None  # words of the complaint or the note; None: it is no trap for us, and nothing is said
    spoils: bool = False
    sensors: str = "odometry"  # of the estimate that must be right
    refused: bool = False  # without the cure there is no estimate at all
    blur: float = 0.01  # m that the cure may cost: it is measured, not known


def other_order(drive: Drive) -> None:
    """Every second message lists the right wheel first."""

    def swap(m: RawMessage) -> RawMessage:
        if int(seconds(m) * 25) % 2:
            return m
        turned = {k: tuple(m.fields[k])[::-1] for k in ("name", "position", "velocity")}
        return m._replace(fields={**m.fields, **turned})

    drive.each(WHEELS, swap)


def arm(drive: Drive) -> None:
    """The arm's joints come on the same topic, in messages of their own and among the wheels'."""
    arms = list(drive.on(WHEELS)[::5])
    own = {"name": ("arm_1", "arm_2"), "position": np.array([0.3, -0.2]), "velocity": np.zeros(0)}
    drive.field(WHEELS, name=lambda n: ("arm_1", *n), position=lambda p: np.array([0.3, *p]))
    drive.add(m._replace(log_ns=m.log_ns + MS, stamp_ns=m.stamp_ns + MS, fields=own) for m in arms)


def wrapped(drive: Drive) -> None:
    drive.field(WHEELS, position=lambda p: (p + np.pi) % (2 * np.pi) - np.pi)


def spiked(drive: Drive) -> None:
    bad = {id(m) for m in drive.on(WHEELS)[200:203]}

    def spike(m: RawMessage) -> RawMessage:
        return (
            m._replace(fields={**m.fields, "position": m.fields["position"] + [900.0, 0.0]}) if id(m) in bad else m
        )

    drive.each(WHEELS, spike)


def restarted(drive: Drive) -> None:
    """The base controller restarts during a halt, and counts from 0 again."""
    drive.each(
        WHEELS,
        lambda m: (
            m if seconds(m) < 12.0 else m._replace(fields={**m.fields, "position": m.fields["position"] - 37.5})
        ),
    )


def repeated(drive: Drive) -> None:
    """Every fifth reading is recorded twice."""
    drive.add(m._replace(log_ns=m.log_ns + MS) for m in drive.on(WHEELS)[::5])


def not_numbers(drive: Drive) -> None:
    drive.each(
        WHEELS,
        lambda m: (
            m if int(seconds(m) * 25) % 7 else m._replace(fields={**m.fields, "position": np.full(2, np.nan)})
        ),
    )


def mirrored(drive: Drive) -> None:
    drive.field(WHEELS, position=lambda p: p * [1.0, -1.0])


def swapped(drive: Drive) -> None:
    drive.field(WHEELS, name=lambda n: tuple(n)[::-1])


def other_names(drive: Drive) -> None:
    """Joints that are not called left and right, beside one that does not turn; robot.toml names none."""
    drive.field(WHEELS, name=("caster", "drive_l", "drive_r"), position=lambda p: np.array([0.1, *p]))
    del drive.tables["wheels"]["left"], drive.tables["wheels"]["right"]


def wrong_track(drive: Drive) -> None:
    drive.tables["wheels"]["track"] = 0.9 * TRACK


def wrong_radius(drive: Drive) -> None:
    """Worn or mistyped, 15 %; the track is nominal too, so that turning is right."""
    drive.tables["wheels"].update(radius=1.15 * RADIUS, track=1.15 * TRACK)


def no_geometry(drive: Drive) -> None:
    """Joint angles and the odometry that the base made of them; robot.toml says nothing of wheels."""
    drive.add(odometry(drive, dead_reckoning(drive), speeds(drive)))
    drive.tables["wheels"] = {"topic": WHEELS}


DESCRIPTION = f"""<robot name="tried"><link name="base_link"/>
<link name="lw"><collision><geometry><cylinder radius="{RADIUS}" length="0.02"/></geometry></collision></link>
<link name="rw"><collision><geometry><cylinder radius="{RADIUS}" length="0.02"/></geometry></collision></link>
<joint name="left_wheel_joint" type="continuous"><parent link="base_link"/><child link="lw"/>
  <origin xyz="0 {TRACK / 2} 0" rpy="-1.5708 0 0"/></joint>
<joint name="right_wheel_joint" type="continuous"><parent link="base_link"/><child link="rw"/>
  <origin xyz="0 {-TRACK / 2} 0" rpy="-1.5708 0 0"/></joint></robot>"""


def described(drive: Drive) -> None:
    """Only /robot_description knows the geometry."""
    first = drive.messages[0]
    drive.add(
        [first._replace(topic="/robot_description", msgtype="std_msgs/msg/String", fields={"data": DESCRIPTION})]
    )
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


def only_odometry(drive: Drive) -> None:
    drive.add(odometry(drive, dead_reckoning(drive), speeds(drive)))
    drive.drop(WHEELS)
    drive.tables["wheels"] = {}


def blind_to_reverse(drive: Drive) -> None:
    """The driver puts wheel turns without their sign into the pose; its twist knows better."""
    poses, twist = dead_reckoning(drive), speeds(drive)
    step, turn = np.hypot(*np.diff(poses[:, :2], axis=0).T), np.diff(poses[:, 2])
    middle = poses[:-1, 2] + turn / 2
    for axis, f in enumerate((np.cos, np.sin)):
        poses[1:, axis] = np.cumsum(step * f(middle))
    drive.add(odometry(drive, poses, twist))
    drive.drop(WHEELS)
    drive.tables["wheels"] = {}


def twist_only(drive: Drive) -> None:
    """An odometry whose pose is never filled in."""
    drive.add(odometry(drive, np.zeros((len(drive.on(WHEELS)), 3)), speeds(drive)))
    drive.drop(WHEELS)
    drive.tables["wheels"] = {}


def relocalised(drive: Drive) -> None:
    """The odometry's pose is reset to 0 half-way."""
    poses = dead_reckoning(drive)
    half = len(poses) // 2
    poses[half:, :2] -= poses[half, :2] - [0.0, 3.0]
    drive.add(odometry(drive, poses, speeds(drive)))
    drive.drop(WHEELS)
    drive.tables["wheels"] = {}


def two_odometries(drive: Drive) -> None:
    only_odometry(drive)
    drive.add([m._replace(topic="/odom2") for m in drive.on("/odom")])


WHEEL_TRAPS = (
    Trap("joints in another order", other_order),
    Trap("an arm on the same topic", arm, "other joints than left_wheel_joint and right_wheel_joint"),
    Trap("no velocity and no effort", lambda d: d.field(WHEELS, velocity=np.zeros(0))),
    Trap("a first sample that is not zero", lambda d: d.field(WHEELS, position=lambda p: p + 371.2)),
    Trap("angles that wrap at pi", wrapped, "left counter rolled over"),
    Trap("a spike that returns", spiked, "left counter jumped away and back"),
    Trap("a counter that starts anew", restarted, "counter started anew"),
    Trap("repeats with dt = 0", repeated, "repeat the one before"),
    Trap("readings that are no numbers", not_numbers, "NaN or Inf"),
    Trap("a mirrored wheel", mirrored, "the right wheel counts backward", spoils=True),
    Trap("left and right swapped", swapped, "left and right are swapped", spoils=True),
    Trap("joints of other names", other_names, "which joints are the wheels'", spoils=True, refused=True),
    Trap("a wrong track", wrong_track, "the track is 0.54 m, but the turning of", spoils=True),
    Trap("a wrong radius", wrong_radius, "they measure", spoils=True),
    Trap("geometry that only /odom knows", no_geometry, "/odom was made with these", spoils=True, refused=True),
    Trap(
        "geometry that /robot_description knows", described, "/robot_description tells", spoils=True, refused=True
    ),
    Trap("a pair of Int16 counters", tick_pair, "/odom was made with these"),
    Trap("odometry instead of wheels", only_odometry),
    Trap("an odometry blind to reverse", blind_to_reverse, "while its velocity says reverse"),
    Trap("an odometry without poses", twist_only, "its pose never changes: its twist is used"),
    Trap("an odometry that jumps", relocalised, "its pose jumped once"),
    Trap("two odometries", two_odometries, "2 topics that fit", spoils=True, refused=True),
)


def backwards(drive: Drive) -> None:
    """For a second the stamps run 0.4 s behind: recording knows the order."""
    drive.each(WHEELS, lambda m: m._replace(stamp_ns=m.stamp_ns - 400 * MS) if 9.0 < seconds(m) < 10.0 else m)


def some_zero(drive: Drive) -> None:
    drive.each(WHEELS, lambda m: m._replace(stamp_ns=0) if int(seconds(m) * 25) % 9 == 0 else m)


def some_absurd(drive: Drive) -> None:
    drive.each(
        WHEELS, lambda m: m._replace(stamp_ns=m.stamp_ns + 3600 * S) if int(seconds(m) * 25) % 9 == 0 else m
    )


def all_zero(drive: Drive) -> None:
    drive.each(WHEELS, lambda m: m._replace(stamp_ns=0))


def simulated_time(drive: Drive) -> None:
    """All headers start at 0, as with use_sim_time, while recording goes by the wall clock."""
    first = drive.messages[0].stamp_ns - 5 * S
    drive.messages = [m._replace(stamp_ns=m.stamp_ns - first) for m in drive.messages]


def silence(drive: Drive) -> None:
    drive.each(WHEELS, lambda m: None if 8.0 < seconds(m) < 8.9 else m)


def repeated_truth(drive: Drive) -> None:
    drive.add(m._replace(log_ns=m.log_ns + MS) for m in drive.on(TRUTH)[::3])


CLOCK_TRAPS = (
    Trap("stamps that run backwards", backwards, "moved into their order (9 backwards)"),
    Trap("stamps of zero", some_zero, "zero)"),
    Trap("absurd stamps", some_absurd, "off the stream's clock)"),
    Trap("stamps that are all zero", all_zero, "most header stamps contradict it"),
    Trap("header and log time are two clocks", simulated_time, "two clocks; header stamps are used"),
    Trap("a silence", silence, "a gap of 0.9 s"),
    Trap("a truth that repeats", repeated_truth, "repeat the one before"),
)
