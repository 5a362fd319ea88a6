"""The noise figures of robot.toml as logarithms: which ones are searched, and how the filter gets them.

One logarithm per sensor: keys of one sensor (range, angle) keep their ratio, which measuring has already used to
weigh its beams.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import msgspec
from msgspec import field
from msgspec.structs import replace

from locfuse.fusion.robot import Robot
from locfuse.fusion.sensors.registry import REGISTRY

WHEELS = "wheels.noise"
DRIFT = ":drift"  # of a sensor's estimated offset
DRIFT_START = 0.1  # degrees per sqrt(s)


class Figures(msgspec.Struct):
    """The present noise figures: `factors` are ln(now / told), of the variance for the wheels, else of sigmas."""

    told: Robot
    sensors: tuple[str, ...]
    drift: str | None = None  # the sensor whose estimated offset may drift
    factors: dict[str, float] = field(default_factory=dict)

    @property
    def names(self) -> list[str]:
        """Names of the logarithms in the order of the search."""
        return [WHEELS, *self.sensors, *([self.drift + DRIFT] if self.drift else [])]

    def factor(self, name: str) -> float:
        """Return now / told."""
        return math.exp(self.factors.get(name, 0.0))

    def values(self) -> dict[str, float]:
        """Return every present figure by its key in robot.toml."""
        out = {WHEELS: self.told.wheels.noise * self.factor(WHEELS)}
        for s in self.sensors:
            settings = self.told.settings(s)
            out |= {f"{s}.{k}": getattr(settings, k) * self.factor(s) for k in REGISTRY[s].noise_keys}
        if self.drift:
            key = drift_key(self.drift)
            start = getattr(self.told.settings(self.drift), key) or DRIFT_START
            out[f"{self.drift}.{key}"] = start * self.factor(self.drift + DRIFT)
        return out

    def name_of(self, key: str) -> str:
        """Return the logarithm behind a key of robot.toml."""
        table, _, name = key.partition(".")
        if key == WHEELS:
            return WHEELS
        return table + DRIFT if table == self.drift and name == drift_key(table) else table

    def tables(self) -> dict[str, dict[str, float]]:
        """Return the figures as tables of robot.toml."""
        tables: dict[str, dict[str, float]] = {}
        for key, value in self.values().items():
            table, _, name = key.partition(".")
            tables.setdefault(table, {})[name] = value
        return tables

    def robot(self, robot: Robot) -> Robot:
        """Return a robot with the present figures."""
        tables = self.tables()
        wheels = msgspec.structs.replace(robot.wheels, **tables.pop("wheels"))
        settings = {s: msgspec.structs.replace(c, **tables.get(s, {})) for s, c in robot.sensors.items()}
        return replace(robot, wheels=wheels, sensors=settings)


def drift_key(sensor: str) -> str:
    """Return the key for the drift of a sensor's estimated offset, "" without one."""
    return REGISTRY[sensor].drift_key or ""


def drifting(robot: Robot, sensors: Sequence[str], wanted: bool) -> str | None:
    """Return the sensor whose offset is estimated and drifts, or may drift."""
    for s in sensors:
        offset, key = REGISTRY[s].bias, drift_key(s)
        if key and offset is not None and getattr(robot.settings(s), offset.key) is None:
            return s if wanted or getattr(robot.settings(s), key) > 0.0 else None
    return None
