"""What `init` says of the keys that a log cannot tell: how to measure them, and which defaults are guesses."""

from __future__ import annotations

# Without these nothing runs (wheels), or their sensor does not.
NEEDED = {
    "wheels.radius": "m: not in this log. Roll ten turns of a wheel along a ruler: way / (10 * 2 pi)",
    "wheels.track": "m: not in this log. Between the middles of both tyres; `locfuse calibrate` refines it",
    "wheels.ticks_per_revolution": "not in this log. Turn a wheel ten times by hand: ticks / 10",
    "camera.landmark": (
        "[x, y] in m, map frame: not in this log. Where the red landmark stands; "
        "`locfuse info LOG --preview DIR` shows what the camera takes for it"
    ),
}
MOUNT = (
    "not in this log (no /tf_static says it). Measure from the middle between the wheels: forward, left, turned. "
    "How well they are known: sigma_x, sigma_y, sigma_yaw_deg; above 0 the drive improves them"
)
# Blank although they have a default: zero looks as if somebody had measured it.
PLACE = ("x", "y", "yaw_deg")
BLANK = {f"{sensor}.{key}" for sensor in ("lrf", "camera", "gps") for key in PLACE}
ASKS = {
    "wheels.noise": "m: variance per metre that a wheel rolls; `locfuse calibrate` finds it",
    **dict.fromkeys(
        ("start.x", "start.y", "start.theta_deg"),
        "m, degrees: pose at the first wheel reading, where the map is not to begin at the robot",
    ),
    **dict.fromkeys(
        ("truth.x", "truth.y"),
        "m: the point of the robot that was tracked, forward and left of the axle's middle",
    ),
    "truth.sigma": "m: how exact the truth is itself",
    **dict.fromkeys(
        (f"{sensor}.{key}" for sensor in ("lrf", "camera") for key in PLACE), f"m, m, degrees: {MOUNT}"
    ),
    **dict.fromkeys(("gps.x", "gps.y"), f"m: {MOUNT}"),
    "sonar.mounts": f'{{ "/topic" = [m, m, degrees] }}: {MOUNT}',
    "lrf.sigma_range": "m: noise of one range, by the data sheet",
    "compass.sigma_deg": "noise of one heading",
    "compass.offset_deg": "left out, it is estimated from the drive; locfuse calibrate finds iron",
    "camera.centre": "[column, row] in px: where the mirror's axis meets the picture; left out, its middle",
    "camera.outer": "px: radius of the mirror's rim; left out, to the picture's nearest edge",
    "gps.origin": "[latitude, longitude] of the map's origin; left out, estimated",
    "gps.sigma": "m: where the receiver does not say",
}
# Conventions that are in force unless somebody says otherwise, and that no log states.
GUESSES = {
    "wheels.mirrored": "guess: both counters rise while the robot drives forward",
    "compass.convention": "guess: radians, 0 is east and counter-clockwise (enu_deg, compass_rad, compass_deg)",
    "camera.zero_deg": "guess: bearing at which column 0 (straight down in the picture) looks",
    "camera.clockwise": "guess: columns turn counter-clockwise in the world, seen from above",
    "gyro.unit": "guess: radians per second, as REP 103 wants",
}
