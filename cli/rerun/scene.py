"""The content of a Rerun recording, from a measured log and its estimates, or from a folder of results."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from operator import itemgetter
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from msgspec.structs import replace

from locfuse.cli.analysis.load import Loaded, common_fields
from locfuse.cli.session.foreign import estimates_in
from locfuse.cli.session.result import Result, events, places
from locfuse.formats.figures.palette import Trace, colours, traces_in, traces_of
from locfuse.formats.inputs import MAX_REPORT, read_small
from locfuse.formats.logs.clock import MadeStream
from locfuse.formats.logs.file_stream import read_file
from locfuse.formats.report import json_report, markdown
from locfuse.formats.rerun.scene import (
    GROUP_OF,
    DrawnScans,
    Picture,
    RawTopic,
    RerunScene,
    Rgb,
    SensorLook,
)
from locfuse.fusion.data import Array, Column, Drive, LocfuseError, Motions, Ragged, Stream, Truth, evenly
from locfuse.fusion.judge.evaluate import evaluate
from locfuse.fusion.lines.points import ScanPoints
from locfuse.fusion.lines.scans import points_in_base
from locfuse.fusion.measure import thinned
from locfuse.fusion.robot import VIRTUAL_TRACK, TruthSettings
from locfuse.fusion.sensors.camera import detector
from locfuse.fusion.sensors.lrf import laser_of
from locfuse.fusion.sensors.registry import REGISTRY, colours as sensor_colours
from locfuse.fusion.statistics import chi_square
from locfuse.fusion.streams import seconds
from locfuse.fusion.truth import read_truth
from locfuse.fusion.wheels.odometry import POSE

MAX_BEAMS = 360  # drawn beams of a scan
MAX_PICTURES = 600  # drawn pictures by default
MAX_ARRAY_COLUMNS = 8  # longer numeric arrays, such as ranges, are not drawn as curves
SMOOTHED_LIGHT_SHARE = 0.7  # brightness of a smoothed result's colour
SCAN_FIELDS = ("angle_min", "angle_increment", "time_increment", "range_min", "range_max", "ranges")
NIS_LOW, NIS_HIGH = 0.025, 0.975  # quantiles of the band of consistent NIS
JPEG_QUALITY = 80  # of panoramas and raw Image messages
MEDIA_TYPES = {b"\xff\xd8": "image/jpeg", b"\x89P": "image/png"}
NO_ROWS = np.zeros(0, np.int64)


def make_scene(result: Result, images: int | None = None, full: bool = False) -> RerunScene:
    """Return the scene of a result's estimates and evaluations, with the tables of its report.

    `images` = n keeps every n-th picture, 0 none, None at most MAX_PICTURES. `full` keeps all curves and scans.
    """
    loaded, drive, settings = result.loaded, result.drive, result.robot.settings
    runs = tuple(result.estimates.values())
    scene = RerunScene(
        name=loaded.log.name,
        drive=drive,
        estimates=runs,
        evaluations=result.evaluations,
        sights={s: look_of(s, settings(s)) for s in drive.measurements},
        track=loaded.robot.wheels.track or VIRTUAL_TRACK,
        table=markdown.render(result.report),
        raw=_raw_topics(loaded),
        full=full,
        palette=palette(traces_of(runs)),
        events=events(loaded, runs),
        thinned={e.name: thinned(drive, e.rates) for e in runs if e.rates},
    )
    found: dict[str, Any] = {}
    if "lrf" in drive.measurements:
        found["scans"] = _scans(_stream(loaded, "lrf"), settings("lrf"), scene)
    if "camera" in drive.measurements and images != 0:
        from locfuse.fusion.camera.images import decode, messages

        stream = _stream(loaded, "camera")
        every = images or max(1, math.ceil(len(stream.t_ns) / MAX_PICTURES))
        found["pictures"] = _pictures(stream, settings("camera"), scene, every)
        pictures = (decode(message) for block in messages(stream) for _, message in block)
        first = next((picture for picture in pictures if not isinstance(picture, str)), None)
        if first is not None:  # height of the panoramas [px]
            found["picture_rows"] = int(detector(settings("camera")).optics(first.shape).rows)
    return replace(scene, **found)


def palette(traces: Mapping[str, Trace]) -> dict[str, Rgb]:
    """Return the colours of results by name, as on the dark page; smoothed ones darker, as Rerun has no dashes."""
    found, shades = colours(traces, sensor_colours()), dict[str, Rgb]()
    for name, trace in traces.items():
        light = SMOOTHED_LIGHT_SHARE if trace.smoothed else 1.0
        red, green, blue = (round(light * c) for c in bytes.fromhex(found[name].dark.removeprefix("#")))
        shades[name] = red, green, blue
    return shades


def look_of(name: str, settings: Any) -> SensorLook:
    """Return how a sensor is drawn: its components, the band of consistent NIS, its mount and its landmark."""
    sensor = REGISTRY[name]
    low, high = (chi_square(share, len(sensor.components)) for share in (NIS_LOW, NIS_HIGH))
    mount, landmark = sensor.mount(settings), sensor.landmark(settings)
    return SensorLook(sensor.components, (low, high), sensor.drawn, mount, landmark, places(name, settings))


def _stream(loaded: Loaded, role: str) -> Stream:
    return loaded.log.stream(loaded.choice.topics[role], order=loaded.robot.order)


def _scans(stream: Stream, settings: Any, scene: RerunScene) -> DrawnScans:
    """Return evenly chosen scans as points, each corrected for motion to its middle time."""
    drive, beams = scene.drive, 2**62 if scene.full else MAX_BEAMS
    measured = drive.measurements["lrf"].points
    laser = measured.laser if isinstance(measured, ScanPoints) else laser_of(settings)
    wanted = set(evenly(len(stream.t_ns), scene.max_scans).tolist())
    found: list[tuple[float, Any]] = []  # (time [s], points (n, 2))
    for rows, columns in stream.blocks(*SCAN_FIELDS, rows=128):
        for i, row in enumerate(rows.tolist()):
            if row not in wanted:
                continue
            scan: dict[str, Any] = {k: np.atleast_1d(np.asarray(c[i], np.float64)) for k, c in columns.items()}
            scan["ranges"] = scan["ranges"][None]
            stamp = (stream.t_ns[row] - drive.epoch_ns) * 1e-9 + settings.time_offset
            points, middle = points_in_base(scan, np.array([stamp]), laser, drive.wheels)
            drawn = points[0, evenly(points.shape[1], beams)]
            found.append((float(middle[0]), drawn[np.isfinite(drawn[:, 0])].astype(np.float32)))
    kept = sorted((scan for scan in found if drive.t[0] <= scan[0] <= drive.t[-1]), key=itemgetter(0))
    counts = np.array([len(points) for _, points in kept], dtype=np.int64)
    xy = np.concatenate([*(points for _, points in kept), np.zeros((0, 2), np.float32)])
    return DrawnScans(np.array([t for t, _ in kept]), counts, xy)


def _raw_topics(loaded: Loaded) -> list[RawTopic]:
    """Return the numeric fields of each used topic, without scans and pictures."""
    found = []
    for stream, role in ((_stream(loaded, role), role) for role in loaded.choice.topics):
        fields = common_fields(role, stream.msgtype)
        curves = _curves(stream.columns(*fields) if fields else {})
        found.append(RawTopic(stream.topic, seconds(stream.t_ns, loaded.drive.epoch_ns), curves))
    return found


def _curves(columns: Mapping[str, Column]) -> dict[str, Array]:
    """Return curves (n,) by name: numeric fields, and each element of short numeric arrays."""
    names: Any = columns.get("name")  # joints of a JointState
    first = names[0] if isinstance(names, list) and names and isinstance(names[0], tuple) else ()
    curves: dict[str, Array] = {}
    for field, column in columns.items():
        values = column.matrix() if isinstance(column, Ragged) else column
        if not isinstance(values, np.ndarray) or values.dtype.kind not in "fiub" or values.ndim > 2:
            continue
        if values.ndim == 1:
            curves[field] = np.asarray(values, np.float64)
        elif values.shape[1] <= MAX_ARRAY_COLUMNS:
            for i, curve in enumerate(values.T):
                curves[f"{field}.{first[i] if i < len(first) else i}"] = np.asarray(curve, np.float64)
    return curves


def _pictures(stream: Stream, settings: Any, scene: RerunScene, every: int) -> Iterator[Picture]:
    """Yield each `every`-th readable picture of the camera with its detections."""
    from locfuse.fusion.camera.images import decode, messages

    drive: Drive = scene.drive
    m, finder = drive.measurements["camera"], detector(settings)
    verdicts = np.full(len(m.z), "new", dtype="<U8")  # verdict on every detection, in the best configuration
    audit = scene.best.audits.get("camera")
    if audit is not None:
        verdicts[audit.row] = np.array(GROUP_OF)[audit.verdict]
    for block in messages(stream):
        for row, message in block:
            picture = decode(message) if row % every == 0 else ""
            if isinstance(picture, str):
                continue
            t = float((stream.t_ns[row] - drive.epoch_ns) * 1e-9 + settings.time_offset)
            i = int(np.searchsorted(m.t, t - 1e-9))
            found = np.arange(m.first[i], m.first[i + 1]) if i < len(m.t) and abs(m.t[i] - t) < 1e-6 else NO_ROWS
            yield _picture(t, message, picture, finder.optics(picture.shape), (m.z[found, 0], verdicts[found]))


def _picture(t: float, message: Any, picture: Any, optics: Any, found: tuple[Array, Any]) -> Picture:
    """Return a picture with its panorama and detections; `found`: bearings and verdicts (k,)."""
    from locfuse.fusion.camera.optics import angle_of_bearing, column
    from locfuse.fusion.camera.panorama import unwrap

    theta = angle_of_bearing(found[0], optics)
    ray = np.stack((np.sin(theta), np.cos(theta)), axis=-1)
    rays = np.array([optics.x_c, optics.y_c]) + np.array([optics.inner, optics.outer])[:, None] * ray[:, None]
    data = bytes(message[0]) if len(message) == 2 else b""
    kind = MEDIA_TYPES.get(data[:2])
    omni, kind = (_jpeg(picture), "image/jpeg") if kind is None else (data, kind)
    # flipped: row 0, the inner radius (floor), is shown at the bottom
    panorama = _jpeg(unwrap(picture, optics)[::-1])
    return Picture(t, omni, kind, panorama, rays, column(theta, optics.width), tuple(found[1].tolist()))


def _jpeg(picture: Any) -> bytes:
    from locfuse.fusion.camera.opencv import cv2

    done, data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    return data.tobytes() if done else b""


# --- Scene of a folder of results: trajectories (read as by --estimate), truth (as by --truth), and table


def scene_of(report_file: Path) -> RerunScene:
    """Return the scene of a results' folder, by its report. Raises LocfuseError for unreadable files."""
    folder = report_file.parent
    try:
        report = json_report.readable(msgspec.json.decode(read_small(report_file, MAX_REPORT)), str(report_file))
        return _scene(folder, report, report_file.name == "run.json")
    except (msgspec.DecodeError, UnicodeDecodeError, ValueError, KeyError, IndexError, TypeError) as problem:
        raise LocfuseError(f"{folder}: its files are not as locfuse writes them: {problem}") from None


