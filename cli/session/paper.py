"""`locfuse paper`: the paper's experiment repeated, with our filter and with the equations as printed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import msgspec
from msgspec.structs import replace

from locfuse.cli.analysis import outputs
from locfuse.cli.analysis.settings import Progress, silent
from locfuse.formats.figures.palette import looks_of, traces_of
from locfuse.formats.figures.panels import Panel, Spots
from locfuse.formats.figures.sections import sections
from locfuse.fusion.sensors.registry import colours

from . import path_following
from .path_following import Distance, Driven
from .result import Comparison
from .session import load

if TYPE_CHECKING:
    from locfuse.formats.whole_files import Content

LOG = "rounded_rectangle"
PRESETS = {"ours": "default", "print": "paper"}  # column -> preset
FIGURES = ("position_rmse_m", "heading_rmse_deg", "anees")


class Repeated(msgspec.Struct, frozen=True):
    """Everything that came out."""

    compared: Mapping[str, Comparison]  # "ours", "print"
    driven: Mapping[str, Driven]  # the four drives of figure 14

    def rows(self) -> list[dict[str, Any]]:
        """Return a row per configuration: error figures of the print and of our filter side by side."""
        reports = {which: c.report["configurations"] for which, c in self.compared.items()}
        return [
            {
                "configuration": name,
                **{f"{which}_{key}": found[name].get(key) for which, found in reports.items() for key in FIGURES},
            }
            for name in reports["ours"]
        ]

    def distances(self) -> list[Distance]:
        """Return how far from its path each robot of figure 14 was."""
        return list(path_following.table(self.driven))

    def values(self) -> dict[str, Any]:
        """Return everything as plain values: paper.json."""
        first = self.compared["ours"].report
        return {
            "locfuse": first["locfuse"],
            "made_with": first["made_with"],
            "log": LOG,
            "seed": path_following.SEED,
            "table": self.rows(),
            "figure_14": [d._asdict() for d in self.distances()],
        }

    def panels(self, which: str) -> dict[str, list[Panel]]:
        """Return figures 12 and 13 of one filter: trajectories, deviations in X and in Y."""
        comparison = self.compared[which]
        found = {
            p.name: p for s in sections(outputs.scene(comparison.compared, comparison.drawn)) for p in s.panels
        }
        tail = "" if which == "ours" else "_print"
        map_ = found["trajectories"]
        bare = replace(map_, marks=tuple(m for m in map_.marks if not (isinstance(m, Spots) and m.of == "time")))
        return {
            f"fig12{tail}": [replace(bare, name=f"fig12{tail}")],
            f"fig13{tail}": [replace(found[f"deviation_{a}"], name=f"fig13{tail}_{a}") for a in ("x", "y")],
        }


def repeat(progress: Progress = silent, jobs: int = 2) -> Repeated:
    """Compare the shipped log under both filters, and drive figure 14's paths."""
    compared = {
        which: load(LOG, preset=preset, progress=progress).compare(smooth=False)
        for which, preset in PRESETS.items()
    }
    progress("driving the paths of figure 14")
    return Repeated(compared, path_following.drives(jobs=jobs))


def files(found: Repeated) -> dict[str, Content]:
    """Return table, figures and page by their files' names."""
    from locfuse.formats.figures.for_paper import draw, draw_column
    from locfuse.formats.report import json_report, paper_page

    out: dict[str, Content] = {}
    shown: dict[str, list[Panel]] = {}
    inks, looks = colours_of(found), dict(path_following.LOOKS)
    light = {name: colour.light for name, colour in inks.items()}
    for which in PRESETS:
        looks |= looks_of(traces_of(found.compared[which].compared.estimates))
        shown |= found.panels(which)
    for name, panels in shown.items():
        drawn = draw(panels[0], light, looks) if len(panels) == 1 else draw_column(panels, light, looks)
        out[f"{name}.svg"], out[f"{name}.pdf"] = drawn
    for panel in path_following.panels(found.driven):
        shown[panel.name] = [panel]
        out[f"{panel.name}.svg"], out[f"{panel.name}.pdf"] = draw(panel, light, looks)
    values = json_report.plain(found.values())
    out["paper.json"] = json_report.encode(values)
    out["table.tex"] = paper_page.latex(values)
    out["table.csv"] = paper_page.csv(values)
    out["paper.html"] = paper_page.render(values, shown, inks, looks)
    return out


def colours_of(found: Repeated) -> dict[str, Any]:
    """Return the colour of everything that is drawn."""
    from locfuse.formats.figures import palette

    traces = traces_of(found.compared["ours"].compared.estimates)
    return {**palette.ROLES, **palette.colours(traces, colours()), **path_following.INKS}


def lines(found: Repeated) -> Sequence[str]:
    """Return a line per drive of figure 14."""
    return [f"fig. {d.figure}, {d.steered}: {d.rms:.3f} m rms from the path" for d in found.distances()]
