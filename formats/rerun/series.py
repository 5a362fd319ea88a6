"""Drawing of time series: deviation from truth, NIS, innovations, gates, raw numbers, and events as text."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import rerun as rr

from locfuse.formats.thin import extremes
from locfuse.fusion import data
from locfuse.fusion.data import Array, Audit, Estimates, Evaluation, Event, Ints, Measurements, RowVerdict

from . import drawing as ink
from .drawing import TimelineRecorder, part
from .scene import RerunScene, Rgb, SensorLook

# component -> unit of the plot, factor from SI units
DEVIATIONS = {"x": ("m", 1.0), "y": ("m", 1.0), "heading": ("deg", float(np.degrees(1.0)))}
DEVIATION_BAND_SIGMAS = 3.0  # sigmas of a deviation
INNOVATION_BAND_SIGMAS = 2.0  # sigmas of an innovation
EVENTS = "events"
LEVELS = {data.LOST: "ERROR", data.FAULT: "WARN", data.REFUSED: "WARN"}  # others are INFO


class Pen(NamedTuple):
    """Draws time series under one name, in one colour, thinned to `limit` points."""

    to: TimelineRecorder
    name: str  # in the legend
    colour: Rgb
    limit: int

    def curve(self, path: str, t: Array, values: Array) -> None:
        """Draw values (n,) over times t (n,) s as a line."""
        self._draw(path, t, values, rr.SeriesLines(colors=[self.colour], names=[self.name], widths=[1.5]))

    def dots(self, path: str, t: Array, values: Array) -> None:
        """Draw values (n,) over times t (n,) s as dots."""
        look = rr.SeriesPoints(colors=[self.colour], names=[self.name], markers=["circle"], marker_sizes=[1.5])
        self._draw(path, t, values, look)

    def band(self, path: str, t: Array, bound: Array) -> None:
        """Draw two lines at +-bound (n,); the legend switches them on and off together with the curve."""
        look = rr.SeriesLines(colors=[(*self.colour, 200)] * 2, names=[self.name] * 2, widths=[0.75] * 2)
        self._draw(path, t, np.column_stack((bound, -bound)), look)

    def _draw(self, path: str, t: Array, values: Array, look: Any) -> None:
        if len(t):
            picks = extremes(values if values.ndim == 1 else values[:, 0], self.limit)
            self.to.static(path, look)
            self.to.send(path, t[picks], rr.Scalars.columns(scalars=values[picks]))


def draw_series(to: TimelineRecorder, scene: RerunScene) -> None:
    """Draw all time series, gate states and events."""
    limit = scene.max_points
    causal = {e.configuration for e in scene.estimates if not e.smoothed}
    for e in scene.estimates:
        pen, name, drive = Pen(to, e.name, scene.colour(e.name), limit), part(e.name), scene.seen_by(e.name)
        if e.name in scene.evaluations:
            _draw_deviation(pen, scene.evaluations[e.name])
        if e.smoothed and e.configuration in causal:
            continue  # a smoothed result has the audits of its filter
        for sensor, audit in e.audits.items():
            compared = np.flatnonzero(np.isfinite(audit.nis))
            pen.dots(f"nis/{sensor}/{name}", e.t[audit.instant[compared]], audit.nis[compared])
            _draw_innovation(pen, f"innovation/{sensor}", e, audit, scene.sights[sensor])
            t = drive.t[drive.instant[sensor]]
            _draw_gate(pen, f"gate/{sensor}/{name}", t, reading_states(drive.measurements[sensor], audit))
    for sensor, sight in scene.sights.items():
        _draw_limits(to, scene, sensor, sight)
    for topic in scene.raw:
        for i, (name, values) in enumerate(topic.fields.items()):
            colour = ink.FIELD_COLOURS[i % len(ink.FIELD_COLOURS)]
            Pen(to, name, colour, limit).curve(raw_path(topic.topic, name), topic.t, values)
    for kind in dict.fromkeys(e.kind for e in scene.events):
        some = sorted(line for e in scene.events if e.kind == kind for line in _lines(e))
        texts = [text for _, text in some]
        columns = rr.TextLog.columns(text=texts, level=[LEVELS.get(kind, "INFO")] * len(some))
        to.send(f"{EVENTS}/{part(kind)}", np.array([t for t, _ in some]), columns)


def raw_path(topic: str, name: str = "") -> str:
    """Return the entity path of a raw topic, or of its field `name`."""
    return "/".join(("raw", *(part(p) for p in (*topic.split("/"), name) if p)))


def _draw_deviation(pen: Pen, judged: Evaluation) -> None:
    """Draw estimate - truth in x, y and heading, with bands of +-3 sigma."""
    columns = [*judged.deviation.T, *([] if judged.heading is None else [judged.heading])]
    for (name, (_, scale)), values, sigma in zip(DEVIATIONS.items(), columns, judged.sigma.T, strict=False):
        path = f"deviation/{name}/{part(judged.name)}"
        pen.curve(path, judged.t, scale * values)
        if sigma.any():
            pen.band(f"{path}/three_sigma", judged.t, DEVIATION_BAND_SIGMAS * scale * sigma)


def _draw_innovation(pen: Pen, root: str, e: Estimates, audit: Audit, sight: SensorLook) -> None:
    """Draw each component of the innovation as dots, with bands of +-2 sigma."""
    some = np.flatnonzero(np.isfinite(audit.y).all(axis=1))
    t = e.t[audit.instant[some]]
    for i in range(audit.y.shape[1]):
        name, _, scale = sight.components[i]
        path = f"{root}/{part(name)}/{part(e.name)}"
        pen.dots(path, t, scale * audit.y[some, i])
        pen.band(f"{path}/two_sigma", t, INNOVATION_BAND_SIGMAS * scale * audit.sigma[some, i])


def _draw_limits(to: TimelineRecorder, scene: RerunScene, sensor: str, sight: SensorLook) -> None:
    """Draw a sensor's gate and the 95 % bounds of its NIS as horizontal lines."""
    audits = (e.audits[sensor] for e in scene.estimates if sensor in e.audits)
    gate = next((float(a.threshold[0]) for a in audits if len(a.threshold)), None)
    if gate is None:
        return
    low, high = sight.bounds
    lines = (("low", low, "95 %", ink.LEVEL), ("high", high, "95 %", ink.LEVEL), ("gate", gate, "gate", ink.LIMIT))
    for level, value, name, colour in lines:
        if np.isfinite(value):
            pen = Pen(to, name, colour, 2)
            pen.curve(f"nis/{sensor}/limits/{level}", scene.drive.t[[0, -1]], np.full(2, value))


