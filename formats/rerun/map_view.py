"""The map view: truth; each configuration's path, pose, 3-sigma ellipse and map; the sensors' measurements.

Data are in map coordinates, y up; one flip at the root turns them for the screen, where y grows down. Segments,
rays and headings are drawn from the configuration's own pose, so that a wrong pose shows: matched segments of a
good estimate lie on its walls.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import rerun as rr
from msgspec.structs import asdict

from locfuse.formats.geometry import ellipses, mounted, quaternions, segments, steps, to_map, wall, wall_band
from locfuse.formats.thin import evenly, extremes
from locfuse.fusion.data import VERDICTS, Array, Audit, Estimates, Ints, MapLine, Measurements, matrices

from . import style
from .recorder import TimelineRecorder, part
from .scene import GROUP_OF, RerunScene, Rgb, SensorLook

ROOT = "world"
PATH_ORDER = 40.0  # draw order, above walls and scans
TRUTH_ORDER = 35.0  # below the estimates, a broad line under thin ones: neither hides the other
TRUTH_WIDTH, PATH_WIDTH = 2.75, 1.25  # points on the screen
SIGHT_WIDTH = {"segments": 2.5, "bearing": 1.0, "heading": 1.5}  # points on the screen
MIN_BODY_SHARE = 0.02  # of the map: smaller robots would not be seen
HEADING_LENGTH_TRACKS = 1.5  # tracks
BEARING_LENGTH_M = 2.0  # m, where no landmark gives the distance
FLIP = rr.Transform3D(mat3x3=((1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, 1.0)))


def draw_map(to: TimelineRecorder, scene: RerunScene) -> None:
    """Draw everything with a position on the map."""
    to.static(ROOT, FLIP)
    for order, e in enumerate(scene.estimates, start=int(PATH_ORDER)):
        root, colour = f"{ROOT}/{part(e.name)}", scene.colour(e.name)
        _draw_path(to, f"{root}/path", e.t, e.pose[:, :2], scene, style.lines(colour, PATH_WIDTH, order))
        _draw_pose(to, root, e, evenly(len(e.t), scene.detail.curve), colour)
        body = style.lines(colour, 2.0 if e is scene.best else 1.0, order)
        to.static(f"{root}/pose/body", rr.LineStrips2D([_body(scene)]), body)
        _draw_walls(to, f"{root}/walls", e)
        _draw_loops(to, f"{root}/loops", e)
        _draw_sights(to, f"{root}/seen", scene, e)
    _draw_scans(to, scene)
    _draw_truth(to, scene)
    for sensor, sight in scene.sights.items():
        if sight.landmark is not None:
            point = rr.Points2D([sight.landmark], labels=["landmark"])
            to.static(f"{ROOT}/landmark/{sensor}", point, style.points(style.LANDMARK, 6.0))


def _draw_path(
    to: TimelineRecorder, path: str, t: Array, xy: Array, scene: RerunScene, look: rr.LineStrips2D
) -> None:
    """Draw a growing path: one short strip per step, so that no point is written twice."""
    picks = extremes(xy, scene.detail.curve)
    to.static(path, look)
    to.send(path, t[picks][1:], rr.LineStrips2D.columns(strips=steps(xy[picks]).astype(np.float32)))


def _draw_pose(to: TimelineRecorder, root: str, e: Estimates, picks: Ints, colour: Rgb) -> None:
    t, pose = e.t[picks], e.pose[picks]
    to.send(f"{root}/pose", t, _moves(pose[:, :2], pose[:, 2]))
    if not e.triangles.any():
        return  # a trajectory from a file, without its covariances
    axes, angle = ellipses(matrices(e.triangles[picks]))
    to.static(f"{root}/sigma", rr.Ellipses2D.from_fields(colors=[colour], line_radii=style.on_screen(0.75)))
    to.send(f"{root}/sigma", t, _moves(pose[:, :2], angle), rr.Ellipses2D.columns(half_sizes=axes))


def _moves(xy: Array, angle: Array) -> rr.ComponentColumnList:
    """Return places (n, 2) m and directions (n,) rad as transforms."""
    place = np.column_stack((xy, np.zeros(len(xy))))
    return rr.Transform3D.columns(translation=place, quaternion=quaternions(angle))


def _body(scene: RerunScene) -> Array:
    """Return the robot's outline (5, 2): an arrow head on the axle, as wide as the track or a visible minimum."""
    low, high = scene.extent
    size = max(scene.track, MIN_BODY_SHARE * float((high - low).max()))
    return size * np.array([[0.6, 0.0], [-0.4, 0.45], [-0.2, 0.0], [-0.4, -0.45], [0.6, 0.0]])


