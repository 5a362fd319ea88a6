"""A car's motor on one topic and its steering on another: what a VESC motor controller measures.

The VESC counts electrical revolutions per minute (erpm). With those of 1 m/s, which its driver calls
speed_to_erpm_gain, they are a speed v; the front wheels' angle d turns the car by v tan(d) / wheelbase. The angle
is an Ackermann command, or the position of the servo, which is gain * angle + offset.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import cast

import numpy as np

from locfuse.fusion.data import Array, LocfuseError, Stream
from locfuse.fusion.robot import WheelSettings
from locfuse.fusion.streams import MergedStream

from .odometry import STEERED, wheelbase_of

# Message type -> field of the motor's speed [erpm].
MOTOR: Mapping[str, str] = {
    "vesc_msgs/msg/VescStateStamped": "state.speed",
    "vesc_msgs/msg/VescState": "speed",
}
SERVO = "std_msgs/msg/Float64"  # its position, 0 to 1
GAIN_HINT = "speed_to_erpm_gain of vesc.yaml"


def motor_speeds(stream: MergedStream, settings: WheelSettings) -> Array:
    """Return (n, 5) zeros, forward speed [m/s] and turning rate [rad/s] at the motor's readings.

    The steering is the newest that came before; before the first it is the first. Raises LocfuseError where a
    setting is missing, or nothing was steered.
    """
    motor, steering = stream.parts
    if not settings.erpm_per_mps:
        raise LocfuseError(
            f"{motor.topic} gives revolutions of the motor, so those of 1 m/s must be known.",
            role="wheels",
            hint=f"Set them with --set wheels.erpm_per_mps=<erpm> ({GAIN_HINT})",
        )
    if not len(steering.t_ns):
        raise LocfuseError(f"{steering.topic} holds no messages, so nobody knows where to", role="wheels")
    erpm = cast("dict[str, Array]", motor.columns(MOTOR[motor.msgtype]))[MOTOR[motor.msgtype]]
    newest = np.searchsorted(steering.t_ns, motor.t_ns, side="right") - 1
    angle = _angles(steering, settings)[np.maximum(newest, 0)]
    values = np.zeros((len(motor.t_ns), 5))
    values[:, 3] = erpm.astype(np.float64) / settings.erpm_per_mps
    values[:, 4] = values[:, 3] * np.tan(angle) / wheelbase_of(motor, settings)
    return values


def _angles(steering: Stream, settings: WheelSettings) -> Array:
    """Return the angles (n,) [rad] of the front wheels."""
    field = STEERED[steering.msgtype][1] if steering.msgtype in STEERED else "data"
    told = cast("dict[str, Array]", steering.columns(field))[field].astype(np.float64)
    if steering.msgtype in STEERED:
        return told
    if not settings.servo_gain:
        raise LocfuseError(
            f"{steering.topic} gives positions of the servo, so its gain must be known.",
            role="wheels",
            hint="Set them with --set wheels.servo_gain=<gain> --set wheels.servo_offset=<offset> "
            "(steering_angle_to_servo_gain and _offset of vesc.yaml)",
        )
    return (told - settings.servo_offset) / settings.servo_gain
