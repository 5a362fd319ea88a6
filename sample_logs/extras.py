"""Sensors a scenario may add: ultrasonic rangers and a satellite receiver."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from .robot import Robot
from .scenario import Gps, Sonar
from .world import Scene

EARTH_RADIUS = 6_378_137.0  # m, WGS 84 semi-major axis
FLATTENING = 1 / 298.257223563
RAYS = 21  # cast within a sonar's cone
ULTRASOUND = 0  # Range.radiation_type
APPROXIMATED, FIX, GPS_SERVICE = 1, 0, 1  # NavSatFix: covariance type, status, service


class Ranger:
    """The nearest echo in a cone, +inf beyond its reach (REP 117)."""

    name, msgtype = "sonar", "sensor_msgs/msg/Range"
    duration, latency = 0.0, 0.005

    def __init__(self, sonar: Sonar, scene: Scene, robot: Robot, rng: np.random.Generator) -> None:
        self.settings, self.scene, self.robot, self.rng = sonar, scene, robot, rng
        self.topic, self.frame_id = f"/sonar/{sonar.name}", f"sonar_{sonar.name}"
        self.period, self.phase = 1 / sonar.rate, sonar.phase
        half = math.radians(sonar.field_of_view_deg) / 2
        self.angles = np.linspace(-half, half, RAYS)
        self.mount = np.array([sonar.x, sonar.y, math.radians(sonar.yaw_deg)])

    def read(self, t: float) -> dict[str, Any]:
        """Return the range of the nearest thing within the cone."""
        s = self.settings
        x, y, theta = self.robot.sensor_pose("sonar", np.array([t]), self.mount)[0]
        eye = np.full((RAYS, 2), (x, y))
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
    """Geographic position with white noise, on the tangent plane at the map's origin."""

    name, topic, msgtype, frame_id = "gps", "/gps/fix", "sensor_msgs/msg/NavSatFix", "gps"
    duration, latency = 0.0, 0.1

    def __init__(self, gps: Gps, robot: Robot, rng: np.random.Generator) -> None:
        self.settings, self.robot, self.rng = gps, robot, rng
        self.period, self.phase = 1 / gps.rate, gps.phase

    def read(self, t: float) -> dict[str, Any]:
        """Return latitude and longitude of the axle's middle."""
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
    """Return the radii of the meridian and of the parallel at a latitude [deg] on WGS 84 [m]."""
    e2 = FLATTENING * (2 - FLATTENING)
    phi = math.radians(latitude)
    w = 1 - e2 * math.sin(phi) ** 2
    return EARTH_RADIUS * (1 - e2) / w**1.5, EARTH_RADIUS / math.sqrt(w) * math.cos(phi)