def _draw_walls(to: TimelineRecorder, root: str, e: Estimates) -> None:
    """Draw the first scan's walls, and the refined ones with their uncertainty, each from its first match."""
    if not e.first_map and not e.final_map:
        return
    start, born = _first_matches(e)
    first = np.array([wall(line) for line in e.first_map]).reshape(-1, 2, 2)
    to.static(f"{root}/first_scan", style.lines(style.faded(style.FIRST_WALL, 200), 1.0))
    columns = rr.LineStrips2D.columns(strips=first)
    to.send(f"{root}/first_scan", np.array([start]), columns, lengths=[len(first)])
    walls = sorted(e.final_map, key=lambda line: (born.get(line.id, start), line.id))
    t = np.array([born.get(line.id, start) for line in walls])
    to.static(f"{root}/refined", style.lines(style.WALL, 1.5))
    ends = rr.LineStrips2D.columns(strips=[wall(line) for line in walls], labels=[_label(x) for x in walls])
    to.send(f"{root}/refined", t, ends)
    to.static(f"{root}/three_sigma", style.lines(style.faded(style.WALL, 110), 0.5))
    to.send(f"{root}/three_sigma", t, rr.LineStrips2D.columns(strips=[wall_band(x) for x in walls]))


def _first_matches(e: Estimates) -> tuple[float, dict[int, float]]:
    """Return when the map began [s], and when each of its lines was first matched [s], by its id."""
    began = [a.instant[0] for a in e.audits.values() if len(a.instant) and (a.landmark >= 0).any()]
    start = float(e.t[min(began, default=0)])
    found: dict[int, float] = {}
    for audit in e.audits.values():
        ids, at = np.unique(audit.landmark, return_index=True)
        found |= dict(zip(ids.tolist(), e.t[audit.instant[at]].tolist(), strict=True))
    return start, found | {line.id: start for line in e.first_map}


def _label(line: MapLine) -> str:
    offset, angle = np.sqrt(np.maximum(np.diagonal(line.P_map), 0.0))
    return (
        f"wall {line.id}: rho {line.rho:.3f} ± {offset:.3f} m, "
        f"beta {np.degrees(line.beta):.2f} ± {np.degrees(angle):.2f}°, {line.hits} hits"
    )


def _draw_loops(to: TimelineRecorder, path: str, e: Estimates) -> None:
    """Draw a line for every recognised place: from the robot to its earlier place."""
    if len(e.loops):
        at = np.minimum(np.searchsorted(e.t, e.loops), len(e.t) - 1)
        to.static(path, style.lines(style.faded(style.LOOP, 120), 0.75, PATH_ORDER - 1.0))
        to.send(path, e.loops[:, 1], rr.LineStrips2D.columns(strips=e.pose[at][:, :, :2].astype(np.float32)))


def _draw_truth(to: TimelineRecorder, scene: RerunScene) -> None:
    truth = scene.drive.truth
    if truth is None or len(truth.t) == 0:
        return
    look = style.lines(style.faded(style.TRUTH, 150), TRUTH_WIDTH, TRUTH_ORDER)
    _draw_path(to, f"{ROOT}/truth/path", truth.t, truth.xy, scene, look)
    now = evenly(len(truth.t), scene.detail.curve)
    to.static(f"{ROOT}/truth/now", style.points(style.TRUTH, 4.0))
    to.send(f"{ROOT}/truth/now", truth.t[now], rr.Points2D.columns(positions=truth.xy[now]))


class SeenReadings(NamedTuple):
    """The audit rows (k,) of some readings (s,), in order."""

    t: Array  # (s,) s, when each reading was taken
    reading: Ints  # (k,) position among these readings
    audit: Audit  # k rows
    pose: Array  # (k, 3) the configuration's pose then


