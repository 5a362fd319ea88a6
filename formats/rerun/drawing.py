"""Drawing into a Rerun stream on the log's clock: columns, styles, legend and pictures.

Each colour has one meaning: red is used only for rejected measurements.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import islice
from typing import Any

import numpy as np
import rerun as rr

from locfuse.fusion.data import Array, Drive, Ints

from .scene import MATCHED, NEW, REJECTED, Picture, RerunScene, Rgb

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


def legend_ranges(scene: RerunScene) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the x and y ranges of the legend's view; each row has height 1."""
    return (-0.5 * LEGEND_CELL, (LEGEND_COLUMNS - 0.5) * LEGEND_CELL), (-0.2, legend_rows(scene) - 0.1)


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
        _send_encoded(to, OMNI, t, [p.omni for p in batch], [p.omni_type for p in batch])
        _send_encoded(to, PANORAMA, t, [p.panorama for p in batch], ["image/jpeg"] * len(batch))
        for name in GROUPS:
            _send_found(to, name, t, batch, rows)


def _send_encoded(to: TimelineRecorder, path: str, t: Array, data: Sequence[bytes], kinds: Sequence[str]) -> None:
    blobs = [np.frombuffer(d, np.uint8) for d in data]
    to.send(path, t, rr.EncodedImage.columns(blob=blobs, media_type=list(kinds)))


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
