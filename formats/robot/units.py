"""The unit of every number in robot.toml: by the key's ending, else by the key."""

from __future__ import annotations

EXACT = {
    "wheels.ticks_per_revolution": "ticks",
    "wheels.rollover": "the counter's own unit",
    "wheels.max_speed": "m/s",
    "wheels.erpm_per_mps": "rpm at 1 m/s",
    "wheels.servo_gain": "1/rad",
    "truth.max_speed": "m/s",
    "truth.origin": "°",
    "gps.origin": "°",
    "compass.offset_drift_deg": "°/√s",
    "compass.hard_iron": "the message's unit",
    "camera.landmark": "m",
    "landmarks.mounts": "m, m, °, °",
    "landmarks.optics": "px",
    "camera.centre": "px",
    "camera.inner": "px",
    "camera.outer": "px",
    "camera.width": "columns",
    "camera.min_length": "px",
    "camera.red_min": "grey levels",
    "gyro.sigma_deg": "°/√s",
    "gyro.bias_deg": "°/s",
    "gyro.sigma_bias_deg": "°/s",
    "gyro.bias_drift_deg": "°/s/√s",
    "landmarks.map": "m",
    "ranges.map": "m",
    "landmarks.fx": "px",
    "landmarks.cx": "px",
    "pose.correlated": "s",
    "pose.sigma_drift": "m/√m",
    "pose.sigma_drift_deg": "°/√m",
    "twist.sigma": "m/s",
    "twist.sigma_turn_deg": "°/s",
    "sonar.mounts": "m, m, °",
}
SECONDS = {"at", "time_offset", "period"}
METRES = {
    "floor_range",
    "min_length",
    "noise",
    "offset",
    "radius",
    "range_max",
    "range_offset",
    "sigma",
    "sigma_offset",
    "sigma_range",
    "sigma_range_offset",
    "sigma_x",
    "sigma_xy",
    "sigma_y",
    "track",
    "wheelbase",
    "x",
    "y",
}
WITH_METRES = {"m", "m, m, °", "m, m, °, °"}
WORDS = {"m": "metres", "°": "degrees", "s": "seconds", "px": "pixels", "m/s": "metres per second"}


def of(table: str, key: str) -> str:
    """Return the unit of a key's value, "" without one."""
    if (path := f"{table}.{key}") in EXACT:
        return EXACT[path]
    return "°" if key.endswith("_deg") else "s" if key in SECONDS else "m" if key in METRES else ""


def in_words(table: str, key: str) -> str:
    """Return the unit as a word for a sentence: "metres"; "" without a unit."""
    unit = of(table, key)
    return WORDS.get(unit, unit)
