"""How accurate and how honest is the filter? Many simulated drives, every configuration, every map mode.

    python -m benchmarks.accuracy --drives 50
    python -m benchmarks.accuracy --drives 50 --modes refine,grow --smooth

The drives are the paper's robot in lock-step (paper, section IV): every sensor and the truth once per 0.1 s,
compass and camera as exact as maths allows. `--set` changes the scenario, `--robot-set` what the filter is told.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import Any

import click
import numpy as np

from locfuse.cli.analysis.load import make_robot
from locfuse.formats.robot import robot_toml
from locfuse.fusion.data import ArrayStream, Drive, Evaluation
from locfuse.fusion.fuse import fuse
from locfuse.fusion.judge.evaluate import evaluate
from locfuse.fusion.measure import measure
from locfuse.fusion.robot import Robot
from locfuse.fusion.sensors.registry import REGISTRY
from locfuse.fusion.whole_drive.smooth import fuse_and_smooth
from locfuse.sample_logs.load import load
from locfuse.sample_logs.record import in_memory

FIRST_SEED = 1000  # the shipped logs use small seeds: nothing here has been looked at before
MODES = ("first-scan", "consider", "refine", "grow")
SMOOTHED = ("refine", "grow")  # smoothing assumes optimal weights
# Every sensor at each step of 0.1 s and truth just after: the set-up of the paper. The compass is the sketch's,
# white and calibrated; its rate and the camera's are those of the laser. The filter is told the noise as it is: of
# the camera what `locfuse tune` finds.
LOCK_STEP = (
    "compass.rate=10",
    "compass.phase=0.05",
    "compass.noise_deg=0.1",
    "compass.sigma_deg=0.1",
    "compass.hard_iron=[0, 0]",
    "compass.soft_iron=[1, 1, 0]",
    "lrf.phase=0.05",
    "lrf.duration=1e-6",
    "camera.rate=10",
    "camera.phase=0.05",
    "camera.sigma_deg=0.15",
    "truth.rate=10",
    "truth.phase=0.050001",
)


@dataclass(frozen=True)
class Task:
    """One drive and everything that is to be done with it."""

    seed: int
    scenario: str
    sets: tuple[str, ...]
    robot_sets: tuple[str, ...]
    modes: tuple[str, ...]
    configurations: tuple[tuple[str, ...], ...]
    smooth: bool = False


def streams_by_role(topics: dict[str, ArrayStream], tables: dict[str, Any]) -> dict[str, ArrayStream]:
    """Return the streams that the robot's tables name."""
    roles = ("wheels", "truth", *REGISTRY)
    return {r: topics[tables[r]["topic"]] for r in roles if r in tables and tables[r].get("topic") in topics}


def drive(task: Task) -> dict[str, dict[str, Any]]:
    """Simulate one drive and judge it: "<mode> <configuration>" -> figures."""
    topics, tables, _ = in_memory(load(task.scenario, task.sets), task.seed)
    found: dict[str, dict[str, Any]] = {}
    measured = None
    for mode in task.modes:
        sets = robot_toml.apply_sets((f"lrf.map={mode}", *task.robot_sets))
        robot = make_robot(robot_toml.layered(tables, sets))
        measured = measured or measure(streams_by_role(topics, tables), robot)
        for sensors in task.configurations:
            if set(sensors) <= set(measured.measurements):
                for judged in judgements(measured, robot, sensors, task.smooth and mode in SMOOTHED):
                    found[f"{mode} {judged.name}"] = figures(judged)
    return found


def judgements(measured: Drive, robot: Robot, sensors: tuple[str, ...], smooth: bool) -> list[Evaluation]:
    """Judge the filter, and where asked and there is something to smooth, the smoother."""
    found = fuse_and_smooth(measured, robot, sensors) if smooth and sensors else (fuse(measured, robot, sensors),)
    return [evaluate(e, measured) for e in found]


def figures(judged: Evaluation) -> dict[str, Any]:
    """Return what the table needs of one run."""
    keys = ("position_rmse_m", "heading_rmse_deg", "anees")
    nis = {s: f.nis for s, f in judged.sensors.items()}
    return {**{k: judged.figures[k] for k in keys}, "nis": nis, "nees": per_state(judged)}


