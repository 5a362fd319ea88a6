"""The sections of a report's figures in reading order, with those of errors and of the filter.

Errors: deviations over time (as in the article's fig. 12 and 13), histograms, effect of each sensor. Filter: NEES
and NIS with bounds, innovations, gate verdicts over time, estimated parameters. `where` has the maps.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import numpy as np
from msgspec.structs import replace

from locfuse.fusion.data import VERDICTS, Array, Audit, Component, Estimates, Evaluation

from .panels import TIME, Band, Curve, Dots, Mark, Panel, Scene, Section, Spots, Strokes, metres
from .where import trajectories, where


def sections(scene: Scene) -> list[Section]:
    """Return the figures of a report in reading order, without empty sections."""
    found = [trajectories(scene), where(scene)]
    found += [deviations(scene), spread(scene), bands(scene)] if scene.has_truth else [uncertainty(scene)]
    found += [consistency(scene), innovations(scene), gates(scene), learnt(scene), credit(scene)]
    events = tuple(scene.events)  # on every time axis
    panels = ([replace(p, events=events) if p.x_label == TIME else p for p in s.panels] for s in found)
    return [replace(s, panels=tuple(own)) for s, own in zip(found, panels, strict=True) if own]


BAND_SIGMAS = 3.0
TURN_DEG = 360.0
COMPONENTS = ("x", "y", "heading")
MIN_ENLARGED_RATIO = 5.0  # ratio of the largest to the smallest rms, above which an enlarged panel is added
MAX_SIMILAR_RATIO = 2.5  # ratio to the smallest rms of curves that fit into the enlarged panel
MIN_ERROR_M = 1e-4  # m: smaller position errors are drawn here on logarithmic axes
# panel -> title, key in the report, deviation (n,)
OVERLAYS: Mapping[str, tuple[str, str, Callable[[Evaluation], Array]]] = {
    "deviation_x": ("Deviation in x", "x_rmse_m", lambda j: j.deviation[:, 0]),
    "deviation_y": ("Deviation in y", "y_rmse_m", lambda j: j.deviation[:, 1]),
    "deviation_along": ("Deviation along the way", "along_rmse_m", lambda j: j.along_cross[:, 0]),
    "deviation_cross": ("Deviation left of the way", "cross_rmse_m", lambda j: j.along_cross[:, 1]),
    "deviation_heading": ("Deviation in heading", "heading_rmse_deg", lambda j: np.degrees(_components(j)[2])),
}


def deviations(scene: Scene) -> Section:
    """Return the section of deviations (x, y, along, across, heading, position), all configurations per panel."""
    judged = scene.judged()
    span = (0.0, float(scene.drive.t[-1]))
    unit = metres([j.deviation for j in judged])
    panels = {name: _overlay(judged, name, span, unit) for name in OVERLAYS if "heading" not in name}
    near = {name: _similar(name, judged) for name in ("deviation_x", "deviation_y")}
    unit = metres([c for small in near.values() for c in small])
    shown = list(panels.values())
    shown[2:2] = [_enlarged(panels[name], judged, small, unit) for name, small in near.items() if small]
    with_heading = [j for j in judged if j.heading is not None]
    shown += [_overlay(with_heading, "deviation_heading", span, (1.0, "°"))] if with_heading else []
    shown.append(_error(judged, scene.judged_by))
    text = f"Estimate minus {scene.judged_by}. Curves are thinned; peaks are kept."
    return Section("deviation", f"Deviation from {scene.judged_by}", text, tuple(shown))


def _overlay(judged: list[Evaluation], name: str, span: tuple[float, float], in_unit: tuple[float, str]) -> Panel:
    """Return the panel of one deviation over time; `in_unit` is (factor to the unit, unit)."""
    title, key, column = OVERLAYS[name]
    scale, unit = in_unit
    period = TURN_DEG if unit == "°" else math.inf
    marks = tuple(Curve(j.name, j.t, scale * column(j), period=period) for j in judged)
    summary = f"{title} over time; " + _figures_words(judged, key, "°" if key.endswith("_deg") else "m")
    return Panel(name, title, f"{title.lower()}, {unit}", TIME, marks, summary, x_range=span)


def _similar(name: str, judged: list[Evaluation]) -> list[Array]:
    """Return those deviations [m] of a panel that have a similar, small rms and fit into an enlarged panel.

    [] if the largest rms is less than MIN_ENLARGED_RATIO times the smallest.
    """
    columns = [OVERLAYS[name][2](j) for j in judged]
    rms = [float(np.sqrt(np.nanmean(c**2))) if np.isfinite(c).any() else np.nan for c in columns]
    least = min(filter(np.isfinite, rms), default=0.0)
    if least <= 0.0 or np.nanmax(rms) < MIN_ENLARGED_RATIO * least:
        return []
    return [c for c, size in zip(columns, rms, strict=True) if size <= MAX_SIMILAR_RATIO * least]


def _enlarged(panel: Panel, judged: list[Evaluation], small: list[Array], in_unit: tuple[float, str]) -> Panel:
    """Return a panel like `panel` with y limits that fit the curves `small`."""
    scale, unit = in_unit
    reach = 1.1 * scale * max(float(np.nanmax(np.abs(c))) for c in small)
    return replace(
        panel,
        name=f"{panel.name}_enlarged",
        title=f"{panel.title}, enlarged",
        y_label=f"{panel.title.lower()}, enlarged, {unit}",
        marks=tuple(Curve(j.name, j.t, scale * OVERLAYS[panel.name][2](j)) for j in judged),
        y_range=(-reach, reach),
    )


def _error(judged: list[Evaluation], by: str) -> Panel:
    """Return the panel of the position error over the distance driven, with a logarithmic y axis."""
    errors = [np.hypot(*j.deviation.T) for j in judged]
    errors = [np.where(e > 0.0, np.maximum(e, MIN_ERROR_M), np.nan) for e in errors]
    scale, unit = metres(errors)
    marks = tuple(Curve(j.name, j.distance, scale * e) for j, e in zip(judged, errors, strict=True))
    title, label = "Position error against distance", f"position error, {unit}"
    summary = f"Distance of estimate and {by}; " + _figures_words(judged, "position_rmse_m", "m")
    return Panel("error_distance", title, label, "distance driven, m", marks, summary, log=True)


def bands(scene: Scene) -> Section:
    """Return the section of deviations in x, y and heading with their 3-sigma bands, a row per configuration."""
    judged = scene.judged()
    rows = [_bands(j) for j in judged]
    text = (
        "Each configuration on its own scale. The band is the 3 sigma that the filter claims: "
        "a curve that leaves it is an overconfident estimate."
    )
    panels = tuple(panel for row in rows for panel in row)
    columns = max(map(len, rows), default=2)
    return Section("bands", "Deviation and claimed 3 sigma", text, panels, columns, tuple(j.name for j in judged))


def _components(judged: Evaluation) -> list[Array]:
    """Return the deviations in x and y [m], and in heading [rad] if the truth has headings, (n,) each."""
    return [*judged.deviation.T, *([] if judged.heading is None else [judged.heading])]


def _bands(judged: Evaluation) -> list[Panel]:
    """Return a configuration's panels: x and y in one unit, and heading if the truth has it."""
    in_unit = metres([judged.deviation, np.minimum(BAND_SIGMAS * judged.sigma[:, :2], 10.0)])
    units = (in_unit, in_unit, (180.0 / np.pi, "°"))
    panels = []
    for i, deviation in enumerate(_components(judged)):
        what, (scale, unit) = COMPONENTS[i], units[i]
        reach = scale * (BAND_SIGMAS * judged.sigma[:, i])
        curve = Curve(judged.name, judged.t, scale * deviation, period=TURN_DEG if unit == "°" else math.inf)
        panels.append(
            Panel(
                name=f"band_{judged.name}_{what}",
                title=f"{judged.name}: deviation in {what} with 3 sigma",
                y_label=f"{what}, {unit}",
                x_label=TIME,
                marks=(Band(judged.name, judged.t, -reach, reach), curve),
                summary=f"Deviation of {judged.name} in {what} over time, in the band of its 3 sigma.",
                x_range=(0.0, float(judged.t[-1])),
            )
        )
    return panels