def _draw_gate(pen: Pen, path: str, t: Array, codes: Ints) -> None:
    """Draw the changes of the state of a sensor's readings; `codes` (n,) at t (n,) [s] are indices into STATES."""
    names = list(ink.STATES)
    reading, code = thinned_states(codes, pen.limit)
    changes = np.flatnonzero(np.diff(code, prepend=-1))
    pen.to.static(path, rr.StateConfiguration(values=names, labels=names, colors=list(ink.STATES.values())))
    words = [names[state] for state in code[changes].tolist()]
    pen.to.send(path, t[reading[changes]], rr.StateChange.columns(state=words))


def reading_states(m: Measurements, audit: Audit) -> Ints:
    """Return the state of every reading (n,), an index into drawing.STATES; a scan is one reading."""
    owner = np.searchsorted(m.first, audit.row, side="right") - 1

    def any_of(rows: Any) -> Any:
        return np.bincount(owner[rows], minlength=len(m.t)) > 0

    accepted = any_of(np.isin(audit.verdict, (RowVerdict.ACCEPTED, RowVerdict.REPEATED)))
    new = any_of(audit.verdict == RowVerdict.NEW)
    refused = any_of(~np.isin(audit.verdict, (RowVerdict.ACCEPTED, RowVerdict.NEW, RowVerdict.REPEATED)))
    cases = {"rejected": refused & ~accepted, "partly": refused, "accepted": accepted, "new": new}
    order = list(ink.STATES)
    return np.select(list(cases.values()), [order.index(name) for name in cases], order.index("unusable"))


def thinned_states(code: Ints, limit: int) -> tuple[Ints, Ints]:
    """Return the indices (k,) and states (k,) of all readings.

    If the state changes `limit` times or more, return only the worst state in each of `limit` intervals.
    """
    n = len(code)
    if np.count_nonzero(np.diff(code)) < limit:
        return np.arange(n), code
    first = np.unique(np.linspace(0, n, limit, endpoint=False).astype(np.int64))
    return first, np.maximum.reduceat(code, first)


def _lines(event: Event) -> list[tuple[float, str]]:
    """Return (time [s], text) of the begin of an event, and of its end if it has a duration."""
    who = f"{event.configuration}: " if event.configuration else ""
    begin = (event.start, f"{event.kind}: {who}{event.words}")
    end = (event.end, f"{event.kind} ends: {who}{event.words}")
    return [begin, end] if event.end > event.start else [begin]
