"""Reading of wheel motion from joint angles, ticks, poses of an odometry, or steered wheels."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from msgspec.structs import replace

from locfuse.fusion.data import Array, LocfuseError, Stream
from locfuse.fusion.robot import VIRTUAL_TRACK, Mirrored, WheelSettings
from locfuse.fusion.streams import MergedStream, blank, count_dropped

from . import odometry, sources
from .motion import Wheels
from .repairs import repaired
from .steered import MOTOR, is_tricycle, motor_speeds, read_encoders, twists_of

# In order of preference: wheel angles before computed odometry.
WHEEL_READS: Mapping[str, tuple[str, ...]] = {
    sources.JOINTS: ("name", "position"),
    **sources.TICKS,
    **sources.SPEEDS,
    **dict.fromkeys(sources.NUMBERS, ("data",)),
    **dict.fromkeys(sources.ARRAYS, ("data",)),
    **odometry.BODY_READS,
    **{kind: (field,) for kind, field in MOTOR.items()},
}
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
    if stream.msgtype in odometry.BODY_READS:
        posed = odometry.has_pose(stream.msgtype, settings)
        commands = not posed and odometry.commanded(stream.topic, stream.msgtype)
        return _from_body(stream, odometry.pose_and_speed(stream, settings), settings, posed, commands)
    if settings.scales != (1.0, 1.0, 1.0):
        raise LocfuseError(
            f"wheels.scale and wheels.turn_scale correct an odometry, and {stream.topic} is none: set "
            "wheels.radius and wheels.track",
            role="wheels",
        )
    if isinstance(stream, MergedStream) and is_tricycle(stream):
        found = read_encoders(stream, settings)
        sources.require_two(stream.topic, len(found.t), len(stream.parts[0].t_ns))
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
    counters = sources.read_counters(stream, settings)
    turn = 2.0 * math.pi / settings.ticks_per_revolution if settings.ticks_per_revolution else 1.0
    t, left, right, notes = _rolled(counters, radius * turn, settings)
    sources.require_two(stream.topic, len(t), len(stream.t_ns))
    wheels = Wheels.from_wheels(t - t[0], left, right, track, settings.noise)
    epoch_ns = counters.zero_ns + round((float(t[0]) + settings.time_offset) * 1e9)
    return WheelReading(wheels, epoch_ns, counters.dropped, (*counters.notes, *notes))


def _rolled(
    counters: sources.Counters, metres: float, settings: WheelSettings
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
    if settings.ratio <= 0.0:
        raise LocfuseError(
            f"ratio {settings.ratio:g} must be positive: right radius over left radius", role="wheels"
        )
    if settings.ticks_per_revolution is None and counts_ticks(stream.msgtype):
        usual = sources.USUAL_TICKS.get(stream.msgtype)
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
    return msgtype in sources.TICKS or sources.NUMBERS.get(msgtype, 0) > 0 or sources.ARRAYS.get(msgtype, 0) > 0


def _from_body(
    stream: Stream, values: Array, settings: WheelSettings, posed: bool, commands: bool
) -> WheelReading:
    """Read the body's motion from values (n, 5): x, y [m], yaw [rad], forward speed [m/s], turning rate [rad/s].

    Without a configured track, VIRTUAL_TRACK is used; it affects only the noise. `posed` is whether the messages
    have poses, `commands` whether the speeds are commands.
    """
    dropped = dict(stream.dropped)
    keep = sources.usable(stream.t_ns, values, dropped)
    if posed:
        lost = blank(values[keep, :2])
        count_dropped(dropped, zeros=lost)
        keep = keep[~lost]
    sources.require_two(stream.topic, len(keep), len(stream.t_ns), dropped)
    t = (stream.t_ns[keep] - stream.t_ns[keep[0]]) * 1e-9
    if commands:
        can = odometry.possible(values[keep, 3:], settings.max_speed)
        count_dropped(dropped, spike=~can)
        t, twist = odometry.obeyed(t[can], values[keep[can], 3:])
        notes, doubt = tuple[str, ...](), ""
    else:
        motion = odometry.travelled(t, values[keep], settings.reverse_by_twist, settings.max_speed, posed)
        count_dropped(dropped, spike=motion.spikes)
        t, twist, notes, doubt = t[motion.keep], motion.twist, motion.notes, motion.doubt
    sources.require_two(stream.topic, len(t), len(stream.t_ns))
    twist = twist * settings.scales
    wheels = Wheels.from_twists(t - t[0], twist, settings.track or VIRTUAL_TRACK, settings.noise)
    epoch_ns = int(stream.t_ns[keep[0]]) + round((float(t[0]) + settings.time_offset) * 1e9)
    return WheelReading(wheels, epoch_ns, dropped, notes, doubt)