def _scene(folder: Path, report: Mapping[str, Any], by_run: bool) -> RerunScene:
    """Return the scene of a folder of results.

    `by_run`: the folder has the files trajectory and smoothed, as .csv or .tum. Else it has one .tum file for each
    configuration, with the configuration's name.
    """
    rows = report["configurations"]
    file_of = {n: ("smoothed" if row["smoothed"] else "trajectory") if by_run else n for n, row in rows.items()}
    tracks = {name: _trajectory(folder, file, by_run) for name, file in file_of.items()}
    first = next(iter(tracks.values()))
    epoch_ns = int(first.t_ns[0])
    still = Motions(np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros((0, 3, 0)))
    t = seconds(first.t_ns, epoch_ns)
    drive = Drive(epoch_ns, t, still, {}, {}, {}, _truth(folder, report, epoch_ns))
    estimates = []
    for name, track in tracks.items():
        row = rows[name]
        if (found := estimates_in(track, drive, row["configuration"])) is None:
            raise ValueError(f"{Path(track.topic).name} has fewer than two poses")
        used = {"sensors": tuple(row["sensors"]), "smoothed": row["smoothed"], "rates": row["rates_hz"]}
        estimates.append(replace(found, **used))
    return RerunScene(
        str(report["input"]["name"]),
        drive,
        estimates,
        {e.name: evaluate(e, drive, rows[e.name]["align"]) for e in estimates},
        track=report["settings"].get("wheels", {}).get("track", 0.3),
        table=markdown.render(report),
        palette=palette(traces_in(report)),
    )


