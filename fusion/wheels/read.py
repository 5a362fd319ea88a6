"""Reading of wheel motion from joint angles, ticks, number topics, poses of an odometry, or steered wheels."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import NamedTuple, cast

import numpy as np
from msgspec.structs import replace

from locfuse.fusion.data import Array, Ints, LocfuseError, Mask, Ragged, Stream, totals
from locfuse.fusion.robot import MIN_SCALE, VIRTUAL_TRACK, Mirrored, WheelSettings
from locfuse.fusion.streams import MergedStream, blank, count_dropped, numbers, seconds

from . import odometry
from .motion import Wheels
from .repairs import Side, increments, repaired, spread
from .steered import MOTOR, is_tricycle, motor_speeds, read_encoders, twists_of

JOINTS = "sensor_msgs/msg/JointState"
KOBUKI = "kobuki_msgs/msg/SensorState"
# Message type -> fields of the left and the right counter.
TICKS: Mapping[str, tuple[str, str]] = {
    "irobot_create_msgs/msg/WheelTicks": ("ticks_left", "ticks_right"),
    "turtlebot3_msgs/msg/SensorState": ("left_encoder", "right_encoder"),
    KOBUKI: ("left_encoder", "right_encoder"),
}
TICK_BITS = {KOBUKI: 16}  # of the counters; 32 by default
# Message type -> fields of the left and the right wheel's speed [rad/s].
SPEEDS: Mapping[str, tuple[str, str]] = {"irobot_create_msgs/msg/WheelVels": ("velocity_left", "velocity_right")}
SPEEDS_ALONE = "it gives speeds and no angles: they are integrated"  # note on JointState
# Message type with one wheel per topic -> bits of the counter; 0: the number may be an angle.
NUMBERS: Mapping[str, int] = {
    "std_msgs/msg/Int16": 16,
    "std_msgs/msg/UInt16": 16,
    "std_msgs/msg/Int32": 32,
    "std_msgs/msg/UInt32": 32,
    "std_msgs/msg/Int64": 64,
    "std_msgs/msg/Float32": 0,
    "std_msgs/msg/Float64": 0,
    "duckietown_msgs/msg/WheelEncoderStamped": 32,
}
# Message type with both wheels in an array -> bits of the counters; 0: the numbers may be angles.
ARRAYS: Mapping[str, int] = {f"{kind}MultiArray": n for kind, n in NUMBERS.items() if kind.startswith("std_msgs/")}
USUAL_TICKS = {
    "irobot_create_msgs/msg/WheelTicks": 508.8,  # Create 3, and the TurtleBot 4 on it
    "turtlebot3_msgs/msg/SensorState": 4096.0,  # the TurtleBot 3's Dynamixels
    KOBUKI: 2578.33,  # the TurtleBot 2's Kobuki base: 52 ticks per motor revolution, gear 49.58
    "duckietown_msgs/msg/WheelEncoderStamped": 135.0,  # the Duckiebot DB21's Hall encoders
}
SIDE_LETTERS = {"left": {"l", "fl", "rl", "bl"}, "right": {"r", "fr", "rr", "br"}}  # in names of wheel joints
REAR_WORDS, REAR_LETTERS = ("rear", "back"), {"rl", "rr", "bl", "br"}
NO_DRIVE = ("caster", "steer", "drop", "suspension")  # words in names of joints of a wheel that do not roll it
LIMBS = (
    *("hip", "knee", "thigh", "calf", "ankle", "leg", "foot"),
    *("arm", "shoulder", "elbow", "wrist", "finger", "gripper"),
)


class Counters(NamedTuple):
    """Readings of both wheels, and the number of unused readings by reason."""

    left: Side
    right: Side
    zero_ns: int  # stamp from which the times of both sides count
    dropped: dict[str, int]
    notes: tuple[str, ...] = ()


def read_counters(stream: Stream, settings: WheelSettings) -> Counters:
    """Read the counters of both wheels from a stream. Raises LocfuseError if it has none.

    Ticks since the message before, in place of a counter, are summed.
    """
    counters = _pair(stream, settings) if isinstance(stream, MergedStream) else _one(stream, settings)
    sides = counters.left, counters.right
    if not counts_ticks(stream.msgtype) or not all(map(increments, sides)):
        return counters
    left, right = (side._replace(value=np.cumsum(side.value)) for side in sides)
    note = "the ticks are 0 whenever a wheel stands: they count from message to message, and are summed"
    return counters._replace(left=left, right=right, notes=(*counters.notes, note))


def _one(stream: Stream, settings: WheelSettings) -> Counters:
    """Read both wheels from one topic."""
    dropped = dict(stream.dropped)
    found = _found(stream, settings, dropped)
    keep = usable(found.t_ns, found.values, dropped)
    sides = [Side("", seconds(found.t_ns[keep], 0), one) for one in found.values[keep].T]
    if stream.msgtype == JOINTS and not found.speeds and len(keep) and all(map(increments, sides)):
        note = "the positions are 0 whenever a wheel stands: they are speeds, and are summed as rad/s"
        found = found._replace(speeds=True, notes=(*found.notes, note))
    if not found.speeds:
        lost = blank(found.values[keep])
        count_dropped(dropped, zeros=lost)
        keep = keep[~lost]
    require_two(stream.topic, len(keep), len(stream.t_ns), dropped)
    zero_ns = int(found.t_ns[keep[0]])
    t = seconds(found.t_ns[keep], zero_ns)
    values, bursts = found.values[keep], tuple[str, ...]()
    if found.speeds:  # integrated to angles by the trapezoidal rule
        values = totals(0.5 * (values[1:] + values[:-1]) * np.diff(t)[:, None])
    else:
        t, bursts = spread(t, np.abs(np.diff(values, axis=0)).sum(axis=1))
    likely = (*found.likely, *_revolution(settings))
    left, right = (Side(name, t, values[:, i], likely) for i, name in enumerate(("left", "right")))
    return Counters(left, right, zero_ns, dropped, (*found.notes, *bursts))


def _found(stream: Stream, settings: WheelSettings, dropped: dict[str, int]) -> _Found:
    if stream.msgtype == JOINTS:
        return _joints(stream, settings, dropped)
    if stream.msgtype in ARRAYS:
        bits = ARRAYS[stream.msgtype]
        return _Found(stream.t_ns, _of_array(stream, settings), (2.0**bits,) if bits else ())
    fields = SPEEDS.get(stream.msgtype)
    if fields is not None:
        return _Found(stream.t_ns, numbers(stream, *fields), speeds=True)
    modulus = 2.0 ** TICK_BITS.get(stream.msgtype, 32)
    return _Found(stream.t_ns, numbers(stream, *TICKS[stream.msgtype]), (modulus,))


def _of_array(stream: Stream, settings: WheelSettings) -> Array:
    """Return the numbers (n, 2) of left and right wheel from arrays; NaN for arrays of unusual length.

    An array of two numbers has left and right. For longer arrays, the settings `[wheels] left` and `right` are the
    indices ("0" is the first).
    """
    rows = cast("Ragged", stream.columns("data")["data"])
    long = int(np.median(rows.lengths)) if len(rows) else 0
    configured = (settings.left, settings.right)
    at = [int(one) if one is not None and one.isdecimal() else -1 for one in configured]
    if long == 2 and configured == (None, None):
        at = [0, 1]
    if not all(0 <= k < long for k in at):
        raise LocfuseError(
            f"{stream.topic} holds {long} numbers; which are the left and the right wheel is not said.",
            role="wheels",
            hint=f"Say it with --set wheels.left=0 --set wheels.right={max(long - 1, 1)} (0 is the first)",
        )
    out = np.full((len(rows), 2), np.nan)
    whole = rows.lengths == long
    for side, k in enumerate(at):
        out[whole, side] = rows.values[rows.first[:-1][whole] + k]
    return out


class _Found(NamedTuple):
    t_ns: Ints  # (n,)
    values: Array  # (n, 2) left, right
    likely: tuple[float, ...] = ()
    notes: tuple[str, ...] = ()
    speeds: bool = False  # the values are rad/s


def usable(t_ns: Ints, values: Array, dropped: dict[str, int]) -> Ints:
    """Return the indices of rows that are finite and have increasing stamps; count the others in `dropped`."""
    finite = np.isfinite(values).all(axis=1)
    count_dropped(dropped, not_finite=~finite)
    rows = np.flatnonzero(finite)
    if len(rows) == 0:
        return rows
    # of several readings with one stamp the last one is used: it has the newest value
    last = np.append(t_ns[rows[1:]] > t_ns[rows[:-1]], True)
    same = (values[rows[1:]] == values[rows[:-1]]).all(axis=1) & ~last[:-1]
    count_dropped(dropped, repeat=same, same_stamp=~last[:-1] & ~same)
    return np.asarray(rows[last])


def require_two(topic: str, found: int, n: int, dropped: Mapping[str, int] | None = None) -> None:
    """Raise LocfuseError if fewer than two readings are usable."""
    if found < 2:
        same = sum((dropped or {}).get(why, 0) for why in ("repeat", "same_stamp"))
        why = f" ({same} share the stamp of another)" if same else ""
        raise LocfuseError(f"{topic} has {found} usable readings of {n}{why}; two are the least", role="wheels")


def _revolution(settings: WheelSettings) -> tuple[float, ...]:
    return (settings.ticks_per_revolution,) if settings.ticks_per_revolution else ()


def _pair(stream: MergedStream, settings: WheelSettings) -> Counters:
    """Read both wheels from two topics of numbers, which are not synchronised and have only recording times."""
    dropped: dict[str, int] = {}
    zero_ns = int(max(part.t_ns[0] if len(part.t_ns) else 0 for part in stream.parts))
    sides, notes = [], list[str]()
    for name, part in zip(("left", "right"), stream.parts, strict=True):
        values, own = numbers(part, "data"), dict(part.dropped)
        keep = usable(part.t_ns, values, own)
        require_two(part.topic, len(keep), len(part.t_ns))
        for reason, n in own.items():
            count_dropped(dropped, **{reason: n})
        bits = NUMBERS[part.msgtype]
        likely = (2.0**bits, *_revolution(settings)) if bits else _revolution(settings)
        t, bursts = spread(seconds(part.t_ns[keep], zero_ns), np.abs(np.diff(values[keep, 0])))
        sides.append(Side(name, t, values[keep, 0], likely))
        notes += bursts
    notes.append("the two topics are not synchronised: the right wheel is interpolated to the left one's instants")
    return Counters(sides[0], sides[1], zero_ns, dropped, tuple(dict.fromkeys(notes)))


def _joints(stream: Stream, settings: WheelSettings, dropped: dict[str, int]) -> _Found:
    """Return the positions or speeds of the two wheel joints; messages without these joints are left out."""
    columns = stream.columns("name", "position")
    names, positions = cast("list[tuple[str, ...]]", columns["name"]), cast("Ragged", columns["position"])
    joints = joint_names(names, stream.topic, settings)
    values, held = _by_name(names, positions, joints)
    speeds = not np.isfinite(values).any()
    if speeds:  # no angles: drivers with a velocity interface leave the positions empty or NaN
        values, held = _by_name(names, cast("Ragged", stream.columns("velocity")["velocity"]), joints)
    left, right = joints
    if not held.any() or (speeds and not np.isfinite(values).any()):
        raise LocfuseError(f"no message on {stream.topic} holds a position of {left} or {right}", role="wheels")
    notes: tuple[str, ...] = (SPEEDS_ALONE,) if speeds else ()
    if not held.all():
        others = int((~held).sum())
        dropped["other_joints"] = others
        words = f"{others} of {len(held)} messages are of other joints than {left} and {right}; set aside"
        notes = (*notes, words)
    return _Found(stream.t_ns[held], values[held], (), notes, speeds)


def _by_name(names: list[tuple[str, ...]], positions: Ragged, joints: Sequence[str]) -> tuple[Array, Mask]:
    """Return positions (n, 2) of two joints, NaN if missing, and a mask (n,) of messages with at least one."""
    out = np.full((len(names), 2), np.nan)
    layouts = {row: i for i, row in enumerate(dict.fromkeys(names))}
    layout = np.zeros(len(names), np.int64)
    if len(layouts) > 1:
        layout = np.fromiter(map(layouts.__getitem__, names), np.int64, len(names))
    held = np.zeros(len(names), dtype=bool)
    lengths = positions.lengths
    for row, which in layouts.items():
        rows = np.flatnonzero(layout == which)
        for side, joint in enumerate(joints):
            if joint in row:
                k = row.index(joint)
                ok = rows[lengths[rows] > k]
                out[ok, side] = positions.values[positions.first[ok] + k]
                held[ok] = True
    return out, held


def joint_names(names: list[tuple[str, ...]], topic: str, settings: WheelSettings) -> tuple[str, str]:
    """Return the names of the left and right wheel joint: the configured ones, else a pair of similar names.

    Of a front and a rear pair, the rear one is used: on a skid-steered robot both are equal, and on a car the rear
    wheels are not steered.
    """
    known = sorted({joint for row in set(names) for joint in row})
    sides = {side: _guesses(known, side) for side in SIDE_LETTERS}
    if len({len(guesses) for guesses in sides.values()}) == 1:  # as many left ones as right ones
        sides = {side: [j for j in guesses if _is_rear(j)] or guesses for side, guesses in sides.items()}
    found = []
    if settings.left is not None and settings.left == settings.right:
        words = f"wheels.left and wheels.right both name {settings.left!r}: name two joints of {topic}"
        raise LocfuseError(words, role="wheels")
    for side, given in (("left", settings.left), ("right", settings.right)):
        if given is not None and given not in known:
            raise LocfuseError(
                f"{topic} has no joint {given!r}; it has {', '.join(known) or 'none'}.",
                role="wheels",
                hint=f"Name one with --set wheels.{side}=<joint>",
            )
        guesses = [given] if given is not None else sides[side]
        if len(guesses) != 1:
            what = f"{len(guesses)} joints are" if guesses else "no joint is"
            fix = f"wheels.{side}={guesses[0] if guesses else '<joint>'}"
            raise LocfuseError(
                f"{what} named like the {side} wheel on {topic} ({', '.join(known) or 'no joints'}).",
                role="wheels",
                fixes=(fix,) if guesses else (),
                hint=f"Name it with --set {fix}",
            )
        found.append(guesses[0])
    return found[0], found[1]


def _guesses(joints: Sequence[str], side: str) -> list[str]:
    """Return the wheel joints of this side, by name; without any, the joints of this side that are no limbs."""
    found = [j for j in joints if side in j.lower() and not any(word in j.lower() for word in LIMBS)]
    wheels = [j for j in joints if "wheel" in j.lower() and not any(word in j.lower() for word in NO_DRIVE)]
    return [j for j in wheels if j in found or _letters(j) & SIDE_LETTERS[side]] or found


def _letters(joint: str) -> set[str]:
    """Return the words in a joint's name: "fl_wheel_joint" gives fl, wheel, joint."""
    return set(re.split(r"[^a-z]+", joint.lower()))


