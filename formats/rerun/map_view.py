"""Drawing of the map view: truth, measurements, and path, pose, 3-sigma ellipse and map of each configuration.

Data are in map coordinates; a transform at the root turns y downwards, as on the screen. Segments, rays and
headings are drawn from the estimated pose of the configuration: if this pose is right, matched segments lie on its
walls.
"""

from __future__ import annotations

import numpy as np
import rerun as rr
from msgspec.structs import asdict

from locfuse.formats.geometry import ellipses, extremes, quaternions, segments, wall_band, walls
from locfuse.fusion.data import VERDICTS, Array, Audit, Estimates, MapLine, Measurements, evenly, matrices
from locfuse.fusion.se2 import compose, transform

from . import drawing as ink
from .drawing import TimelineRecorder, part
from .scene import GROUP_OF, RerunScene, SensorLook

ROOT = "world"
PATH_ORDER = 40.0  # draw order, above walls and scans
TRUTH_ORDER = 35.0  # below the estimates, whose lines are thinner
TRUTH_WIDTH, PATH_WIDTH = 2.75, 1.25  # points on the screen
SIGHT_WIDTH = {"segments": 2.5, "bearing": 1.0, "heading": 1.5}  # points on the screen
MIN_BODY_SHARE = 0.02  # minimum size of the robot, as a share of the map
BODY_SHAPE = np.array([[0.6, 0.0], [-0.4, 0.45], [-0.2, 0.0], [-0.4, -0.45], [0.6, 0.0]])  # an arrow head
HEADING_LENGTH_TRACKS = 1.5  # multiples of the track width
BEARING_LENGTH_M = 2.0  # m, for bearings without a landmark
FLIP = rr.Transform3D(mat3x3=((1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, 1.0)))


def draw_map(to: TimelineRecorder, scene: RerunScene) -> None:
    """Draw everything that has a position on the map."""
    to.static(ROOT, FLIP)
    low, high = scene.extent
    body = max(scene.track, MIN_BODY_SHARE * float((high - low).max())) * BODY_SHAPE
    for order, e in enumerate(scene.estimates, start=int(PATH_ORDER)):
        root, colour = f"{ROOT}/{part(e.name)}", scene.colour(e.name)
        _draw_path(to, f"{root}/path", e.t, e.pose[:, :2], scene.max_points)
        to.static(f"{root}/path", ink.lines(colour, PATH_WIDTH, order))
        _draw_pose(to, root, e, scene)
        width = 2.0 if e is scene.best else 1.0
        to.static(f"{root}/pose/body", rr.LineStrips2D([body]), ink.lines(colour, width, order))
        _draw_walls(to, f"{root}/walls", e)
        if len(e.loops):  # a line per loop closure, from the robot to its earlier position
            at = np.minimum(np.searchsorted(e.t, e.loops), len(e.t) - 1)
            to.static(f"{root}/loops", ink.lines(ink.LOOP, 0.75, PATH_ORDER - 1.0, 120))
            strips = e.pose[at][:, :, :2].astype(np.float32)
            to.send(f"{root}/loops", e.loops[:, 1], rr.LineStrips2D.columns(strips=strips))
        _draw_measurements(to, f"{root}/seen", scene, e)
    _draw_scans(to, scene)
    truth = scene.drive.truth
    if truth is not None and len(truth.t):
        _draw_path(to, f"{ROOT}/truth/path", truth.t, truth.xy, scene.max_points)
        to.static(f"{ROOT}/truth/path", ink.lines(ink.TRUTH, TRUTH_WIDTH, TRUTH_ORDER, 150))
        now = evenly(len(truth.t), scene.max_points)
        to.static(f"{ROOT}/truth/now", ink.points(ink.TRUTH, 4.0))
        to.send(f"{ROOT}/truth/now", truth.t[now], rr.Points2D.columns(positions=truth.xy[now]))
    if scene.landmarks:
        label = ["landmark"] if len(scene.landmarks) == 1 else None
        to.static(f"{ROOT}/landmark", rr.Points2D(scene.landmarks, labels=label), ink.points(ink.LANDMARK, 6.0))


