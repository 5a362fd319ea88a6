"""Does tuning find the noise that was drawn? Simulated drives, told of noise that is far off.

    python -m benchmarks.tuning --drives 3
    python -m benchmarks.tuning --drives 1 --scenario straight_runs
    python -m benchmarks.tuning --drives 1 --set camera.enabled=true

Standard deviations are told 10 times too large and too small (wheels.noise, a variance: 100 times). The table says
what was found over what the simulator drew from. The compass has no iron, so that its noise is white.
"""

from __future__ import annotations

import time
from typing import Any

import click

from locfuse.cli.analysis.load import make_robot
from locfuse.formats.robot import robot_toml
from locfuse.fusion.measure import measure
from locfuse.fusion.robot import Robot
from locfuse.fusion.sensors.registry import REGISTRY
from locfuse.fusion.tune.tune import Trial, Tuned, tune
from locfuse.sample_logs.load import load
from locfuse.sample_logs.record import in_memory

from .accuracy import FIRST_SEED, streams_by_role

SETS = (
    "compass.hard_iron=[0, 0]",
    "compass.soft_iron=[1, 1, 0]",
    "compass.sigma_deg=0.5",
    "camera.enabled=false",
)


def told_wrong(tables: dict[str, Any], factor: float) -> dict[str, Any]:
    """Return the robot's tables with every standard deviation `factor` times too large."""
    robot = make_robot(tables)
    wrong: dict[str, dict[str, float]] = {"wheels": {"noise": robot.wheels.noise * factor**2}}
    for sensor in (s for s in REGISTRY if s in tables):
        settings = robot.settings(sensor)
        wrong[sensor] = {key: getattr(settings, key) * factor for key in REGISTRY[sensor].noise_keys}
    return robot_toml.merge(tables, wrong)


def tuned(scenario: str, sets: tuple[str, ...], seed: int, factor: float) -> Tuned:
    """Return what tuning makes of one simulated drive."""
    topics, tables, _ = in_memory(load(scenario, (*SETS, *sets)), seed)
    streams = streams_by_role(topics, tables)
    robot = make_robot(told_wrong(tables, factor))
    drive = measure(streams, robot)

    def again(_: int, sensor: str, now: Robot) -> Any:
        return measure(streams, now).measurements[sensor]

    return tune([Trial(scenario, drive, robot)], list(drive.measurements), remeasure=again)


@click.command()
@click.option("--drives", default=3, show_default=True)
@click.option("--scenario", default="tour", show_default=True)
@click.option("--set", "sets", multiple=True, help="Change the scenario.")
def main(drives: int, scenario: str, sets: tuple[str, ...]) -> None:
    """Print what was found over what is true."""
    click.echo("| seed | told | key | found / true | CPU |\n|---|--:|---|--:|--:|")
    for seed in range(FIRST_SEED, FIRST_SEED + drives):
        for factor in (10.0, 0.1):
            start = time.process_time()
            found = tuned(scenario, sets, seed, factor)
            seconds = time.process_time() - start
            for row in found.rows:
                true = row.before / (factor**2 if row.key == "wheels.noise" else factor)
                click.echo(f"| {seed} | {factor:g} | {row.key} | {row.after / true:.3f} | {seconds:.0f} s |")
            for flag in found.flags:
                click.echo(f"| {seed} | {factor:g} | {flag} | | |")


if __name__ == "__main__":
    main()
