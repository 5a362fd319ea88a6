"""The registry: the only list of sensors. A new sensor is one file in this folder and one line here."""

from __future__ import annotations

from locfuse.fusion.sensor import Sensor

from .camera import Camera
from .compass import Compass
from .gps import Gps
from .gyro import Gyro
from .lrf import Lrf
from .sonar import Sonar

REGISTRY: dict[str, Sensor] = {
    sensor.name: sensor
    for sensor in (
        Compass(),
        Lrf(),
        Camera(),
        Sonar(),
        Gps(),
        Gyro(),
    )
}