def uncertainty(scene: Scene) -> Section:
    """Return the section of the filters' own 3 sigma of x, y and heading, for logs without truth."""
    panels = []
    names = {shown.name for shown, _ in scene.shown()}
    for column, what in enumerate(COMPONENTS):
        sigmas = [BAND_SIGMAS * np.sqrt(np.maximum(e.P[:, column, column], 0.0)) for e in scene.estimates]
        scale, unit = (180.0 / np.pi, "°") if what == "heading" else metres(sigmas)
        drawn = [(e, s) for e, s in zip(scene.estimates, sigmas, strict=True) if e.name in names]
        marks = tuple(Curve(e.name, e.t, scale * s) for e, s in drawn)
        label = f"3 sigma of {what}, {unit}"
        panels.append(Panel(f"sigma_{what}", f"Claimed 3 sigma of {what}", label, TIME, marks, label))
    text = "No truth in this log: this is what the filters claim, not their error."
    return Section("uncertainty", "Claimed uncertainty", text, tuple(panels))


def _figures_words(judged: list[Evaluation], key: str, unit: str) -> str:
    """Return the rms of every configuration as text: "lrf rms 0.0123 m, all rms 0.0101 m."."""
    known = [(j.name, value) for j in judged if (value := j.figures.get(key)) is not None]
    return ", ".join(f"{name} rms {value:.4f} {unit}" for name, value in known) + "."


