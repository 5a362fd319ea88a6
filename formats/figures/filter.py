"""Filter figures: NEES and NIS with bounds, innovations, gate verdicts over time, estimated parameters."""

from __future__ import annotations

import numpy as np

from locfuse.fusion.data import VERDICTS, Array, Audit, Component, Estimates

from .panels import TIME, Band, Curve, Dots, Mark, Panel, Scene, Section

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
