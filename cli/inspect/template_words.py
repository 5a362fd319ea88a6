"""What `init` says of the keys that a log cannot tell: how to measure them, and which defaults are guesses."""

from __future__ import annotations

from typing import Any, NamedTuple


class Ask(NamedTuple):
    """A key that only the robot's owner can fill in."""

    words: str
    example: Any = None  # None: the key's default


# Without these nothing runs (wheels), or their sensor does not.
NEEDED = {
    "wheels.radius": Ask("m: not in this log. Roll ten turns of a wheel along a ruler: way / (10 * 2 pi)", 0.035),
    "wheels.track": Ask(
        "m: not in this log. Between the middles of both tyres; `locfuse calibrate` refines it",
        0.16,
    ),
    "wheels.ticks_per_revolution": Ask("not in this log. Turn a wheel ten times by hand: ticks / 10", 4096.0),
    "camera.landmark": Ask(
        "m, map frame: not in this log. Where the red landmark stands; "
        "`locfuse info LOG --preview DIR` shows what the camera takes for it",
        (2.0, 0.0),
    ),
}
MOUNT = (
    "not in this log (no /tf_static says it). Measure from the middle between the wheels: forward, left, turned. "
    "How well they are known: sigma_x, sigma_y, sigma_yaw_deg; above 0 the drive improves them"
)
ASKS = {
    "wheels.noise": Ask("m: variance per metre that a wheel rolls; `locfuse calibrate` finds it"),
    **dict.fromkeys(
        ("start.x", "start.y", "start.theta_deg"),
        Ask("m, degrees: pose at the first wheel reading, where the map is not to begin at the robot"),
    ),
    **dict.fromkeys(
        ("truth.x", "truth.y"),
        Ask("m: the point of the robot that was tracked, forward and left of the axle's middle"),
    ),
    "truth.sigma": Ask("m: how exact the truth is itself"),
    **dict.fromkeys((f"lrf.{k}" for k in ("x", "y", "yaw_deg")), Ask(f"m, m, degrees: {MOUNT}")),
    **dict.fromkeys((f"camera.{k}" for k in ("x", "y", "yaw_deg")), Ask(f"m, m, degrees: {MOUNT}")),
    **dict.fromkeys(("gps.x", "gps.y"), Ask(f"m: {MOUNT}")),
    "sonar.mounts": Ask(f"topic = [m, m, degrees]: {MOUNT}", {"/range": (0.0, 0.0, 0.0)}),
    "lrf.sigma_range": Ask("m: noise of one range, by the data sheet"),
    "compass.sigma_deg": Ask("noise of one heading"),
    "compass.offset_deg": Ask("left out, it is estimated from the drive; locfuse calibrate finds iron", 0.0),
    "camera.centre": Ask("px: where the mirror's axis meets the picture; left out, its middle", (320.0, 240.0)),
    "camera.outer": Ask("px: radius of the mirror's rim; left out, to the picture's nearest edge", 230.0),
    "gps.origin": Ask("latitude and longitude of the map's origin; left out, estimated", (0.0, 0.0)),
    "gps.sigma": Ask("m: where the receiver does not say"),
}
# Conventions that are in force unless somebody says otherwise, and that no log states.
GUESSES = {
    "wheels.mirrored": "guess: both counters rise while the robot drives forward",
    "compass.convention": "guess: radians, 0 is east and counter-clockwise (enu_deg, compass_rad, compass_deg)",
    "camera.zero_deg": "guess: bearing at which column 0 (straight down in the picture) looks",
    "camera.clockwise": "guess: columns turn counter-clockwise in the world, seen from above",
    "gyro.unit": "guess: radians per second, as REP 103 wants",
}
