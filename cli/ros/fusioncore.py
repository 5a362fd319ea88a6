"""FusionCore: standard deviations of wheels, gyro, satellites and magnetometer, and the antenna's lever arm.

Its noises are standard deviations of one reading (docs/configuration.md): of a speed here the variance by
fusion.wheels.velocity_noise, of a gyro its random walk over one period.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from locfuse.formats.robot.ros_yaml import KEPT, Setting
from locfuse.fusion.wheels.odometry import ODOMETRY

from .ekf import gyro_variance, readings_per_second
from .found import Found

FIX = "sensor_msgs/msg/NavSatFix"
FIELD = "sensor_msgs/msg/MagneticField"


def settings(found: Found, there: Mapping[str, Any]) -> list[Setting]:
    """Return the parameters; `there` are those of the file that is changed."""
    return [*_wheels(found), *_gyro(found), *_satellites(found), *_compass(found), *_rest(found)]


def _wheels(found: Found) -> list[Setting]:
    topic, kind = found.topic("wheels")
    named = kind == ODOMETRY
    why, origin = found.why("wheels.noise"), found.origin("wheels.noise")
    model = "DifferentialDrive" if found.robot.wheels.wheelbase is None else "Ackermann"
    at = f"of one reading at {1.0 / found.velocity.period:.3g} Hz; {why}"
    vel, yaw = np.sqrt(found.velocity.needed / found.velocity.period).tolist()  # its Q is not ours to set
    return [
        Setting(
            key="encoder.topic",
            value=topic if named else None,
            words=f"{topic} in the log" if named else f"{topic} is no nav_msgs/Odometry: name your driver's",
            origin=KEPT,
        ),
        Setting(key="encoder.vel_noise", value=vel, words=f"m/s {at}", origin=origin),
        Setting(key="encoder.yaw_noise", value=yaw, words=f"rad/s {at}", origin=origin),
        Setting(key="motion_model", value=model, words="by the wheels of robot.toml", origin=KEPT),
        Setting(key="publish.force_2d", value=True, words="locfuse estimates in the plane", origin=KEPT),
    ]


def _gyro(found: Found) -> list[Setting]:
    if not found.has("gyro"):
        return []
    noise = math.sqrt(gyro_variance(found, with_bias=False))
    rate = readings_per_second(found, "gyro")
    words = f"rad/s of one reading at {rate:.3g} Hz; {found.why('gyro.sigma_deg')}"
    return [Setting(key="imu.gyro_noise", value=noise, words=words, origin=found.origin("gyro.sigma_deg"))]


def _satellites(found: Found) -> list[Setting]:
    topic, kind = found.topic("gps")
    if not found.has("gps"):
        return []
    gps = found.robot.settings("gps")
    is_fix = kind == FIX
    made = [
        Setting(
            key="gnss.fix_topic",
            value=topic if is_fix else None,
            words=f"{topic} in the log" if is_fix else f"{topic} is {kind}, not {FIX}",
            origin=KEPT,
        ),
        Setting(
            key="gnss.base_noise_xy",
            value=gps.sigma,
            words=f"m; {found.why('gps.sigma')}",
            origin=found.origin("gps.sigma"),
        ),
    ]
    for axis in ("x", "y"):
        key = f"gps.{axis}"
        words = f"m, antenna on the base; {found.why(key)}"
        origin = found.origin(key)
        made.append(Setting(key=f"gnss.lever_arm_{axis}", value=getattr(gps, axis), words=words, origin=origin))
    return made


def _compass(found: Found) -> list[Setting]:
    topic, kind = found.topic("compass")
    if not found.has("compass") or kind != FIELD:
        return []
    compass, why = found.robot.settings("compass"), found.why("compass.sigma_deg")
    xx, xy, yx, yy = compass.soft_iron
    return [
        Setting(key="magnetometer.enabled", value=True, words=f"{topic} in the log", origin=KEPT),
        Setting(key="magnetometer.topic", value=topic, words=f"{topic} in the log", origin=KEPT),
        Setting(
            key="magnetometer.noise_rad",
            value=math.radians(compass.sigma_deg),
            words=f"rad; {why}",
            origin=found.origin("compass.sigma_deg"),
        ),
        Setting(
            key="magnetometer.hard_iron",
            value=[*compass.hard_iron, 0.0],
            words=f"in the message's unit; z is not measured; {found.why('compass.hard_iron')}",
            origin=found.origin("compass.hard_iron"),
            places=(0, 1),
        ),
        Setting(
            key="magnetometer.soft_iron",
            value=[xx, xy, 0.0, yx, yy, 0.0, 0.0, 0.0, 1.0],
            words=f"z is not measured; {found.why('compass.soft_iron')}",
            origin=found.origin("compass.hard_iron"),
            places=(0, 1, 3, 4),
        ),
    ]


def _rest(found: Found) -> list[Setting]:
    """Return comments on what FusionCore has no parameter for."""
    others = {"lrf": "FusionCore reads no laser: give it the pose of AMCL as vslam.topic"}
    others |= dict.fromkeys(("camera", "sonar", "landmarks", "ranges"), "FusionCore reads no such sensor")
    return [Setting(key=name, value=None, words=why) for name, why in others.items() if found.has(name)]