def _is_rear(joint: str) -> bool:
    return any(word in joint.lower() for word in REAR_WORDS) or bool(_letters(joint) & REAR_LETTERS)


# In order of preference: wheel angles before computed odometry.
WHEEL_READS: Mapping[str, tuple[str, ...]] = {
    JOINTS: ("name", "position"),
    **TICKS,
    **SPEEDS,
    **dict.fromkeys(NUMBERS, ("data",)),
    **dict.fromkeys(ARRAYS, ("data",)),
    **odometry.BODY_READS,
    **{kind: (field,) for kind, field in MOTOR.items()},
}
OF_ODOMETRY = ("scale", "turn_scale", "x", "y", "yaw_deg")  # keys that only an odometry has
MIN_LENGTH_M = 1e-6  # least radius and track
SIGNS: Mapping[Mirrored, tuple[float, float]] = {
    "none": (1.0, 1.0),
    "left": (-1.0, 1.0),
    "right": (1.0, -1.0),
    "both": (-1.0, -1.0),
}


class WheelReading(NamedTuple):
    """Wheel motion of a log, with notes on its repairs."""

    wheels: Wheels
    epoch_ns: int  # stamp of the first used reading, plus the time offset
    dropped: dict[str, int]  # readings that are not used, by reason
    notes: tuple[str, ...]  # repairs, each with the setting that controls it
    doubt: str = ""  # why the motion is impossible for a robot

    def with_noise(self, noise: float) -> WheelReading:
        """Return the same motion with the wheel noise replaced by `noise`, the variance per metre rolled [m]."""
        return self._replace(wheels=replace(self.wheels, noise=noise), dropped=dict(self.dropped))


