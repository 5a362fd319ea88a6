"""An exported ekf.yaml in an emulation of robot_localization: its predict and update, written from its documents.

State x, y, yaw, vx, vy, vyaw, ax, ay of the plane; P grows by Q dt; a reading is refused beyond the rejection
threshold, a Mahalanobis distance; "relative" counts from the first reading.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import locfuse
from numpy.typing import NDArray
from ros_drive import SIGMA_POSE, SIGMA_YAW, drive, parameters

from locfuse import load

Floats = NDArray[np.float64]
KEPT = [0, 1, 5, 6, 7, 11, 12, 13]  # of the 15 states
YAW = 2


class Emulated:
    """The filter."""

    def __init__(self, parameters: dict[str, Any]) -> None:
        Q = np.array(parameters["process_noise_covariance"], float).reshape(15, 15)
        self.Q = Q[np.ix_(KEPT, KEPT)]
        self.x, self.P, self.t = np.zeros(8), 1e-9 * np.eye(8), 0.0
        self.nis: dict[str, list[float]] = {}
        self.refused = 0

    def predict(self, t: float) -> None:
        dt, self.t = t - self.t, t
        if dt <= 0.0:
            return
        yaw, vx, vy, w, ax, ay = self.x[2:]
        c, s = np.cos(yaw), np.sin(yaw)
        along, aside = vx * dt + 0.5 * ax * dt**2, vy * dt + 0.5 * ay * dt**2
        F = np.eye(8)
        F[0, 2:] = -s * along - c * aside, c * dt, -s * dt, 0.0, 0.5 * c * dt**2, -0.5 * s * dt**2
        F[1, 2:] = c * along - s * aside, s * dt, c * dt, 0.0, 0.5 * s * dt**2, 0.5 * c * dt**2
        F[2, 5] = F[3, 6] = F[4, 7] = dt
        F[2, 2] = F[3, 3] = 1.0
        moved = (c * along - s * aside, s * along + c * aside, w * dt, ax * dt, ay * dt, 0.0, 0.0, 0.0)
        self.x = self.x + np.array(moved)
        self.P = F @ self.P @ F.T + dt * self.Q

    def update(self, name: str, places: list[int], z: list[float], variances: list[float], limit: float) -> None:
        H = np.eye(8)[places]
        y = np.array(z) - self.x[places]
        y = np.where(np.array(places) == YAW, (y + np.pi) % (2 * np.pi) - np.pi, y)
        S = H @ self.P @ H.T + np.diag(np.maximum(variances, 1e-9))
        square = float(y @ np.linalg.solve(S, y))
        if square >= limit**2:
            self.refused += 1
            return
        if self.t > 5.0:
            self.nis.setdefault(name, []).append(square / len(places))
        K = self.P @ H.T @ np.linalg.inv(S)
        self.x, A = self.x + K @ y, np.eye(8) - K @ H
        self.P = A @ self.P @ A.T + K @ np.diag(np.maximum(variances, 1e-9)) @ K.T


def covariances(text: str) -> dict[str, float]:
    """What the driver's messages must say: "vx 0.004 (m/s)^2" in the comments."""
    found = re.findall(r"(vx|vyaw|yaw|angular_velocity, z) (\S+) (?:\(?rad|\(?m)", text)
    return {name: float(value) for name, value in found}


def readings(session: Any) -> Iterator[tuple[float, str, list[float]]]:
    """Raw readings in order: time, topic, what the filter can take of them."""
    found: list[tuple[float, str, list[float]]] = []
    begin = None
    for topic, fields in (
        ("/odom", ("twist.twist.linear.x", "twist.twist.angular.z")),
        ("/imu", ("orientation.z", "orientation.w", "angular_velocity.z")),
        (
            "/amcl_pose",
            ("pose.pose.position.x", "pose.pose.position.y", "pose.pose.orientation.z", "pose.pose.orientation.w"),
        ),
    ):
        stream = session.log.stream(topic)
        begin = stream.t_ns[0] if begin is None else begin
        columns = np.column_stack([np.asarray(c, float) for c in stream.columns(*fields).values()])
        times = ((stream.t_ns - begin) * 1e-9).tolist()
        found.extend(zip(times, [topic] * len(times), columns.tolist(), strict=True))
    yield from sorted(found, key=lambda one: one[0])


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return drive(tmp_path_factory.mktemp("drive") / "drive.mcap")


