"""Plots over time: deviation from truth, NIS, innovations, gates, raw numbers, and events as texts."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import rerun as rr

from locfuse.formats.thin import extremes
from locfuse.fusion.data import (
    FAULT,
    LOST,
    REFUSED,
    VERDICTS,
    Array,
    Audit,
    Component,
    Estimates,
    Evaluation,
    Event,
    Ints,
    Measurements,
)

from . import style
from .recorder import TimelineRecorder, part
from .scene import RerunScene, Rgb, SensorLook

DEVIATIONS = ("x [m]", "y [m]", "heading [deg]")
DEVIATION_BAND_SIGMAS = 3.0  # sigmas of a deviation
INNOVATION_BAND_SIGMAS = 2.0  # sigmas of an innovation
EVENTS = "events"
LEVELS = {LOST: "ERROR", FAULT: "WARN", REFUSED: "WARN"}  # what asks for attention first; the rest is INFO
ACCEPTED, NEW, REPEATED = (VERDICTS.index(v) for v in ("accepted", "new", "repeated"))


def draw_series(to: TimelineRecorder, scene: RerunScene) -> None:
    """Draw all curves, states and events."""
    limit = scene.detail.curve
    causal = {e.configuration for e in scene.estimates if not e.smoothed}
    for e in scene.estimates:
        pen, name = Pen(to, e.name, scene.colour(e.name), limit), part(e.name)
        drive = scene.seen_by(e.name)
        if e.name in scene.evaluations:
            draw_deviation(pen, scene.evaluations[e.name])
        if e.smoothed and e.configuration in causal:
            continue  # its audits are the filter's
        for sensor, audit in e.audits.items():
            compared = np.flatnonzero(np.isfinite(audit.nis))
            pen.dots(f"nis/{sensor}/{name}", e.t[audit.instant[compared]], audit.nis[compared])
            draw_innovation(pen, f"innovation/{sensor}", e, audit, scene.sights.get(sensor))
            m, instant = drive.measurements[sensor], drive.instant[sensor]
            draw_gate(to, f"gate/{sensor}/{name}", drive.t[instant], m, audit, limit)
    for sensor, sight in scene.sights.items():
        draw_limits(to, scene, sensor, sight)
    for topic in scene.raw:
        for i, (name, values) in enumerate(topic.fields.items()):
            colour = style.FIELDS[i % len(style.FIELDS)]
            Pen(to, name, colour, limit).curve(raw_path(topic.topic, name), topic.t, values)
    draw_events(to, scene.events)


class Pen(NamedTuple):
    """Draws curves of one name and colour, thinned to `limit` points."""

    to: TimelineRecorder
    name: str  # in the legend
    colour: Rgb
    limit: int

    def curve(self, path: str, t: Array, values: Array) -> None:
        """Draw one line."""
        look = rr.SeriesLines(colors=[self.colour], names=[self.name], widths=[1.5])
        self._draw(path, t, values, look)

    def dots(self, path: str, t: Array, values: Array) -> None:
        """Draw one cloud of dots."""
        look = rr.SeriesPoints(colors=[self.colour], names=[self.name], markers=["circle"], marker_sizes=[1.5])
        self._draw(path, t, values, look)

    def band(self, path: str, t: Array, bound: Array) -> None:
        """Draw two lines at +-bound (n,); under the curve's own name the legend switches both."""
        faint = style.faded(self.colour, 200)
        look = rr.SeriesLines(colors=[faint, faint], names=[self.name, self.name], widths=[0.75, 0.75])
        self._draw(path, t, np.column_stack((bound, -bound)), look)

    def _draw(self, path: str, t: Array, values: Array, look: Any) -> None:
        if len(t):
            picks = extremes(values if values.ndim == 1 else values[:, 0], self.limit)
            self.to.static(path, look)
            self.to.send(path, t[picks], rr.Scalars.columns(scalars=values[picks]))


def entity(name: str) -> str:
    """Return a deviation's name without its unit: what its entity is called."""
    return name.split(" ", 1)[0]


def component(sight: SensorLook | None, i: int) -> Component:
    """Return the name of number i of a sensor's innovation; y0, y1, ... for a sensor without a description."""
    return sight.components[i] if sight else Component(f"y{i}", "")


def raw_path(topic: str, name: str = "") -> str:
    """Return the entity of a raw topic, or of one of its fields."""
    return "/".join(("raw", *(part(p) for p in (*topic.split("/"), name) if p)))


def draw_deviation(pen: Pen, judged: Evaluation) -> None:
    """Draw estimate - truth in x, y, heading, and the filter's 3 sigma around zero."""
    columns = [judged.deviation[:, 0], judged.deviation[:, 1]]
    if judged.heading is not None:
        columns.append(np.degrees(judged.heading))
    to_unit = (1.0, 1.0, 180.0 / np.pi)
    for i, values in enumerate(columns):
        path = f"deviation/{entity(DEVIATIONS[i])}/{part(judged.name)}"
        pen.curve(path, judged.t, values)
        bound = DEVIATION_BAND_SIGMAS * to_unit[i] * judged.sigma[:, i]
        if bound.any():
            pen.band(f"{path}/three_sigma", judged.t, bound)


