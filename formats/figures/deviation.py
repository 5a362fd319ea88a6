"""Deviation from truth: signed over time as in the paper's fig. 12 and 13, with 3 sigma, and against distance."""

from __future__ import annotations

import numpy as np
from msgspec.structs import replace

from locfuse.fusion.data import Array, Evaluation

from .panels import TIME, Band, Curve, Mark, Panel, Section
from .scene import Scene, metres

SIGMAS = 3.0
ENLARGE = 5.0  # times: where curves differ by more in size, the small ones are drawn once more
NEAR = 2.5  # times the smallest rms: such curves are enlarged together
MIN_ERROR_M = 1e-4  # m: a position error below is drawn there on logarithmic axes
OVERLAYS = {  # title, and its figure in the report
    "deviation_x": ("Deviation in x", "x_rmse_m"),
    "deviation_y": ("Deviation in y", "y_rmse_m"),
    "deviation_along": ("Deviation along the way", "along_rmse_m"),
    "deviation_cross": ("Deviation left of the way", "cross_rmse_m"),
}


def deviations(scene: Scene) -> Section:
    """Return the overlaid deviations: x, y, along, across, heading, and position error over time and way."""
    judged = [j for _, j in scene.shown() if len(j.t)]
    span = (0.0, float(scene.drive.t[-1]))
    columns = {
        "deviation_x": [j.deviation[:, 0] for j in judged],
        "deviation_y": [j.deviation[:, 1] for j in judged],
        "deviation_along": [j.along_cross[:, 0] for j in judged],
        "deviation_cross": [j.along_cross[:, 1] for j in judged],
    }
    panels = [_overlay(judged, name, values, span) for name, values in columns.items()]
    near = [_enlarged(p, [j.name for j in judged], columns[p.name]) for p in panels[:2]]
    panels[2:2] = [p for p in near if p is not None]
    with_heading = [j for j in judged if j.heading is not None]
    if with_heading:
        panels.append(_heading(with_heading, span))
    panels.append(_error(judged, scene.judged_by))
    text = f"Estimate minus {scene.judged_by}. Curves keep the least and the greatest value of every pixel."
    return Section("deviation", f"Deviation from {scene.judged_by}", text, tuple(panels))


def _overlay(judged: list[Evaluation], name: str, columns: list[Array], span: tuple[float, float]) -> Panel:
    title, key = OVERLAYS[name]
    scale, unit = metres(columns)
    marks = tuple(Curve(j.name, j.t, scale * c) for j, c in zip(judged, columns, strict=True))
    summary = f"{title} over time; " + _figures_words(judged, key, "m")
    return Panel(name, title, f"{title.lower()}, {unit}", TIME, marks, summary, x_range=span)


def _enlarged(panel: Panel, names: list[str], columns: list[Array]) -> Panel | None:
    """Return a panel once more on the scale of its smallest curves; None where all are of one size."""
    rms = {
        n: float(np.sqrt(np.nanmean(c**2))) for n, c in zip(names, columns, strict=True) if np.isfinite(c).any()
    }
    least = min(rms.values(), default=0.0)
    if least <= 0.0 or max(rms.values()) < ENLARGE * least:
        return None
    small = [c for n, c in zip(names, columns, strict=True) if rms.get(n, np.inf) <= NEAR * least]
    scale, unit = metres(small)
    reach = 1.1 * scale * max(float(np.nanmax(np.abs(c))) for c in small)
    return replace(
        panel,
        name=f"{panel.name}_enlarged",
        title=f"{panel.title}, enlarged",
        y_label=f"{panel.title.lower()}, enlarged, {unit}",
        marks=tuple(
            Curve(n, m.x, scale * c)
            for n, m, c in zip(names, panel.marks, columns, strict=True)
            if isinstance(m, Curve)
        ),
        y_range=(-reach, reach),
    )


