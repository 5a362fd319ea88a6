"""Trajectories over the line map: where each configuration thought it drove."""

from __future__ import annotations

import numpy as np

from locfuse.formats.thin import evenly
from locfuse.fusion.data import Array, MapLine

from .panels import Curve, Mark, Panel, Section, Spots, Strokes
from .route import spots, step, timed_path, track
from .scene import Scene

MAX_POINTS = 20_000  # of all paths together
WALLS = ("walls of the first scan", "walls seen later")


def trajectories(scene: Scene) -> Section:
    """Return the map figure: first and final lines, truth, one path per configuration."""
    mapped = max(scene.estimates, key=lambda e: (len(e.final_map), len(e.sensors)))
    marks: list[Mark] = []
    if mapped.final_map:
        first = {line.id for line in mapped.first_map}
        old = [line for line in mapped.final_map if line.id in first]
        new = [line for line in mapped.final_map if line.id not in first]
        marks += [Strokes(role, ends(lines)) for role, lines in zip(WALLS, (old, new), strict=True) if lines]
    paths = {e.name: timed_path(e, j) for e, j in scene.shown()}
    most = MAX_POINTS // (len(paths) + 1)
    marks += [_curve(name, xy, most) for name, (_, xy) in paths.items()]
    truth = scene.drive.truth
    if truth is not None:
        paths["truth"] = truth.t, truth.xy
        marks.append(_curve("truth", truth.xy, most))
    marks += [Spots("landmark", np.array([x]), np.array([y])) for x, y in scene.landmarks]
    led = paths["truth"] if truth is not None else paths[list(paths)[-1]]
    marks += spots(*led)
    every = f"every {step(led[0]):.0f} seconds"
    names = ", ".join(e.name for e, _ in scene.shown())
    panel = Panel(
        name="trajectories",
        title="Trajectories over the line map" if mapped.final_map else "Trajectories",
        y_label="y, m",
        x_label="x, m",
        marks=tuple(marks),
        summary=f"Paths of {names}{' and the truth' if truth else ''}, seen from above"
        + (f", and the walls of the map that {mapped.name} ended with." if mapped.final_map else "."),
        equal=True,
        keys=tuple(m.of for m in marks if isinstance(m, Strokes | Spots)),
        said={"time": every},
        tracks=tuple(found for name, (t, xy) in paths.items() for found in track(name, t, xy)),
    )
    text = f"Walls are where “{mapped.name}” knew them at the end." if mapped.final_map else ""
    return Section("trajectories", "Trajectories", text, (panel,), columns=1)


def _curve(name: str, xy: Array, most: int) -> Curve:
    return Curve(name, *xy[evenly(len(xy), most)].T)


def ends(lines: list[MapLine]) -> Array:
    """Return both ends of map lines, (k, 2, 2) m."""
    beta = np.array([line.beta for line in lines])
    foot = np.array([line.rho for line in lines])[:, None] * np.stack((np.cos(beta), np.sin(beta)), axis=-1)
    tangent = np.stack((-np.sin(beta), np.cos(beta)), axis=-1)
    along = np.array([line.ends for line in lines])
    points: Array = foot[:, None, :] + along[:, :, None] * tangent[:, None, :]
    return points
