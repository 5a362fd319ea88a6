"""Units of the numbers in robot.toml, determined by the key or its ending."""

from __future__ import annotations

BY_UNIT = {
    "m": ("camera.landmark", "landmarks.map", "ranges.map"),
    "m/s": ("wheels.max_speed", "truth.max_speed", "twist.sigma"),
    "m/√m": ("pose.sigma_drift",),
    "m, m, °": ("sonar.mounts",),
    "m, m, °, °": ("landmarks.mounts",),
    "°": ("truth.origin", "gps.origin"),
    "°/s": ("gyro.bias_deg", "gyro.sigma_bias_deg", "twist.sigma_turn_deg"),
    "°/√s": ("compass.offset_drift_deg", "gyro.sigma_deg"),
    "°/s/√s": ("gyro.bias_drift_deg",),
    "°/√m": ("pose.sigma_drift_deg",),
    "s": ("pose.correlated",),
    "px": (
        "camera.centre", "camera.inner", "camera.outer", "camera.min_length",
        "landmarks.optics", "landmarks.fx", "landmarks.cx",
    ),
    "columns": ("camera.width",),
    "grey levels": ("camera.red_min",),
    "ticks": ("wheels.ticks_per_revolution",),
    "the counter's own unit": ("wheels.rollover",),
    "rpm at 1 m/s": ("wheels.erpm_per_mps",),
    "1/rad": ("wheels.servo_gain",),
    "the message's unit": ("compass.hard_iron",),
}  # fmt: skip
UNIT_OF_PATH = {path: unit for unit, paths in BY_UNIT.items() for path in paths}
SECONDS = {"at", "time_offset", "period"}
METRES = {
    "floor_range", "min_length", "noise", "offset", "radius", "range_max", "range_offset", "track", "wheelbase",
    "sigma", "sigma_offset", "sigma_range", "sigma_range_offset", "sigma_x", "sigma_xy", "sigma_y", "x", "y",
}  # fmt: skip
WITH_METRES = {"m", "m, m, °", "m, m, °, °"}
WORDS = {"m": "metres", "°": "degrees", "s": "seconds", "px": "pixels", "m/s": "metres per second"}


def of(table: str, key: str) -> str:
    """Return the unit of a key's value: "m"; "" without one."""
    if (path := f"{table}.{key}") in UNIT_OF_PATH:
        return UNIT_OF_PATH[path]
    return "°" if key.endswith("_deg") else "s" if key in SECONDS else "m" if key in METRES else ""


def in_words(table: str, key: str) -> str:
    """Return the unit of a key's value in words: "metres"; "" without one."""
    unit = of(table, key)
    return WORDS.get(unit, unit)
