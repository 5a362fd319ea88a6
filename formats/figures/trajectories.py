"""Trajectories over the line map: where each configuration thought it drove."""

from __future__ import annotations

import numpy as np

from locfuse.fusion.data import Array, Estimates, Evaluation, MapLine

from .panels import Curve, Mark, Panel, Section, Strokes
from .scene import Scene

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
    marks += [Curve(e.name, *path(e, j).T) for e, j in scene.shown()]
    truth = scene.drive.truth
    if truth is not None:
        marks.append(Curve("truth", truth.xy[:, 0], truth.xy[:, 1]))
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
        keys=tuple(m.of for m in marks if isinstance(m, Strokes)),
    )
    text = f"Walls are where “{mapped.name}” knew them at the end." if mapped.final_map else ""
    return Section("trajectories", "Trajectories", text, (panel,), columns=1)


def path(estimates: Estimates, judged: Evaluation) -> Array:
    """Return the path (n, 2): at every instant, or as aligned to the truth."""
    return estimates.pose[:, :2] if judged.align == "none" else judged.estimate_xy


def ends(lines: list[MapLine]) -> Array:
    """Return both ends of map lines, (k, 2, 2) m."""
    beta = np.array([line.beta for line in lines])
    foot = np.array([line.rho for line in lines])[:, None] * np.stack((np.cos(beta), np.sin(beta)), axis=-1)
    tangent = np.stack((-np.sin(beta), np.cos(beta)), axis=-1)
    along = np.array([line.ends for line in lines])
    points: Array = foot[:, None, :] + along[:, :, None] * tangent[:, None, :]
    return points