def _draw_path(to: TimelineRecorder, path: str, t: Array, xy: Array, limit: int) -> None:
    """Draw a path (n, 2) that grows with time: each step adds one line segment."""
    picks = extremes(xy, limit)
    points = xy[picks].astype(np.float32)
    to.send(path, t[picks][1:], rr.LineStrips2D.columns(strips=np.stack((points[:-1], points[1:]), axis=1)))


def _draw_pose(to: TimelineRecorder, root: str, e: Estimates, scene: RerunScene) -> None:
    picks = evenly(len(e.t), scene.max_points)
    t, pose = e.t[picks], e.pose[picks]
    to.send(f"{root}/pose", t, _moves(pose[:, :2], pose[:, 2]))
    if not e.triangles.any():
        return  # a trajectory from a file without covariances
    axes, angle = ellipses(matrices(e.triangles[picks]))
    look = rr.Ellipses2D.from_fields(colors=[scene.colour(e.name)], line_radii=ink.screen_radius(0.75))
    to.static(f"{root}/sigma", look)
    to.send(f"{root}/sigma", t, _moves(pose[:, :2], angle), rr.Ellipses2D.columns(half_sizes=axes))


def _moves(xy: Array, angle: Array) -> rr.ComponentColumnList:
    """Return Rerun transforms from positions (n, 2) [m] and angles (n,) [rad]."""
    place = np.column_stack((xy, np.zeros(len(xy))))
    return rr.Transform3D.columns(translation=place, quaternion=quaternions(angle))


def _draw_walls(to: TimelineRecorder, root: str, e: Estimates) -> None:
    """Draw the walls of the map's first scan, and the walls of the final map with 3-sigma bands.

    A final wall appears at the time of its first match.
    """
    if not e.first_map and not e.final_map:
        return
    began = [a.instant[0] for a in e.audits.values() if len(a.instant) and (a.landmark >= 0).any()]
    start = float(e.t[min(began, default=0)])
    born: dict[int, float] = {}  # line id -> time of its first match [s]
    for audit in e.audits.values():
        ids, at = np.unique(audit.landmark, return_index=True)
        born |= dict(zip(ids.tolist(), e.t[audit.instant[at]].tolist(), strict=True))
    born |= {line.id: start for line in e.first_map}
    first = walls(e.first_map)
    to.static(f"{root}/first_scan", ink.lines(ink.FIRST_WALL, 1.0, alpha=200))
    columns = rr.LineStrips2D.columns(strips=list(first))
    to.send(f"{root}/first_scan", np.array([start]), columns, lengths=[len(first)])
    final = sorted(e.final_map, key=lambda line: (born.get(line.id, start), line.id))
    t = np.array([born.get(line.id, start) for line in final])
    to.static(f"{root}/refined", ink.lines(ink.WALL, 1.5))
    ends = rr.LineStrips2D.columns(strips=list(walls(final)), labels=[_label(x) for x in final])
    to.send(f"{root}/refined", t, ends)
    to.static(f"{root}/three_sigma", ink.lines(ink.WALL, 0.5, alpha=110))
    to.send(f"{root}/three_sigma", t, rr.LineStrips2D.columns(strips=[wall_band(x) for x in final]))


def _label(line: MapLine) -> str:
    offset, angle = np.sqrt(np.maximum(np.diagonal(line.P_map), 0.0))
    return (
        f"wall {line.id}: rho {line.rho:.3f} ± {offset:.3f} m, "
        f"beta {np.degrees(line.beta):.2f} ± {np.degrees(angle):.2f}°, {line.hits} hits"
    )


