"""HTML page of `locfuse paper`: results of the filter as printed in the article and of ours; figures 12 to 14."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib.resources import files
from typing import Any

from markupsafe import Markup
from msgspec.structs import replace

from locfuse.formats.figures.palette import SHAPES
from locfuse.formats.figures.panels import Panel, Section
from locfuse.fusion.data import Colour

from .findings import length
from .html import page_of, section_drawings
from .table import Column, Swatches, Table, html, latex as latex_of, of_values
from .tables import CONFIGURATION

COLUMNS = (
    CONFIGURATION,
    Column("ours_position_rmse_m", "position rmse, ours", "m", "{:.3f}"),
    Column("print_position_rmse_m", "as printed", "m", "{:.3f}"),
    Column("ours_heading_rmse_deg", "heading rmse, ours", "°", "{:.2f}"),
    Column("print_heading_rmse_deg", "as printed", "°", "{:.2f}"),
    Column("ours_anees", "ANEES, ours", form="{:.3g}"),
    Column("print_anees", "as printed", form="{:.3g}"),
)
DISTANCES = (
    Column("figure", "figure", kind="text"),
    Column("steered", "the robot was", kind="text"),
    Column("rms", "rms distance from the path", "m", "{:.3f}"),
    Column("largest", "largest", "m", "{:.3f}"),
)
ALL = "all"  # configuration with all sensors
FIGURES = {  # name -> title, columns
    "fig12": ("Figure 12: trajectories under five configurations, our filter", 1),
    "fig12_print": ("Figure 12 by the equations as printed", 1),
    "fig13": ("Figure 13: deviation in X and Y, our filter", 2),
    "fig13_print": ("Figure 13 by the equations as printed", 2),
    "fig14a": ("Figure 14 a: a rounded rectangle, with and without the EKF in the loop", 1),
    "fig14b": ("Figure 14 b: a rounded triangle, with and without the EKF in the loop", 1),
}


def table(values: Mapping[str, Any]) -> Table:
    """Return the errors of each configuration by our filter and by the filter as printed in the article."""
    rows = ((row, ("table", i)) for i, row in enumerate(values["table"]))
    return of_values(COLUMNS, rows, "The print and our filter")


def distances(values: Mapping[str, Any]) -> Table:
    """Return the rms and largest distance [m] from the commanded path, for each simulated robot of figure 14."""
    rows = ((row, ("figure_14", i)) for i, row in enumerate(values["figure_14"]))
    return of_values(DISTANCES, rows, "Distances from the path in figure 14")


def conclusion(values: Mapping[str, Any]) -> str:
    """Return the article's conclusion (all sensors are best) and the best configuration of each filter."""
    rows = {row["configuration"]: row for row in values["table"]}
    parts = []
    for of, words in {"ours": "with our filter", "print": "by the equations as printed"}.items():
        errors = {name: row[f"{of}_position_rmse_m"] for name, row in rows.items()}
        best = min(errors, key=lambda name: errors[name])
        beside = "" if best == ALL else f", {ALL} {length(errors[ALL])}"
        parts.append(f"{words} {best} ({length(errors[best])}{beside})")
    return (
        "The paper concludes that all sensors together are best. The smallest position error of this drive has "
        f"{' and '.join(parts)}."
    )


def latex(values: Mapping[str, Any]) -> str:
    """Return the table of errors as LaTeX."""
    head = f"% locfuse {values['locfuse']}; needs \\usepackage{{booktabs}} and \\usepackage{{textcomp}}\n"
    return f"{head}{latex_of(table(values))}\n"


def render(
    values: Mapping[str, Any],
    figures: Mapping[str, Sequence[Panel]],
    inks: Mapping[str, Colour],
    looks: Mapping[str, str],
) -> str:
    """Return the HTML page. `figures`: figure name -> panels; `inks` and `looks`: name -> colour, line style."""
    swatches = Swatches(inks, {**SHAPES, **looks})
    return page_of(
        files(__package__) / "paper.html.j2",
        values["locfuse"],
        swatches,
        values=values,
        table=Markup(html(table(values), swatches)),
        conclusion=conclusion(values),
        distances=Markup(html(distances(values))),
        sections=[section_drawings(_section(name, figures[name]), swatches) for name in FIGURES],
    )


def _section(name: str, panels: Sequence[Panel]) -> Section:
    """Return a figure of the article as a section whose legend names every curve."""
    title, columns = FIGURES[name]
    keyed = tuple(replace(panel, keys=tuple(mark.of for mark in panel.marks)) for panel in panels)
    return Section(name, title, "", keyed, columns=columns)