def _draw_sights(to: TimelineRecorder, root: str, scene: RerunScene, e: Estimates) -> None:
    """Draw segments, bearing rays and headings, one entity per group of verdicts.

    A reading without a member of the group empties the entity.
    """
    drive = scene.seen_by(e.name)
    for sensor, audit in e.audits.items():
        sight = scene.sights.get(sensor)
        if sight is None or not sight.kind or len(audit.instant) == 0:
            continue
        m = drive.measurements[sensor]
        seen = _some_readings(m, drive.t[drive.instant[sensor]], audit, e, scene.detail.scans)
        strips = _strips(m, seen, sight, scene.track).astype(np.float32)
        group = np.array(GROUP_OF)[seen.audit.verdict]
        for name, colour in style.GROUPS.items():
            members = np.flatnonzero(group == name)
            if len(members) == 0:
                continue
            counts = np.bincount(seen.reading[members], minlength=len(seen.t))
            path = f"{root}/{sensor}/{name}"
            to.static(path, style.lines(colour, SIGHT_WIDTH[sight.kind]))
            columns = rr.LineStrips2D.columns(strips=strips[members], labels=_labels(seen.audit, members))
            to.send(path, seen.t, columns, lengths=counts)


def _some_readings(m: Measurements, t: Array, audit: Audit, e: Estimates, limit: int) -> SeenReadings:
    """Return the audit of at most `limit` readings, taken at t (n,), evenly over the drive."""
    readings = evenly(len(m.t), limit)
    owner = np.searchsorted(m.first, audit.row, side="right") - 1
    at = np.searchsorted(readings, owner)
    keep = np.flatnonzero(readings[np.minimum(at, len(readings) - 1)] == owner)
    rows = Audit(*(column[keep] for name, column in asdict(audit).items() if name != "joint"))
    return SeenReadings(t[readings], at[keep], rows, e.pose[rows.instant])


def _strips(m: Measurements, seen: SeenReadings, sight: SensorLook, track: float) -> Array:
    """Return the drawing of each audit row on the map, (k, 2, 2) m."""
    z = m.z[seen.audit.row]
    if sight.kind == "segments":
        return to_map(seen.pose[:, None], segments(z, m.extra["ends"][seen.audit.row]))
    origin = mounted(seen.pose, sight.mount)
    if sight.kind == "heading":
        angle = seen.pose[:, 2] + np.nan_to_num(seen.audit.y[:, 0])
        length = np.full(len(angle), HEADING_LENGTH_TRACKS * track)
    else:
        angle = origin[:, 2] + z[:, 0]
        length = np.full(len(angle), BEARING_LENGTH_M)
    if sight.landmark is not None:
        length = np.hypot(sight.landmark[0] - origin[:, 0], sight.landmark[1] - origin[:, 1])
    end = origin[:, :2] + length[:, None] * np.stack((np.cos(angle), np.sin(angle)), axis=-1)
    return np.stack((origin[:, :2], end), axis=1)


def _labels(audit: Audit, rows: Ints) -> list[str]:
    """Return the hover text of each row: the verdict, the matched wall, its NIS."""
    columns = (audit.verdict[rows].tolist(), audit.landmark[rows].tolist(), audit.nis[rows].tolist())
    return [
        f"{VERDICTS[v]}: NIS {nis:.1f}" + (f", wall {line}" if line >= 0 else "")
        if nis == nis  # noqa: PLR0124  NaN where nothing was predicted
        else VERDICTS[v]
        for v, line, nis in zip(*columns, strict=True)
    ]


def _draw_scans(to: TimelineRecorder, scene: RerunScene) -> None:
    """Draw the scans once, in the robot's frame; the map shows them at the best pose."""
    scans, best = scene.scans, scene.best
    if scans is None or len(scans.t) == 0:
        return
    k = np.clip(np.searchsorted(best.t, scans.t), 0, len(best.t) - 1)
    pose, root = best.pose[k], f"{ROOT}/{part(best.name)}/scan"
    to.send(root, scans.t, _moves(pose[:, :2], pose[:, 2]))
    to.static(f"{root}/points", style.points(style.faded(style.SCAN, 190), 1.25))
    points = rr.Points2D.columns(positions=scans.xy)
    to.send(f"{root}/points", scans.t, points, lengths=scans.counts)
    to.static(f"{root}/screen", FLIP)
