"""How the viewer opens: the map large on the left, what explains it on the right, the rest one click away."""

from __future__ import annotations

from typing import Any

import numpy as np

from . import images, series, style
from .deferred import rrb
from .events import EVENTS
from .map_view import ROOT
from .recorder import DRIVE, STEP, TIME, part
from .scene import Scene

BACKGROUND = (20, 21, 26)
MARGIN_SHARE = 0.06  # of the map's size, around it
SCAN_RANGE_M = (1.5, 15.0)  # m shown around the robot at first: the least and the most
MAX_RAW_VIEWS = 12  # topics with a view of their own: a viewer with hundreds is of no use
TABS = ("Deviation", "Close-up", "NIS", "Innovation", "Gates", "Events", "Result", "Raw topics")


def blueprint(scene: Scene, tab: str | None = None) -> Any:
    """Return the rerun.blueprint.Blueprint of a scene: only views that have something to show; `tab` in front."""
    left, right = _left(scene), _right(scene, tab)
    return rrb.Blueprint(
        left if right is None else rrb.Horizontal(contents=[left, right], column_shares=[0.54, 0.46]),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=DRIVE),
        auto_views=False,
        auto_layout=False,
    )


def _left(scene: Scene) -> Any:
    """Return the map with its legend, and the panorama below where there are pictures."""
    rows = [(map_view(scene), 0.66)]
    if len(list(style.legend_entries(scene))) > 1:
        rows.append((legend_view(scene), 0.1))
    if scene.picture_rows is not None:
        wide = rrb.Spatial2DView(name="Panorama", origin=f"/{images.PANORAMA}", background=BACKGROUND)
        rows.append((wide, 0.24))
    if len(rows) == 1:
        return rows[0][0]
    return rrb.Vertical(contents=[view for view, _ in rows], row_shares=[share for _, share in rows])


def legend_view(scene: Scene) -> Any:
    """Return what the colours on the map mean, in one strip below it."""
    low, high = style.legend_bounds(scene)
    return rrb.Spatial2DView(
        name="Legend",
        origin=f"/{style.LEGEND}",
        background=BACKGROUND,
        visual_bounds=rrb.VisualBounds2D(x_range=(low[0], high[0]), y_range=(low[1], high[1])),
    )


def _right(scene: Scene, tab: str | None) -> Any | None:
    """Return what the robot saw above what explains the estimate."""
    looks, reasons = _looks(scene), _reasons(scene, tab)
    parts = [part for part in (looks, reasons) if part is not None]
    if len(parts) < 2:
        return parts[0] if parts else None
    return rrb.Vertical(contents=parts, row_shares=[0.34, 0.66])


def map_view(scene: Scene) -> Any:
    """Return the map: one entry per configuration to switch, walls and matches shown for the best one only."""
    x, y = _bounds(scene)
    return rrb.Spatial2DView(
        name="Map",
        origin="/",
        contents=[f"/{ROOT}/**"],
        background=BACKGROUND,
        visual_bounds=rrb.VisualBounds2D(x_range=x, y_range=(-y[1], -y[0])),
        overrides=_map_overrides(scene),
    )


def _map_overrides(scene: Scene) -> dict[Any, list[Any]]:

    until_now = _until_now()
    hidden = rrb.EntityBehavior(visible=False)
    overrides: dict[Any, list[Any]] = {f"{ROOT}/truth/path": [until_now]}
    for e in scene.estimates:
        root = f"{ROOT}/{part(e.name)}"
        overrides[f"{root}/path"] = [until_now]
        overrides[f"{root}/loops"] = [until_now]
        for walls in ("refined", "three_sigma"):
            overrides[f"{root}/walls/{walls}"] = [until_now]
        if e is not scene.best:
            overrides[f"{root}/walls"] = [hidden]
            overrides[f"{root}/seen"] = [hidden]
    return overrides


