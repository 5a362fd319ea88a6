"""How well does the laser hold a simulated building, whose truth is known? One line per run, then their means.

    python -m benchmarks.simulated_building --drives 20
    python -m benchmarks.simulated_building --scenario hall --drives 5 --robot-set lrf.recover=false

Every drive has another seed: other noise, other walls, other walks of the people. Only wheels and laser are fused,
causally and smoothed. The position error is that after the best rigid alignment (SE(2), without scale) with the
truth; ANEES is that of the poses as they are, since both start at the known start. The CPU time of a smoothed run
includes the causal run under it.

Version 0.1 on these drives, from seed 2000 on (no drive was called lost):

| scenario | drives | aligned rmse (worst drive) | unaligned | heading | ANEES | lost | CPU |
|---|--:|--:|--:|--:|--:|--:|--:|
| office, causal | 3 | 0.165 m (0.197) | 0.344 m | 1.24° | 39.9 | 0% | 34 s |
| hall, causal | 2 | 2.41 m (3.69) | 2.86 m | 6.30° | 170 | 0% | 3.7 s |
| hall, smoothed | 1 | 3.42 m | 4.59 m | 6.71° | 454 | 0% | 78 s |
"""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from typing import Any

import click
import numpy as np

from benchmarks.accuracy import streams_by_role
from locfuse.cli.analysis.load import make_robot
from locfuse.formats.robot import robot_toml
from locfuse.fusion.data import Drive, Estimates
from locfuse.fusion.fuse import fuse
from locfuse.fusion.judge.evaluate import evaluate
from locfuse.fusion.measure import measure
from locfuse.fusion.robot import Robot
from locfuse.fusion.whole_drive.smooth import fuse_and_smooth
from locfuse.sample_logs.load import load
from locfuse.sample_logs.record import in_memory

FIRST_SEED = 2000  # nothing else looks at these drives
SENSORS = ["lrf"]
FIGURES = ("aligned_m", "aligned_worst_m", "position_m", "heading_deg", "anees", "lost")


def one_drive(
    scenario: str, seed: int, sets: tuple[str, ...], robot_sets: tuple[str, ...], smooth: bool
) -> Iterator[dict[str, Any]]:
    """Simulate a drive, fuse it causally and smoothed, and yield the figures of each."""
    begin = time.process_time()
    topics, tables, outcome = in_memory(load(scenario, ("compass.enabled=false", *sets)), seed)
    simulated = time.process_time() - begin
    robot = make_robot(robot_toml.layered(tables, robot_toml.apply_sets(robot_sets)))
    drive = measure(streams_by_role(topics, tables), robot)
    facts = {"seed": seed, "way_m": outcome.way, "duration_s": outcome.duration, "simulation_cpu_s": simulated}
    for kind in ("causal", "smoothed") if smooth else ("causal",):
        yield {**facts, "kind": kind, **timed(drive, robot, kind == "smoothed")}


def timed(drive: Drive, robot: Robot, smooth: bool) -> dict[str, Any]:
    """Fuse once and return figures and CPU seconds; an error of the filter is its result."""
    begin = time.process_time()
    try:
        estimates = fuse_and_smooth(drive, robot, SENSORS)[-1] if smooth else fuse(drive, robot, SENSORS)
    except Exception as error:  # the next drive is still to be judged
        return {"failed": f"{type(error).__name__}: {error}"}
    seconds = time.process_time() - begin
    return {**judged(estimates, drive), "cpu_s": seconds, "lines": len(estimates.final_map)}


def judged(estimates: Estimates, drive: Drive) -> dict[str, Any]:
    """Return errors, consistency and the share of the drive's time in which the robot was called lost."""
    aligned, plain = evaluate(estimates, drive, "se2").figures, evaluate(estimates, drive).figures
    lost = sum(end - begin for begin, end in estimates.lost)
    return {
        "aligned_m": aligned["position_rmse_m"],
        "aligned_worst_m": aligned["position_max_m"],
        "position_m": plain["position_rmse_m"],
        "heading_deg": plain["heading_rmse_deg"],
        "anees": plain["anees"],
        "lost": lost / float(drive.t[-1] - drive.t[0]),
    }


def markdown(rows: list[dict[str, Any]], scenario: str) -> str:
    """Return the means over all drives as a table, with the worst aligned error of any drive."""
    lines = [
        "| scenario | drives | failed | aligned rmse (worst drive) | unaligned | heading | ANEES | lost | CPU |",
        "|---|--:|--:|--:|--:|--:|--:|--:|--:|",
    ]
    for kind in ("causal", "smoothed"):
        of_kind = [r for r in rows if r["kind"] == kind]
        good = [r for r in of_kind if "failed" not in r]
        if good:
            m = {key: float(np.mean([r[key] for r in good])) for key in (*FIGURES, "cpu_s")}
            worst = max(r["aligned_m"] for r in good)
            cells = (
                f"{scenario}, {kind}",
                f"{len(of_kind)}",
                f"{len(of_kind) - len(good)}",
                f"{m['aligned_m']:.3f} m ({worst:.3f})",
                f"{m['position_m']:.3f} m",
                f"{m['heading_deg']:.2f}°",
                f"{m['anees']:.3g}",
                f"{m['lost']:.0%}",
                f"{m['cpu_s']:.1f} s",
            )
            lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


@click.command()
@click.option("--scenario", default="office", show_default=True)
@click.option("--drives", default=20, show_default=True)
@click.option("--set", "sets", multiple=True, help="Scenario key.")
@click.option("--robot-set", "robot_sets", multiple=True, help="robot.toml key: how the filter is configured.")
@click.option("--smooth/--no-smooth", default=True, show_default=True, help="Also judge the smoothed drives.")
def main(scenario: str, drives: int, sets: tuple[str, ...], robot_sets: tuple[str, ...], smooth: bool) -> None:
    """Judge the laser over simulated drives through a building; one JSON line per run, then a table."""
    found = []
    for seed in range(FIRST_SEED, FIRST_SEED + drives):
        for row in one_drive(scenario, seed, sets, robot_sets, smooth):
            found.append(row)
            click.echo(json.dumps(row))
    click.echo(markdown(found, scenario))


if __name__ == "__main__":
    main()
