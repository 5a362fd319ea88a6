"""How often errors of which size occur: one histogram per configuration, below each other on one axis."""

from __future__ import annotations

import numpy as np

from locfuse.fusion.data import Array, Evaluation

from .deviation import MIN_ERROR_M
from .panels import Band, Mark, Panel, Section, Strokes
from .scene import Scene, metres

BINS_PER_DECADE = 12
MAX_DECADES = 8
TALLEST = 0.8  # of a lane: the fullest bin of all


def spread(scene: Scene) -> Section:
    """Return the histograms of the position errors on a common logarithmic axis, medians marked."""
    judged = [j for _, j in scene.shown() if len(j.t)]
    errors = [_errors(j) for j in judged]
    if not any(len(e) for e in errors):
        return Section("spread", "", "", ())
    scale, unit = metres(errors)
    edges = _edges(np.concatenate(errors))
    shares = [np.histogram(e, edges)[0] / max(1, len(e)) for e in errors]
    tallest = max(float(s.max()) for s in shares)
    marks: list[Mark] = []
    for lane, (j, error, share) in enumerate(zip(judged, errors, shares, strict=True)):
        foot = lane + 0.92
        top = foot - TALLEST * np.repeat(share, 2) / tallest
        x = scale * np.repeat(edges, 2)[1:-1]
        marks.append(Band(j.name, x, np.full_like(x, foot), top, solid=True))
        if len(error):
            middle = scale * float(np.median(error))
            marks.append(Strokes("median", np.array([[[middle, lane + 0.1], [middle, foot]]])))
    panel = Panel(
        name="spread",
        title="How large the position errors are",
        y_label="",
        x_label=f"position error, {unit}",
        marks=tuple(marks),
        summary="Histograms of the position errors: medians "
        + ", ".join(f"{j.name} {np.median(e):.4f} m" for j, e in zip(judged, errors, strict=True) if len(e))
        + ".",
        x_log=True,
        x_range=(scale * float(edges[0]), scale * float(edges[-1])),
        y_range=(float(len(judged)), 0.0),
        lanes=tuple(j.name for j in judged),
    )
    text = "Share of the truth's stamps in bins of equal ratio. The upright line is the median."
    return Section("spread", "How large the errors are", text, (panel,), columns=1)


def _errors(judged: Evaluation) -> Array:
    """Return the finite position errors (k,) [m], none below what is drawn."""
    error = np.hypot(*judged.deviation.T)
    found: Array = np.maximum(error[np.isfinite(error)], MIN_ERROR_M)
    return found


def _edges(errors: Array) -> Array:
    """Return edges of bins of equal ratio that hold all errors, of the largest decades where there are many."""
    high = np.ceil(BINS_PER_DECADE * np.log10(errors.max()) + 1e-9)
    low = np.floor(BINS_PER_DECADE * np.log10(errors.min()) - 1e-9)
    low = max(low, high - MAX_DECADES * BINS_PER_DECADE)
    edges: Array = 10.0 ** (np.arange(low, high + 1) / BINS_PER_DECADE)
    return edges