# --- Histograms of the errors, one lane per configuration on a common axis

MIN_ERROR_DEG = 1e-3  # smaller heading errors are drawn here
BINS_PER_DECADE = 12
MAX_DECADES = 8
MAX_BIN_HEIGHT_LANES = 0.8  # height of the highest bin, in lane heights


def spread(scene: Scene) -> Section:
    """Return the section of histograms of position and heading errors, on logarithmic axes, with medians."""
    judged = scene.judged()
    position = {j.name: _sizes(np.hypot(*j.deviation.T), MIN_ERROR_M) for j in judged}
    scale, unit = metres(list(position.values()))
    heading = {j.name: _sizes(np.degrees(j.heading), MIN_ERROR_DEG) for j in judged if j.heading is not None}
    panels = (_histograms("position", position, scale, unit), _histograms("heading", heading, 1.0, "°"))
    text = "Histogram, logarithmic axis; line: median."
    return Section("spread", "How large the errors are", text, tuple(p for p in panels if p is not None))


def _sizes(errors: Array, least: float) -> Array:
    """Return the absolute values (k,) of the finite, nonzero `errors` (n,), raised to at least `least`."""
    found: Array = errors[np.isfinite(errors) & (errors != 0.0)]
    return np.maximum(np.abs(found), least)


def _histograms(what: str, errors: Mapping[str, Array], scale: float, unit: str) -> Panel | None:
    """Return the panel of histograms of one kind of error, a lane per configuration; None without errors."""
    if not any(len(e) for e in errors.values()):
        return None
    every = np.concatenate(list(errors.values()))
    high = np.ceil(BINS_PER_DECADE * np.log10(every.max()) + 1e-9)
    low = np.floor(BINS_PER_DECADE * np.log10(every.min()) - 1e-9)
    low = max(low, high - MAX_DECADES * BINS_PER_DECADE)  # smaller errors are left out
    edges = 10.0 ** (np.arange(low, high + 1) / BINS_PER_DECADE)
    shares = {name: np.histogram(e, edges)[0] / max(1, len(e)) for name, e in errors.items()}
    tallest = max(float(s.max()) for s in shares.values())
    x = scale * np.repeat(edges, 2)[1:-1]
    marks: list[Mark] = []
    for lane, (name, share) in enumerate(shares.items()):
        foot = lane + 0.92
        top = foot - MAX_BIN_HEIGHT_LANES * np.repeat(share, 2) / tallest
        marks.append(Band(name, x, np.full_like(x, foot), top, solid=True))
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


