"""Drawing into a Rerun stream on the log's clock: columns, styles, legend, pictures and time series.

Each colour has one meaning: red is used only for rejected measurements.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import islice
from typing import Any, NamedTuple

import numpy as np
import rerun as rr

from locfuse.formats.geometry import extremes
from locfuse.fusion import data
from locfuse.fusion.data import Array, Audit, Drive, Estimates, Evaluation, Event, Ints, Measurements, RowVerdict

from .scene import MATCHED, NEW, REJECTED, Picture, RerunScene, Rgb, SensorLook

DRIVE, TIME, STEP = "drive", "log time", "step"  # s since the start, the log's clock, update index
MIN_DATE_NS = 10**17  # 1973; a smaller time counts from the robot's start and is shown as a duration
OMNI, PANORAMA, LEGEND = "camera/omni", "camera/panorama", "legend"
LEGEND_COLUMNS, LEGEND_CELL = 6, 4.6  # entries per row, and their distance in row heights
FOUND_ORDER = 10.0  # draw order of detections, above the picture
PICTURES_IN_MEMORY = 16

TRUTH: Rgb = (244, 245, 247)
FIELD_COLOURS: tuple[Rgb, ...] = ((240, 165, 40), (80, 165, 235), (215, 110, 190), (150, 120, 240), (60, 190, 190))
LANDMARK: Rgb = (255, 60, 230)
FIRST_WALL: Rgb = (170, 115, 60)
WALL: Rgb = (225, 205, 150)
SCAN: Rgb = (110, 165, 200)
LIMIT: Rgb = (255, 235, 60)
LEVEL: Rgb = (205, 205, 210)
LOOP: Rgb = (235, 210, 255)
GROUPS: dict[str, Rgb] = {MATCHED: (40, 185, 50), REJECTED: (240, 60, 50), NEW: (0, 225, 235)}
STATES: dict[str, Rgb] = {  # state of a reading on the gate timeline -> colour, worst state last
    "accepted": (60, 150, 85),
    "new": (70, 125, 205),
    "unusable": (95, 95, 100),
    "partly": (200, 165, 60),
    "rejected": (205, 70, 60),
}


class TimelineRecorder:
    """Writes columns to a Rerun stream on all timelines: seconds since the start, log time, update index."""

    def __init__(self, stream: rr.RecordingStream, drive: Drive) -> None:
        self._stream, self._epoch_ns, self._updates = stream, drive.epoch_ns, drive.t

    def send(self, path: str, t: Array, *columns: Any, lengths: Sequence[int] | Ints | None = None) -> None:
        """Write component columns, one row per time t (n,) [s].

        `lengths` (n,) are the numbers of values in each row; None: one value per row.
        """
        if len(t) == 0:
            return
        parts = [part for group in columns for part in (group if lengths is None else group.partition(lengths))]
        since_ns = np.rint(t * 1e9).astype(np.int64)
        ns = self._epoch_ns + since_ns
        dated = self._epoch_ns >= MIN_DATE_NS
        when = {"timestamp": ns.astype("datetime64[ns]")} if dated else {"duration": ns.astype("timedelta64[ns]")}
        step = np.maximum(np.searchsorted(self._updates, t, side="right") - 1, 0)
        since = rr.TimeColumn(DRIVE, duration=since_ns.astype("timedelta64[ns]"))
        times = [since, rr.TimeColumn(TIME, **when), rr.TimeColumn(STEP, sequence=step)]
        self._stream.send_columns(path, times, parts, strict=True)

    def static(self, path: str, *archetypes: Any) -> None:
        """Write static data, such as colours."""
        self._stream.log(path, *archetypes, static=True, strict=True)


def part(name: str) -> str:
    """Return a name escaped as one part of a Rerun entity path."""
    return "".join(c if c.isalnum() or c in "_-." else f"\\{c}" for c in name)


def screen_radius(points: float) -> Any:
    """Return a radius [screen points] that is independent of the zoom."""
    return rr.Radius.ui_points(points)


def lines(colour: Rgb, width: float, order: float | None = None, alpha: int = 255) -> rr.LineStrips2D:
    """Return the style of line strips: colour, width [screen points], draw order, opacity 0 to 255."""
    colors, radii = [(*colour, alpha)], [screen_radius(width)]
    return rr.LineStrips2D.from_fields(colors=colors, radii=radii, draw_order=order, show_labels=False)


def points(colour: Rgb, width: float, alpha: int = 255) -> rr.Points2D:
    """Return the style of points: colour, radius [screen points], opacity 0 to 255."""
    return rr.Points2D.from_fields(colors=[(*colour, alpha)], radii=[screen_radius(width)])


def legend_of(scene: RerunScene) -> list[tuple[str, Rgb]]:
    """Return the legend of the map as (text, colour), configurations first."""
    runs = scene.estimates
    groups = {"matched": GROUPS[MATCHED], "rejected": GROUPS[REJECTED], "new": GROUPS[NEW]}
    shown: list[tuple[bool, dict[str, Rgb]]] = [
        (scene.drive.truth is not None, {"truth": TRUTH}),
        (any(scene.sights[s].kind for e in runs for s in e.audits), groups),
        (any(e.final_map for e in runs), {"wall": WALL, "wall at first sight": FIRST_WALL}),
        (any(len(e.loops) for e in runs), {"loop closed": LOOP}),
        (scene.scans is not None, {"scan": SCAN}),
        (bool(scene.landmarks), {"landmark": LANDMARK}),
    ]
    rest = [entry for present, entries in shown if present for entry in entries.items()]
    return [*((e.name, scene.colour(e.name)) for e in runs), *rest]


def legend_rows(scene: RerunScene) -> int:
    """Return the number of rows of the legend."""
    return -(-len(legend_of(scene)) // LEGEND_COLUMNS)


def draw_legend(to: TimelineRecorder, scene: RerunScene) -> None:
    """Draw the legend entries in their colours."""
    for i, (words, colour) in enumerate(legend_of(scene)):
        row, column = divmod(i, LEGEND_COLUMNS)
        place = rr.Points2D([[column * LEGEND_CELL, float(row)]], labels=[words], show_labels=True)
        to.static(f"{LEGEND}/{part(words)}", place, points(colour, 3.0))


def draw_pictures(to: TimelineRecorder, scene: RerunScene) -> None:
    """Draw the omnidirectional pictures and their panoramas.

    Each detection is a ray in the picture and a column in the panorama.
    """
    rows = float(scene.picture_rows or 0)
    for root in (OMNI, PANORAMA):
        for name, colour in GROUPS.items():
            to.static(f"{root}/found/{name}", lines(colour, 1.0, order=FOUND_ORDER))
    rest = iter(scene.pictures)
    while batch := list(islice(rest, PICTURES_IN_MEMORY)):
        t = np.array([picture.t for picture in batch])
        of_omni = [p.omni for p in batch], [p.omni_type for p in batch]
        of_panorama = [p.panorama for p in batch], ["image/jpeg"] * len(batch)
        for root, (images, kinds) in ((OMNI, of_omni), (PANORAMA, of_panorama)):
            blobs = [np.frombuffer(data, np.uint8) for data in images]
            to.send(root, t, rr.EncodedImage.columns(blob=blobs, media_type=kinds))
        for name in GROUPS:
            _send_found(to, name, t, batch, rows)


def _send_found(to: TimelineRecorder, group: str, t: Array, batch: Sequence[Picture], rows: float) -> None:
    """Draw the detections in one group of verdicts.

    A picture without such detections removes those of the picture before.
    """
    found = [(p, i) for p in batch for i, verdict in enumerate(p.verdicts) if verdict == group]
    lengths = [p.verdicts.count(group) for p in batch]
    rays = [p.rays[i] for p, i in found]
    columns = [[(p.columns[i], 0.0), (p.columns[i], rows)] for p, i in found]
    for root, strips in ((OMNI, rays), (PANORAMA, columns)):
        shape = np.array(strips, np.float32).reshape(-1, 2, 2)
        to.send(f"{root}/found/{group}", t, rr.LineStrips2D.columns(strips=shape), lengths=lengths)


# --- Time series: deviation from truth, NIS, innovations, gates, raw numbers, and events as text

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
            states, path = list(STATES), f"gate/{sensor}/{name}"
            reading, code = thinned_states(reading_states(drive.measurements[sensor], audit), limit)
            changes = np.flatnonzero(np.diff(code, prepend=-1))
            colours = list(STATES.values())
            to.static(path, rr.StateConfiguration(values=states, labels=states, colors=colours))
            words = [states[state] for state in code[changes].tolist()]
            to.send(path, t[reading[changes]], rr.StateChange.columns(state=words))
    for sensor, sight in scene.sights.items():
        _draw_limits(to, scene, sensor, sight)
    for topic in scene.raw:
        for i, (name, values) in enumerate(topic.fields.items()):
            colour = FIELD_COLOURS[i % len(FIELD_COLOURS)]
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
    lines = (("low", low, "95 %", LEVEL), ("high", high, "95 %", LEVEL), ("gate", gate, "gate", LIMIT))
    for level, value, name, colour in lines:
        if np.isfinite(value):
            pen = Pen(to, name, colour, 2)
            pen.curve(f"nis/{sensor}/limits/{level}", scene.drive.t[[0, -1]], np.full(2, value))


def reading_states(m: Measurements, audit: Audit) -> Ints:
    """Return the state of every reading (n,), an index into drawing.STATES; a scan is one reading."""
    owner = np.searchsorted(m.first, audit.row, side="right") - 1

    def any_of(rows: Any) -> Any:
        return np.bincount(owner[rows], minlength=len(m.t)) > 0

    accepted = any_of(np.isin(audit.verdict, (RowVerdict.ACCEPTED, RowVerdict.REPEATED)))
    new = any_of(audit.verdict == RowVerdict.NEW)
    refused = any_of(~np.isin(audit.verdict, (RowVerdict.ACCEPTED, RowVerdict.NEW, RowVerdict.REPEATED)))
    cases = {"rejected": refused & ~accepted, "partly": refused, "accepted": accepted, "new": new}
    order = list(STATES)
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
