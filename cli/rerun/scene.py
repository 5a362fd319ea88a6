"""From a measured log and its estimates to the scene of a recording."""

from __future__ import annotations

import math
import shlex
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, cast

import numpy as np

from locfuse.cli.analysis.load import Loaded
from locfuse.cli.analysis.outputs import events
from locfuse.cli.session.result import Result
from locfuse.formats.figures.palette import Trace, colours, traces_of
from locfuse.formats.report import markdown
from locfuse.formats.rerun.scene import Detail, DrawnScans, Floats, Picture, RawTopic, RerunScene, Rgb, SensorLook
from locfuse.formats.thin import evenly
from locfuse.formats.visible import visible
from locfuse.fusion.chi_square import chi_square
from locfuse.fusion.data import Array, Column, Drive, Estimates, Evaluation, Ints, Ragged, Stream
from locfuse.fusion.lines.points import ScanPoints
from locfuse.fusion.lines.scans import Laser, points_in_base
from locfuse.fusion.measure import thinned
from locfuse.fusion.robot import VIRTUAL_TRACK
from locfuse.fusion.sensor import Sensor
from locfuse.fusion.sensors.lrf import LrfSettings, laser_of
from locfuse.fusion.sensors.registry import REGISTRY
from locfuse.fusion.sensors.registry import colours as sensor_colours
from locfuse.fusion.truth import TRUTH_READS
from locfuse.fusion.wheels.read import WHEEL_READS

MAX_BEAMS = 360  # of a scan that are drawn: more than a screen shows
MAX_PICTURES = 600  # kept by default
MAX_ARRAY_COLUMNS = 8  # of a numeric array that is drawn as curves: a scan's ranges are not
SMOOTHED_LIGHT_SHARE = 0.65  # of the light of a colour, for the smoothed result
SCAN_FIELDS = ("angle_min", "angle_increment", "time_increment", "range_min", "range_max", "ranges")
NIS_LOW, NIS_HIGH = 0.025, 0.975  # between them lie 95 % of consistent NIS


def scene_of_result(result: Result, images: int | None = None, full: bool = False) -> RerunScene:
    """Return the scene of a result with its report's tables; `images`, `full` as in `make_scene`."""
    estimates, evaluations = tuple(result.estimates.values()), tuple(result.evaluations.values())
    return make_scene(result.loaded, estimates, evaluations, table_of(result.report), images, full)


def table_of(report: Mapping[str, Any]) -> str:
    """Return the tables of a report in Markdown, with the next command to type."""
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
) -> RerunScene:
    """Return the scene of these configurations.

    `images` = n keeps every n-th picture, 0 none, None as many as stay light.
    """
    detail = Detail.everything() if full else Detail()
    best = max(estimates, key=lambda e: len(e.sensors))
    shown, rows = _pictures(loaded, best, images)
    return RerunScene(
        name=loaded.log.name,
        drive=loaded.drive,
        estimates=estimates,
        evaluations={e.name: e for e in evaluations},
        sights=sights(loaded),
        track=loaded.robot.wheels.track or VIRTUAL_TRACK,
        table=table,
        scans=_scans(loaded, detail, full),
        pictures=shown,
        picture_rows=rows,
        raw=raw_topics(loaded),
        events=events(loaded, estimates),
        detail=detail,
        palette=palette(traces_of(estimates)),
        thinned={e.name: thinned(loaded.drive, e.rates) for e in estimates if e.rates},
    )


def palette(traces: Mapping[str, Trace]) -> dict[str, Rgb]:
    """Return the colours of results in the report, for a dark page.

    The report dashes what is smoothed. The viewer has no dashes: there it is the same colour, darker.
    """
    found = colours(traces, sensor_colours())
    return {
        name: _rgb(found[name].dark, SMOOTHED_LIGHT_SHARE if trace.smoothed else 1.0)
        for name, trace in traces.items()
    }


def _rgb(web: str, light: float) -> Rgb:
    """Return a colour with this share of its light."""
    red, green, blue = (round(light * c) for c in bytes.fromhex(web.removeprefix("#")))
    return red, green, blue


def sights(loaded: Loaded) -> dict[str, SensorLook]:
    """Return the drawing style of each measured sensor."""
    return {s: _sight(REGISTRY[s], loaded.robot.settings(s)) for s in loaded.drive.measurements}


def _sight(sensor: Sensor, settings: Any) -> SensorLook:
    width = len(sensor.components)
    return SensorLook(
        components=sensor.components,
        bounds=(chi_square(NIS_LOW, width), chi_square(NIS_HIGH, width)),
        kind=sensor.drawn,
        mount=sensor.mount(settings),
        landmark=sensor.landmark(settings),
    )