# --- Effect of each sensor on the position error: alone, added to the others, and on average

EFFECTS = {"alone": 0.28, "leave_one_out": 0.55, "credit": 0.82}  # effect -> y in a sensor's lane
WORDS = {
    "alone": "alone",
    "leave_one_out": "last, beside all others",
    "credit": "credit: mean over every order",
    "bounds": "no effect",
}
FACTOR_LIMITS = (1e-3, 1e5)  # factors outside are drawn at the limit


def credit(scene: Scene) -> Section:
    """Return the section of each sensor's factor on the position error, with 95 % intervals."""
    sensors = dict((scene.credit or {}).get("sensors", {}))
    marks: list[Mark] = []
    for lane, (sensor, values) in enumerate(sensors.items()):
        kinds = [kind for kind in EFFECTS if values.get(kind)]
        for kind in kinds:
            y = lane + (EFFECTS[kind] if len(kinds) > 1 else 0.5)
            low, high, factor = (values[kind][k] for k in ("low", "high", "factor"))
            ends = [[float(np.clip(v, *FACTOR_LIMITS)), y] for v in (low, high) if v is not None]
            marks += [Strokes(sensor, np.array([ends]))] if ends else []
            marks.append(Spots(kind, np.clip([factor], *FACTOR_LIMITS), np.array([y])))
    if not marks:
        return Section("credit", "", "", ())
    n = len(sensors)
    marks.insert(0, Curve("bounds", np.ones(2), np.array([0.0, float(n)])))
    values = [float(v) for m in marks for v in (m.ends[:, :, 0].ravel() if isinstance(m, Strokes) else m.x)]
    panel = Panel(
        name="credit",
        title="How many times smaller each sensor makes the position error",
        y_label="",
        x_label="position error smaller by this factor",
        marks=tuple(marks),
        summary="Each sensor's effect with its 95 % interval; right of 1 the error shrinks.",
        x_log=True,
        x_range=(min(values) / 1.15, max(values) * 1.15),
        y_range=(float(n), 0.0),
        lanes=tuple(sensors),
        keys=tuple(dict.fromkeys(m.of for m in marks if not isinstance(m, Strokes))),
        legend=WORDS,
    )
    return Section("credit", "Credit", "", (panel,))


MAX_NEES_STRETCHES = 120  # intervals of a drive over which NEES is averaged for drawing
GATE_BINS = 150  # intervals of the timeline of gate verdicts
INNOVATION_SIGMAS = 2.0


def consistency(scene: Scene) -> Section:
    """Return the section of NEES per configuration and NIS per sensor, with their chi-square bounds."""
    span = (0.0, float(scene.drive.t[-1]))
    panels = []
    judged = [j for _, j in scene.shown() if np.isfinite(j.nees).any()]
    if judged:
        curves = [Curve(j.name, *means(j.t, j.nees, MAX_NEES_STRETCHES)) for j in judged]
        words = ", ".join(f"{j.name} {value:.2f}" for j in judged if (value := j.figures.get("anees")) is not None)
        low, high = (np.full(2, bound) for bound in scene.nees_bounds)
        band = Band("bounds", np.array(span), low, high)
        summary = f"Normalised estimation error squared over time; means: {words}."
        panels.append(_ratios("nees", "NEES", "", band, curves, summary, span))
    panels += [p for s in scene.drive.measurements if (p := _nis(scene, s, span)) is not None]
    text = (
        "1 is right; above: overconfident; below: underconfident. Grey: where 95 % should lie. "
        "NIS near 1 alone proves nothing."
    )
    return Section("consistency", "Consistency over time", text, tuple(panels))