def read_wheels(stream: Stream, settings: WheelSettings) -> WheelReading:
    """Read the wheel motion of a stream. Raises LocfuseError if readings or geometry are insufficient."""
    if stream.msgtype == odometry.SCANS:
        raise LocfuseError(f"{stream.topic} holds scans, whose motion has to be matched first", role="wheels")
    if settings.ratio <= 0.0:
        words = f"ratio {settings.ratio:g} must be positive: right radius over left radius"
        raise LocfuseError(words, role="wheels")
    if stream.msgtype in odometry.BODY_READS:
        posed = odometry.has_pose(stream.msgtype, settings)
        commands = not posed and odometry.commanded(stream.topic, stream.msgtype)
        return _from_body(stream, odometry.pose_and_speed(stream, settings), settings, posed, commands)
    usual = WheelSettings()
    if wrong := [f"wheels.{key}" for key in OF_ODOMETRY if getattr(settings, key) != getattr(usual, key)]:
        words = f"{' and '.join(wrong)}: only for an odometry, and {stream.topic} is none: set "
        raise LocfuseError(f"{words}wheels.radius and wheels.track", role="wheels")
    if isinstance(stream, MergedStream) and is_tricycle(stream):
        found = read_encoders(stream, settings)
        require_two(stream.topic, len(found.t), len(stream.parts[0].t_ns))
        twist, track = twists_of(found, settings, stream), settings.track or VIRTUAL_TRACK
        wheels = Wheels.from_twists(found.t - found.t[0], twist, track, settings.noise)
        epoch_ns = found.zero_ns + round((float(found.t[0]) + settings.time_offset) * 1e9)
        dropped = dict(stream.dropped)
        count_dropped(dropped, spike=found.spikes)
        return WheelReading(wheels, epoch_ns, dropped, found.notes)
    if stream.msgtype in MOTOR:
        if not isinstance(stream, MergedStream):
            words = f"{stream.topic} says how fast the motor turns, and no topic says how the car was steered"
            raise LocfuseError(words, role="wheels")
        return _from_body(stream.parts[0], motor_speeds(stream, settings), settings, False, False)
    radius, track = _geometry(settings, stream)
    counters = read_counters(stream, settings)
    turn = 2.0 * math.pi / settings.ticks_per_revolution if settings.ticks_per_revolution else 1.0
    t, left, right, notes = _rolled(counters, radius * turn, settings)
    require_two(stream.topic, len(t), len(stream.t_ns))
    wheels = Wheels.from_wheels(t - t[0], left, right, track, settings.noise)
    epoch_ns = counters.zero_ns + round((float(t[0]) + settings.time_offset) * 1e9)
    return WheelReading(wheels, epoch_ns, counters.dropped, (*counters.notes, *notes))


