"""List of all sensors. To add a sensor to locfuse, add one file to this folder and one line to this module.

A sensor of another package needs no change here: the package declares an entry point in the group
`locfuse.sensors`.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection
from importlib import metadata
from typing import Any

from locfuse.fusion.data import BASES, Colour, LocfuseError
from locfuse.fusion.sensor import Sensor, SensorSettings

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

KINDS = (Compass, Lrf, Camera, Sonar, Gps, Gyro, Landmarks, PoseSensor, Twist, Ranges)  # in the order of reports
REGISTRY: dict[str, Sensor] = {kind.name: kind() for kind in KINDS}
GROUP = "locfuse.sensors"
SOURCES: dict[str, str] = {}
"""Sensor of another package -> that package and its version."""
SENSOR_NAME = re.compile(r"[a-z][a-z0-9_]*")  # it names a table of robot.toml, and stands in lists with commas
REQUIRED = ("name", "Settings", "reads", "noise_keys", "components", "colour")
RESERVED_NAMES = {*BASES, "all", "order", "preset", "start", "truth", "wheels"}


def register(sensor: Sensor | type[Sensor]) -> None:
    """Add a sensor class or object to the list of sensors in this process: `locfuse.register(Beacon())`.

    Args:
        sensor: a `Sensor`, or its class. An installed package declares it by an entry point instead: then the
            commands and their worker processes use it too.

    Raises:
        LocfuseError: the sensor is incomplete, or another sensor has its name; the message is one line.
    """
    kind = sensor if isinstance(sensor, type) else type(sensor)
    _add(lambda: sensor, f"{kind.__module__}.{kind.__name__}", "")


def _add(load: Callable[[], Any], source: str, hint: str) -> None:
    """Call `load` and add the sensor that it returns. Raises LocfuseError if the sensor is invalid.

    The error message begins with `source`, the origin of the sensor; `hint` is the hint of the error.
    """
    try:
        found = load()
        sensor = found() if isinstance(found, type) else found
        problem = _unfit(sensor)
    except Exception as error:  # code of another package may raise anything
        problem = f"{type(error).__name__}: {error}"
    if problem is None and sensor.name in REGISTRY:
        other = SOURCES.get(sensor.name, "locfuse itself")
        problem = f"{other} has a sensor {sensor.name} too. Rename one of them"
    if problem is not None:
        why = " ".join(problem.split()).rstrip(".")
        raise LocfuseError(f"{source}: this sensor cannot be used: {why}.", hint=hint)
    REGISTRY[sensor.name], SOURCES[sensor.name] = sensor, source


def _unfit(sensor: Any) -> str | None:
    """Return why an object cannot be used as a sensor, or None."""
    if not isinstance(sensor, Sensor):
        return f"{sensor!r} is no locfuse.Sensor"
    lacking = [key for key in REQUIRED if not hasattr(sensor, key)]
    if lacking:
        return f"{type(sensor).__name__} does not define {', '.join(lacking)}"
    if not SENSOR_NAME.fullmatch(sensor.name) or sensor.name in RESERVED_NAMES:
        return f"its name {sensor.name!r} is reserved, or no word of small letters, digits and _"
    if not issubclass(sensor.Settings, SensorSettings):
        return f"{sensor.Settings.__name__} is no locfuse.SensorSettings"
    unknown = [key for key in sensor.noise_keys if not hasattr(sensor.Settings(), key)]
    return f"noise_keys names {unknown[0]}, which is no setting of it" if unknown else None


def register_installed() -> None:
    """Add the sensors of installed packages, once each. Raises LocfuseError for an invalid one.

    An invalid package stops every command: without its sensor, results would differ unnoticed.
    """
    for point in sorted(metadata.entry_points(group=GROUP), key=lambda point: (point.name, point.value)):
        package, version = ("?", "") if point.dist is None else (point.dist.name, point.dist.version)
        source = f"package {package} {version} ({point.value})"
        if source not in SOURCES.values():
            _add(point.load, source, f"Update that package, or remove it: python -m pip uninstall {package}")


def of_points() -> frozenset[str]:
    """Return the names of the sensors that measure points with ids."""
    return frozenset(name for name, sensor in REGISTRY.items() if issubclass(sensor.Settings, PointsSettings))


def needed(sensor: str) -> tuple[str, ...]:
    """Return all sensors that `sensor` depends on, each after its own dependencies; () for an unknown sensor."""
    own = REGISTRY[sensor].needs if sensor in REGISTRY else ()
    return tuple(dict.fromkeys(name for other in own for name in (*needed(other), other)))


def unmet(present: Collection[str]) -> dict[str, str]:
    """Return the sensors of `present` that need an absent sensor, directly or indirectly: {name: reason}."""
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


register_installed()