def draw_innovation(pen: Pen, root: str, e: Estimates, audit: Audit, sight: SensorLook | None) -> None:
    """Draw every component of the innovation as dots, and its predicted 2 sigma around zero."""
    some = np.flatnonzero(np.isfinite(audit.y).all(axis=1))
    t = e.t[audit.instant[some]]
    for i in range(audit.y.shape[1]):
        name, _, scale = component(sight, i)
        path = f"{root}/{part(name)}/{part(e.name)}"
        pen.dots(path, t, scale * audit.y[some, i])
        pen.band(f"{path}/two_sigma", t, INNOVATION_BAND_SIGMAS * scale * audit.sigma[some, i])


def draw_limits(to: TimelineRecorder, scene: RerunScene, sensor: str, sight: SensorLook) -> None:
    """Draw a sensor's gate and the 95 % bounds of a consistent NIS, as level lines."""
    audits = [e.audits[sensor] for e in scene.estimates if sensor in e.audits]
    gates = [float(a.threshold[0]) for a in audits if len(a.threshold)]
    if not gates:
        return
    low, high = sight.bounds
    levels = [("low", low, "95 %", style.LEVEL), ("high", high, "95 %", style.LEVEL)]
    if np.isfinite(gates[0]):
        levels.append(("gate", gates[0], "gate", style.LIMIT))
    for entity_name, value, name, colour in levels:
        path = f"nis/{sensor}/limits/{entity_name}"
        Pen(to, name, colour, 2).curve(path, scene.drive.t[[0, -1]], np.full(2, value))


def draw_gate(to: TimelineRecorder, path: str, t: Array, m: Measurements, audit: Audit, limit: int) -> None:
    """Draw the state of each reading where it changes."""
    names = list(style.STATES)
    states = thinned_states(reading_states(m, audit), limit)
    changes = np.flatnonzero(np.diff(states.code, prepend=-1))
    rgb = [style.STATES[name] for name in names]
    to.static(path, rr.StateConfiguration(values=names, labels=names, colors=rgb))
    words = [names[code] for code in states.code[changes].tolist()]
    to.send(path, t[states.reading[changes]], rr.StateChange.columns(state=words))


class States(NamedTuple):
    """The states of some readings."""

    reading: Ints  # (k,)
    code: Ints  # (k,) position in style.STATES: the higher the worse


def reading_states(m: Measurements, audit: Audit) -> Ints:
    """Return the state of every reading (n,): a scan with five walls is one reading."""
    n = len(m.t)
    owner = np.searchsorted(m.first, audit.row, side="right") - 1
    accepted = np.bincount(owner[np.isin(audit.verdict, (ACCEPTED, REPEATED))], minlength=n) > 0
    new = np.bincount(owner[audit.verdict == NEW], minlength=n) > 0
    fine = np.isin(audit.verdict, (ACCEPTED, NEW, REPEATED))
    refused = np.bincount(owner[~fine], minlength=n) > 0
    order = list(style.STATES)
    cases = {"rejected": refused & ~accepted, "partly": refused, "accepted": accepted, "new": new}
    codes = [order.index(name) for name in cases]
    return np.select(list(cases.values()), codes, order.index("absent"))


def thinned_states(code: Ints, limit: int) -> States:
    """Return the states of all readings, or of `limit` intervals of them by the worst in each."""
    n = len(code)
    if np.count_nonzero(np.diff(code)) < limit:
        return States(np.arange(n), code)
    first = np.unique(np.linspace(0, n, limit, endpoint=False).astype(np.int64))
    return States(first, np.maximum.reduceat(code, first))


def draw_events(to: TimelineRecorder, events: Sequence[Event]) -> None:
    """Draw each event as a text at its begin, and at its end if it lasted; one entity for each kind."""
    for kind in dict.fromkeys(e.kind for e in events):
        some = sorted(line for e in events if e.kind == kind for line in _lines(e))
        texts = [text for _, text in some]
        columns = rr.TextLog.columns(text=texts, level=[LEVELS.get(kind, "INFO")] * len(some))
        to.send(f"{EVENTS}/{part(kind)}", np.array([t for t, _ in some]), columns)


def _lines(event: Event) -> list[tuple[float, str]]:
    who = f"{event.configuration}: " if event.configuration else ""
    begin = (event.start, f"{event.kind}: {who}{event.words}")
    if event.end <= event.start:
        return [begin]
    return [begin, (event.end, f"{event.kind} ends: {who}{event.words}")]