def _until_now() -> Any:
    """Show everything up to the cursor: paths and walls grow."""
    edge = rrb.TimeRangeBoundary
    return rrb.VisibleTimeRanges(
        [
            rrb.VisibleTimeRange(name, start=edge.infinite(), end=edge.cursor_relative())
            for name in (DRIVE, TIME, STEP)
        ]
    )


def _bounds(scene: Scene) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return x and y ranges [m] around what matters."""
    low, high = scene.extent
    margin = MARGIN_SHARE * max(float((high - low).max()), 1.0)
    (x0, y0), (x1, y1) = (low - margin).tolist(), (high + margin).tolist()
    return (x0, x1), (y0, y1)


def _looks(scene: Scene) -> Any | None:
    """Return what the robot saw: the scan around it, and the omni picture."""
    views = [scan_view(scene)] if scene.scans is not None and len(scene.scans.t) else []
    if scene.picture_rows is not None:
        omni = rrb.Spatial2DView(name="Omni image", origin=f"/{images.OMNI}", background=BACKGROUND)
        views.append(omni)
    return rrb.Horizontal(contents=views) if views else None


def scan_view(scene: Scene) -> Any:
    """Return the view from the robot: x ahead to the right, y to the left upwards."""
    root = f"{ROOT}/{part(scene.best.name)}"
    reach = _reach(scene)
    left_out = [f"- /{root}/{path}/**" for path in ("path", "sigma", "loops")]
    contents = [f"+ /{root}/**", f"+ /{ROOT}/landmark/**", *left_out]
    overrides: dict[Any, list[Any]] = {f"{root}/walls/{w}": [_until_now()] for w in ("refined", "three_sigma")}
    return rrb.Spatial2DView(
        name="Scan",
        origin=f"/{root}/scan/screen",
        contents=contents,
        background=BACKGROUND,
        visual_bounds=rrb.VisualBounds2D(x_range=(-reach, reach), y_range=(-reach, reach)),
        overrides=overrides,
    )


def _reach(scene: Scene) -> float:
    """Return how far the scan view looks [m]: four of five returns are nearer."""
    if scene.scans is None or len(scene.scans.xy) == 0:
        return SCAN_RANGE_M[0]
    least, most = SCAN_RANGE_M
    return float(np.clip(1.1 * np.quantile(np.hypot(*scene.scans.xy.T), 0.8), least, most))


def _reasons(scene: Scene, tab: str | None) -> Any | None:
    """Return the tabs that explain the estimate: deviation, NIS, innovations, gates, table, raw topics."""
    views = [
        _deviations(scene, "Deviation", None),
        _deviations(scene, "Close-up", _close(scene)),
        _nis(scene),
        _innovations(scene),
        _gates(scene),
        rrb.TextLogView(name="Events", origin=f"/{EVENTS}") if scene.events else None,
        rrb.TextDocumentView(name="Result", origin="/result") if scene.table else None,
        _raw(scene),
    ]
    shown = {name: view for name, view in zip(TABS, views, strict=True) if view is not None}
    front = list(shown).index(tab) if tab in shown else 0
    return rrb.Tabs(contents=list(shown.values()), active_tab=front) if shown else None


def _judged(scene: Scene) -> list[Any]:
    return [e for e in scene.evaluations.values() if len(e.t)]


def _deviations(scene: Scene, name: str, close: list[float] | None) -> Any | None:
    """Return the plots of estimate - truth; `close` (one per component) limits them to what corrected runs do."""
    judged = _judged(scene)
    if not judged or (name != "Deviation" and close is None):
        return None
    count = 2 if judged[0].heading is None else 3
    best = scene.best.name
    views = []
    for i, component in enumerate(series.DEVIATIONS[:count]):
        origin = f"/deviation/{series.entity(component)}"
        bands = {
            f"{origin}/{part(e.name)}/three_sigma": [rrb.EntityBehavior(visible=e.name == best)] for e in judged
        }
        views.append(_plot(component, origin, legend=i == 0, span=close[i] if close else None, overrides=bands))
    label = f"{name} (reference)" if judged[0].reference else name
    return rrb.Vertical(contents=views, name=label, row_shares=[1.35, *[1.0] * (count - 1)])  # room for the legend


def _close(scene: Scene) -> list[float] | None:
    """Return the span of x, y [m] and heading [deg] of the better half of the configurations."""
    judged = sorted(_judged(scene), key=lambda e: e.figures["position_rmse_m"] or 0.0)
    if len(judged) < 2:
        return None
    good = judged[: (len(judged) + 1) // 2]
    xy = max(float(np.abs(e.deviation).max()) for e in good)
    heading = max(float(np.abs(e.heading).max()) if e.heading is not None else 0.0 for e in good)
    return [1.2 * xy, 1.2 * xy, float(np.degrees(1.2 * heading))]


def _nis(scene: Scene) -> Any | None:

    sensors = _used(scene)
    spans = [_nis_span(scene, s) for s in sensors]
    views = [
        _plot(f"NIS {s}", f"/nis/{s}", legend=True, span=top, low=None if top is None else -0.04 * top)
        for s, top in zip(sensors, spans, strict=True)
    ]
    return rrb.Vertical(contents=views, name="NIS") if views else None


def _nis_span(scene: Scene, sensor: str) -> float | None:
    """Return a height that shows the gate and what is below: outliers of 10^4 would flatten the rest."""
    gates = [float(e.audits[sensor].threshold[0]) for e in scene.estimates if sensor in e.audits]
    return 1.6 * gates[0] if gates and np.isfinite(gates[0]) else None


def _innovations(scene: Scene) -> Any | None:

    views = []
    for sensor in _used(scene):
        sight = scene.sights.get(sensor)
        width = next(e.audits[sensor].y.shape[1] for e in scene.estimates if sensor in e.audits)
        for i in range(width):
            shown = series.component(sight, i)
            span = _innovation_span(scene, sensor, i) * shown.scale
            origin = f"/innovation/{sensor}/{part(shown.name)}"
            views.append(_plot(f"{sensor} {shown.label}", origin, legend=i == 0, span=span or None))
    return rrb.Vertical(contents=views, name="Innovation") if views else None


def _innovation_span(scene: Scene, sensor: str, i: int) -> float:
    """Return a height that shows 99 % of the innovations: the first ones may be of another size (an offset)."""
    y = np.concatenate([np.abs(e.audits[sensor].y[:, i]) for e in scene.estimates if sensor in e.audits])
    y = y[np.isfinite(y)]
    return 1.2 * float(np.quantile(y, 0.99)) if len(y) else 0.0


def _gates(scene: Scene) -> Any | None:

    return rrb.StateTimelineView(name="Gates", origin="/gate") if _used(scene) else None


def _raw(scene: Scene) -> Any | None:

    views = [
        _plot(topic.topic, f"/{series.raw_path(topic.topic)}", legend=True)
        for topic in scene.raw[:MAX_RAW_VIEWS]
        if topic.fields
    ]
    return rrb.Vertical(contents=views, name="Raw topics") if views else None


def _used(scene: Scene) -> list[str]:
    """Return the sensors that some configuration used and that said something."""
    used = {s for e in scene.estimates for s, audit in e.audits.items() if len(audit.instant)}
    return [s for s in scene.drive.measurements if s in used]


def _plot(
    name: str,
    origin: str,
    *,
    legend: bool,
    span: float | None = None,
    low: float | None = None,
    overrides: dict[Any, list[Any]] | None = None,
) -> Any:
    """Return a time series view; `span` limits it to +-span, or to low..span."""
    edge = rrb.TimeRangeBoundary.infinite()
    whole = rrb.TimeAxis(view_range=rrb.TimeRange(start=edge, end=edge))
    limits = None if span is None else (-span if low is None else low, span)
    return rrb.TimeSeriesView(
        name=name,
        origin=origin,
        axis_x=whole,
        axis_y=rrb.ScalarAxis(range=limits) if limits else None,
        plot_legend=rrb.PlotLegend(visible=legend, corner="RightTop"),
        background=rrb.archetypes.PlotBackground(color=BACKGROUND),
        overrides=overrides,
    )
