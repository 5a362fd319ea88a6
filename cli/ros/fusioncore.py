"""Parameters of FusionCore: sigmas of wheels, gyro, GPS and magnetometer, and the antenna's lever arm.

FusionCore's noise is the standard deviation of one reading (docs/configuration.md): of a speed by
fusion.wheels.velocity_noise, of a gyro its random walk over one period.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from locfuse.formats.robot.ros_yaml import KEPT, Setting
from locfuse.fusion.sensors.magnetic import FIELD
from locfuse.fusion.truth import FIX
from locfuse.fusion.wheels.odometry import ODOMETRY

from .ekf import gyro_rate_hz, gyro_variance
from .found import FoundRobot


def settings(found: FoundRobot, there: Mapping[str, Any]) -> list[Setting]:
    """Return the node's parameters, computed from `found`; `there`, the file's present values, is not needed."""
    parts = {sensor: of(found) for sensor, of in SENSORS.items() if found.has(sensor)}
    mapped = [sensor for sensor, part in parts.items() if part]
    made = [setting for part in parts.values() for setting in part]
    return [*_wheels(found), *made, *found.unmapped("FusionCore", mapped, REASONS)]


def _wheels(found: FoundRobot) -> list[Setting]:
    model = "DifferentialDrive" if found.robot.wheels.wheelbase is None else "Ackermann"
    at = f"of one reading at {1.0 / found.velocity.period:.3g} Hz"
    vel, yaw = np.sqrt(found.velocity.needed / found.velocity.period).tolist()  # FusionCore's Q is no parameter
    return [
        found.topic_setting("encoder.topic", "wheels", ODOMETRY),
        found.setting("encoder.vel_noise", vel, f"m/s {at}", "wheels.noise"),
        found.setting("encoder.yaw_noise", yaw, f"rad/s {at}", "wheels.noise"),
        Setting("motion_model", model, "by the wheels of robot.toml", KEPT),
        Setting("publish.force_2d", True, "locfuse estimates in the plane", KEPT),
    ]


def _gyro(found: FoundRobot) -> list[Setting]:
    noise = math.sqrt(gyro_variance(found, with_bias=False))
    words = f"rad/s of one reading at {gyro_rate_hz(found):.3g} Hz"
    return [found.setting("imu.gyro_noise", noise, words, "gyro.sigma_deg")]


def _satellites(found: FoundRobot) -> list[Setting]:
    gps = found.robot.settings("gps")
    return [
        found.topic_setting("gnss.fix_topic", "gps", FIX),
        found.setting("gnss.base_noise_xy", gps.sigma, "m", "gps.sigma"),
        found.setting("gnss.lever_arm_x", gps.x, "m, antenna on the base", "gps.x"),
        found.setting("gnss.lever_arm_y", gps.y, "m, antenna on the base", "gps.y"),
    ]


def _compass(found: FoundRobot) -> list[Setting]:
    topic, kind = found.topic("compass")
    if kind != FIELD:
        return []
    compass = found.robot.settings("compass")
    xx, xy, yx, yy = compass.soft_iron
    hard, soft = [*compass.hard_iron, 0.0], [xx, xy, 0.0, yx, yy, 0.0, 0.0, 0.0, 1.0]
    noise = math.radians(compass.sigma_deg)
    unit, z = "in the message's unit", "z is not measured"
    return [
        Setting("magnetometer.enabled", True, f"{topic} in the log", KEPT),
        found.topic_setting("magnetometer.topic", "compass", FIELD),
        found.setting("magnetometer.noise_rad", noise, "rad", "compass.sigma_deg"),
        found.setting("magnetometer.hard_iron", hard, f"{unit}; {z}", "compass.hard_iron", (0, 1)),
        found.setting("magnetometer.soft_iron", soft, z, "compass.soft_iron", (0, 1, 3, 4)),
    ]


Settings = Callable[[FoundRobot], list[Setting]]
SENSORS: Mapping[str, Settings] = {"gyro": _gyro, "gps": _satellites, "compass": _compass}
REASONS = {  # of sensors that stay unmapped
    "lrf": "FusionCore reads no laser: give it the pose of AMCL as vslam.topic",
    "compass": f"the magnetometer of FusionCore reads {FIELD} only",
    "pose": "FusionCore reads the pose of another program from vslam.topic: set it by hand",
}
