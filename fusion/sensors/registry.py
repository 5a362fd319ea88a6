"""The registry: the only list of sensors. A new sensor is one file in this folder and one line here."""

from __future__ import annotations

from .base import Sensor
from .camera import Camera
from .compass import Compass
from .lrf import Lrf

REGISTRY: dict[str, Sensor] = {
    sensor.name: sensor
    for sensor in (
        Compass(),
        Lrf(),
        Camera(),
    )
}