def _rolled(
    counters: Counters, metres: float, settings: WheelSettings
) -> tuple[Array, Array, Array, tuple[str, ...]]:
    """Return times (n,) and the repaired distances of left and right wheel (n,) [m] at these times, and notes."""
    how = metres, settings.rollover, settings.max_speed
    left, right = (repaired(side, *how) for side in (counters.left, counters.right))
    count_dropped(counters.dropped, spike=left.spikes + right.spikes)
    t_left, t_right = counters.left.t[left.keep], counters.right.t[right.keep]
    if counters.left.t is counters.right.t:
        t = np.intersect1d(t_left, t_right)
    else:  # two topics: at the times of the left wheel
        t = t_left[(t_left >= t_right[0]) & (t_left <= t_right[-1])]
    s_left, s_right = (s * share for s, share in zip(SIGNS[settings.mirrored], settings.shares, strict=True))
    distances = s_left * np.interp(t, t_left, left.rolled), s_right * np.interp(t, t_right, right.rolled)
    return t, *distances, (*left.notes, *right.notes)


def _geometry(settings: WheelSettings, stream: Stream) -> tuple[float, float]:
    """Return wheel radius and track. Raises LocfuseError if one is missing, or the ticks per revolution."""
    missing = [key for key in ("radius", "track") if getattr(settings, key) is None]
    if missing:
        raise LocfuseError(
            f"wheel angles come from {stream.topic}, so wheels.{' and wheels.'.join(missing)} must be known.",
            role="wheels",
            hint=f"Set them: {' '.join(f'--set wheels.{key}=<metres>' for key in missing)}; locfuse init LOG > "
            "robot.toml writes them where the log describes its robot, else how to measure them",
        )
    radius, track = float(settings.radius or 0.0), float(settings.track or 0.0)
    if min(radius, track) < MIN_LENGTH_M:
        words = f"radius {radius:g} m and track {track:g} m must both be at least {MIN_LENGTH_M:g} m"
        raise LocfuseError(words, role="wheels")
    if settings.ticks_per_revolution is None and counts_ticks(stream.msgtype):
        usual = USUAL_TICKS.get(stream.msgtype)
        fix = f"wheels.ticks_per_revolution={usual or '<ticks>'}"
        raise LocfuseError(
            f"{stream.topic} counts ticks, so wheels.ticks_per_revolution must be known.",
            role="wheels",
            fixes=(fix,) if usual else (),
            hint=f"Set it in robot.toml or with --set {fix}" + (" (usual for this message)" if usual else ""),
        )
    return radius, track


