"""The paper's experiment (`locfuse paper`), repeated with locfuse's filter and with the equations as printed."""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import Any, NamedTuple

import msgspec
import numpy as np
from msgspec.structs import replace

from locfuse.cli.analysis.settings import Progress
from locfuse.formats.figures import palette
from locfuse.formats.figures.for_paper import draw
from locfuse.formats.figures.panels import Curve, Panel, Spots, Strokes
from locfuse.formats.figures.sections import sections
from locfuse.formats.report import json_report, paper_page, table
from locfuse.formats.whole_files import Content
from locfuse.fusion.data import Array, Colour
from locfuse.fusion.sensors.registry import colours
from locfuse.sample_logs import scenario as scenarios
from locfuse.sample_logs.paths import polygon
from locfuse.sample_logs.scenario import Polygon
from locfuse.sample_logs.simulate import in_memory

from . import result
from .result import Comparison
from .session import load
from .simulate import localise

PATHS = {"a": "rounded_rectangle", "b": "rounded_triangle"}
WITHOUT, WITH, INTENDED, WALLS = "steered on odometry", "steered on the EKF", "path", "walls"
COLOURS = {
    WITHOUT: Colour("#cb7627", "#ec8c10"),
    WITH: Colour("#1a34b0", "#3a78de"),
    INTENDED: Colour("#0d0f12", "#f4f5f7"),
    WALLS: Colour("#9aa3af", "#667080"),
}
LINE_STYLES = {WITHOUT: "dash", WITH: "over"}  # the planned path is seen through the gaps of the dashes
SEED = 1
LOG = "rounded_rectangle"
PRESETS = {"ours": "default", "print": "paper"}  # column -> preset
FIGURES = ("position_rmse_m", "heading_rmse_deg", "anees")


class Driven(NamedTuple):
    """One simulated drive of one scenario, for figure 14."""

    xy: Array  # (n, 2) m, true positions
    path: Array  # (m, 2) m, planned positions


def drive(scenario: str) -> Driven:
    """Simulate a scenario whose controller uses the scenario's estimator."""
    chosen = scenarios.load(scenario)
    assert isinstance(chosen.path, Polygon)
    *_, outcome = in_memory(chosen, SEED, localise(chosen.control.estimator))
    return Driven(outcome.truth[::10, :2], polygon(chosen.path).pose[:, :2])


def path_panels(driven: Mapping[str, Driven]) -> list[Panel]:
    """Return figures 14 a and 14 b: the driven paths."""
    panels = []
    for letter, path in PATHS.items():
        room = scenarios.load(path).room
        x, y = room.size
        sides = [((0, 0), (x, 0)), ((x, 0), (x, y)), ((x, y), (0, y)), ((0, y), (0, 0))]
        ends = np.array([*sides, *(((a, b), (c, d)) for a, b, c, d in room.plates)], float)
        planned = driven[path].path
        curves = {INTENDED: np.concatenate((planned, planned[:1]))}
        curves |= {WITHOUT: driven[path].xy, WITH: driven[f"{path}_ekf"].xy}
        title = f"Figure 14 {letter}: {path.replace('_', ' ')}"
        panel = Panel(
            name=f"fig14{letter}",
            title=title,
            y_label="y, m",
            x_label="x, m",
            marks=(Strokes(WALLS, ends), *(Curve(of, xy[:, 0], xy[:, 1]) for of, xy in curves.items())),
            summary=f"{title}: the way that the robot really took, steered on odometry and on the EKF.",
            equal=True,
            keys=(INTENDED, WITHOUT, WITH),
        )
        panels.append(panel)
    return panels


class Repeated(msgspec.Struct, frozen=True):
    """The results of the repeated experiment."""

    compared: Mapping[str, Comparison]  # "ours", "print"
    driven: Mapping[str, Driven]  # the four drives of figure 14

    def rows(self) -> list[dict[str, Any]]:
        """Return a row per configuration with the error figures of both filters."""
        reports = {which: c.report["configurations"] for which, c in self.compared.items()}
        return [
            {
                "configuration": name,
                **{f"{which}_{key}": found[name].get(key) for which, found in reports.items() for key in FIGURES},
            }
            for name in reports["ours"]
        ]

    def distances(self) -> list[dict[str, Any]]:
        """Return the distance [m] of each drive of figure 14 to its path: rms and largest."""
        rows = []
        for letter, path in PATHS.items():
            for name, steered in ((path, WITHOUT), (f"{path}_ekf", WITH)):
                xy, planned = self.driven[name]
                d = np.array([np.hypot(*(planned - p).T).min() for p in xy])
                rms = float(np.sqrt((d**2).mean()))
                rows.append({"figure": f"14 {letter}", "steered": steered, "rms": rms, "largest": float(d.max())})
        return rows

    def values(self) -> dict[str, Any]:
        """Return all results as plain values: paper.json."""
        first = self.compared["ours"].report
        return {
            "locfuse": first["locfuse"],
            "made_with": first["made_with"],
            "log": LOG,
            "seed": SEED,
            "table": self.rows(),
            "figure_14": self.distances(),
        }

    def panels(self, which: str) -> dict[str, list[Panel]]:
        """Return figures 12 (trajectories) and 13 (deviations) of a filter: "ours", or "print" (as printed)."""
        found = {p.name: p for s in sections(result.scene(self.compared[which].compared)) for p in s.panels}
        tail = "" if which == "ours" else "_print"
        map_ = found["trajectories"]
        bare = replace(map_, marks=tuple(m for m in map_.marks if not (isinstance(m, Spots) and m.of == "time")))
        return {
            f"fig12{tail}": [replace(bare, name=f"fig12{tail}")],
            f"fig13{tail}": [replace(found[f"deviation_{a}"], name=f"fig13{tail}_{a}") for a in ("x", "y")],
        }


def repeat(progress: Progress, jobs: int) -> Repeated:
    """Compare the sample log with both filters, and simulate the drives of figure 14."""
    compared = {
        which: load(LOG, preset=preset, progress=progress).compare(smooth=False)
        for which, preset in PRESETS.items()
    }
    progress("driving the paths of figure 14")
    # each of the two paths twice: steered on odometry, and steered on the EKF
    names = [name for path in PATHS.values() for name in (path, f"{path}_ekf")]
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
        return Repeated(compared, dict(zip(names, pool.map(drive, names), strict=True)))


def files(found: Repeated, values: Mapping[str, Any]) -> dict[str, Content]:
    """Return file name -> content for table, figures and page."""
    out: dict[str, Content] = {}
    shown: dict[str, list[Panel]] = {}
    traces = palette.traces_of(found.compared["ours"].compared.estimates)
    inks = {**palette.colours(traces, colours()), **COLOURS}
    looks = dict(LINE_STYLES)
    light = {name: colour.light for name, colour in inks.items()}
    for which in PRESETS:
        looks |= palette.looks_of(palette.traces_of(found.compared[which].compared.estimates))
        shown |= found.panels(which)
    shown |= {panel.name: [panel] for panel in path_panels(found.driven)}
    for name, panels in shown.items():
        out[f"{name}.svg"], out[f"{name}.pdf"] = draw(panels, light, looks)
    out["paper.json"] = json_report.encode(values)
    out["table.tex"] = paper_page.latex(values)
    out["table.csv"] = table.csv(paper_page.table(values))
    out["paper.html"] = paper_page.render(values, shown, inks, looks)
    return out
