"""The content of figures as values: series with their roles, axes with their labels. Two renderers draw them.

`svg` draws for the page (theme, phone, toggles, pointer), `for_paper` for print (PDF, SVG by matplotlib).
"""

from __future__ import annotations

from collections.abc import Mapping

import msgspec
import numpy as np
from msgspec import field

from locfuse.fusion.data import Array, Event

MAX_AXIS_VALUE = 1e100  # that an axis shows: the span of what a damaged log says may be more than a number holds
TIME = "time, s"  # the label of a time axis


class Curve(msgspec.Struct, frozen=True):
    """A line through points; NaN breaks it. `of` is a configuration or a role of the palette."""

    of: str
    x: Array  # (n,)
    y: Array  # (n,)
    wide: bool = False  # where the colour is what is to be read


class Band(msgspec.Struct, frozen=True):
    """The area between two curves."""

    of: str
    x: Array  # (n,)
    low: Array  # (n,)
    high: Array  # (n,)
    solid: bool = False


class Dots(msgspec.Struct, frozen=True):
    """Single points."""

    of: str
    x: Array  # (n,)
    y: Array  # (n,)


class Strokes(msgspec.Struct, frozen=True):
    """Straight pieces: walls."""

    of: str
    ends: Array  # (k, 2, 2) both ends


class Spots(msgspec.Struct, frozen=True):
    """Marks of constant size when the panel is enlarged; `of` is a role of the palette with a shape."""

    of: str
    x: Array  # (n,)
    y: Array  # (n,)


Mark = Curve | Band | Dots | Strokes | Spots


class TimedPlaces(msgspec.Struct, frozen=True):
    """Positions at evenly spaced times, for a cursor over time. They are not drawn."""

    of: str
    start: float  # s
    end: float  # s
    x: Array  # (n,)
    y: Array  # (n,)


class Panel(msgspec.Struct, frozen=True):
    """One pair of axes."""

    name: str  # of its file and its anchor
    title: str
    y_label: str  # with the unit
    x_label: str
    marks: tuple[Mark, ...]
    summary: str = ""  # what it shows, for those who cannot see it
    log: bool = False  # logarithmic y
    x_log: bool = False  # logarithmic x
    equal: bool = False  # one metre is as long in x as in y
    x_range: tuple[float, float] | None = None
    y_range: tuple[float, float] | None = None
    lanes: tuple[str, ...] = ()  # names of unit-high lanes on y, from the top
    keys: tuple[str, ...] = ()  # roles that need a legend of their own
    events: tuple[Event, ...] = ()  # what happened when, shaded behind the marks of a time axis
    said: Mapping[str, str] = field(default_factory=dict)  # role -> its words in the legend, where not its name
    tracks: tuple[TimedPlaces, ...] = ()  # of a map: where each result was when


class Section(msgspec.Struct, frozen=True):
    """Panels that belong together, under one heading."""

    name: str
    title: str
    text: str
    panels: tuple[Panel, ...]
    columns: int = 2
    rows: tuple[str, ...] = field(default=())  # a heading per row of panels, where rows are configurations


def ranges(panel: Panel) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the limits of x and y: as given, else the marks' range with a small margin."""
    x = panel.x_range or _span([v for m in panel.marks for v in values_of(m, 0)], 0.0, panel.x_log)
    y = panel.y_range or _span([v for m in panel.marks for v in values_of(m, 1)], 0.04, panel.log)
    return _opened(*x), _opened(*y)


def values_of(mark: Mark, axis: int) -> tuple[Array, ...]:
    """Return the values of a mark along x (0) or y (1)."""
    if isinstance(mark, Strokes):
        return (mark.ends[:, :, axis].ravel(),)
    if axis == 0:
        return (mark.x,)
    return (mark.low, mark.high) if isinstance(mark, Band) else (mark.y,)


def _span(columns: list[Array], air: float, log: bool = False) -> tuple[float, float]:
    values = np.concatenate([c[np.isfinite(c)] for c in columns]) if columns else np.zeros(0)
    if log:
        values = values[values > 0.0]
    if len(values) == 0:
        return (0.1, 10.0) if log else (0.0, 1.0)
    low, high = float(values.min()), float(values.max())
    if log:
        return low / 1.2, high * 1.2
    return low - air * (high - low), high + air * (high - low)


def _opened(low: float, high: float) -> tuple[float, float]:
    """Return limits that differ, also if the log is one instant long or a value constant."""
    low, high = max(low, -MAX_AXIS_VALUE), min(high, MAX_AXIS_VALUE)
    if high - low >= 1e-12 * max(1.0, abs(high)):
        return low, high
    pad = max(abs(high) * 0.1, 1e-3)
    return low - pad, high + pad
