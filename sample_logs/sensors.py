"""Physical models of the sensors, which return message fields; their mounts, and the matching robot.toml."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from locfuse.fusion.data import Array
from locfuse.fusion.se2 import compose

from .camera import OmniCamera
from .faults import EncoderRollover, EncoderSpike, TruthStep
from .robot import SIDES, SimulatedRobot
from .scenario import CompassSpec, GpsSpec, LrfSpec, Scenario, SonarSpec, TruthSpec
from .table import Pose, RawMessage, Streams
from .world import World

JOINTS = ("left_wheel_joint", "right_wheel_joint")
EARTH_RADIUS = 6_378_137.0  # m, WGS 84 semi-major axis
FLATTENING = 1 / 298.257223563
SONAR_RAYS = 21  # cast within a sonar's cone
ULTRASOUND = 0  # Range.radiation_type
APPROXIMATED, FIX, GPS_SERVICE = 1, 0, 1  # NavSatFix: covariance type, status, service


class SimulatedEncoders:
    """Encoders of both wheels, which publish joint angles."""

    name, topic, msgtype, frame_id = "wheels", "/joint_states", "sensor_msgs/msg/JointState", ""
    phase, duration, latency = 0.0, 0.0, 0.001

    def __init__(self, scenario: Scenario, robot: SimulatedRobot) -> None:
        self.period = 1 / scenario.wheels.rate
        self.robot = robot
        self.faults = [f for f in scenario.faults if isinstance(f, EncoderSpike | EncoderRollover)]

    def read(self, t: float) -> dict[str, Any]:
        """Return the message fields with the counters at time t [s] as joint angles."""
        tick = self.robot.ticks[round(t / self.period)]
        counts = list(tick.counts)
        for fault in self.faults:
            if not fault.active(t):
                continue
            if isinstance(fault, EncoderSpike):
                counts[SIDES.index(fault.wheel)] += fault.counts
            else:
                half = 1 << (fault.bits - 1)
                counts = [(c + half) % (2 * half) - half for c in counts]
        angle = np.array(counts) * self.robot.wheels[0].rad_per_count
        return {"name": JOINTS, "position": angle, "velocity": np.array(tick.speed), "effort": np.zeros(0)}


class Magnetometer:
    """Two-axis magnetometer: the earth's field, magnets in the room, and iron on the robot."""

    name, topic, msgtype, frame_id = "compass", "/compass", "sensor_msgs/msg/MagneticField", "compass"
    duration, latency = 0.0, 0.002

    def __init__(
        self, compass: CompassSpec, scene: World, robot: SimulatedRobot, rng: np.random.Generator
    ) -> None:
        self.settings, self.scene, self.robot, self.rng = compass, scene, robot, rng
        self.period, self.phase = 1 / compass.rate, compass.phase
        north = np.radians(scene.room.north_deg)
        self.earth = compass.field * np.array([np.cos(north), np.sin(north)])  # T, map frame
        gain_x, gain_y, cross = compass.soft_iron
        self.iron = np.array([[gain_x, cross], [cross, gain_y]])
        self.sigma = compass.field * np.radians(compass.noise_deg)
        self.step = compass.field * np.radians(compass.resolution_deg)

    def read(self, t: float) -> dict[str, Any]:
        """Return the message fields with the field on two axes [T]; the third is 0."""
        pose = self.robot.sensor_pose("compass", np.array([t]))
        field = self.earth + self.scene.magnetic(t, pose[:, :2])[0]
        c, s = np.cos(pose[0, 2]), np.sin(pose[0, 2])
        axes = self.iron @ np.array([[c, s], [-s, c]]) @ field + self.settings.hard_iron
        axes = axes + self.sigma * self.rng.standard_normal(2)
        if self.step > 0:
            axes = np.round(axes / self.step) * self.step
        return {
            "magnetic_field.x": float(axes[0]),
            "magnetic_field.y": float(axes[1]),
            "magnetic_field.z": 0.0,
            "magnetic_field_covariance": np.zeros(9),
        }