def _heading(judged: list[Evaluation], span: tuple[float, float]) -> Panel:
    columns = [np.degrees(j.heading) for j in judged if j.heading is not None]
    marks = tuple(Curve(j.name, j.t, c) for j, c in zip(judged, columns, strict=True))
    summary = "Heading deviation over time; " + _figures_words(judged, "heading_rmse_deg", "°")
    label = "deviation in heading, °"
    return Panel("deviation_heading", "Deviation in heading", label, TIME, marks, summary, x_range=span)


def _error(judged: list[Evaluation], by: str) -> Panel:
    """Position error against the way driven, on a logarithmic axis."""
    errors = [np.maximum(np.hypot(*j.deviation.T), MIN_ERROR_M) for j in judged]
    scale, unit = metres(errors)
    return Panel(
        "error_distance",
        "Position error against distance",
        f"position error, {unit}",
        "distance driven, m",
        tuple(Curve(j.name, j.distance, scale * e) for j, e in zip(judged, errors, strict=True)),
        f"Distance of estimate and {by}; " + _figures_words(judged, "position_rmse_m", "m"),
        log=True,
    )


def bands(scene: Scene) -> Section:
    """Return x, y and heading of each configuration alone, between the 3 sigma that it claims for itself."""
    panels: list[Panel] = []
    names: list[str] = []
    columns = 2
    for _, judged in scene.shown():
        if len(judged.t) == 0:
            continue
        row = [_band(judged, "x", judged.deviation[:, 0], 0), _band(judged, "y", judged.deviation[:, 1], 1)]
        if judged.heading is not None:
            row.append(_band(judged, "heading", judged.heading, 2))
        columns = len(row)
        panels += row
        names.append(judged.name)
    text = (
        "Each configuration on its own scale. The band is the 3 sigma that the filter claims: "
        "a curve that leaves it is an overconfident estimate."
    )
    return Section("bands", "Deviation and claimed 3 sigma", text, tuple(panels), columns, tuple(names))


def _band(judged: Evaluation, what: str, deviation: Array, column: int) -> Panel:
    sigma = SIGMAS * judged.sigma[:, column]
    scale, unit = (180.0 / np.pi, "°") if what == "heading" else metres([deviation, np.minimum(sigma, 10.0)])
    marks: tuple[Mark, ...] = (
        Band(judged.name, judged.t, -scale * sigma, scale * sigma),
        Curve(judged.name, judged.t, scale * deviation),
    )
    return Panel(
        name=f"band_{judged.name}_{what}",
        title=f"{judged.name}: deviation in {what} with 3 sigma",
        y_label=f"{what}, {unit}",
        x_label=TIME,
        marks=marks,
        summary=f"Deviation of {judged.name} in {what} over time, in the band of its 3 sigma.",
        x_range=(0.0, float(judged.t[-1])),
    )


def uncertainty(scene: Scene) -> Section:
    """Return the standard deviations that the filters claim: all that can be shown without truth."""
    panels = []
    names = {shown.name for shown, _ in scene.shown()}
    for what, column in (("x", 0), ("y", 1), ("heading", 2)):
        sigmas = [SIGMAS * np.sqrt(np.maximum(e.P[:, column, column], 0.0)) for e in scene.estimates]
        scale, unit = (180.0 / np.pi, "°") if what == "heading" else metres(sigmas)
        marks = tuple(
            Curve(e.name, e.t, scale * s) for e, s in zip(scene.estimates, sigmas, strict=True) if e.name in names
        )
        label = f"3 sigma of {what}, {unit}"
        panels.append(Panel(f"sigma_{what}", f"Claimed 3 sigma of {what}", label, TIME, marks, label))
    text = "There is no truth in this log. This is how sure the filters claim to be, not how right they are."
    return Section("uncertainty", "Claimed uncertainty", text, tuple(panels))


def _figures_words(judged: list[Evaluation], key: str, unit: str) -> str:
    """Return one figure of the report of every configuration, in words."""
    known = [(j.name, value) for j in judged if (value := j.figures.get(key)) is not None]
    return ", ".join(f"{name} rms {value:.4f} {unit}" for name, value in known) + "."
