"""The registry: the only list of sensors. A new sensor is one file in this folder and one line here."""

from __future__ import annotations

from collections.abc import Collection

from locfuse.fusion.data import Colour
from locfuse.fusion.sensor import Sensor

from .camera import Camera
from .compass import Compass
from .gps import Gps
from .gyro import Gyro
from .landmarks import Landmarks
from .lrf import Lrf
from .points import PointsSettings
from .pose import PoseSensor
from .ranges import Ranges
from .sonar import Sonar
from .twist import Twist

REGISTRY: dict[str, Sensor] = {
    sensor.name: sensor
    for sensor in (
        Compass(),
        Lrf(),
        Camera(),
        Sonar(),
        Gps(),
        Gyro(),
        Landmarks(),
        PoseSensor(),
        Twist(),
        Ranges(),
    )
}
OF_POINTS = frozenset(name for name, sensor in REGISTRY.items() if issubclass(sensor.Settings, PointsSettings))
"""Sensors of points with ids, whose map is a .csv that is given or made."""


def needed(sensor: str) -> tuple[str, ...]:
    """Return the sensors without which this one says nothing, those that they need first; () for unknown ones."""
    own = REGISTRY[sensor].needs if sensor in REGISTRY else ()
    return tuple(dict.fromkeys(name for other in own for name in (*needed(other), other)))


def unmet(present: Collection[str]) -> dict[str, str]:
    """Return which of these sensors cannot be used for want of another one, and why."""
    left, found = set(present), dict[str, str]()
    while lacking := {
        name: f"it is {why}, and that is absent"
        for name in REGISTRY
        for other, why in REGISTRY[name].needs.items()
        if name in left and other not in left
    }:
        found |= lacking
        left -= lacking.keys()
    return found


def colours() -> dict[str, Colour]:
    """Return the colour of every sensor, in the registry's order."""
    return {name: sensor.colour for name, sensor in REGISTRY.items()}