def _trajectory(folder: Path, name: str, by_run: bool) -> MadeStream:
    """Return a trajectory: of a run by the .csv, which has covariances, else by the .tum."""
    endings = (".csv", ".tum") if by_run else (".tum",)
    found = [read_file(str(path)) for e in endings if (path := folder / f"{name}{e}").is_file()]
    if not found:
        words = "so there is no trajectory to show; make it again without --write"
        raise LocfuseError(f"{folder} lacks {name}.tum, {words}")
    places = [[np.asarray(c) for c in track.columns(*POSE[track.msgtype][:2]).values()] for track in found]
    stamps = [track.t_ns for track in found]
    if not (np.array_equal(stamps[0], stamps[-1]) and np.array_equal(places[0], places[-1])):
        raise ValueError(f"{name}.csv and {name}.tum are of different runs")
    return found[0]


def _truth(folder: Path, report: Mapping[str, Any], epoch_ns: int) -> Truth | None:
    path, settings = folder / "truth.tum", report["settings"].get("truth", {})
    if not path.is_file() or not report["truth"]:
        return None
    point = TruthSettings(x=float(settings.get("x", 0.0)), y=float(settings.get("y", 0.0)))
    truth, _ = read_truth(read_file(str(path)), point, epoch_ns)
    return replace(truth, topic=str(report["truth"]["topic"]))