def _nis(scene: Scene, sensor: str, span: tuple[float, float]) -> Panel | None:
    found = {name: v for (name, s), v in scene.nis.items() if s == sensor and np.isfinite(v.mean).any()}
    shown = [j for e, j in scene.shown() if e.name in found]
    if not shown:
        return None
    widest = found[shown[-1].name]
    band = Band("bounds", widest.t, widest.low, widest.high)
    curves = [Curve(j.name, found[j.name].t, found[j.name].mean) for j in shown]
    means_of = ((j.name, j.sensors[sensor].nis) for j in shown)
    words = ", ".join(f"in {name} {value:.2f}" for name, value in means_of if value is not None)
    summary = f"Normalised innovation squared of {sensor} over stretches of the drive; means: {words}."
    return _ratios(f"nis_{sensor}", "NIS", f"{sensor}: ", band, curves, summary, span)


def _ratios(
    name: str, what: str, of: str, band: Band, curves: list[Curve], summary: str, span: tuple[float, float]
) -> Panel:
    """Return a panel of NEES or NIS over time with its bounds, with a logarithmic y axis."""
    values = np.concatenate([*(c.y for c in curves), [np.nanmin(band.low), np.nanmax(band.high)]])
    values = values[np.isfinite(values) & (values > 0)]
    low, high = (float(values.min()), float(values.max())) if len(values) else (0.1, 10.0)
    y_range = max(low / 1.5, 1e-2), min(max(high * 1.5, 2.0), 1e6)
    title, label = f"{of}{what} per degree of freedom", f"{of}{what} / dof"
    return Panel(name, title, label, TIME, (band, *curves), summary, log=True, x_range=span, y_range=y_range)


def innovations(scene: Scene) -> Section:
    """Return the section of innovations in the configuration with most sensors, with 2-sigma bands."""
    best = scene.best
    panels = []
    for sensor, audit in best.audits.items():
        components = scene.components.get(sensor, ())[: audit.y.shape[1]]  # camera without ranges: bearings only
        for i, component in enumerate(components):
            if len(audit.y) and np.isfinite(audit.y[:, i]).any():
                panels.append(_innovation(best, sensor, audit, i, component))
    text = (
        f"What each sensor measured minus what “{best.name}” expected, with the 2 sigma expected of it "
        "(rms over short stretches)."
    )
    return Section("innovations", "Innovations", text, tuple(panels))


