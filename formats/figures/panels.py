"""Input and content of figures as values: panels with curves, bands, dots and other marks, and labelled axes.

`svg` draws them for a page, `for_paper` for print (PDF and SVG by matplotlib).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import msgspec
import numpy as np

from locfuse.fusion.data import Array, Component, Drive, Estimates, Evaluation, Event, RunningNis

MAX_IN_MM = 0.2  # m: smaller lengths are shown in mm
MAX_CONFIGURATIONS = 8  # more curves in one panel are unreadable


class Scene(msgspec.Struct, frozen=True):
    """Drive, estimates and their evaluation, as input of the figures."""

    drive: Drive
    estimates: Sequence[Estimates]
    evaluations: Sequence[Evaluation]
    nis: Mapping[tuple[str, str], RunningNis] = {}  # (configuration, sensor)
    nees_bounds: tuple[float, float] = (0.0, 0.0)  # 95 % bounds of one NEES per degree of freedom
    components: Mapping[str, Sequence[Component]] = {}  # of innovations, by sensor
    states: Mapping[str, Sequence[Component]] = {}  # states other than the pose, by block
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

    def judged(self) -> list[Evaluation]:
        """Return the evaluations to draw, without those of the result that is the reference itself."""
        found = [j for _, j in self.shown() if len(j.t)]
        return [j for j in found if not j.reference or j.deviation.any()] or found

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


MAX_AXIS_VALUE = 1e100  # limit of axes: the range of values from a damaged log may overflow
TIME = "time, s"  # the label of a time axis


class Curve(msgspec.Struct, frozen=True):
    """A line through points, broken at NaN; `of` is a configuration or a role of the palette."""

    of: str
    x: Array  # (n,)
    y: Array  # (n,)
    wide: bool = False  # a thick line whose colour shows a value
    period: float = math.inf  # of y, of an angle: the line is broken where y passes the ends of its range


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
    """Straight line segments, such as walls."""

    of: str
    ends: Array  # (k, 2, 2) both ends


class Spots(msgspec.Struct, frozen=True):
    """Symbols that keep their size when the panel is enlarged; `of` is a role in palette.SHAPES."""

    of: str
    x: Array  # (n,)
    y: Array  # (n,)


Mark = Curve | Band | Dots | Strokes | Spots


class TimedPlaces(msgspec.Struct, frozen=True):
    """Positions at evenly spaced times from start to end, for the page's time cursor; not drawn."""

    of: str
    start: float  # s
    end: float  # s
    x: Array  # (n,)
    y: Array  # (n,)


class Panel(msgspec.Struct, frozen=True):
    """The content of one pair of axes."""

    name: str  # for file name and anchor
    title: str
    y_label: str  # with the unit
    x_label: str
    marks: tuple[Mark, ...]
    summary: str = ""  # description for screen readers
    log: bool = False  # logarithmic y
    x_log: bool = False  # logarithmic x
    equal: bool = False  # equal scale in x and y
    x_range: tuple[float, float] | None = None
    y_range: tuple[float, float] | None = None
    lanes: tuple[str, ...] = ()  # names of lanes on the y axis from top to bottom, each of height 1
    keys: tuple[str, ...] = ()  # roles listed in the panel's legend
    events: tuple[Event, ...] = ()  # shaded intervals behind the marks, on a time axis
    legend: Mapping[str, str] = {}  # role -> legend text that replaces the role's name
    tracks: tuple[TimedPlaces, ...] = ()  # on a map: positions of each result over time


class Section(msgspec.Struct, frozen=True):
    """Panels under one heading."""

    name: str
    title: str
    text: str
    panels: tuple[Panel, ...]
    columns: int = 2
    rows: tuple[str, ...] = ()  # a heading per row of panels, if rows are configurations


