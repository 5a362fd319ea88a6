"""Panels for print: SVG and PDF by matplotlib, one column wide, in the colours of a light page.

Equal input gives equal bytes: no date, ids from a fixed salt. Text stays text, so a paper can use its own font.
"""

from __future__ import annotations

import io
import tomllib
from collections.abc import Mapping, Sequence
from importlib.resources import files
from typing import Any

import numpy as np

from locfuse.formats.geometry import broken, extremes
from locfuse.fusion.data import Colour

from . import palette
from .palette import Trace
from .panels import Band, Curve, Dots, Mark, Panel, Section, Spots, Strokes, ranges, ticks

PANEL_SIZE_IN = (3.5, 2.1)  # one column of a two-column paper
SQUARE_SIZE_IN = (3.5, 3.0)
# of the axes in the figure; fixed, because a layout engine would take a third of the time
AXES_AREA = (0.17, 0.19, 0.8, 0.66)
HEIGHT_IN_COLUMN = 1.45  # inches per panel in a column of panels
COLUMN = {"top": 0.88, "bottom": 0.12, "hspace": 0.12}
LANES_AREA = (0.24, 0.19, 0.73, 0.66)
MAX_LEGEND_SPOT = 5.0  # points; symbols in the legend are enlarged up to this size
MAX_CURVE_POINTS = 1600  # more than 3.5 inches at 300 dpi can show
TRUTH_DASH = (0, (1, 2))
DASHES = {"dash": (0, (4, 2)), "over": (0, (7, 3))}
WIDE_PT = 1.8
LOOK = tomllib.loads((files(__package__) / "print.toml").read_text(encoding="utf-8"))


def paper_figures(
    sections: Sequence[Section], traces: Mapping[str, Trace], sensors: Mapping[str, Colour]
) -> dict[str, bytes]:
    """Return file name -> content of every panel, as .svg and .pdf.

    `traces`: configurations that are drawn. `sensors`: colour of every sensor known to locfuse.
    """
    inks = _inks(traces, sensors)
    looks = palette.looks_of(traces)
    out: dict[str, bytes] = {}
    for section in sections:
        for panel in section.panels:
            name = "".join(c if c.isalnum() or c in "_-+@." else "_" for c in panel.name)
            out[f"{name}.svg"], out[f"{name}.pdf"] = draw((panel,), inks, looks)
    return out


def _inks(traces: Mapping[str, Trace], sensors: Mapping[str, Colour]) -> dict[str, str]:
    """Return the print colour of every configuration, sensor and role."""
    return {name: colour.light for name, colour in palette.colours(traces, sensors).items()}


def on_axes(axes: Any, panel: Panel, traces: Mapping[str, Trace], sensors: Mapping[str, Colour]) -> Any:
    """Draw a panel on matplotlib axes (None: new ones) and return them."""
    if axes is None:
        from matplotlib import pyplot as plt

        axes = plt.figure(figsize=(7.0, 6.0), layout="constrained").add_subplot()
    _fill(axes, panel, _inks(traces, sensors), palette.looks_of(traces))
    return axes


def draw(panels: Sequence[Panel], inks: dict[str, str], looks: Mapping[str, str]) -> tuple[bytes, bytes]:
    """Return a panel, or a column of panels with a common x axis, drawn as (SVG, PDF)."""
    from matplotlib import rc_context
    from matplotlib.backends.backend_pdf import FigureCanvasPdf
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    first, n = panels[0], len(panels)
    with rc_context(LOOK["style"]):
        if n == 1:
            figure = Figure(figsize=SQUARE_SIZE_IN if first.equal else PANEL_SIZE_IN)
            axes = [figure.add_axes(LANES_AREA if first.lanes else AXES_AREA)]
        else:
            figure = Figure(figsize=(PANEL_SIZE_IN[0], 0.45 + HEIGHT_IN_COLUMN * n))
            grid = figure.add_gridspec(n, 1, left=AXES_AREA[0], right=AXES_AREA[0] + AXES_AREA[2], **COLUMN)
            axes = [figure.add_subplot(grid[i]) for i in range(n)]
        for own, panel in zip(axes, panels, strict=True):
            _fill(own, panel, inks, looks)
        for own in axes[1:]:
            if (legend := own.get_legend()) is not None:
                legend.remove()
        for own in axes[:-1]:
            own.set_xlabel("")
            own.tick_params(labelbottom=False)
        svg, pdf = io.BytesIO(), io.BytesIO()
        to_svg: Any = FigureCanvasSVG(figure)
        to_pdf: Any = FigureCanvasPdf(figure)
        to_svg.print_svg(svg, metadata={"Date": None, "Creator": "locfuse"})
        to_pdf.print_pdf(pdf, metadata={"CreationDate": None, "Creator": "locfuse", "Producer": None})
    return svg.getvalue(), pdf.getvalue()


