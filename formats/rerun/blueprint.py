"""Layout of the Rerun viewer: map on the left; sensor views and tabs with plots on the right."""

from __future__ import annotations

from typing import Any

import numpy as np
import rerun.blueprint as rrb

from locfuse.formats.figures.panels import count_ticks
from locfuse.fusion.data import Evaluation

from . import drawing
from .drawing import DRIVE, STEP, TIME, part
from .map_view import ROOT
from .scene import RerunScene

BACKGROUND = (20, 21, 26)
MARGIN_SHARE = 0.06  # margin around the map, as a share of its size
SCAN_RANGE_M = (1.5, 15.0)  # smallest and largest range around the robot that the scan view shows at first
LEGEND_SHARES = (0.04, 0.037)  # heights as shares of the left column: the legend's title, each row of the legend
TICK_MARGIN = 0.04  # margin beyond the outer values, as a share of the plot's range or of a tick step
MAX_TEN_STEPS = 6.5  # with more tick steps than this, one of three plots has no room for their labels
LEGEND_ROWS = 5  # entries of a plot's legend that fit into a plot of usual height
MAX_RAW_VIEWS = 12  # topics with a view of their own
Range = tuple[float, float]


def blueprint(scene: RerunScene, tab: str | None = None) -> rrb.Blueprint:
    """Return the layout for a scene, without empty views; the tab with the name `tab` is active.

    Left: map, legend, and panorama if there are pictures. Right: scan and camera views in the robot's frame, above
    the tabs with plots.
    """
    rows = [(_map_view(scene), 0.66)]
    if len(drawing.legend_of(scene)) > 1:
        share = LEGEND_SHARES[0] + LEGEND_SHARES[1] * drawing.legend_rows(scene)
        x = (-0.5 * drawing.LEGEND_CELL, (drawing.LEGEND_COLUMNS - 0.5) * drawing.LEGEND_CELL)
        y = (-0.2, drawing.legend_rows(scene) - 0.1)  # each row has height 1
        rows.append((_view_2d("Legend", f"/{drawing.LEGEND}", x, y), share))
    sensor_views = [_scan_view(scene)] if scene.scans is not None and len(scene.scans.t) else []
    if scene.picture_rows is not None:
        rows.append((_view_2d("Panorama", f"/{drawing.PANORAMA}"), 0.24))
        sensor_views.append(_view_2d("Omni image", f"/{drawing.OMNI}"))
    views, shares = zip(*rows, strict=True)
    root = rrb.Vertical(contents=views, row_shares=shares) if len(rows) > 1 else views[0]
    right: list[Any] = [rrb.Horizontal(contents=sensor_views)] if sensor_views else []
    if tabs := _tabs(scene):
        first = tab if tab in tabs else "Result" if scene.table and "Deviation" not in tabs else next(iter(tabs))
        front = list(tabs).index(first)
        right.append(rrb.Tabs(contents=list(tabs.values()), active_tab=front))
    if right:
        beside = rrb.Vertical(contents=right, row_shares=[0.26, 0.74]) if len(right) > 1 else right[0]
        root = rrb.Horizontal(contents=[root, beside], column_shares=[0.54, 0.46])
    return rrb.Blueprint(
        root,
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=DRIVE),
        auto_views=False,
        auto_layout=False,
    )


def _view_2d(name: str, origin: str, x: Range | None = None, y: Range | None = None, **more: Any) -> Any:
    """Return a 2D view; x and y are the ranges shown at first, with y down."""
    bounds = rrb.VisualBounds2D(x_range=x, y_range=y) if x and y else None
    return rrb.Spatial2DView(name=name, origin=origin, background=BACKGROUND, visual_bounds=bounds, **more)


def _map_view(scene: RerunScene) -> Any:
    """Return the map view; at first, walls and matches are visible only for the best configuration."""
    low, high = scene.extent
    margin = max(MARGIN_SHARE * float((high - low).max()), 0.6 * scene.track)  # the robot's own reach
    (x0, y0), (x1, y1) = (low - margin).tolist(), (high + margin).tolist()
    growing = [f"{ROOT}/truth/path"]
    overrides: dict[Any, Any] = {}
    for e in scene.estimates:
        root = f"{ROOT}/{part(e.name)}"
        growing += [f"{root}/{name}" for name in ("path", "loops", "walls/refined", "walls/three_sigma")]
        if e is not scene.best:
            overrides |= {f"{root}/{name}": [rrb.EntityBehavior(visible=False)] for name in ("walls", "seen")}
    overrides |= {path: [_up_to_cursor()] for path in growing}
    return _view_2d("Map", "/", (x0, x1), (-y1, -y0), contents=[f"/{ROOT}/**"], overrides=overrides)


