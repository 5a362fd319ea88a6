"""Is the covariance honest when nobody knows exactly where the laser sits? Simulated drives, the mount drawn anew.

    python -m benchmarks.mounts --drives 20

The laser of each drive sits where its prior allows: told values are off by a draw from lrf.sigma_x, sigma_y and
sigma_yaw_deg. `stated` tells the filter these sigmas, `certain` does not, `exact` tells it the true mount.
"""

from __future__ import annotations

from typing import Any

import click
import numpy as np

from locfuse.cli.analysis.load import make_robot
from locfuse.formats.robot import robot_toml
from locfuse.fusion.data import Drive
from locfuse.fusion.fuse import fuse
from locfuse.fusion.judge.evaluate import evaluate
from locfuse.fusion.measure import measure
from locfuse.fusion.robot import Robot
from locfuse.sample_logs.load import load
from locfuse.sample_logs.record import in_memory

from .accuracy import FIRST_SEED, LOCK_STEP, figures, markdown, over_drives, streams_by_role

PRIOR = {"sigma_x": 0.01, "sigma_y": 0.01, "sigma_yaw_deg": 0.5}
SENSORS = (["lrf"], ["compass", "lrf"])
MODES = ("grow", "refine", "consider")


def told(tables: dict[str, Any], seed: int, mode: str, how: str) -> Robot:
    """Return what the filter is told of the robot."""
    keys: dict[str, Any] = {"map": mode}
    off = np.random.default_rng(seed).normal(size=3) * np.array(list(PRIOR.values()))
    if how != "exact":
        keys |= {k: float(tables["lrf"].get(k, 0.0) + d) for k, d in zip(("x", "y", "yaw_deg"), off, strict=True)}
    keys |= PRIOR if how == "stated" else dict.fromkeys(PRIOR, 0.0)
    return make_robot(robot_toml.layered(tables, {"lrf": keys}))


def drive(seed: int, modes: tuple[str, ...]) -> dict[str, dict[str, Any]]:
    """Simulate one drive and judge it under every map and every way of telling."""
    topics, tables, _ = in_memory(load("rounded_rectangle", (*LOCK_STEP, "camera.enabled=false")), seed)
    found = {}
    for how in ("stated", "certain", "exact"):
        measured: Drive | None = None
        for mode in modes:
            robot = told(tables, seed, mode, how)
            measured = measured or measure(streams_by_role(topics, tables), robot)
            for sensors in SENSORS:
                judged = evaluate(fuse(measured, robot, sensors), measured)
                found[f"{mode} {judged.name}, {how}"] = figures(judged)
    return found


@click.command()
@click.option("--drives", default=20, show_default=True)
@click.option("--modes", default=",".join(MODES), show_default=True)
def main(drives: int, modes: str) -> None:
    """Print errors and ANEES of drives whose laser sits a little off where it should."""
    seeds = range(FIRST_SEED, FIRST_SEED + drives)
    click.echo(markdown(over_drives([drive(seed, tuple(modes.split(","))) for seed in seeds])))


if __name__ == "__main__":
    main()
