"""The input of the figures of a report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import msgspec
import numpy as np
from msgspec import field

from locfuse.fusion.data import Array, Component, Drive, Estimates, Evaluation, Event, RunningNis

MAX_IN_MM = 0.2  # m: smaller lengths are shown in mm
MAX_CONFIGURATIONS = 8  # more curves in one panel are unreadable


class Scene(msgspec.Struct, frozen=True):
    """Drive, estimates and their evaluation, as input of the figures."""

    drive: Drive
    estimates: Sequence[Estimates]
    evaluations: Sequence[Evaluation]
    nis: Mapping[tuple[str, str], RunningNis] = field(default_factory=dict)  # (configuration, sensor)
    nees_bounds: tuple[float, float] = (0.0, 0.0)  # 95 % bounds of one NEES per degree of freedom
    components: Mapping[str, Sequence[Component]] = field(default_factory=dict)  # of innovations, by sensor
    states: Mapping[str, Sequence[Component]] = field(default_factory=dict)  # states other than the pose, by block
    credit: Mapping[str, Any] | None = None  # each sensor's effects on the error, as in report.json
    landmarks: Sequence[tuple[float, float]] = ()  # m, map frame: targets of bearings and ranges
    events: Sequence[Event] = ()  # of the drive and of the configuration with most sensors

    @property
    def best(self) -> Estimates:
        """The configuration with most sensors."""
        return max(self.estimates, key=lambda e: len(e.sensors))

    @property
    def judged_by(self) -> str:
        """Origin of the deviations: "truth", or "reference" (a smoothed solution used instead of truth)."""
        return "reference" if any(e.reference for e in self.evaluations) else "truth"

    @property
    def has_truth(self) -> bool:
        """Whether any configuration has deviations from truth or reference."""
        return any(len(e.t) for e in self.evaluations)

    def shown(self) -> list[tuple[Estimates, Evaluation]]:
        """Return the configurations to draw, at most MAX_CONFIGURATIONS.

        If there are more: odometry, single sensors, `all` and those with reduced rates.
        """
        pairs = list(zip(self.estimates, self.evaluations, strict=True))
        if len(pairs) <= MAX_CONFIGURATIONS:
            return pairs
        few = [p for p in pairs if len(p[0].sensors) <= 1 or p[0].configuration == "all" or p[0].rates]
        return few[:MAX_CONFIGURATIONS] if len(few) > 1 else pairs[:MAX_CONFIGURATIONS]


def metres(values: Sequence[Array]) -> tuple[float, str]:
    """Return (scale, unit) for lengths [m]: (1000, "mm") if all are below MAX_IN_MM, else (1, "m")."""
    largest = max((float(np.nanmax(np.abs(v))) for v in values if np.isfinite(v).any()), default=0.0)
    return (1000.0, "mm") if largest < MAX_IN_MM else (1.0, "m")
