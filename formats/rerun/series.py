"""Curves over time: deviation from truth, NIS with its bounds, innovations with 2 sigma, gates, raw numbers."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from locfuse.formats.thin import extremes
from locfuse.fusion.data import VERDICTS, Array, Audit, Component, Estimates, Evaluation, Ints, Measurements

from . import style
from .deferred import rr
from .recorder import Recorder, part
from .scene import Rgb, Scene, Sight

DEVIATIONS = ("x [m]", "y [m]", "heading [deg]")
BAND = 3.0  # sigmas of a deviation
INNOVATION_BAND = 2.0  # sigmas of an innovation
ACCEPTED, NEW, REPEATED = (VERDICTS.index(v) for v in ("accepted", "new", "repeated"))


def draw_series(to: Recorder, scene: Scene) -> None:
    """Send all curves."""
    for e in scene.estimates:
        colour, limit, name = scene.colour(e.name), scene.detail.curve, part(e.name)
        drive = scene.seen_by(e.name)
        if e.name in scene.evaluations:
            draw_deviation(to, scene.evaluations[e.name], colour, limit)
        for sensor, audit in e.audits.items():
            draw_nis(to, f"nis/{sensor}/{name}", e, audit, colour, limit)
            draw_innovation(to, f"innovation/{sensor}", e, audit, scene.sights.get(sensor), colour, limit)
            m, instant = drive.measurements[sensor], drive.instant[sensor]
            draw_gate(to, f"gate/{sensor}/{name}", drive.t[instant], m, audit, limit)
    for sensor, sight in scene.sights.items():
        draw_limits(to, scene, sensor, sight)
    draw_raw(to, scene)


def entity(name: str) -> str:
    """Return a deviation's name without its unit: what its entity is called."""
    return name.split(" ", 1)[0]


def component(sight: Sight | None, i: int) -> Component:
    """Return how number i of a sensor's innovation is shown, y0, y1, ... where nobody says."""
    return sight.components[i] if sight else Component(f"y{i}", "")


def draw_deviation(to: Recorder, judged: Evaluation, colour: Rgb, limit: int) -> None:
    """Send estimate - truth in x, y, heading, and the 3 sigma that the filter claims around zero."""
    columns = [judged.deviation[:, 0], judged.deviation[:, 1]]
    if judged.heading is not None:
        columns.append(np.degrees(judged.heading))
    to_unit = (1.0, 1.0, 180.0 / np.pi)
    for i, values in enumerate(columns):
        path = f"deviation/{entity(DEVIATIONS[i])}/{part(judged.name)}"
        curve(to, path, judged.t, values, judged.name, colour, limit)
        bound = BAND * to_unit[i] * judged.sigma[:, i]
        if bound.any():
            band(to, f"{path}/three_sigma", judged.t, bound, judged.name, colour, limit)


def draw_nis(to: Recorder, path: str, e: Estimates, audit: Audit, colour: Rgb, limit: int) -> None:
    """Send the NIS of every measurement that was compared, as dots."""
    some = np.flatnonzero(np.isfinite(audit.nis))
    dots(to, path, e.t[audit.instant[some]], audit.nis[some], e.name, colour, limit)


def draw_limits(to: Recorder, scene: Scene, sensor: str, sight: Sight) -> None:
    """Send the gate of a sensor and between what 95 % of consistent NIS lie, as level lines."""
    audits = [e.audits[sensor] for e in scene.estimates if sensor in e.audits]
    gates = [float(a.threshold[0]) for a in audits if len(a.threshold)]
    if not gates:
        return
    t = scene.drive.t[[0, -1]]
    if np.isfinite(gates[0]):
        curve(to, f"nis/{sensor}/limits/gate", t, np.full(2, gates[0]), "gate", style.LIMIT, 2)
    for name, value in zip(("low", "high"), sight.bounds, strict=True):
        curve(to, f"nis/{sensor}/limits/{name}", t, np.full(2, value), "95 %", style.LEVEL, 2)


