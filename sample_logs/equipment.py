"""Equipment of the robot: sensors of a scenario, their mounts, and the matching robot.toml."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from locfuse.fusion.data import Array

from .camera import OmniCamera
from .messages import Pose, RawMessage, Streams
from .robot import SimulatedRobot
from .scenario import LrfSpec, Scenario
from .sensors import (
    JOINTS,
    GroundTruth,
    Magnetometer,
    Ranger,
    SatelliteReceiver,
    SimulatedEncoders,
    SimulatedLaser,
    SimulatedSensor,
)
from .world import World

EXACT_MOUNT = ("sigma_x", "sigma_y", "sigma_yaw_deg")  # 0: the simulated mount is exact


def sensors(scenario: Scenario, scene: World, robot: SimulatedRobot, streams: Streams) -> list[SimulatedSensor]:
    """Return the sensors of a scenario, each with its own random stream."""
    carried: list[SimulatedSensor] = [SimulatedEncoders(scenario, robot)]
    if scenario.compass.enabled:
        carried.append(Magnetometer(scenario.compass, scene, robot, streams("compass")))
    if scenario.lrf.enabled:
        carried.append(
            SimulatedLaser(scenario.lrf, scene, robot, streams("lrf"), beam_pattern(scenario.lrf, streams))
        )
    if scenario.camera.enabled:
        carried.append(OmniCamera(scenario.camera, scene, robot, streams("camera")))
    carried += [Ranger(s, scene, robot, streams(f"sonar {s.name}")) for s in scenario.sonar]
    if scenario.gps.enabled:
        carried.append(SatelliteReceiver(scenario.gps, robot, streams("gps")))
    carried.append(GroundTruth(scenario.truth, robot, streams("truth")))
    return carried


def beam_pattern(lrf: LrfSpec, streams: Streams) -> Array:
    """Return the constant errors of the laser's beams in a drive, (beams,) [m]."""
    return np.asarray(lrf.pattern * streams("lrf pattern").standard_normal(lrf.beams))


def static_transforms(scenario: Scenario, epoch_ns: int) -> RawMessage:
    """Return the /tf_static message with the mounts of the sensors."""
    lrf, camera = scenario.lrf, scenario.camera
    mounts = [("compass", 0.0, 0.0, 0.6, 0.0)] if scenario.compass.enabled else []
    if lrf.enabled:
        mounts.append(("laser", lrf.x, lrf.y, lrf.z, lrf.yaw_deg))
    if camera.enabled:
        mounts.append(("omni_camera", camera.x, camera.y, camera.z, camera.yaw_deg))
    mounts += [(f"sonar_{s.name}", s.x, s.y, s.z, s.yaw_deg) for s in scenario.sonar]
    if scenario.gps.enabled:
        mounts.append(("gps", 0.0, 0.0, 1.0, 0.0))
    stamp = {"sec": epoch_ns // 10**9, "nanosec": epoch_ns % 10**9}
    transforms = [
        {
            "header": {"stamp": stamp, "frame_id": "base_link"},
            "child_frame_id": child,
            "transform": {
                "translation": {"x": x, "y": y, "z": z},
                "rotation": {"z": math.sin(math.radians(yaw) / 2), "w": math.cos(math.radians(yaw) / 2)},
            },
        }
        for child, x, y, z, yaw in mounts
    ]
    fields = {"transforms": transforms}
    return RawMessage("/tf_static", "tf2_msgs/msg/TFMessage", epoch_ns, epoch_ns, "", fields)


def stated_start(scenario: Scenario, true: Pose, streams: Streams) -> Pose:
    """Return the start pose for robot.toml: true pose, plus the error of the user, plus a random error."""
    s = scenario.start
    sigma = np.array([s.sigma_xy, s.sigma_xy, math.radians(s.sigma_theta_deg)])
    wrong = np.array([*s.error[:2], math.radians(s.error[2])])
    x, y, theta = (true + wrong + sigma * streams("start").standard_normal(3)).tolist()
    return x, y, theta


def robot_tables(scenario: Scenario, start: Pose) -> dict[str, dict[str, Any]]:
    """Return the robot.toml that a user would write: nominal geometry, data-sheet accuracies.

    `start` is the user's start pose. Errors of the scenario (noise, iron, wheel errors, direction of north) are
    left out.
    """
    wheels = scenario.wheels
    tables: dict[str, dict[str, Any]] = {
        "wheels": {
            "topic": SimulatedEncoders.topic,
            "left": JOINTS[0],
            "right": JOINTS[1],
            "radius": wheels.radius,
            "track": wheels.track,
        },
        "start": _start_table(scenario, start),
    }
    if scenario.compass.enabled:
        tables["compass"] = {"topic": Magnetometer.topic, "sigma_deg": scenario.compass.sigma_deg}
    if scenario.lrf.enabled:
        tables["lrf"] = _lrf_table(scenario)
    if scenario.camera.enabled:
        tables["camera"] = _camera_table(scenario)
    tables["truth"] = {"topic": GroundTruth.topic, "x": 0.0, "y": 0.0}
    return tables


def _start_table(scenario: Scenario, start: Pose) -> dict[str, Any]:
    x, y, theta = start
    known = {k: getattr(scenario.start, k) for k in ("sigma_xy", "sigma_theta_deg")}
    return {"x": x, "y": y, "theta_deg": math.degrees(theta), **{k: s for k, s in known.items() if s > 0}}


def _lrf_table(scenario: Scenario) -> dict[str, Any]:
    lrf = scenario.lrf
    keys = ("x", "y", "yaw_deg", "sigma_range", "sigma_angle_deg")
    return {
        "topic": SimulatedLaser.topic,
        **{key: getattr(lrf, key) for key in keys},
        **dict.fromkeys(EXACT_MOUNT, 0.0),
    }


def _camera_table(scenario: Scenario) -> dict[str, Any]:
    camera, mark = scenario.camera, scenario.landmark
    optics = ("centre", "inner", "outer", "zero_deg", "clockwise") if camera.calibrated else ()
    tables = {"topic": OmniCamera.topic, "landmark": [mark.x, mark.y]}
    return tables | {key: getattr(camera, key) for key in (*optics, "x", "y", "yaw_deg", "sigma_deg")}
