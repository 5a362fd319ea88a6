"""The map view: truth, each configuration's path, pose and 3-sigma ellipse, and the walls it believes in.

Data are in map coordinates, y up; one flip at the root turns them for the screen, where y grows down.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from locfuse.formats.geometry import ellipses, quaternions, steps, wall, wall_band
from locfuse.formats.thin import evenly, extremes
from locfuse.fusion.data import Array, Estimates, Ints, MapLine, matrices

from . import style
from .deferred import rr
from .recorder import Recorder, part
from .scene import Rgb, Scene

ROOT = "world"
PATH_ORDER = 40.0  # above walls and scans
TRUTH_ORDER = 35.0  # below the estimates, a broad line under thin ones: neither hides the other
TRUTH_WIDTH, PATH_WIDTH = 2.75, 1.25  # points on the screen
MIN_BODY_SHARE = 0.02  # of the map: smaller robots would not be seen
FLIP = ((1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, 1.0))


def draw_map(to: Recorder, scene: Scene) -> None:
    """Send everything on the map but what the sensors saw."""
    to.static(ROOT, rr.Transform3D(mat3x3=FLIP))
    for order, estimates in enumerate(scene.estimates):
        root = f"{ROOT}/{part(estimates.name)}"
        colour = scene.colour(estimates.name)
        picks = extremes(estimates.pose[:, :2], scene.detail.curve)
        draw_path(
            to,
            f"{root}/path",
            estimates.t[picks],
            estimates.pose[picks, :2],
            colour,
            PATH_WIDTH,
            PATH_ORDER + order,
        )
        _draw_pose(to, root, estimates, evenly(len(estimates.t), scene.detail.curve), colour)
        width = 2.0 if estimates is scene.best else 1.0
        body = rr.LineStrips2D([_body(scene)])
        to.static(f"{root}/pose/body", body, style.lines(colour, width, PATH_ORDER + order))
        _draw_walls(to, f"{root}/walls", estimates)
        _draw_loops(to, f"{root}/loops", estimates)
    _draw_truth(to, scene)
    _draw_landmarks(to, scene)


def draw_path(
    to: Recorder, path: str, t: Array, xy: Array, colour: style.Colour, width: float, order: float
) -> None:
    """Send a growing path: one short strip per step (n - 1), so that nothing is sent twice."""
    to.static(path, style.lines(colour, width, order))
    to.send(path, t[1:], rr.LineStrips2D.columns(strips=steps(xy).astype(np.float32)))


def _draw_pose(to: Recorder, root: str, e: Estimates, picks: Ints, colour: Rgb) -> None:

    t, pose = e.t[picks], e.pose[picks]
    place = np.column_stack((pose[:, :2], np.zeros(len(pose))))
    move = rr.Transform3D.columns(translation=place, quaternion=quaternions(pose[:, 2]))
    to.send(f"{root}/pose", t, move)
    if not e.triangles.any():
        return  # a trajectory from a file, without its covariances
    axes, angle = ellipses(matrices(e.triangles[picks]))
    turned = rr.Transform3D.columns(translation=place, quaternion=quaternions(angle))
    thin: Any = style.on_screen(0.75)
    to.static(f"{root}/sigma", rr.Ellipses2D.from_fields(colors=[colour], line_radii=thin))
    to.send(f"{root}/sigma", t, turned, rr.Ellipses2D.columns(half_sizes=axes))


def _body(scene: Scene) -> Array:
    """Return the robot's outline (5, 2): an arrow head on the axle, as wide as the track or as can be seen."""
    low, high = scene.extent
    size = max(scene.track, MIN_BODY_SHARE * float((high - low).max()))
    return size * np.array([[0.6, 0.0], [-0.4, 0.45], [-0.2, 0.0], [-0.4, -0.45], [0.6, 0.0]])


