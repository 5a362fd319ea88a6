"""Does the verdict find the useless and the harmful sensor? Many simulated drives, all subsets, one word each.

    python -m benchmarks.verdicts --drives 20

`noise`: a compass whose noise is 180 degrees, and told so. `bias`: a compass that is constantly 5 degrees off,
told to be absolute and good to 1 degree. `plain`: the scenario as shipped.
"""

from __future__ import annotations

from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial

import click

from benchmarks.accuracy import FIRST_SEED, streams_by_role
from locfuse.cli.analysis.load import make_robot
from locfuse.formats.robot import robot_toml
from locfuse.fusion.fuse import fuse
from locfuse.fusion.judge.credit import credit, subsets
from locfuse.fusion.judge.evaluate import evaluate
from locfuse.fusion.measure import measure
from locfuse.sample_logs.load import load
from locfuse.sample_logs.record import in_memory


@dataclass(frozen=True)
class Case:
    """What the sensors are, and what the filter is told of them."""

    scenario: tuple[str, ...]
    robot: tuple[str, ...]


# the compass' offset is minus the direction of north: 65 degrees counter-clockwise from the map's x axis
PERFECT = ("compass.hard_iron=[0, 0]", "compass.soft_iron=[1, 1, 0]", "room.north_deg=65")
CASES = {
    "plain": Case((), ()),
    "noise": Case(("compass.noise_deg=180",), ("compass.sigma_deg=180", "compass.field_tolerance=1e9")),
    "bias": Case(PERFECT, ("compass.offset_deg=-60", "compass.sigma_deg=1")),
}


def drive(seed: int, name: str, camera: bool) -> dict[str, str]:
    """Simulate one drive, run every subset, and return each sensor's verdict."""
    case = CASES[name]
    off = () if camera else ("camera.enabled=false",)
    topics, tables, _ = in_memory(load("rounded_rectangle", (*case.scenario, *off)), seed)
    robot = make_robot(robot_toml.layered(tables, robot_toml.apply_sets(case.robot)))
    measured = measure(streams_by_role(topics, tables), robot)
    sensors = list(measured.measurements)
    judged = {frozenset(s): evaluate(fuse(measured, robot, s), measured) for s in subsets(sensors)}
    found = credit(judged, sensors)
    return {s: c.verdict for s, c in found.sensors.items()} if found else {}


@click.command()
@click.option("--drives", default=20, show_default=True)
@click.option("--case", "cases", multiple=True, type=click.Choice(list(CASES)), help="[default: all]")
@click.option("--camera/--no-camera", default=False, help="Rendering takes most of the time.")
@click.option("--jobs", default=2, show_default=True)
def main(drives: int, cases: tuple[str, ...], camera: bool, jobs: int) -> None:
    """Count the verdicts over many drives."""
    for name in cases or CASES:
        with ProcessPoolExecutor(jobs) as pool:
            seeds = range(FIRST_SEED, FIRST_SEED + drives)
            results = list(pool.map(partial(drive, name=name, camera=camera), seeds))
        for sensor in results[0]:
            counts = Counter(r[sensor] for r in results)
            click.echo(f"{name:6} {sensor:8} " + ", ".join(f"{n} {v}" for v, n in counts.most_common()))


if __name__ == "__main__":
    main()
