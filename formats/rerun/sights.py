"""What the sensors saw, drawn on the map from where each configuration believes the robot was.

Green matched and corrected the filter, red was refused, blue is new to the map. A wrong pose shows at once: the
matched segments of a good estimate lie on its walls.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from msgspec.structs import asdict

from locfuse.formats.geometry import mounted, quaternions, segments, to_map
from locfuse.formats.thin import evenly
from locfuse.fusion.data import VERDICTS, Array, Audit, Estimates, Ints, Measurements

from . import style
from .deferred import rr
from .map_view import FLIP, ROOT
from .recorder import Recorder, part
from .scene import Scene, Sight

WORDS = np.array(style.GROUP_OF)  # verdict -> group
WIDTH = {"segments": 2.5, "bearing": 1.0, "heading": 1.5}  # points on the screen
HEADING_LENGTH = 1.5  # tracks
BEARING_LENGTH = 2.0  # m, where no landmark says how far


class Seen(NamedTuple):
    """The audit rows (k,) of some readings (s,), in order."""

    t: Array  # (s,) when each reading was taken
    reading: Ints  # (k,) position among these readings
    audit: Audit  # k rows
    pose: Array  # (k, 3) the configuration's pose then


def draw_sights(to: Recorder, scene: Scene) -> None:
    """Send segments, bearing rays and headings of every configuration, and the scan of the best one."""
    for estimates in scene.estimates:
        for sensor, audit in estimates.audits.items():
            sight = scene.sights.get(sensor)
            if sight is None or not sight.kind or len(audit.instant) == 0:
                continue
            drive = scene.seen_by(estimates.name)
            m = drive.measurements[sensor]
            t = drive.t[drive.instant[sensor]]
            seen = some_readings(m, t, audit, estimates, scene.detail.scans)
            strips = _strips(m, seen, sight, scene.track)
            _send_groups(to, f"{ROOT}/{part(estimates.name)}/seen/{sensor}", seen, strips, WIDTH[sight.kind])
    draw_scans(to, scene)


def some_readings(m: Measurements, t: Array, audit: Audit, e: Estimates, limit: int) -> Seen:
    """Return what became of at most `limit` readings, taken at t (n,), evenly over the drive."""
    readings = evenly(len(m.t), limit)
    owner = np.searchsorted(m.first, audit.row, side="right") - 1
    at = np.searchsorted(readings, owner)
    keep = np.flatnonzero(readings[np.minimum(at, len(readings) - 1)] == owner)
    rows = Audit(*(column[keep] for name, column in asdict(audit).items() if name != "joint"))
    return Seen(t[readings], at[keep], rows, e.pose[rows.instant])


def _strips(m: Measurements, seen: Seen, sight: Sight, track: float) -> Array:
    """Return what each audit row looks like on the map, (k, 2, 2) m."""
    z = m.z[seen.audit.row]
    if sight.kind == "segments":
        return to_map(seen.pose[:, None], segments(z, m.extra["ends"][seen.audit.row]))
    origin = mounted(seen.pose, sight.mount)
    if sight.kind == "heading":
        angle = seen.pose[:, 2] + np.nan_to_num(seen.audit.y[:, 0])
        length = np.full(len(angle), HEADING_LENGTH * track)
    else:
        angle = origin[:, 2] + z[:, 0]
        length = np.full(len(angle), BEARING_LENGTH)
    if sight.landmark is not None:
        length = np.hypot(sight.landmark[0] - origin[:, 0], sight.landmark[1] - origin[:, 1])
    end = origin[:, :2] + length[:, None] * np.stack((np.cos(angle), np.sin(angle)), axis=-1)
    return np.stack((origin[:, :2], end), axis=1)


def _send_groups(to: Recorder, path: str, seen: Seen, strips: Array, width: float) -> None:
    """Send one entity per group; a reading without a member of the group empties it."""
    group = WORDS[seen.audit.verdict]
    for name, colour in style.GROUPS.items():
        members = np.flatnonzero(group == name)
        if len(members) == 0:
            continue
        counts = np.bincount(seen.reading[members], minlength=len(seen.t))
        to.static(f"{path}/{name}", style.lines(colour, width))
        labels = _labels(seen.audit, members)
        columns = rr.LineStrips2D.columns(strips=strips[members].astype(np.float32), labels=labels)
        to.send(f"{path}/{name}", seen.t, columns, lengths=counts)


def _labels(audit: Audit, rows: Ints) -> list[str]:
    """Return for each row what hovering shows: the verdict, the wall it was compared with, its NIS."""
    columns = (audit.verdict[rows].tolist(), audit.landmark[rows].tolist(), audit.nis[rows].tolist())
    return [
        f"{VERDICTS[v]}: NIS {nis:.1f}" + (f", wall {line}" if line >= 0 else "")
        if nis == nis  # noqa: PLR0124  NaN where nothing was predicted
        else VERDICTS[v]
        for v, line, nis in zip(*columns, strict=True)
    ]


def draw_scans(to: Recorder, scene: Scene) -> None:
    """Send the scans once, in the robot's frame: the map shows them through the best pose."""
    scans, best = scene.scans, scene.best
    if scans is None or len(scans.t) == 0:
        return
    k = np.clip(np.searchsorted(best.t, scans.t), 0, len(best.t) - 1)
    pose, root = best.pose[k], f"{ROOT}/{part(best.name)}/scan"
    place = np.column_stack((pose[:, :2], np.zeros(len(pose))))
    to.send(root, scans.t, rr.Transform3D.columns(translation=place, quaternion=quaternions(pose[:, 2])))
    to.static(f"{root}/points", style.points(style.faded(style.SCAN, 190), 1.25))
    points = rr.Points2D.columns(positions=scans.xy.astype(np.float32))
    to.send(f"{root}/points", scans.t, points, lengths=scans.counts)
    to.static(f"{root}/screen", rr.Transform3D(mat3x3=FLIP))
