"""Steered wheels: motor and steering of a car, and encoders of a tricycle's front wheel.

The VESC, a motor controller of cars, counts electrical revolutions per minute (erpm). Divided by those of 1 m/s
(speed_to_erpm_gain of its driver), they give the speed v; with the angle d of the front wheels, the turning rate
is v tan(d) / wheelbase. The angle is an Ackermann command, or follows from the servo position, gain * angle +
offset.

The front wheel of a tricycle rolls ds in the direction phi, so the middle of the rear axle moves by ds cos(phi)
and turns by ds sin(phi) / wheelbase. One tick of the traction encoder is 2 pi radius / ticks_per_revolution; the
steering encoder reads servo_gain * phi + servo_offset in ticks, and rolls over once per turn.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from locfuse.fusion.data import Array, LocfuseError, Stream
from locfuse.fusion.robot import WheelSettings
from locfuse.fusion.streams import MergedStream, numbers, seconds

from .odometry import STEERED, wheelbase_of
from .repairs import Side, repaired, unrolled

# Message type -> field of the motor speed [erpm].
MOTOR: Mapping[str, str] = {"vesc_msgs/msg/VescStateStamped": "state.speed", "vesc_msgs/msg/VescState": "speed"}
SERVO = "std_msgs/msg/Float64"  # servo position, 0 to 1
GAIN_HINT = "speed_to_erpm_gain of vesc.yaml"
COUNTER_RANGES = (2.0**16, 2.0**32)  # possible moduli of traction counters, independent of the message type
STEERING_WORD = "steer"


def motor_speeds(stream: MergedStream, settings: WheelSettings) -> Array:
    """Return x, y, yaw (zeros: no pose), forward speed [m/s], turning rate [rad/s] of n motor readings, (n, 5).

    Each motor reading gets the last steering reading before it, or the first one. Raises LocfuseError if a setting
    or the steering is missing.
    """
    motor, steering = stream.parts
    if not settings.erpm_per_mps:
        raise LocfuseError(
            f"{motor.topic} gives revolutions of the motor, so those of 1 m/s must be known.",
            role="wheels",
            hint=f"Set them with --set wheels.erpm_per_mps=<erpm> ({GAIN_HINT})",
        )
    if not len(steering.t_ns):
        raise LocfuseError(f"{steering.topic} holds no messages: the steering is unknown", role="wheels")
    newest = np.searchsorted(steering.t_ns, motor.t_ns, side="right") - 1
    angle = _angles(steering, settings)[np.maximum(newest, 0)]
    values = np.zeros((len(motor.t_ns), 5))
    values[:, 3] = numbers(motor, MOTOR[motor.msgtype])[:, 0] / settings.erpm_per_mps
    values[:, 4] = values[:, 3] * np.tan(angle) / wheelbase_of(motor, settings)
    return values


def _angles(steering: Stream, settings: WheelSettings) -> Array:
    """Return the steering angles (n,) [rad] of the front wheels, from commands or servo positions."""
    field = STEERED[steering.msgtype][1] if steering.msgtype in STEERED else "data"
    steered = numbers(steering, field)[:, 0]
    if steering.msgtype in STEERED:
        return steered
    if not settings.servo_gain:
        raise LocfuseError(
            f"{steering.topic} gives positions of the servo, so its gain must be known.",
            role="wheels",
            hint="Set them with --set wheels.servo_gain=<gain> --set wheels.servo_offset=<offset> "
            "(steering_angle_to_servo_gain and _offset of vesc.yaml)",
        )
    return (steered - settings.servo_offset) / settings.servo_gain


class Encoders(NamedTuple):
    """Readings of both encoders of a tricycle, at the times of the traction encoder."""

    t: Array  # (n,) s since the first reading
    zero_ns: int
    rolled: Array  # (n,) m, distance rolled by the front wheel
    steering: Array  # (n,) ticks, without rollovers
    spikes: int
    notes: tuple[str, ...]


def is_tricycle(stream: Stream) -> bool:
    """Return whether two topics of numbers are traction and steering, instead of left and right wheel."""
    return isinstance(stream, MergedStream) and STEERING_WORD in stream.parts[-1].topic.lower()


def read_encoders(stream: MergedStream, settings: WheelSettings) -> Encoders:
    """Read both encoders of a tricycle. Raises LocfuseError without wheel radius or ticks per revolution."""
    traction, steering = stream.parts
    if not (settings.radius and settings.ticks_per_revolution):
        raise LocfuseError(
            f"{traction.topic} counts how far the front wheel rolls, so its size must be known.",
            role="wheels",
            hint="Set it with --set wheels.radius=<metres> --set wheels.ticks_per_revolution=<ticks>",
        )
    if not len(steering.t_ns) or len(traction.t_ns) < 2:
        raise LocfuseError(f"{traction.topic} and {steering.topic} hold too few messages", role="wheels")
    rows = np.flatnonzero(np.diff(traction.t_ns, append=np.iinfo(np.int64).max) > 0)
    zero_ns = int(traction.t_ns[0])
    t = seconds(traction.t_ns[rows], zero_ns)
    metres = 2.0 * math.pi * settings.radius / settings.ticks_per_revolution
    side = Side("traction", t, numbers(traction, "data")[rows, 0], COUNTER_RANGES)
    wheel = repaired(side, metres, settings.rollover, settings.max_speed)
    turned = unrolled(numbers(steering, "data")[:, 0]).values
    at = np.interp(t[wheel.keep], seconds(steering.t_ns, zero_ns), turned)
    return Encoders(t[wheel.keep], zero_ns, wheel.rolled, at, wheel.spikes, wheel.notes)


def twists_of(found: Encoders, settings: WheelSettings, stream: Stream) -> Array:
    """Return the twists (n-1, 3) of the rear axle's middle, from the encoders of a tricycle.

    Raises LocfuseError if the gain of the steering or the wheelbase is not configured.
    """
    if not settings.servo_gain:
        raise LocfuseError(
            f"{stream.topic}: how the steering's ticks become an angle must be known.",
            role="wheels",
            hint="Set it with --set wheels.servo_gain=<ticks per radian> --set wheels.servo_offset=<ticks "
            "straight ahead>; locfuse calibrate refines both",
        )
    angle = (found.steering - settings.servo_offset) / settings.servo_gain
    return rolled_by(np.diff(found.rolled), angle, wheelbase_of(stream, settings))


def rolled_by(ds: Array, angle: Array, wheelbase: float) -> Array:
    """Return body twists (n-1, 3) of a tricycle for front-wheel distances ds (n-1,) [m] at `angle` (n,) [rad]."""
    middle = 0.5 * (angle[1:] + angle[:-1])
    return np.stack((ds * np.cos(middle), np.zeros_like(ds), ds * np.sin(middle) / wheelbase), axis=-1)
