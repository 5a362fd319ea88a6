"""From a measured log and its estimates to what a recording shows."""

from __future__ import annotations

import math
import shlex
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from locfuse.cli.analysis.load import Loaded
from locfuse.cli.analysis.outputs import events
from locfuse.cli.session.result import Result
from locfuse.formats.figures.palette import Trace, colours, traces_of
from locfuse.formats.report import markdown
from locfuse.formats.rerun.scene import Detail, Picture, RawTopic, Rgb, ScanPoints, Scene, Sight
from locfuse.formats.visible import visible
from locfuse.fusion.chi_square import chi_square
from locfuse.fusion.data import Array, Column, Estimates, Evaluation, Ragged
from locfuse.fusion.measure import thinned
from locfuse.fusion.robot import VIRTUAL_TRACK
from locfuse.fusion.sensor import Sensor
from locfuse.fusion.sensors.registry import REGISTRY
from locfuse.fusion.sensors.registry import colours as sensor_colours
from locfuse.fusion.truth import TRUTH_READS
from locfuse.fusion.wheels.read import WHEEL_READS

from .scans import MAX_BEAMS, scan_points

MAX_PICTURES = 600  # kept by default
MAX_ARRAY_COLUMNS = 8  # of a numeric array that is drawn as curves: a scan's ranges are not
SHADE = 0.65  # of the light of a colour, for the smoothed result
NIS_LOW, NIS_HIGH = 0.025, 0.975  # between them lie 95 % of consistent NIS


def scene_of_result(result: Result, images: int | None = None, full: bool = False) -> Scene:
    """Return what a recording of a result shows, its report's tables too; `images`, `full` as in `make_scene`."""
    estimates, evaluations = tuple(result.estimates.values()), tuple(result.evaluations.values())
    return make_scene(result.loaded, estimates, evaluations, table_of(result.report), images, full)


def table_of(report: Mapping[str, Any]) -> str:
    """Return the tables of a report in Markdown, and below them the command to type next."""
    log = shlex.quote(visible(str(report["input"]["name"])))
    what = "tune" if "verdicts" in report else "compare"
    why = "which noise figures suit this log" if what == "tune" else "what each sensor adds"
    return f"{markdown.render(report)}\n\nNext: `locfuse {what} {log}` says {why}.\n"


def make_scene(
    loaded: Loaded,
    estimates: Sequence[Estimates],
    evaluations: Sequence[Evaluation],
    table: str,
    images: int | None = None,
    full: bool = False,
) -> Scene:
    """Return what a recording of these configurations shows.

    `images` = n keeps every n-th picture, 0 none, None as many as stay light.
    """
    detail = Detail.everything() if full else Detail()
    best = max(estimates, key=lambda e: len(e.sensors))
    shown, rows = _pictures(loaded, best, images)
    return Scene(
        name=loaded.log.name,
        drive=loaded.drive,
        estimates=estimates,
        evaluations={e.name: e for e in evaluations},
        sights=sights(loaded),
        track=loaded.robot.wheels.track or VIRTUAL_TRACK,
        table=table,
        scans=_scans(loaded, best, detail, full),
        pictures=shown,
        picture_rows=rows,
        raw=raw_topics(loaded),
        events=events(loaded, estimates),
        detail=detail,
        palette=palette(traces_of(estimates)),
        thinned={e.name: thinned(loaded.drive, e.rates) for e in estimates if e.rates},
    )


def palette(traces: Mapping[str, Trace]) -> dict[str, Rgb]:
    """Return the colours that results have in the report, on its dark page.

    The report dashes what is smoothed. The viewer has no dashes: there it is the same colour, darker.
    """
    found = colours(traces, sensor_colours())
    return {name: _rgb(found[name].dark, SHADE if trace.smoothed else 1.0) for name, trace in traces.items()}