def _draw_measurements(to: TimelineRecorder, root: str, scene: RerunScene, e: Estimates) -> None:
    """Draw segments, bearing rays and headings, one entity per group of verdicts.

    At most `max_scans` evenly spaced readings are drawn. A reading without a measurement of the group clears the
    entity.
    """
    drive = scene.seen_by(e.name)
    for sensor, audit in e.audits.items():
        sight = scene.sights[sensor]
        if not sight.kind or len(audit.instant) == 0:
            continue
        m = drive.measurements[sensor]
        readings = evenly(len(m.t), scene.max_scans)
        owner = np.searchsorted(m.first, audit.row, side="right") - 1
        at = np.searchsorted(readings, owner)
        keep = np.flatnonzero(readings[np.minimum(at, len(readings) - 1)] == owner)
        seen = Audit(*(column[keep] for name, column in asdict(audit).items() if name != "joint"))
        strips = _strips(m, seen, e.pose[seen.instant], sight, scene.track).astype(np.float32)
        group, labels = np.array(GROUP_OF)[seen.verdict], np.array(_labels(seen), dtype=object)
        for name in np.unique(group).tolist():
            some, path = group == name, f"{root}/{sensor}/{name}"
            counts = np.bincount(at[keep][some], minlength=len(readings))
            to.static(path, ink.lines(ink.GROUPS[name], SIGHT_WIDTH[sight.kind]))
            columns = rr.LineStrips2D.columns(strips=strips[some], labels=labels[some].tolist())
            to.send(path, drive.t[drive.instant[sensor]][readings], columns, lengths=counts)


def _strips(m: Measurements, seen: Audit, pose: Array, sight: SensorLook, track: float) -> Array:
    """Return the line segments (k, 2, 2) [m, map frame] of k rows of an audit.

    They are drawn from the poses (k, 3) at the times of the rows.
    """
    z = m.z[seen.row]
    if sight.kind == "segments":
        return transform(pose[:, None], segments(z, m.extra["ends"][seen.row]))
    origin = compose(pose, np.array(sight.mount))
    if sight.kind == "heading":
        angle, length = pose[:, 2] + np.nan_to_num(seen.y[:, 0]), np.full(len(z), HEADING_LENGTH_TRACKS * track)
    else:
        angle, length = origin[:, 2] + z[:, 0], np.full(len(z), BEARING_LENGTH_M)
    if sight.landmark is not None:
        length = np.hypot(sight.landmark[0] - origin[:, 0], sight.landmark[1] - origin[:, 1])
    end = origin[:, :2] + length[:, None] * np.stack((np.cos(angle), np.sin(angle)), axis=-1)
    return np.stack((origin[:, :2], end), axis=1)


def _labels(audit: Audit) -> list[str]:
    """Return the hover text of each audit row: verdict, NIS if known, matched wall."""
    rows = zip(audit.verdict.tolist(), audit.landmark.tolist(), audit.nis.tolist(), strict=True)
    predicted = np.isfinite(audit.nis).tolist()
    return [
        f"{VERDICTS[v]}: NIS {nis:.1f}" + (f", wall {line}" if line >= 0 else "") if known else VERDICTS[v]
        for (v, line, nis), known in zip(rows, predicted, strict=True)
    ]


def _draw_scans(to: TimelineRecorder, scene: RerunScene) -> None:
    """Draw the scans in the robot's frame; the poses of the best configuration place them on the map."""
    scans, best = scene.scans, scene.best
    if scans is None or len(scans.t) == 0:
        return
    k = np.clip(np.searchsorted(best.t, scans.t), 0, len(best.t) - 1)
    pose, root = best.pose[k], f"{ROOT}/{part(best.name)}/scan"
    to.send(root, scans.t, _moves(pose[:, :2], pose[:, 2]))
    to.static(f"{root}/points", ink.points(ink.SCAN, 1.25, alpha=190))
    to.send(f"{root}/points", scans.t, rr.Points2D.columns(positions=scans.xy), lengths=scans.counts)
    to.static(f"{root}/screen", FLIP)
