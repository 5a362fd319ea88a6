"""A car's motor controller as motion: its topic, that of the steering, and what they lack."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from locfuse.fusion.data import LocfuseError
from locfuse.fusion.robot import Robot
from locfuse.fusion.wheels.motor import GAIN_HINT, MOTOR, SERVO
from locfuse.fusion.wheels.odometry import STEERED

from .topics import checked, of_type

if TYPE_CHECKING:
    from locfuse.formats.logs.log import Log


def motors(log: Log) -> list[str]:
    """Return topics that say how fast a car's motor turns."""
    return [t for t in of_type(log, MOTOR) if log.topics[t].count]


def steering_of(log: Log, robot: Robot) -> str | None:
    """Return the topic that says how a car was steered: as set, else an Ackermann command, else a servo."""
    named = robot.wheels.steering_topic
    if named is not None:
        return checked(log, "wheels", named, (*STEERED, SERVO))
    commands = [t for t in of_type(log, STEERED) if log.topics[t].count]
    servos = [t for t in of_type(log, (SERVO,)) if log.topics[t].count and "servo" in t.lower()]
    if robot.wheels.servo_gain and servos:
        return servos[0]
    obeyed = [t for t in commands if t.rpartition("/")[2] == "ackermann_cmd"]
    return next(iter([*obeyed, *commands, *servos]), None)


def with_steering(log: Log, robot: Robot, motor: str) -> list[str]:
    """Return the topics of a motor and of its steering. Raises LocfuseError where nothing was steered."""
    steering = steering_of(log, robot)
    if steering is None:
        raise LocfuseError(
            f"{motor} says how fast the motor turns, and no topic says how the car was steered "
            "(an AckermannDrive, or a servo's position).",
            role="wheels",
            hint="Name it with --set wheels.steering_topic=<topic>, or the odometry that was made of both",
        )
    return [motor, steering]


def motor_of(log: Log, robot: Robot) -> Sequence[str]:
    """Return the topics of a motor and of its steering, where the settings make metres of them; else nothing."""
    found, settings = motors(log), robot.wheels
    known = settings.erpm_per_mps and settings.wheelbase and steering_of(log, robot) is not None
    return with_steering(log, robot, found[0]) if len(found) == 1 and known else ()


def motor_words(log: Log, robot: Robot) -> str:
    """Say which settings would make a motion of what a motor controller measured; "" where there is none."""
    found = motors(log)
    if not found or motor_of(log, robot):
        return ""
    if steering_of(log, robot) is None:
        return f"{found[0]} says how fast the motor turns, and no topic says how the car was steered"
    return (
        f"{found[0]} holds what its motor did: --set wheels.topic={found[0]} --set wheels.erpm_per_mps=<erpm> "
        f"({GAIN_HINT}) --set wheels.wheelbase=<metres> uses it"
    )
