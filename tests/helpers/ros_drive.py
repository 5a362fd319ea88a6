"""A drive as a ROS 2 robot records it: odometry, an IMU, a localiser's pose, and the truth; all noise is white."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from bags import T0, S, Said, cdr, header, write
from numpy.typing import NDArray
from ruamel.yaml import YAML

Floats = NDArray[np.float64]

RATE_HZ = 20
NOISE_M, TRACK_M = 4e-4, 0.3  # variance of a wheel per metre; an odometry's track in locfuse
SIGMA_YAW, SIGMA_RATE, SIGMA_POSE = 0.02, 0.004, 0.03  # rad, rad/s, m
ODOMETRY, IMU = "nav_msgs/msg/Odometry", "sensor_msgs/msg/Imu"
POSE, STAMPED = "geometry_msgs/msg/PoseWithCovarianceStamped", "geometry_msgs/msg/PoseStamped"


def parameters(text: str, node: str) -> dict[str, Any]:
    """The parameters of one node of an exported file."""
    yaml = YAML(typ="safe", pure=True)
    yaml.version = (1, 1)  # as libyaml reads it for ROS
    found: dict[str, Any] = yaml.load(text)[node]["ros__parameters"]
    return found


def quaternion(yaw: float) -> dict[str, float]:
    return {"z": float(np.sin(0.5 * yaw)), "w": float(np.cos(0.5 * yaw))}


def pose_of(x: float, y: float, yaw: float) -> dict[str, Any]:
    return {"position": {"x": x, "y": y}, "orientation": quaternion(yaw)}


def speeds(t: Floats) -> Floats:
    """Forward speed and turning rate (n, 2): at rest for two seconds, then a winding path."""
    begun = np.clip(t - 2.0, 0.0, 1.0)[:, None]
    return begun * np.column_stack((0.4 + 0.1 * np.sin(0.3 * t), 0.5 * np.sin(0.25 * (t - 2.0))))


def chained(twists: Floats, dt: float) -> Floats:
    """Poses (n + 1, 3) of speeds and turning rates (n, 2), each held for dt."""
    pose, poses = np.zeros(3), [np.zeros(3)]
    for v, w in twists:
        half = pose[2] + 0.5 * w * dt
        pose = pose + np.array([v * dt * np.cos(half), v * dt * np.sin(half), w * dt])
        poses.append(pose)
    return np.array(poses)


def drive(path: Path, seconds: float = 60.0, seed: int = 3) -> Path:
    """Write the drive to an .mcap file."""
    rng = np.random.default_rng(seed)
    dt, n = 1.0 / RATE_HZ, int(seconds * RATE_HZ)
    t: Floats = np.arange(n, dtype=np.float64) * np.float64(dt)
    true = speeds(t + np.float64(0.5 * dt))  # over each period
    grown = (
        NOISE_M * 2.0 * np.abs(true[:, 0]) * dt
    )  # both wheels; rolled by half the track more or less they are alike
    noise = np.column_stack((np.sqrt(0.25 * grown), np.sqrt(grown) / TRACK_M)) / dt
    told = true + noise * rng.standard_normal((n, 2))
    poses, odometry = chained(true, dt), chained(told, dt)
    said: list[Said] = []
    for i in range(n):
        stamp = T0 + i * S // RATE_HZ + S // RATE_HZ
        v, w = told[i]
        body = {"pose": pose_of(*odometry[i + 1]), "covariance": np.zeros(36)}
        twist = {"twist": {"linear": {"x": v}, "angular": {"z": w}}, "covariance": np.zeros(36)}
        message = cdr(ODOMETRY, header=header(stamp, "odom"), child_frame_id="base_link", pose=body, twist=twist)
        said.append(Said("/odom", ODOMETRY, message, stamp, i))
        yaw = poses[i + 1, 2] + SIGMA_YAW * rng.standard_normal()
        rate = speeds(t[i : i + 1] + np.float64(dt))[0, 1] + SIGMA_RATE * rng.standard_normal()
        imu = cdr(
            IMU,
            header=header(stamp, "base_link"),
            orientation=quaternion(yaw),
            orientation_covariance=np.diag([1e-4, 1e-4, SIGMA_YAW**2]).ravel(),
            angular_velocity={"z": rate},
            angular_velocity_covariance=np.diag([1e-5, 1e-5, SIGMA_RATE**2]).ravel(),
            linear_acceleration={"z": 9.81},
        )
        said.append(Said("/imu", IMU, imu, stamp, i))
        truth = cdr(STAMPED, header=header(stamp, "map"), pose=pose_of(*poses[i + 1]))
        said.append(Said("/ground_truth/pose", STAMPED, truth, stamp, i))
        if i % 10 == 0:
            x, y, theta = poses[i + 1] + rng.standard_normal(3) * (SIGMA_POSE, SIGMA_POSE, SIGMA_YAW)
            covariance = np.diag([SIGMA_POSE**2, SIGMA_POSE**2, 0, 0, 0, SIGMA_YAW**2]).ravel()
            given = {"pose": pose_of(x, y, theta), "covariance": covariance}
            said.append(Said("/amcl_pose", POSE, cdr(POSE, header=header(stamp, "map"), pose=given), stamp, i))
    return write(path, said)