def draw_innovation(
    to: Recorder, root: str, e: Estimates, audit: Audit, sight: Sight | None, colour: Rgb, limit: int
) -> None:
    """Send every component of the innovation as dots, and its predicted 2 sigma around zero."""
    some = np.flatnonzero(np.isfinite(audit.y).all(axis=1))
    t = e.t[audit.instant[some]]
    for i in range(audit.y.shape[1]):
        name, _, scale = component(sight, i)
        path = f"{root}/{part(name)}/{part(e.name)}"
        dots(to, path, t, scale * audit.y[some, i], e.name, colour, limit)
        bound = INNOVATION_BAND * scale * audit.sigma[some, i]
        band(to, f"{path}/two_sigma", t, bound, e.name, colour, limit)


def draw_gate(to: Recorder, path: str, t: Array, m: Measurements, audit: Audit, limit: int) -> None:
    """Send what became of each reading, where that changes."""
    names = list(style.STATES)
    states = thinned_states(reading_states(m, audit), limit)
    changes = np.flatnonzero(np.diff(states.code, prepend=-1))
    rgb = [style.STATES[name] for name in names]
    to.static(path, rr.StateConfiguration(values=names, labels=names, colors=rgb))
    words = [names[code] for code in states.code[changes].tolist()]
    to.send(path, t[states.reading[changes]], rr.StateChange.columns(state=words))


class States(NamedTuple):
    """What became of some readings."""

    reading: Ints  # (k,)
    code: Ints  # (k,) position in style.STATES: the higher the worse


def reading_states(m: Measurements, audit: Audit) -> Ints:
    """Return the state of every reading (n,): a scan of five walls is one reading."""
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
    """Return the states of all readings, or of `limit` stretches of them by the worst in each."""
    n = len(code)
    if np.count_nonzero(np.diff(code)) < limit:
        return States(np.arange(n), code)
    first = np.unique(np.linspace(0, n, limit, endpoint=False).astype(np.int64))
    return States(first, np.maximum.reduceat(code, first))


def draw_raw(to: Recorder, scene: Scene) -> None:
    """Send the numbers of every topic that was read, as the log holds them."""
    for topic in scene.raw:
        for i, (name, values) in enumerate(topic.fields.items()):
            colour = style.FIELDS[i % len(style.FIELDS)]
            path = raw_path(topic.topic, name)
            curve(to, path, topic.t, values, name, colour, scene.detail.curve)


def raw_path(topic: str, name: str = "") -> str:
    """Return the entity of a raw topic, or of one of its fields."""
    return "/".join(("raw", *(part(p) for p in (*topic.split("/"), name) if p)))


def curve(to: Recorder, path: str, t: Array, values: Array, name: str, colour: Rgb, limit: int) -> None:
    """Send one line."""
    if len(t) == 0:
        return
    picks = extremes(values, limit)
    to.static(path, rr.SeriesLines(colors=[colour], names=[name], widths=[1.5]))
    to.send(path, t[picks], rr.Scalars.columns(scalars=values[picks]))


def dots(to: Recorder, path: str, t: Array, values: Array, name: str, colour: Rgb, limit: int) -> None:
    """Send one cloud of dots."""
    if len(t) == 0:
        return
    picks = extremes(values, limit)
    to.static(path, rr.SeriesPoints(colors=[colour], names=[name], markers=["circle"], marker_sizes=[1.5]))
    to.send(path, t[picks], rr.Scalars.columns(scalars=values[picks]))


def band(to: Recorder, path: str, t: Array, bound: Array, name: str, colour: Rgb, limit: int) -> None:
    """Send the two lines +-bound around zero; under the curve's own name the legend switches both."""
    if len(t) == 0:
        return
    picks = extremes(bound, limit)
    faint = style.faded(colour, 200)
    to.static(path, rr.SeriesLines(colors=[faint, faint], names=[name, name], widths=[0.75, 0.75]))
    to.send(path, t[picks], rr.Scalars.columns(scalars=np.column_stack((bound[picks], -bound[picks]))))