def per_state(judged: Evaluation) -> list[float]:
    """Mean squared error over predicted variance of x, y and theta, each on its own."""
    if judged.heading is None:
        return []
    e = np.column_stack((judged.deviation, judged.heading))
    good = (judged.sigma > 0).all(axis=1)
    ratios: list[float] = ((e[good] / judged.sigma[good]) ** 2).mean(axis=0).tolist()
    return ratios


def over_drives(results: Sequence[dict[str, dict[str, Any]]]) -> dict[str, dict[str, float]]:
    """Return for every mode and configuration the mean, median and spread over drives."""
    table: dict[str, dict[str, float]] = {}
    for name in results[0]:
        rows = [r[name] for r in results if name in r]
        position = np.array([r["position_rmse_m"] for r in rows])
        table[name] = {
            "drives": len(rows),
            "position_rmse_mm": float(1000 * np.sqrt((position**2).mean())),
            "mean_mm": float(1000 * position.mean()),
            "median_mm": float(1000 * np.median(position)),
            "worst_mm": float(1000 * position.max()),
            "heading_rmse_deg": math.sqrt(float(np.mean([r["heading_rmse_deg"] ** 2 for r in rows]))),
            "anees": float(np.mean([r["anees"] for r in rows])),
            **{
                f"nees_{s}": float(np.mean([r["nees"][i] for r in rows]))
                for i, s in enumerate(("x", "y", "theta"))
            },
        }
    return table


def markdown(table: dict[str, dict[str, float]]) -> str:
    """Return the table for people."""
    lines = [
        "| map, configuration | rmse of all | mean of drives | median | worst | heading | ANEES | x | y | theta |",
        "|---|--:|--:|--:|--:|--:|--:|--:|--:|--:|",
    ]
    for name, r in table.items():
        lines.append(
            f"| {name} | {r['position_rmse_mm']:.2f} mm | {r['mean_mm']:.2f} | {r['median_mm']:.2f} "
            f"| {r['worst_mm']:.2f} "
            f"| {r['heading_rmse_deg']:.4f}° | {r['anees']:.2f} | {r['nees_x']:.2f} | {r['nees_y']:.2f} "
            f"| {r['nees_theta']:.2f} |"
        )
    return "\n".join(lines)


def run(task: Task, drives: int, jobs: int) -> list[dict[str, dict[str, Any]]]:
    """Run the task over `drives` seeds."""
    tasks = [Task(FIRST_SEED + i, *task_fields(task)) for i in range(drives)]
    if jobs == 1:
        return [drive(t) for t in tasks]
    with ProcessPoolExecutor(jobs) as pool:
        return list(pool.map(partial(drive), tasks))


def task_fields(task: Task) -> tuple[Any, ...]:
    """Return everything but the seed."""
    return task.scenario, task.sets, task.robot_sets, task.modes, task.configurations, task.smooth


@click.command()
@click.option("--drives", default=50, show_default=True)
@click.option("--scenario", default="rounded_rectangle", show_default=True)
@click.option("--set", "sets", multiple=True, help="Scenario key, after lock-step.")
@click.option("--robot-set", "robot_sets", multiple=True, help="robot.toml key: what the filter is told.")
@click.option("--modes", default=",".join(MODES), show_default=True)
@click.option(
    "--as-shipped", is_flag=True, help="Sensors asynchronous as in the shipped scenario, not in lock-step."
)
@click.option("--no-camera", is_flag=True, help="Leave out the camera: rendering takes most of the time.")
@click.option("--smooth", is_flag=True, help="Also judge the smoothed drives, where the map allows it.")
@click.option("--jobs", default=2, show_default=True)
@click.option("--json", "as_json", is_flag=True)
def main(
    drives: int,
    scenario: str,
    sets: tuple[str, ...],
    robot_sets: tuple[str, ...],
    modes: str,
    as_shipped: bool,
    no_camera: bool,
    smooth: bool,
    jobs: int,
    as_json: bool,
) -> None:
    """Judge every configuration over many simulated drives."""
    base = () if as_shipped else LOCK_STEP
    camera = ("camera.enabled=false",) if no_camera else ()
    sensors = ("compass", "lrf") if no_camera else ("compass", "lrf", "camera")
    configurations = ((), *((s,) for s in sensors), sensors)
    task = Task(0, scenario, (*base, *camera, *sets), robot_sets, tuple(modes.split(",")), configurations, smooth)
    table = over_drives(run(task, drives, jobs))
    click.echo(json.dumps(table, indent=2) if as_json else markdown(table))


if __name__ == "__main__":
    main()
