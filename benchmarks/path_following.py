"""Figure 14 of the paper: the way a robot really takes when it steers on odometry, and when it steers on the EKF.

    python -m benchmarks.path_following -o figures

Draws fig14_rounded_rectangle and fig14_rounded_triangle (SVG, PDF) and prints how far from its path the robot was.
"""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import NamedTuple

import click
import numpy as np

from locfuse.cli.jobs.simulate import localise
from locfuse.formats.drawing.for_paper import draw
from locfuse.formats.figures.panels import Curve, Panel, Strokes
from locfuse.formats.whole_files import write_results
from locfuse.fusion.data import Array
from locfuse.sample_logs.load import load
from locfuse.sample_logs.paths import polygon
from locfuse.sample_logs.record import in_memory
from locfuse.sample_logs.scenario import Polygon, Scenario

PATHS = {"a": "rounded_rectangle", "b": "rounded_triangle"}
WITHOUT, WITH, INTENDED, WALLS = "on odometry", "on the EKF", "path", "walls"
INKS = {WITHOUT: "#cb7627", WITH: "#1a34b0", INTENDED: "#0d0f12", WALLS: "#9aa3af"}


class Driven(NamedTuple):
    """One drive of one scenario."""

    scenario: str
    seed: int
    xy: Array  # (n, 2) where the robot really was
    path: Array  # (m, 2) where it should have been


def drive(scenario: str, seed: int) -> Driven:
    """Drive a scenario with its own estimator in the loop."""
    chosen = load(scenario)
    if not isinstance(chosen.path, Polygon):
        raise TypeError(f"{scenario} follows no closed path")
    *_, outcome = in_memory(chosen, seed, localise(chosen.control.estimator))
    return Driven(scenario, seed, outcome.truth[::10, :2], polygon(chosen.path).pose[:, :2])


def distances(driven: Driven) -> Array:
    """Return the distance of every point driven to the nearest point of the path, (n,) m; it has one every cm."""
    return np.array([np.hypot(*(driven.path - p).T).min() for p in driven.xy])


def panel(letter: str, without: Driven, with_ekf: Driven, scenario: Scenario) -> Panel:
    """Return figure 14 a or b."""
    x, y = scenario.room.size
    sides = [((0, 0), (x, 0)), ((x, 0), (x, y)), ((x, y), (0, y)), ((0, y), (0, 0))]
    ends = np.array([*sides, *(((a, b), (c, d)) for a, b, c, d in scenario.room.plates)], float)
    closed = np.concatenate((without.path, without.path[:1]))
    curves = {INTENDED: closed, WITHOUT: without.xy, WITH: with_ekf.xy}
    return Panel(
        name=f"fig14_{PATHS[letter]}",
        title=f"Figure 14 {letter}: {PATHS[letter].replace('_', ' ')}",
        y_label="y [m]",
        x_label="x [m]",
        marks=(
            Strokes(WALLS, ends),
            *(Curve(of, xy[:, 0], xy[:, 1]) for of, xy in curves.items()),
        ),
        equal=True,
        keys=(INTENDED, WITHOUT, WITH),
    )


@click.command()
@click.option("-o", "--out", type=click.Path(path_type=Path, file_okay=False), help="Folder for the figures.")
@click.option("--seed", default=1, show_default=True)
def main(out: Path | None, seed: int) -> None:
    """Drive both paths with and without the EKF in the loop."""
    names = [name for path in PATHS.values() for name in (path, f"{path}_ekf")]
    with ProcessPoolExecutor(2) as pool:
        driven = dict(zip(names, pool.map(drive, names, [seed] * len(names)), strict=True))
    click.echo("| figure | steered on | rms distance from the path | largest |\n|---|---|--:|--:|")
    for letter, path in PATHS.items():
        for name, word in ((path, "odometry"), (f"{path}_ekf", "EKF, all sensors")):
            d = distances(driven[name])
            click.echo(f"| 14 {letter} | {word} | {np.sqrt((d**2).mean()):.3f} m | {d.max():.3f} m |")
    if out is not None:
        files: dict[str, str | bytes] = {}
        for letter, path in PATHS.items():
            drawn = panel(letter, driven[path], driven[f"{path}_ekf"], load(path))
            files[f"{drawn.name}.svg"], files[f"{drawn.name}.pdf"] = draw(drawn, INKS)
        write_results(out, files, overwrite=True)
        click.echo(f"\n{out}: {', '.join(sorted(files))}")


if __name__ == "__main__":
    main()