class SimulatedLaser:
    """Laser range finder with a rotating beam: every ray starts at the robot's pose at its own time."""

    name, topic, msgtype, frame_id = "lrf", "/scan", "sensor_msgs/msg/LaserScan", "laser"
    latency = 0.002

    def __init__(
        self,
        lrf: LrfSpec,
        scene: World,
        robot: SimulatedRobot,
        rng: np.random.Generator,
        pattern: Array | None = None,
    ) -> None:
        """`pattern` (beams,) [m] are constant errors of the beams; by default 0."""
        self.settings, self.scene, self.robot, self.rng = lrf, scene, robot, rng
        self.pattern = np.zeros(lrf.beams) if pattern is None else pattern
        self.period, self.phase, self.duration = 1 / lrf.rate, lrf.phase, lrf.duration
        half = np.radians(lrf.field_of_view_deg) / 2
        self.angles = np.linspace(-half, half, lrf.beams)
        self.times = np.linspace(0, lrf.duration, lrf.beams)
        self.mount = np.array([lrf.x, lrf.y, np.radians(lrf.yaw_deg)])

    def read(self, t: float) -> dict[str, Any]:
        """Return the message fields of one scan that starts at t [s]."""
        s, times = self.settings, t + self.times
        laser = self.robot.sensor_pose("lrf", times, self.mount)
        wobble = np.radians(s.sigma_angle_deg) * self.rng.standard_normal(s.beams)
        noise = s.sigma_range * self.rng.standard_normal(s.beams)
        lost = self.rng.random(s.beams) < s.lost
        angles = laser[:, 2] + self.angles + wobble
        ranges = s.scale * self.scene.see(s.z, times, laser[:, :2], angles, s.range_max) + noise + self.pattern
        seen = ~lost & (ranges >= s.range_min) & (ranges <= s.range_max)
        return {
            "angle_min": float(self.angles[0]),
            "angle_max": float(self.angles[-1]),
            "angle_increment": float(self.angles[1] - self.angles[0]),
            "time_increment": float(self.times[1]),
            "scan_time": self.period,
            "range_min": s.range_min,
            "range_max": s.range_max,
            "ranges": np.where(seen, ranges, np.inf).astype(np.float32),
            "intensities": np.zeros(0, np.float32),
        }


class GroundTruth:
    """Tracking system: publishes the robot's true pose with noise."""

    name, topic, msgtype, frame_id = "truth", "/ground_truth/pose", "geometry_msgs/msg/PoseStamped", "map"
    duration, latency = 0.0, 0.001

    def __init__(self, truth: TruthSpec, robot: SimulatedRobot, rng: np.random.Generator) -> None:
        self.period, self.phase = 1 / truth.rate, truth.phase
        self.sigma = np.array([truth.noise, truth.noise, np.radians(truth.noise_deg)])
        self.robot, self.rng = robot, rng

    def read(self, t: float) -> dict[str, Any]:
        """Return the message fields with position and orientation at t [s]."""
        pose = self.robot.sensor_pose("truth", np.array([t]))[0]
        for fault in self.robot.faults:
            if isinstance(fault, TruthStep) and fault.active(t):
                pose = compose(np.array([fault.x, fault.y, np.radians(fault.theta_deg)]), pose)
        x, y, theta = (pose + self.sigma * self.rng.standard_normal(3)).tolist()
        return {
            "pose.position.x": x,
            "pose.position.y": y,
            "pose.position.z": 0.0,
            "pose.orientation.x": 0.0,
            "pose.orientation.y": 0.0,
            "pose.orientation.z": float(np.sin(theta / 2)),
            "pose.orientation.w": float(np.cos(theta / 2)),
        }


class Ranger:
    """Ultrasonic ranger: the nearest object in its cone, +inf beyond its reach (REP 117)."""

    name, msgtype = "sonar", "sensor_msgs/msg/Range"
    duration, latency = 0.0, 0.005

    def __init__(self, sonar: SonarSpec, scene: World, robot: SimulatedRobot, rng: np.random.Generator) -> None:
        self.settings, self.scene, self.robot, self.rng = sonar, scene, robot, rng
        self.topic, self.frame_id = f"/sonar/{sonar.name}", f"sonar_{sonar.name}"
        self.period, self.phase = 1 / sonar.rate, sonar.phase
        half = math.radians(sonar.field_of_view_deg) / 2
        self.angles = np.linspace(-half, half, SONAR_RAYS)
        self.mount = np.array([sonar.x, sonar.y, math.radians(sonar.yaw_deg)])

    def read(self, t: float) -> dict[str, Any]:
        """Return the message fields with the range at t [s]."""
        s = self.settings
        x, y, theta = self.robot.sensor_pose("sonar", np.array([t]), self.mount)[0]
        eye = np.full((SONAR_RAYS, 2), (x, y))
        echoes = self.scene.see(s.z, np.array([t]), eye, theta + self.angles, s.range_max)
        distance = float(echoes.min()) + s.sigma * self.rng.standard_normal()
        return {
            "radiation_type": ULTRASOUND,
            "field_of_view": math.radians(s.field_of_view_deg),
            "min_range": s.range_min,
            "max_range": s.range_max,
            "range": distance if s.range_min <= distance <= s.range_max else math.inf,
        }