def _scan_view(scene: RerunScene) -> Any:
    """Return the scan view in the robot's frame (x to the right, y up), zoomed to show 80 % of the points."""
    root, range_m = f"{ROOT}/{part(scene.best.name)}", SCAN_RANGE_M[0]
    if scene.scans is not None and len(scene.scans.xy):
        range_m = float(np.clip(1.1 * np.quantile(np.hypot(*scene.scans.xy.T), 0.8), *SCAN_RANGE_M))
    hidden = (f"- /{root}/{path}/**" for path in ("path", "sigma", "loops"))
    contents = [f"+ /{root}/**", f"+ /{ROOT}/landmark/**", *hidden]
    overrides = {f"{root}/walls/{name}": [_up_to_cursor()] for name in ("refined", "three_sigma")}
    square = (-range_m, range_m)
    return _view_2d("Scan", f"/{root}/scan/screen", square, square, contents=contents, overrides=overrides)


def _up_to_cursor() -> Any:
    """Return the visible time range from the start to the cursor, for paths and walls that grow."""
    edge = rrb.TimeRangeBoundary
    start, end = edge.infinite(), edge.cursor_relative()
    return rrb.VisibleTimeRanges([rrb.VisibleTimeRange(t, start=start, end=end) for t in (DRIVE, TIME, STEP)])


def _tabs(scene: RerunScene) -> dict[str, Any]:
    """Return tab name -> view, without empty tabs."""
    used = {s for e in scene.estimates for s, audit in e.audits.items() if len(audit.instant)}
    sensors = [s for s in scene.drive.measurements if s in used]
    raw = [t for t in scene.raw[:MAX_RAW_VIEWS] if t.fields]
    judged = [e for e in scene.evaluations.values() if len(e.t)]

    def stacked(name: str, views: list[Any]) -> Any:
        return rrb.Vertical(contents=views, name=name) if views else None

    tabs = {
        "Deviation": _deviations(scene, judged, "Deviation", None) if judged else None,
        "Close-up": _deviations(scene, judged, "Close-up", _close_spans(judged)) if len(judged) > 1 else None,
        "NIS": stacked("NIS", [_nis(scene, s) for s in sensors]),
        "Innovation": stacked("Innovation", [view for s in sensors for view in _innovations(scene, s)]),
        "Gates": rrb.StateTimelineView(name="Gates", origin="/gate") if sensors else None,
        "Events": rrb.TextLogView(name="Events", origin=f"/{drawing.EVENTS}") if scene.events else None,
        "Result": rrb.TextDocumentView(name="Result", origin="/result") if scene.table else None,
        "Raw topics": stacked("Raw topics", [_plot(t.topic, f"/{drawing.raw_path(t.topic)}") for t in raw]),
    }
    return {name: view for name, view in tabs.items() if view is not None}


def _deviations(scene: RerunScene, judged: list[Evaluation], name: str, close: list[float] | None) -> Any:
    """Return the plots of estimate - truth over time, for x [m], y [m] and heading [deg].

    `close` is the largest absolute value shown in each plot [m, m, deg]; None: all values are shown.
    """
    count = 2 if judged[0].heading is None else 3
    views = []
    for i, (component, (unit, _)) in enumerate(list(drawing.DEVIATIONS.items())[:count]):
        origin = f"/deviation/{component}"
        shown = {part(e.name): rrb.EntityBehavior(visible=e.name == scene.best.name) for e in judged}
        bands = {f"{origin}/{name}/three_sigma": [behaviour] for name, behaviour in shown.items()}
        limits = (-close[i], close[i]) if close else _deviation_range(scene, judged, i)
        low, high = ticked(*limits, most=MAX_TEN_STEPS * 3 / count)
        views.append(_plot(f"{component} [{unit}]", origin, high, low, legend=i == 0, overrides=bands))
    label = f"{name} (reference)" if judged[0].reference else name
    first = max(1.2, len(judged) / LEGEND_ROWS)  # room for the legend
    return rrb.Vertical(contents=views, name=label, row_shares=[first, *[1.0] * (count - 1)])


