"""Colours of configurations, equal in all figures and reports, and distinct for every kind of colour vision.

All pairs of colours differ under protanopia, deuteranopia and tritanopia, and each colour has a contrast of 3 to
its page (measured in tests/figures/test_figures.py). Each sensor has its own colour in every log. Curves of
several sensors are dashed.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

from locfuse.fusion.data import BASES, FAULT, JUMP, LOOP, LOST, REFUSED, REST, VERDICTS, Colour, Estimates


class Trace(NamedTuple):
    """Properties of a result that determine its line colour and style."""

    configuration: str  # "odometry", "compass+lrf", "all"
    sensors: tuple[str, ...]
    slowed: bool = False  # with a sensor at a reduced rate
    smoothed: bool = False

    @property
    def dashed(self) -> bool:
        """Whether the line is dashed: for several sensors (but not `all`), reduced rates, or smoothed results."""
        some = len(self.sensors) > 1 and self.configuration != "all"
        return some or self.slowed or self.smoothed

    @property
    def look(self) -> str:
        """The line style: "" (solid), "dash" if `dashed`, or "over" (long dashes) for `all`.

        The line of `all` often covers other lines, which are visible in the gaps of long dashes.
        """
        over = self.configuration == "all" and len(self.sensors) > 1
        return "dash" if self.dashed else "over" if over else ""


ODOMETRY = Colour("#686a70", "#94979c")
ALL = Colour("#8a0a55", "#bf2f80")
TRUTH = Colour("#0d0f12", "#f4f5f7")
SETS = (  # colours for sets of several (but not all) sensors, whose lines are also dashed
    Colour("#0b6e6e", "#58c6c6"),
    Colour("#6d4fc4", "#a58bf0"),
    Colour("#8c6a00", "#d2b13a"),
    Colour("#b0413e", "#f08a80"),
    Colour("#4d7a1f", "#9fce62"),
)
OUT = Colour("#a3123a", "#e0566f")
LANDMARK = Colour("#d615c0", "#ff4fe6")
LEVELS = (  # colour scale along a path, small to large; ordered by lightness
    Colour("#16c3b4", "#044b94"),
    Colour("#0091cd", "#6c5ab6"),
    Colour("#685fbc", "#bb6ab4"),
    Colour("#752870", "#fb906a"),
    Colour("#4e0308", "#fbdd67"),
)
ROLES = {  # colours of marks that are not configurations
    **dict.fromkeys(VERDICTS, OUT),
    "truth": TRUTH,
    "walls of the first scan": Colour("#9aa3af", "#667080"),
    "walls seen later": Colour("#cfc09f", "#6f6750"),
    "bounds": Colour("#8c94a0", "#6b7480"),
    "accepted": Colour("#c5cad3", "#47505d"),
    "new": Colour("#7f97e8", "#4a66b8"),
    "ambiguous": Colour("#e2b04a", "#b98a2c"),
    "unmatched": Colour("#c7843a", "#a8642a"),
    "lost": Colour("#3b3f46", "#b9bec7"),
    "disturbed": Colour("#6a1b6a", "#b06ab8"),
    "fault": Colour("#b86e00", "#e0a040"),
    "rest": Colour("#5f7f95", "#7f9fb5"),
    "loop": Colour("#2c8a5b", "#7fdc9a"),
    "jump": Colour("#c02080", "#f080c0"),
    "repeated": Colour("#e4e7ec", "#2f353e"),
    **{f"level {i}": colour for i, colour in enumerate(LEVELS)},
    **dict.fromkeys(("median", "start", "end", "time"), TRUTH),
    "landmark": LANDMARK,
    **dict.fromkeys(("alone", "leave_one_out", "credit"), TRUTH),  # effects of a sensor on the error
}
SHAPES = {  # role -> shape of its spots
    "start": "ring",
    "end": "square",
    "time": "dot",
    "landmark": "target",
    "gate": "cross",
    "alone": "ring",
    "leave_one_out": "square",
    "credit": "dot",
}
# kind of event -> role
EVENTS = {FAULT: "fault", LOST: "lost", REFUSED: "gate", REST: "rest", LOOP: "loop", JUMP: "jump"}


def traces_of(estimates: Iterable[Estimates]) -> dict[str, Trace]:
    """Return name -> style of each result's curve."""
    return {e.name: Trace(e.configuration, e.sensors, bool(e.rates), e.smoothed) for e in estimates}


def traces_in(report: Mapping[str, Any]) -> dict[str, Trace]:
    """Return name -> style of the curve of each result of a report."""
    of = report["configurations"].items()
    return {
        name: Trace(v["configuration"], tuple(v["sensors"]), bool(v["rates_hz"]), v["smoothed"]) for name, v in of
    }


def looks_of(traces: Mapping[str, Trace]) -> dict[str, str]:
    """Return name -> line style ("dash", "over") of each result; results with solid lines are left out."""
    return {name: trace.look for name, trace in traces.items() if trace.look}


def colours(traces: Mapping[str, Trace], sensors: Mapping[str, Colour]) -> dict[str, Colour]:
    """Return the colour of every result, sensor and role by name; `sensors` has the colours of all sensors."""
    order, found = list(sensors), {**sensors}
    for name, trace in traces.items():
        if trace.configuration in {*BASES, "all"}:
            found[name] = ODOMETRY if trace.configuration in BASES else ALL
        elif len(trace.sensors) == 1 and trace.sensors[0] in sensors:
            found[name] = sensors[trace.sensors[0]]
        else:
            places = [order.index(s) if s in sensors else len(order) for s in trace.sensors]
            found[name] = SETS[sum(2**p for p in places) % len(SETS)]
    return {**found, **ROLES}