def ranges(panel: Panel) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the limits of x and y: those set in the panel, else the range of its marks with a small margin."""
    x = panel.x_range or _span([v for m in panel.marks for v in values_of(m, 0)], 0.0, panel.x_log)
    y = panel.y_range or _span([v for m in panel.marks for v in values_of(m, 1)], 0.04, panel.log)
    return _widened(*x), _widened(*y)


def values_of(mark: Mark, axis: int) -> tuple[Array, ...]:
    """Return the values of a mark along x (0) or y (1)."""
    if isinstance(mark, Strokes):
        return (mark.ends[:, :, axis].ravel(),)
    if axis == 0:
        return (mark.x,)
    return (mark.low, mark.high) if isinstance(mark, Band) else (mark.y,)


def _span(columns: list[Array], margin: float, log: bool = False) -> tuple[float, float]:
    values = np.concatenate([c[np.isfinite(c)] for c in columns]) if columns else np.zeros(0)
    if log:
        values = values[values > 0.0]
    if len(values) == 0:
        return (0.1, 10.0) if log else (0.0, 1.0)
    low, high = float(values.min()), float(values.max())
    if log:
        return low / 1.2, high * 1.2
    return low - margin * (high - low), high + margin * (high - low)


def _widened(low: float, high: float) -> tuple[float, float]:
    """Return limits within MAX_AXIS_VALUE, widened if they are equal (constant values)."""
    low, high = max(low, -MAX_AXIS_VALUE), min(high, MAX_AXIS_VALUE)
    if high - low >= 1e-12 * max(1.0, abs(high)):
        return low, high
    pad = max(abs(high) * 0.1, 1e-3)
    return low - pad, high + pad


# --- Ticks: steps of 1, 2, 5; decades on logarithmic axes


def linear_ticks(low: float, high: float, most: int = 6) -> list[tuple[float, str]]:
    """Return ticks (value, label) within [low, high]: about `most`, but at least two, which show the scale."""
    step = nice_step((high - low) / max(1, most))
    while count_ticks(low, high, step) > most and count_ticks(low, high, nice_step(1.5 * step)) >= 3:
        step = nice_step(1.5 * step)
    while count_ticks(low, high, step) < 2:
        step = nice_step(step / 2.5)
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    decimals = max(0, -math.floor(math.log10(step) + 1e-9))
    labels = {k: f"{k * step:.{decimals}f}" for k in range(first, last + 1)}
    return [(k * step, text.replace("-", "−" if float(text) else "")) for k, text in labels.items()]


def ticks(low: float, high: float, log: bool, most: int = 6) -> list[tuple[float, str]]:
    """Return ticks (value, label) of a linear or a logarithmic axis."""
    return log_ticks(low, high, most) if log else linear_ticks(low, high, most)


def count_ticks(low: float, high: float, step: float) -> int:
    """Return the number of multiples of `step` in [low, high]."""
    return math.floor(high / step + 1e-9) - math.ceil(low / step - 1e-9) + 1


def nice_step(least: float) -> float:
    """Return the smallest number of the form 1, 2 or 5 times a power of ten that is at least `least`."""
    if least <= 0.0 or not math.isfinite(least):
        return 1.0
    power = 10.0 ** math.floor(math.log10(least))
    return next((m * power for m in (1.0, 2.0, 5.0) if m * power >= least * (1 - 1e-9)), 10.0 * power)


def log_ticks(low: float, high: float, most: int = 6) -> list[tuple[float, str]]:
    """Return ticks (value, label) at powers of ten in [low, high], in a small range also at 2 and 5."""
    first, last = math.ceil(math.log10(low) - 1e-9), math.floor(math.log10(high) + 1e-9)
    if last - first < 1:
        steps = [m * 10.0**p for p in range(first - 1, last + 2) for m in (1.0, 2.0, 5.0)]
        return [(s, _log_tick_label(s)) for s in steps if low <= s <= high]
    every = math.ceil((last - first + 1) / most)
    return [(10.0**p, _log_tick_label(10.0**p)) for p in range(first, last + 1, every)]


def _log_tick_label(value: float) -> str:
    power = str(round(math.log10(value))).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
    return f"{value:g}" if 1e-4 <= value < 1e5 else f"10{power}"
