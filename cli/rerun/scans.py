"""Some scans of a log as points in the base frame, deskewed by the wheels as the filter's lines were."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, cast

import numpy as np

from locfuse.formats.rerun.scene import ScanPoints
from locfuse.formats.thin import evenly
from locfuse.fusion import se2
from locfuse.fusion.data import Array, Drive, Ints, Ragged, Stream
from locfuse.fusion.sensors.lrf import LrfSettings

MAX_BEAMS = 360  # of a scan that are drawn: more than a screen shows
FIELDS = ("angle_min", "angle_increment", "time_increment", "range_min", "range_max", "ranges")


def scan_points(stream: Stream, settings: LrfSettings, drive: Drive, scans: int, beams: int) -> ScanPoints:
    """Return at most `scans` scans of at most `beams` points, evenly over the log."""
    wanted = evenly(len(stream.t_ns), scans)
    t = np.zeros(len(wanted))
    points: list[Array] = [np.zeros((0, 2))] * len(wanted)
    for rows, columns in stream.blocks(*FIELDS, rows=128):
        for at, scan in _chosen(rows, columns, wanted):
            stamp = (stream.t_ns[wanted[at]] - drive.epoch_ns) * 1e-9 + settings.time_offset
            t[at], points[at] = _points(scan, float(stamp), settings, drive, beams)
    keep = np.flatnonzero((t >= drive.t[0]) & (t <= drive.t[-1]))
    keep = keep[np.argsort(t[keep], kind="stable")]
    chosen = [points[i] for i in keep.tolist()]
    counts = np.array([len(p) for p in chosen], dtype=np.int64)
    return ScanPoints(t[keep], counts, np.concatenate([*chosen, np.zeros((0, 2))]))


def _chosen(rows: Ints, columns: dict[str, Any], wanted: Ints) -> Iterator[tuple[int, dict[str, Any]]]:
    """Yield (position among the wanted, its fields) for the rows of a block that are wanted."""
    at = np.searchsorted(wanted, rows)
    hit = np.flatnonzero(wanted[np.minimum(at, len(wanted) - 1)] == rows)
    ranges = cast("Ragged", columns["ranges"])
    for i in hit.tolist():
        scalars = {k: float(v[i]) for k, v in columns.items() if k != "ranges"}
        yield int(at[i]), {**scalars, "ranges": ranges[i]}


def _points(
    scan: dict[str, Any], stamp: float, settings: LrfSettings, drive: Drive, beams: int
) -> tuple[float, Array]:
    """Return one scan's middle instant and its returns (k, 2) [m, base frame at that instant]."""
    raw = np.asarray(scan["ranges"], dtype=np.float64)
    n = len(raw)
    index = evenly(n, beams)
    raw = raw[index]
    far = min(scan["range_max"], settings.range_max or math.inf)
    valid = np.flatnonzero(np.isfinite(raw) & (raw >= scan["range_min"]) & (raw <= far) & (raw > 0.0))
    ranges, index = settings.range_scale * raw[valid] + settings.range_offset, index[valid]
    angles = scan["angle_min"] + scan["angle_increment"] * index
    angles = -angles if settings.flipped else angles
    mount = np.array([settings.x, settings.y, math.radians(settings.yaw_deg)])
    points = se2.transform(mount, np.stack((ranges * np.cos(angles), ranges * np.sin(angles)), axis=-1))
    if not settings.deskew or n < 2 or not scan["time_increment"] > 0.0 or len(points) == 0:
        return stamp, points
    step = min(scan["time_increment"], 1.0 / n)
    middle = stamp + 0.5 * step * (n - 1)
    when = stamp + step * index
    moved = drive.wheels.relative(np.full(len(when), middle), when)
    return middle, se2.transform(moved, points)