def counts_ticks(msgtype: str) -> bool:
    """Return whether a message type has integer counts, never angles."""
    return msgtype in TICKS or NUMBERS.get(msgtype, 0) > 0 or ARRAYS.get(msgtype, 0) > 0


def _from_body(
    stream: Stream, values: Array, settings: WheelSettings, posed: bool, commands: bool
) -> WheelReading:
    """Read the body's motion from values (n, 5): x, y [m], yaw [rad], forward speed [m/s], turning rate [rad/s].

    Without a configured track, VIRTUAL_TRACK is used; it affects the noise, and the turns by wheels.ratio. `posed`
    is whether the messages have poses, `commands` whether the speeds are commands.
    """
    if abs(settings.turn_scale) < MIN_SCALE:
        raise LocfuseError(f"turn_scale must be at least {MIN_SCALE:g} or at most -{MIN_SCALE:g}", role="wheels")
    dropped = dict(stream.dropped)
    keep = usable(stream.t_ns, values, dropped)
    values = values - np.array([0.0, 0.0, math.radians(settings.yaw_deg), 0.0, 0.0])
    if posed:
        lost = blank(values[keep, :2])
        count_dropped(dropped, zeros=lost)
        keep = keep[~lost]
    require_two(stream.topic, len(keep), len(stream.t_ns), dropped)
    t = (stream.t_ns[keep] - stream.t_ns[keep[0]]) * 1e-9
    t, bursts = spread(t, np.hypot(*np.diff(values[keep, :2], axis=0).T)) if posed else (t, ())
    if commands:
        can = odometry.possible(values[keep, 3:], settings.max_speed)
        count_dropped(dropped, spike=~can)
        t, twist = odometry.obeyed(t[can], values[keep[can], 3:])
        notes, doubt = tuple[str, ...](), ""
    else:
        motion = odometry.travelled(t, values[keep], settings.reverse_by_twist, settings.max_speed, posed)
        count_dropped(dropped, spike=motion.spikes)
        t, twist, notes, doubt = t[motion.keep], motion.twist, motion.notes, motion.doubt
    require_two(stream.topic, len(t), len(stream.t_ns))
    notes = (*notes, *bursts)
    if settings.x or settings.y or settings.yaw_deg:
        place = f"({settings.x:.3g}, {settings.y:.3g}) m on the base, at {settings.yaw_deg:.1f}°"
        notes = (*notes, f"its poses are of a body at {place} (wheels.x, wheels.y, wheels.yaw_deg)")
    twist = odometry.on_base(twist * settings.scales, settings.x, settings.y)
    (left, right), track = settings.shares, settings.track or VIRTUAL_TRACK
    twist[:, 2] += twist[:, 0] * (right - left) / track
    wheels = Wheels.from_twists(t - t[0], twist, track, settings.noise)
    epoch_ns = int(stream.t_ns[keep[0]]) + round((float(t[0]) + settings.time_offset) * 1e9)
    return WheelReading(wheels, epoch_ns, dropped, notes, doubt)
