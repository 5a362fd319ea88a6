"""How often errors of which size occur: one histogram per configuration, below each other on one axis."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from locfuse.fusion.data import Array

from .deviation import MIN_ERROR_M
from .panels import Band, Mark, Panel, Section, Strokes
from .scene import Scene, metres

MIN_ERROR_DEG = 1e-3  # a smaller heading error is drawn there
BINS_PER_DECADE = 12
MAX_DECADES = 8
TALLEST = 0.8  # of a lane: the fullest bin of all


def spread(scene: Scene) -> Section:
    """Return the histograms of position and heading errors, each on a common logarithmic axis, medians marked."""
    judged = [j for _, j in scene.shown() if len(j.t)]
    position = {j.name: _sizes(np.hypot(*j.deviation.T), MIN_ERROR_M) for j in judged}
    scale, unit = metres(list(position.values()))
    heading = {j.name: _sizes(np.degrees(j.heading), MIN_ERROR_DEG) for j in judged if j.heading is not None}
    panels = (_panel("position", position, scale, unit), _panel("heading", heading, 1.0, "°"))
    text = f"Share of the {scene.judged_by}'s stamps in bins of equal ratio. The upright line is the median."
    return Section("spread", "How large the errors are", text, tuple(p for p in panels if p is not None))


def _sizes(errors: Array, least: float) -> Array:
    """Return the finite sizes (k,) of errors, none below what is drawn."""
    found: Array = np.maximum(np.abs(errors[np.isfinite(errors)]), least)
    return found


def _panel(what: str, errors: Mapping[str, Array], scale: float, unit: str) -> Panel | None:
    """Return the histograms of one kind of error below each other; None without any."""
    if not any(len(e) for e in errors.values()):
        return None
    edges = _edges(np.concatenate(list(errors.values())))
    shares = {name: np.histogram(e, edges)[0] / max(1, len(e)) for name, e in errors.items()}
    tallest = max(float(s.max()) for s in shares.values())
    x = scale * np.repeat(edges, 2)[1:-1]
    marks: list[Mark] = []
    for lane, (name, share) in enumerate(shares.items()):
        foot = lane + 0.92
        marks.append(
            Band(name, x, np.full_like(x, foot), foot - TALLEST * np.repeat(share, 2) / tallest, solid=True)
        )
        if len(errors[name]):
            middle = scale * float(np.median(errors[name]))
            marks.append(Strokes("median", np.array([[[middle, lane + 0.1], [middle, foot]]])))
    medians = ", ".join(f"{name} {scale * np.median(e):.3g} {unit}" for name, e in errors.items() if len(e))
    return Panel(
        name=f"spread_{what}",
        title=f"How large the {what} errors are",
        y_label=f"{what} error",
        x_label=f"{what} error, {unit}",
        marks=tuple(marks),
        summary=f"Histograms of the {what} errors: medians {medians}.",
        x_log=True,
        x_range=(scale * float(edges[0]), scale * float(edges[-1])),
        y_range=(float(len(errors)), 0.0),
        lanes=tuple(errors),
    )


def _edges(errors: Array) -> Array:
    """Return edges of bins of equal ratio that hold all errors, of the largest decades where there are many."""
    high = np.ceil(BINS_PER_DECADE * np.log10(errors.max()) + 1e-9)
    low = np.floor(BINS_PER_DECADE * np.log10(errors.min()) - 1e-9)
    low = max(low, high - MAX_DECADES * BINS_PER_DECADE)
    edges: Array = 10.0 ** (np.arange(low, high + 1) / BINS_PER_DECADE)
    return edges
