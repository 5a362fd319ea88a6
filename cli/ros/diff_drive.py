"""Parameters of diff_drive_controller (ros2_control): wheel geometry as multipliers, wheel noise as covariances.

The controller turns by (right - left) / (wheel_separation * wheel_separation_multiplier), and a wheel's radius is
wheel_radius * left_ or right_wheel_radius_multiplier (ros2_controllers, diff_drive_controller). Estimates are
relative to the configured wheels; with an odometry topic, to the parameters of the controller that published it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from locfuse.formats.robot.ros_yaml import FOUND, KEPT, Setting
from locfuse.fusion.data import LocfuseError
from locfuse.fusion.wheels.odometry import ODOMETRY

from .found import FoundRobot, positive

UNMEASURED_VARIANCE = 1e6  # variance of z, roll, pitch and their rates
SIDEWAYS_VARIANCE = 1e-6  # (m/s)^2: the model has no sideways slip
WAY_M, TURN_RAD = 1.0, 1.0  # path of the constant pose covariance, since the true one grows along the path
X, Y, YAW = 0, 1, 5
SEPARATION, *RADII = MULTIPLIERS = (
    "wheel_separation_multiplier",
    "left_wheel_radius_multiplier",
    "right_wheel_radius_multiplier",
)


def settings(found: FoundRobot, there: Mapping[str, Any]) -> list[Setting]:
    """Return the controller's parameters; `there`: parameters that the file has now, {} for a new file.

    Raises LocfuseError unless the log shows two driven wheels.
    """
    wheels = found.loaded.drive.wheels
    if wheels.matched is not None or found.robot.wheels.wheelbase is not None:
        words = "this log shows no two driven wheels (scan matching, or a steered wheel)"
        raise LocfuseError(words, role="diff_drive")
    nominal = (("wheel_separation", found.nominal.track), ("wheel_radius", found.nominal.radius))
    made = [Setting(key, value, f"{key} as it was set [m]", KEPT) for key, value in nominal if value is not None]
    odometry = found.nominal.radius is None or found.topic("wheels")[1] == ODOMETRY
    multipliers = _of_odometry(found, there) if odometry else _of_wheels(found, there)
    return [*made, *multipliers, *_covariances(found)]


def _of_wheels(found: FoundRobot, there: Mapping[str, Any]) -> list[Setting]:
    """Return the multipliers of separation and radii: estimated values divided by those in the file."""
    was, now = found.nominal, found.robot.wheels
    assert was.radius is not None
    assert was.track is not None
    assert now.radius is not None
    assert now.track is not None
    radius, track = positive(there, "wheel_radius") or was.radius, positive(there, "wheel_separation") or was.track
    why, origin = found.why("wheels.radius"), found.origin("wheels.radius")
    if origin == FOUND:
        radii = {key: now.radius * share for key, share in zip(RADII, now.shares, strict=True)}
        of = radii.items()
        sides = [Setting(key, own / radius, f"{own:.4g} m over {radius:.4g} m; {why}", origin) for key, own in of]
        scale = 1.0
    else:  # only the ratio of radius to track was estimated
        old = {key: positive(there, key) or 1.0 for key in RADII}
        sides = [Setting(key, value, f"the radius was not measured; {why}", KEPT) for key, value in old.items()]
        scale = 0.5 * sum(old.values()) * radius / now.radius
    words = f"{now.track:.4g} m over {track:.4g} m; {found.why('wheels.track')}"
    return [Setting(SEPARATION, scale * now.track / track, words, found.origin("wheels.track")), *sides]


def _of_odometry(found: FoundRobot, there: Mapping[str, Any]) -> list[Setting]:
    """Return the multipliers for the log's odometry: those in the file (default 1) times the correction."""
    old = {key: positive(there, key) or 1.0 for key in MULTIPLIERS}
    relative = None if found.calibration is None else found.calibration.relative()
    if relative is None:
        words = "no truth, laser or gyro measured the odometry"
        return [Setting(key, value, words, KEPT) for key, value in old.items()]
    (mean, difference, track), sigmas = relative[0].tolist(), relative[1].tolist()
    changes = ((track, sigmas[2]), (mean - 0.5 * difference, sigmas[0]), (mean + 0.5 * difference, sigmas[0]))
    made = []
    for (key, before), (change, sigma) in zip(old.items(), changes, strict=True):
        words = f"{1.0 + change:.4f} ± {sigma:.2g} times {before:g} of the log's odometry; locfuse calibrate"
        found_now = Setting(key, before * (1.0 + change), words, FOUND)
        made.append(
            found_now if math.isfinite(sigma) else Setting(key, before, "this drive does not show it", KEPT)
        )
    return made


def _covariances(found: FoundRobot) -> list[Setting]:
    velocity, wheels = found.velocity, found.loaded.drive.wheels
    twist = [UNMEASURED_VARIANCE] * 6
    twist[X], twist[Y], twist[YAW] = float(velocity.reading[0]), SIDEWAYS_VARIANCE, float(velocity.reading[1])
    k, track = wheels.noise, wheels.track
    turn = 2.0 * k / track**2  # rad^2 per metre straight ahead
    pose = [UNMEASURED_VARIANCE] * 6
    pose[X], pose[Y], pose[YAW] = 0.5 * k * WAY_M, turn * WAY_M**3 / 3.0, turn * WAY_M + k / track * TURN_RAD
    now = f"of one reading at {1.0 / velocity.period:.3g} Hz (see docs/export.md)"
    then = f"as after {WAY_M:g} m and {TURN_RAD:g} rad"
    return [
        found.setting("pose_covariance_diagonal", pose, then, "wheels.noise", (X, Y, YAW)),
        found.setting("twist_covariance_diagonal", twist, now, "wheels.noise", (X, YAW)),
    ]