def _deviation_range(scene: RerunScene, judged: list[Evaluation], i: int) -> Range:
    """Return the smallest and largest value of the i-th deviation [m, m, deg] over all configurations.

    The 3-sigma band of the best configuration is included.
    """
    scale = list(drawing.DEVIATIONS.values())[i][1]
    columns = [j.heading if i == 2 and j.heading is not None else j.deviation[:, i % 2] for j in judged]
    bands = [drawing.DEVIATION_BAND_SIGMAS * j.sigma[:, i] for j in judged if j.name == scene.best.name]
    values = scale * np.concatenate([*columns, *bands, *(-b for b in bands)])
    values = values[np.isfinite(values)]
    return (float(values.min()), float(values.max())) if len(values) else (-1.0, 1.0)


def ticked(low: float, high: float, most: float = MAX_TEN_STEPS) -> Range:
    """Return limits of a y axis, widened until it has at least two labelled ticks.

    The viewer labels only multiples of a power of ten, and only if there are at most `most` of them.
    """
    margin = TICK_MARGIN * max(high - low, 1e-9)
    low, high = low - margin, high + margin
    step = 10.0 ** np.floor(np.log10(high - low))
    steps = (high - low) / step
    if steps <= most and count_ticks(low, high, step) >= 2:
        return low, high
    step *= 10.0 if steps > most else 1.0
    down = float((np.floor(low / step) - TICK_MARGIN) * step)
    up = float((np.ceil(high / step) + TICK_MARGIN) * step)
    wider = [ends for ends in ((down, high), (low, up)) if count_ticks(*ends, step) >= 2]
    return min(wider, key=lambda ends: ends[1] - ends[0], default=(down, up))


def _close_spans(judged: list[Evaluation]) -> list[float]:
    """Return the y limits for x, y [m] and heading [deg] that show the better half of the configurations."""
    by_error = sorted(judged, key=lambda e: e.figures["position_rmse_m"] or 0.0)
    good = by_error[: (len(by_error) + 1) // 2]
    xy = 1.05 * max(float(np.abs(e.deviation).max()) for e in good)
    heading = max(float(np.abs(e.heading).max()) if e.heading is not None else 0.0 for e in good)
    return [xy, xy, float(np.degrees(1.05 * heading))]


def _nis(scene: RerunScene, sensor: str) -> Any:
    """Return the plot of a sensor's NIS, cut at 1.6 times the gate, since outliers reach 10^4."""
    gate = next(float(e.audits[sensor].threshold[0]) for e in scene.estimates if sensor in e.audits)
    top = 1.6 * gate if np.isfinite(gate) else None
    return _plot(f"NIS {sensor}", f"/nis/{sensor}", top, low=None if top is None else -0.04 * top)


def _innovations(scene: RerunScene, sensor: str) -> list[Any]:
    """Return a plot for each component of a sensor's innovation, with limits that show 99 % of the values."""
    audits = [e.audits[sensor].y for e in scene.estimates if sensor in e.audits]
    views = []
    for i in range(audits[0].shape[1]):
        shown = scene.sights[sensor].components[i]
        y = np.concatenate([np.abs(y[:, i]) for y in audits])
        y = y[np.isfinite(y)]
        span = 1.2 * float(np.quantile(y, 0.99)) * shown.scale if len(y) else 0.0
        origin = f"/innovation/{sensor}/{part(shown.name)}"
        views.append(_plot(f"{sensor} {shown.label}", origin, span or None, legend=i == 0))
    return views


def _plot(
    name: str, origin: str, span: float | None = None, low: float | None = None, legend: bool = True, **more: Any
) -> Any:
    """Return a time series view.

    Its y axis reaches from -span to span, or from `low` to span. Without a span it shows all values.
    """
    edge = rrb.TimeRangeBoundary.infinite()
    limits = None if span is None else (-span if low is None else low, span)
    return rrb.TimeSeriesView(
        name=name,
        origin=origin,
        axis_x=rrb.TimeAxis(view_range=rrb.TimeRange(start=edge, end=edge)),
        axis_y=rrb.ScalarAxis(range=limits) if limits else None,
        plot_legend=rrb.PlotLegend(visible=legend, corner="RightTop"),
        background=rrb.archetypes.PlotBackground(color=BACKGROUND),
        **more,
    )