def _innovation(e: Estimates, sensor: str, audit: Audit, i: int, c: Component) -> Panel:
    t, y = e.t[audit.instant], c.scale * audit.y[:, i]
    accepted = audit.verdict == 0
    refused = ~accepted & np.isfinite(y)
    used = sensor if len(e.sensors) > 1 else e.name
    stretches = int(np.clip(int(accepted.sum()) // 3, 1, MAX_NEES_STRETCHES))
    at, variance = means(t[accepted], (c.scale * audit.sigma[accepted, i]) ** 2, stretches)
    sigma = INNOVATION_SIGMAS * np.sqrt(variance)
    marks: list[Mark] = [Band("bounds", at, -sigma, sigma)]
    if refused.any():
        marks.append(Dots("gate", t[refused], y[refused]))
    marks.append(Dots(used, t[accepted], y[accepted]))
    # 99.5 % of the accepted values are shown; the largest rejected ones may be outside
    shown = [(y[accepted], 99.5), (sigma[np.isfinite(sigma)], 95.0), (y[refused], 80.0)]
    most = 1.15 * max([1e-9, *(float(np.nanpercentile(np.abs(v), share)) for v, share in shown if len(v))])
    return Panel(
        f"innovation_{sensor}_{i}",
        f"{sensor}: innovation of {c.name}",
        f"{sensor} {c.name}, {c.sign}",
        TIME,
        tuple(marks),
        f"{int(accepted.sum())} accepted, and those that were compared and rejected.",
        x_range=(0.0, float(e.t[-1])),
        y_range=(-most, most),
        keys=("gate",) if refused.any() else (),
    )


def gates(scene: Scene) -> Section:
    """Return the section of gate verdicts over time: the share of each verdict in each sensor's measurements."""
    best = scene.best
    marks: list[Mark] = []
    for lane, audit in enumerate(best.audits.values()):
        marks += _shares(audit, best.t, lane)
    if not marks:
        return Section("gates", "", "", ())
    present = {m.of for m in marks}
    panel = Panel(
        "gates",
        "Accepted and rejected readings over time",
        "",
        TIME,
        tuple(marks),
        "Shares of accepted, new, ambiguous and rejected measurements of each sensor over time.",
        x_range=(0.0, float(best.t[-1])),
        y_range=(float(len(best.audits)), 0.0),
        lanes=tuple(best.audits),
        keys=tuple(v for v in VERDICTS if v in present),
    )
    text = f"In “{best.name}”. An empty stretch means that the sensor measured nothing there."
    return Section("gates", "Accepted and rejected readings over time", text, (panel,), columns=1)


def _shares(audit: Audit, t: Array, lane: int) -> list[Band]:
    """Return the stacked shares of the verdicts as bands in y [lane + 0.1, lane + 0.9], accepted at the bottom."""
    bins = int(np.clip(len(np.unique(audit.instant)) // 3, 1, GATE_BINS))
    edges = np.linspace(0.0, float(t[-1]), bins + 1)
    place = np.clip(np.searchsorted(edges, t[audit.instant], side="right") - 1, 0, bins - 1)
    counts = np.stack([np.bincount(place[audit.verdict == v], minlength=bins) for v in range(len(VERDICTS))])
    total = counts.sum(axis=0)
    shares = np.where(total > 0, counts / np.maximum(total, 1), np.nan)
    tops = lane + 0.9 - 0.8 * np.cumsum(shares, axis=0)
    x = np.repeat(edges, 2)[1:-1]
    out = []
    below = np.where(total > 0, lane + 0.9, np.nan)
    for verdict, top in zip(VERDICTS, tops, strict=True):
        if counts[VERDICTS.index(verdict)].any():
            out.append(Band(verdict, x, np.repeat(below, 2), np.repeat(top, 2), solid=True))
        below = top
    return out


def learnt(scene: Scene) -> Section:
    """Return the section of estimated parameters (compass offset, wheel radii, ...) with 3-sigma bands."""
    best = scene.best
    panels = []
    for name, values in best.blocks.items():
        known = scene.states.get(name, [Component(f"{name} {i}", "") for i in range(values.shape[1])])
        for i, c in enumerate(known[: values.shape[1]]):
            v, s = c.scale * values[:, i], 3.0 * c.scale * best.block_sigmas[name][:, i]
            final = float(s[-1]) if len(s) else 1.0
            low, high = float(v[-1]) - 6.0 * final, float(v[-1]) + 6.0 * final
            seen = np.abs(v - v[-1]) < 20.0 * max(final, 1e-9)
            low, high = min(low, float(v[seen].min())), max(high, float(v[seen].max()))
            marks: tuple[Mark, ...] = (Band(best.name, best.t, v - s, v + s), Curve(best.name, best.t, v))
            label = f"{c.name}, {c.sign}" if c.unit else c.name
            limits = (low, max(high, low + 1e-9))
            words = f"{c.name} as estimated over time, in the band of its 3 sigma."
            panels.append(Panel(f"learnt_{name}_{i}", c.name, label, TIME, marks, words, y_range=limits))
    text = f"States besides the pose that “{best.name}” estimated while driving, with 3 sigma."
    return Section("learnt", "Estimated parameters", text, tuple(panels))


def means(t: Array, values: Array, count: int) -> tuple[Array, Array]:
    """Return the centres [s] of `count` intervals of t (n,) [s], and the means (count,) of values (n,) in them.

    The mean of an interval without values is NaN.
    """
    if len(t) == 0:
        return np.zeros(0), np.zeros(0)
    good = np.isfinite(values)
    edges = np.linspace(t[0], t[-1], count + 1)
    place = np.clip(np.searchsorted(edges, t[good], side="right") - 1, 0, count - 1)
    n = np.bincount(place, minlength=count)
    total = np.bincount(place, weights=values[good], minlength=count)
    return 0.5 * (edges[1:] + edges[:-1]), np.where(n > 0, total / np.maximum(n, 1), np.nan)