def _rgb(web: str, light: float) -> Rgb:
    """Return a colour with this share of its light."""
    red, green, blue = (round(light * c) for c in bytes.fromhex(web.removeprefix("#")))
    return red, green, blue


def sights(loaded: Loaded) -> dict[str, Sight]:
    """Return how each measured sensor is drawn."""
    return {s: _sight(REGISTRY[s], loaded.robot.settings(s)) for s in loaded.drive.measurements}


def _sight(sensor: Sensor, settings: Any) -> Sight:
    width = len(sensor.components)
    return Sight(
        components=sensor.components,
        bounds=(chi_square(NIS_LOW, width), chi_square(NIS_HIGH, width)),
        kind=sensor.drawn,
        mount=sensor.mount(settings),
        landmark=sensor.landmark(settings),
    )


def _stream(loaded: Loaded, role: str) -> Any:
    """Return a fusion.data.Stream of the log."""
    return loaded.log.stream(loaded.choice.topics[role], order=loaded.robot.order)


def _scans(loaded: Loaded, best: Estimates, detail: Detail, full: bool) -> ScanPoints | None:
    if "lrf" not in loaded.drive.measurements:
        return None
    beams = 2**62 if full else MAX_BEAMS
    return scan_points(_stream(loaded, "lrf"), loaded.robot.settings("lrf"), loaded.drive, detail.scans, beams)


def _pictures(loaded: Loaded, best: Estimates, images: int | None) -> tuple[Any, int | None]:
    """Return an iterator over the pictures and the height of their panoramas."""
    nothing: tuple[Picture, ...] = ()
    if "camera" not in loaded.drive.measurements or images == 0:
        return nothing, None
    from .pictures import panorama_rows, pictures

    stream, settings = _stream(loaded, "camera"), loaded.robot.settings("camera")
    every = images or max(1, math.ceil(len(stream.t_ns) / MAX_PICTURES))
    return pictures(stream, settings, loaded.drive, best, every), panorama_rows(stream, settings)


def raw_topics(loaded: Loaded) -> list[RawTopic]:
    """Return the numbers of every topic that was read, as the log holds them."""
    found = []
    for role in loaded.choice.topics:
        stream = _stream(loaded, role)
        fields = _fields(role, stream.msgtype)
        columns = stream.columns(*fields) if fields else {}
        t: Array = (stream.t_ns - loaded.drive.epoch_ns) * np.float64(1e-9)
        found.append(RawTopic(stream.topic, t, _curves(columns)))
    return found


def _fields(role: str, msgtype: str) -> tuple[str, ...]:
    """Return the fields of a topic that are numbers: none where rows are scans or pictures."""
    sensor = REGISTRY.get(role)
    if sensor is not None and sensor.in_blocks:
        return ()
    reads = {"wheels": WHEEL_READS, "truth": TRUTH_READS}.get(role) or (sensor.reads if sensor else {})
    return tuple(reads.get(msgtype, ()))


def _curves(columns: Mapping[str, Column]) -> dict[str, Array]:
    """Return what can be drawn as curves (n,): numbers, and arrays of a few numbers per row."""
    names = columns.get("name")
    curves: dict[str, Array] = {}
    for field, column in columns.items():
        values = column.matrix() if isinstance(column, Ragged) else column
        if not isinstance(values, np.ndarray) or values.dtype.kind not in "fiub" or values.ndim > 2:
            continue
        if values.ndim == 1:
            curves[field] = np.asarray(values, np.float64)
        elif values.shape[1] <= MAX_ARRAY_COLUMNS:
            curves |= {_named(field, i, names): np.asarray(v, np.float64) for i, v in enumerate(values.T)}
    return curves


def _named(field: str, i: int, names: Column | None) -> str:
    """Return the name of one number of an array: by the message's own names where it has them (JointState)."""
    first = names[0] if isinstance(names, list) and names else ()
    return f"{field}.{first[i]}" if isinstance(first, tuple) and i < len(first) else f"{field}.{i}"