@pytest.fixture(scope="module")
def exported(log: Path) -> str:
    sets = ("--set", "pose.topic=/amcl_pose", "--set", "pose.frame=map")
    done = locfuse("export", "ros", log, *sets, "--to", "ekf", "--to", "diff_drive", "-q")
    assert done.exit_code == 0, done.stderr
    return done.stdout


def test_every_sensor_is_as_far_off_as_the_exported_file_says(log: Path, exported: str) -> None:
    found, told = parameters(exported, "ekf_filter_node"), covariances(exported)
    emulated = Emulated(found)
    limits = {key: value for key, value in found.items() if key.endswith("rejection_threshold")}
    for t, topic, values in readings(load(log)):
        emulated.predict(t)
        if topic == "/odom":
            assert [found["odom0_config"][place] for place in (6, 11)] == [True, True]
            emulated.update(topic, [3, 5], values, [told["vx"], told["vyaw"]], np.inf)
        elif topic == "/imu":
            yaw = 2.0 * np.arctan2(values[0], values[1])
            assert found["imu0_differential"] is False  # of the map, as the pose is
            emulated.update("yaw", [YAW], [yaw], [told["yaw"]], limits["imu0_pose_rejection_threshold"])
            emulated.update("rate", [5], values[2:], [told["angular_velocity, z"]], np.inf)
        else:
            heading = 2.0 * np.arctan2(values[2], values[3])
            R = [SIGMA_POSE**2, SIGMA_POSE**2, SIGMA_YAW**2]
            emulated.update(topic, [0, 1, 2], [*values[:2], heading], R, limits["pose0_rejection_threshold"])
    means = {name: float(np.mean(values)) for name, values in emulated.nis.items()}
    assert set(means) == {"/odom", "yaw", "rate", "/amcl_pose"}
    assert all(0.8 < mean < 1.25 for mean in means.values()), means
    assert emulated.refused <= 3  # of 2500


@pytest.mark.parametrize("log", ["rounded_rectangle", "rounded_triangle"])
def test_by_the_wheels_alone_it_is_as_uncertain_as_our_filter_and_its_twists_are_as_expected(log: str) -> None:
    """Their noise is slip, which no reading of the odometry shows."""
    done = locfuse("export", "ros", log, "--to", "ekf", "--as-set", "-q")
    told, emulated, session = (
        covariances(done.stdout),
        Emulated(parameters(done.stdout, "ekf_filter_node")),
        load(log),
    )
    wheels = session.drive.wheels
    speeds = wheels.twist[:, [0, 2]] / np.diff(wheels.t)[:, None]
    for t, twist in zip(wheels.t[1:], speeds, strict=True):
        emulated.predict(float(t))
        emulated.update("twist", [3, 5], twist.tolist(), [told["vx"], told["vyaw"]], np.inf)
    ours = session.run("odometry", advice=False).filtered.P[-1]
    assert np.sqrt(np.diag(emulated.P)[:3]) == pytest.approx(np.sqrt(np.diag(ours)), rel=0.05)
    assert 0.8 < np.mean(emulated.nis["twist"]) < 1.25


def test_fusioncore_names_every_sensor_that_it_has_no_parameters_for(log: Path) -> None:
    sets = ("--set", "pose.topic=/amcl_pose", "--set", "pose.frame=map")
    done = locfuse("export", "ros", log, *sets, "--to", "fusioncore", "--as-set", "-q")
    assert done.exit_code == 0, done.stderr
    comments = [line.split(":")[0].strip("# ") for line in done.stdout.splitlines() if "cannot be mapped" in line]
    assert comments == ["compass", "pose"]
    assert "gyro_noise" in done.stdout