def _draw_walls(to: Recorder, root: str, e: Estimates) -> None:
    """Send the first scan's walls, and the refined ones with their uncertainty, each from when it was matched."""
    if not e.first_map and not e.final_map:
        return
    start = np.array([_first_scan(e)])
    first = np.array([wall(line) for line in e.first_map]).reshape(-1, 2, 2)
    to.static(f"{root}/first_scan", style.lines(style.faded(style.FIRST_WALL, 200), 1.0))
    to.send(f"{root}/first_scan", start, rr.LineStrips2D.columns(strips=first), lengths=[len(first)])
    born = _births(e)
    walls = sorted(e.final_map, key=lambda line: (born.get(line.id, start[0]), line.id))
    t = np.array([born.get(line.id, start[0]) for line in walls])
    to.static(f"{root}/refined", style.lines(style.WALL, 1.5))
    ends = rr.LineStrips2D.columns(strips=[wall(line) for line in walls], labels=[_label(x) for x in walls])
    to.send(f"{root}/refined", t, ends)
    to.static(f"{root}/three_sigma", style.lines(style.faded(style.WALL, 110), 0.5))
    to.send(f"{root}/three_sigma", t, rr.LineStrips2D.columns(strips=[wall_band(x) for x in walls]))


def _draw_loops(to: Recorder, path: str, e: Estimates) -> None:
    """Send a line for every place that was recognised: from where the robot is to where it was then."""
    if not len(e.loops):
        return
    at = np.minimum(np.searchsorted(e.t, e.loops), len(e.t) - 1)
    to.static(path, style.lines(style.faded(style.LOOP, 120), 0.75, PATH_ORDER - 1.0))
    to.send(path, e.loops[:, 1], rr.LineStrips2D.columns(strips=e.pose[at][:, :, :2].astype(np.float32)))


def _first_scan(e: Estimates) -> float:
    """Return when the map began: the first instant at which a sensor with a map reported."""
    instants = [a.instant[0] for a in e.audits.values() if len(a.instant) and (a.landmark >= 0).any()]
    return float(e.t[min(instants, default=0)])


def _births(e: Estimates) -> dict[int, float]:
    """Return when each map line was first matched, by its id."""
    found: dict[int, float] = {}
    for audit in e.audits.values():
        ids, at = np.unique(audit.landmark, return_index=True)
        found |= {i: float(e.t[k]) for i, k in zip(ids.tolist(), audit.instant[at].tolist(), strict=True)}
    for line in e.first_map:
        found[line.id] = _first_scan(e)
    return found


def _label(line: MapLine) -> str:
    offset, angle = np.sqrt(np.maximum(np.diagonal(line.P_map), 0.0))
    return (
        f"wall {line.id}: rho {line.rho:.3f} ± {offset:.3f} m, "
        f"beta {np.degrees(line.beta):.2f} ± {np.degrees(angle):.2f}°, {line.hits} hits"
    )


def _draw_truth(to: Recorder, scene: Scene) -> None:

    truth = scene.drive.truth
    if truth is None or len(truth.t) == 0:
        return
    picks = extremes(truth.xy, scene.detail.curve)
    draw_path(
        to,
        f"{ROOT}/truth/path",
        truth.t[picks],
        truth.xy[picks],
        style.faded(style.TRUTH, 150),
        TRUTH_WIDTH,
        TRUTH_ORDER,
    )
    now = evenly(len(truth.t), scene.detail.curve)
    to.static(f"{ROOT}/truth/now", style.points(style.TRUTH, 4.0))
    to.send(f"{ROOT}/truth/now", truth.t[now], rr.Points2D.columns(positions=truth.xy[now]))


def _draw_landmarks(to: Recorder, scene: Scene) -> None:

    for sensor, sight in scene.sights.items():
        if sight.landmark is not None:
            point = rr.Points2D([sight.landmark], labels=["landmark"])
            to.static(f"{ROOT}/landmark/{sensor}", point, style.points(style.LANDMARK, 6.0))