def _fill(axes: Any, panel: Panel, inks: dict[str, str], looks: Mapping[str, str]) -> None:
    """Draw the marks of a panel, then set limits, ticks, labels and the legend, as on the page."""
    for mark in panel.marks:
        _mark(axes, panel, mark, inks, looks)
    axes.set_xlabel(panel.x_label)
    axes.set_ylabel(panel.y_label)
    if panel.equal:
        axes.set_aspect("equal", adjustable="datalim")
    else:
        x, y = ranges(panel)
        if panel.log:
            axes.set_yscale("log")
        if panel.x_log:
            axes.set_xscale("log")
        axes.set(xlim=x, ylim=y)
        if not panel.lanes:
            axes.set_yticks(*map(list, zip(*ticks(*y, panel.log), strict=True)))
            axes.minorticks_off()
    if panel.lanes:
        axes.set_yticks([i + 0.5 for i in range(len(panel.lanes))], panel.lanes)
        axes.grid(visible=False, axis="y")
    handles, labels = axes.get_legend_handles_labels()
    if len(handles) > 1 or panel.keys:
        legend = axes.legend(handles, labels, **LOOK["legend"])
        for handle in legend.legend_handles:
            if getattr(handle, "get_markersize", lambda: 0.0)() > MAX_LEGEND_SPOT:
                handle.set_markersize(MAX_LEGEND_SPOT)


def _mark(axes: Any, panel: Panel, mark: Mark, inks: dict[str, str], looks: Mapping[str, str]) -> None:
    name = panel.legend.get(mark.of, "rejected" if mark.of == "gate" else mark.of)
    known = name == "bounds" or name in axes.get_legend_handles_labels()[1]
    ink, label = inks[mark.of], None if known else name
    if isinstance(mark, Curve):
        dash = TRUTH_DASH if mark.of == "truth" else DASHES.get(looks.get(mark.of, ""), "solid")
        grows = bool((np.diff(mark.x) >= 0).all())
        kept = extremes(mark.y, MAX_CURVE_POINTS) if grows else np.arange(len(mark.x))
        width = WIDE_PT if mark.wide else None
        axes.plot(*broken(mark.x[kept], mark.y[kept], mark.period), color=ink, ls=dash, lw=width, label=label)
    elif isinstance(mark, Spots):
        axes.plot(
            mark.x, mark.y, color=ink, ls="none", label=label, zorder=4, **LOOK["spots"][palette.SHAPES[mark.of]]
        )
    elif isinstance(mark, Band):
        kept = extremes(np.stack((mark.low, mark.high), axis=-1), MAX_CURVE_POINTS)
        alpha = 1.0 if mark.solid else 0.18
        axes.fill_between(mark.x[kept], mark.low[kept], mark.high[kept], color=ink, alpha=alpha, lw=0, label=label)
    elif isinstance(mark, Dots):
        many = len(mark.x) > MAX_CURVE_POINTS
        axes.plot(mark.x, mark.y, ".", color=ink, ms=1.2, mew=0, label=label, rasterized=many)
    elif isinstance(mark, Strokes):
        for i, (a, b) in enumerate(mark.ends):
            axes.plot((a[0], b[0]), (a[1], b[1]), color=ink, lw=1.8, label=label if i == 0 else None)
