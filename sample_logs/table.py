"""Base types of all tables of a scenario."""

from __future__ import annotations

from typing import Annotated

import msgspec

Positive = Annotated[float, msgspec.Meta(gt=0)]
NotNegative = Annotated[float, msgspec.Meta(ge=0)]
Share = Annotated[float, msgspec.Meta(ge=0, le=1)]
Percent = Annotated[int, msgspec.Meta(ge=1, le=100)]
Count = Annotated[int, msgspec.Meta(ge=2)]
Point = tuple[float, float]  # m, map frame
Segment = tuple[float, float, float, float]  # x1, y1, x2, y2 [m], map frame
Colour = tuple[int, int, int]  # red, green, blue, 0..255

RED: Colour = (200, 20, 30)


class ScenarioTable(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """TOML table of a scenario; unknown keys are errors."""


class Pillar(ScenarioTable, frozen=True):
    """Vertical cylinder, such as a landmark or a leg."""

    x: float  # m, map frame
    y: float
    radius: Positive = 0.06
    bottom: float = 0.0
    top: float = 1.6
    colour: Colour = RED
