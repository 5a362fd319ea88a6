"""Some scans of a log as points in the base frame, deskewed by the wheels as the filter's lines were."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, cast

import numpy as np

from locfuse.formats.rerun.scene import ScanPoints
from locfuse.formats.thin import evenly
from locfuse.fusion.data import Array, Drive, Ints, Ragged, Stream
from locfuse.fusion.lines.points import ScanPoints as Measured
from locfuse.fusion.lines.scans import Laser, points_in_base
from locfuse.fusion.sensors.lrf import LrfSettings, laser_of

MAX_BEAMS = 360  # of a scan that are drawn: more than a screen shows
FIELDS = ("angle_min", "angle_increment", "time_increment", "range_min", "range_max", "ranges")


def scan_points(stream: Stream, settings: LrfSettings, drive: Drive, scans: int, beams: int) -> ScanPoints:
    """Return at most `scans` scans of at most `beams` points, evenly over the log, read as the lines were."""
    measured = drive.measurements["lrf"].points
    laser = measured.laser if isinstance(measured, Measured) else laser_of(settings)
    wanted = evenly(len(stream.t_ns), scans)
    t = np.zeros(len(wanted))
    points: list[Array] = [np.zeros((0, 2))] * len(wanted)
    for rows, columns in stream.blocks(*FIELDS, rows=128):
        for at, scan in _chosen(rows, columns, wanted):
            stamp = (stream.t_ns[wanted[at]] - drive.epoch_ns) * 1e-9 + settings.time_offset
            t[at], points[at] = _points(scan, float(stamp), laser, drive, beams)
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


def _points(scan: dict[str, Any], stamp: float, laser: Laser, drive: Drive, beams: int) -> tuple[float, Array]:
    """Return one scan's middle instant and its returns (k, 2) [m, base frame at that instant]."""
    one = {
        name: np.atleast_1d(value)[None] if name == "ranges" else np.array([value]) for name, value in scan.items()
    }
    points, middle = points_in_base(one, np.array([stamp]), laser, drive.wheels)
    drawn = points[0, evenly(points.shape[1], beams)]
    return float(middle[0]), drawn[np.isfinite(drawn[:, 0])]