class SatelliteReceiver:
    """Satellite receiver: latitude and longitude with white noise."""

    name, topic, msgtype, frame_id = "gps", "/gps/fix", "sensor_msgs/msg/NavSatFix", "gps"
    duration, latency = 0.0, 0.1

    def __init__(self, gps: GpsSpec, robot: SimulatedRobot, rng: np.random.Generator) -> None:
        self.settings, self.robot, self.rng = gps, robot, rng
        self.period, self.phase = 1 / gps.rate, gps.phase

    def read(self, t: float) -> dict[str, Any]:
        """Return the message fields with latitude and longitude of the axle's middle at t [s]."""
        s = self.settings
        at = self.robot.sensor_pose("gps", np.array([t]))[0, :2] + s.sigma * self.rng.standard_normal(2)
        east_axis = math.radians(s.east_deg)
        east = at[0] * math.cos(east_axis) + at[1] * math.sin(east_axis)
        north = -at[0] * math.sin(east_axis) + at[1] * math.cos(east_axis)
        meridian, parallel = radii(s.latitude)
        return {
            "status.status": FIX,
            "status.service": GPS_SERVICE,
            "latitude": s.latitude + math.degrees(north / meridian),
            "longitude": s.longitude + math.degrees(east / parallel),
            "altitude": s.altitude,
            "position_covariance": np.diag([s.sigma**2, s.sigma**2, (2 * s.sigma) ** 2]).ravel(),
            "position_covariance_type": APPROXIMATED,
        }


def radii(latitude: float) -> tuple[float, float]:
    """Return the radii [m] of meridian and parallel at a latitude [deg] on WGS 84."""
    e2 = FLATTENING * (2 - FLATTENING)
    phi = math.radians(latitude)
    w = 1 - e2 * math.sin(phi) ** 2
    return EARTH_RADIUS * (1 - e2) / w**1.5, EARTH_RADIUS / math.sqrt(w) * math.cos(phi)


# --- Equipment of the robot: sensors of a scenario, their mounts, and the matching robot.toml

# Each has a period, the phase of its first reading, the duration of a reading and the latency until its recording,
# in s. `read(t)` returns the fields of the reading that starts at t [s]; the trail must cover its duration.
SimulatedSensor = (
    SimulatedEncoders | Magnetometer | SimulatedLaser | OmniCamera | Ranger | SatelliteReceiver | GroundTruth
)

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
    wheels, (x, y, theta) = scenario.wheels, start
    known = {k: getattr(scenario.start, k) for k in ("sigma_xy", "sigma_theta_deg")}
    tables: dict[str, dict[str, Any]] = {
        "wheels": {
            "topic": SimulatedEncoders.topic,
            "left": JOINTS[0],
            "right": JOINTS[1],
            "radius": wheels.radius,
            "track": wheels.track,
        },
        "start": {"x": x, "y": y, "theta_deg": math.degrees(theta), **{k: s for k, s in known.items() if s > 0}},
    }
    if scenario.compass.enabled:
        tables["compass"] = {"topic": Magnetometer.topic, "sigma_deg": scenario.compass.sigma_deg}
    if scenario.lrf.enabled:
        keys = ("x", "y", "yaw_deg", "sigma_range", "sigma_angle_deg")
        tables["lrf"] = {"topic": SimulatedLaser.topic, **{key: getattr(scenario.lrf, key) for key in keys}}
        tables["lrf"] |= dict.fromkeys(EXACT_MOUNT, 0.0)
    if scenario.camera.enabled:
        camera, mark = scenario.camera, scenario.landmark
        optics = ("centre", "inner", "outer", "zero_deg", "clockwise") if camera.calibrated else ()
        tables["camera"] = {"topic": OmniCamera.topic, "landmark": [mark.x, mark.y]}
        tables["camera"] |= {key: getattr(camera, key) for key in (*optics, "x", "y", "yaw_deg", "sigma_deg")}
    tables["truth"] = {"topic": GroundTruth.topic, "x": 0.0, "y": 0.0}
    return tables
