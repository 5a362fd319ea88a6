"""What `init` says of the keys that a log cannot tell: how to measure them, and which defaults are guesses.

Of a sensor's keys the sensor says it itself.
"""

from __future__ import annotations

from locfuse.fusion.sensor import Ask
from locfuse.fusion.sensors.registry import REGISTRY

ASKS = {
    "wheels": {
        "radius": Ask(
            "m: not in this log. Roll ten turns of a wheel along a ruler: way / (10 * 2 pi)", needed=True
        ),
        "track": Ask(
            "m: not in this log. Between the middles of both tyres; `locfuse calibrate` refines it",
            needed=True,
        ),
        "wheelbase": Ask("m: not in this log. Between the front and the rear axle", needed=True),
        "erpm_per_mps": Ask(
            "electrical revolutions per minute of the motor at 1 m/s: speed_to_erpm_gain of vesc.yaml", blank=True
        ),
        "servo_gain": Ask("of the servo's position: steering_angle_to_servo_gain of vesc.yaml", needed=True),
        "ticks_per_revolution": Ask("not in this log. Turn a wheel ten times by hand: ticks / 10", needed=True),
        "noise": Ask("m: variance per metre that a wheel rolls; `locfuse calibrate` finds it"),
    },
    "start": dict.fromkeys(
        ("x", "y", "theta_deg"),
        Ask("m, degrees: pose at the first wheel reading, where the map is not to begin at the robot"),
    ),
    "truth": {
        **dict.fromkeys(
            ("x", "y"), Ask("m: the point of the robot that was tracked, forward and left of the axle's middle")
        ),
        "sigma": Ask("m: how exact the truth is itself"),
        "sigma_theta_deg": Ask("degrees: how exact its heading is"),
    },
}
# Conventions that hold unless the user sets others; no log states them.
GUESSES = {
    "wheels": {
        "mirrored": "guess: both counters rise while the robot drives forward",
        "steering": "guess: radians of the front wheels (rate: rad/s of the body, heading: rad)",
    }
}


def ask(table: str, key: str) -> Ask | None:
    """Return what to ask the robot's owner of a key, None where nothing need be asked."""
    return (REGISTRY[table].asks if table in REGISTRY else ASKS.get(table, {})).get(key)


def guess(table: str, key: str) -> str | None:
    """Return what a default means that holds unless somebody says otherwise, None where it is no guess."""
    return (REGISTRY[table].guesses if table in REGISTRY else GUESSES.get(table, {})).get(key)