def _stream(loaded: Loaded, role: str) -> Any:
    """Return a fusion.data.Stream of the log."""
    return loaded.log.stream(loaded.choice.topics[role], order=loaded.robot.order)


def _scans(loaded: Loaded, detail: Detail, full: bool) -> DrawnScans | None:
    if "lrf" not in loaded.drive.measurements:
        return None
    beams = 2**62 if full else MAX_BEAMS
    return scan_points(_stream(loaded, "lrf"), loaded.robot.settings("lrf"), loaded.drive, detail.scans, beams)


def scan_points(stream: Stream, settings: LrfSettings, drive: Drive, scans: int, beams: int) -> DrawnScans:
    """Return at most `scans` scans of at most `beams` points, evenly over the log, corrected as for lines."""
    measured = drive.measurements["lrf"].points
    laser = measured.laser if isinstance(measured, ScanPoints) else laser_of(settings)
    wanted = evenly(len(stream.t_ns), scans)
    t = np.zeros(len(wanted))
    points: list[Floats] = [np.zeros((0, 2), np.float32)] * len(wanted)
    for rows, columns in stream.blocks(*SCAN_FIELDS, rows=128):
        for at, scan in _chosen(rows, columns, wanted):
            stamp = (stream.t_ns[wanted[at]] - drive.epoch_ns) * 1e-9 + settings.time_offset
            t[at], points[at] = _points(scan, float(stamp), laser, drive, beams)
    keep = np.flatnonzero((t >= drive.t[0]) & (t <= drive.t[-1]))
    keep = keep[np.argsort(t[keep], kind="stable")]
    chosen = [points[i] for i in keep.tolist()]
    counts = np.array([len(p) for p in chosen], dtype=np.int64)
    return DrawnScans(t[keep], counts, np.concatenate([*chosen, np.zeros((0, 2), np.float32)]))


def _chosen(rows: Ints, columns: dict[str, Any], wanted: Ints) -> Iterator[tuple[int, dict[str, Any]]]:
    """Yield (position among the wanted, its fields) for the wanted rows of a block."""
    at = np.searchsorted(wanted, rows)
    hit = np.flatnonzero(wanted[np.minimum(at, len(wanted) - 1)] == rows)
    ranges = cast("Ragged", columns["ranges"])
    for i in hit.tolist():
        scalars = {k: float(v[i]) for k, v in columns.items() if k != "ranges"}
        yield int(at[i]), {**scalars, "ranges": ranges[i]}


def _points(scan: dict[str, Any], stamp: float, laser: Laser, drive: Drive, beams: int) -> tuple[float, Floats]:
    """Return one scan's middle instant and its returns (k, 2) [m, base frame at that instant]."""
    one = {
        name: np.atleast_1d(value)[None] if name == "ranges" else np.array([value]) for name, value in scan.items()
    }
    points, middle = points_in_base(one, np.array([stamp]), laser, drive.wheels)
    drawn = points[0, evenly(points.shape[1], beams)]
    return float(middle[0]), drawn[np.isfinite(drawn[:, 0])].astype(np.float32)


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
    """Return the numbers of every used topic, as in the log."""
    found = []
    for role in loaded.choice.topics:
        stream = _stream(loaded, role)
        fields = _fields(role, stream.msgtype)
        columns = stream.columns(*fields) if fields else {}
        t: Array = (stream.t_ns - loaded.drive.epoch_ns) * np.float64(1e-9)
        found.append(RawTopic(stream.topic, t, _curves(columns)))
    return found


def _fields(role: str, msgtype: str) -> tuple[str, ...]:
    """Return the fields of a topic that are numbers; none for scans or pictures."""
    sensor = REGISTRY.get(role)
    if sensor is not None and sensor.in_blocks:
        return ()
    reads = {"wheels": WHEEL_READS, "truth": TRUTH_READS}.get(role) or (sensor.reads if sensor else {})
    return tuple(reads.get(msgtype, ()))


def _curves(columns: Mapping[str, Column]) -> dict[str, Array]:
    """Return the curves (n,) of a topic: numbers, and arrays of a few numbers per row."""
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
    """Return the name of one number of an array: from the message if it has names (JointState)."""
    first = names[0] if isinstance(names, list) and names else ()
    return f"{field}.{first[i]}" if isinstance(first, tuple) and i < len(first) else f"{field}.{i}"
