"""Do the verdicts on noise name the right sensor and the right cure? Wrong settings by the dozen, without truth.

    python -m benchmarks.noise_verdicts --seeds 20

Each seed is one lap of the paper's robot. The filter is told the noise that the simulator drew, except for one
setting that is wrong; `compare`'s runs are judged. Right is: the sensor's verdict is the expected one, its words
name the key to set, the value goes the right way, and no other sensor is accused. A clean drive gets no complaint.
The simulated camera is more exact than any real mirror, so 0.5 degrees of white noise are added to its bearings.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, cast

import click
import numpy as np

from locfuse.cli.analysis.load import make_robot
from locfuse.formats.robot import robot_toml
from locfuse.fusion.data import Array, Drive, Stream
from locfuse.fusion.fuse import fuse
from locfuse.fusion.judge.consistency import Consistency, Run, judge
from locfuse.fusion.measure import measure
from locfuse.fusion.se2 import wrap_all
from locfuse.fusion.sensors.registry import REGISTRY
from locfuse.sample_logs.load import load
from locfuse.sample_logs.record import in_memory

FIRST_SEED = 2000
SCENARIO = ("compass.hard_iron=[0, 0]", "compass.soft_iron=[1, 1, 0]", "compass.sigma_deg=0.5")
CAMERA_NOISE = math.radians(0.5)
NORTH_DEG = -65.0  # what compass.offset_deg should be: the scenario's magnetic north
SLOW, SLOW_TIME = math.radians(1.0), 2.0  # rad, s: correlated compass noise
CONFIGURATIONS: tuple[tuple[str, ...], ...] = (
    (),
    ("compass",),
    ("lrf",),
    ("camera",),
    ("compass", "lrf", "camera"),
)


@dataclass(frozen=True)
class Case:
    """One wrong setting and what should be said of it."""

    sets: tuple[str, ...] = ()
    sensor: str = ""  # none: nobody
    verdict: str = ""
    key: str = ""
    right: Callable[[float], bool] = lambda value: True
    slow_compass: bool = False


CASES = {
    "clean": Case(),
    "compass sigma / 3": Case(
        ("compass.sigma_deg=0.1667",), "compass", "understated", "compass.sigma_deg", lambda v: 0.3 < v < 0.8
    ),
    "compass sigma * 3": Case(
        ("compass.sigma_deg=1.5",), "compass", "overstated", "compass.sigma_deg", lambda v: 0.3 < v < 0.8
    ),
    "lrf sigma / 3": Case(
        ("lrf.sigma_range=0.01", "lrf.sigma_angle_deg=0.0833"),
        "lrf",
        "understated",
        "lrf.sigma_range",
        lambda v: 0.015 < v < 0.06,
    ),
    "lrf sigma * 3": Case(
        ("lrf.sigma_range=0.09", "lrf.sigma_angle_deg=0.75"),
        "lrf",
        "overstated",
        "lrf.sigma_range",
        lambda v: 0.015 < v < 0.06,
    ),
    "camera sigma / 3": Case(
        ("camera.sigma_deg=0.1667",), "camera", "understated", "camera.sigma_deg", lambda v: 0.3 < v < 0.8
    ),
    "camera sigma * 3": Case(
        ("camera.sigma_deg=1.5",), "camera", "overstated", "camera.sigma_deg", lambda v: 0.3 < v < 0.8
    ),
    "compass offset + 5 deg": Case(
        (f"compass.offset_deg={NORTH_DEG + 5.0}",),
        "compass",
        "biased",
        "compass.offset_deg",
        lambda v: abs(v - NORTH_DEG) < 1.0,
    ),
    "camera zero + 3 deg": Case(
        ("camera.zero_deg=3.0",), "camera", "biased", "camera.zero_deg", lambda v: abs(v) < 1.0
    ),
    "compass noise of 2 s": Case(
        ("compass.sigma_deg=1.0",),
        "compass",
        "correlated",
        "compass.sigma_deg",
        lambda v: v > 3.0,
        slow_compass=True,
    ),
}


def drive_of(
    topics: dict[str, Any], tables: dict[str, Any], case: Case, seed: int
) -> tuple[Drive, dict[str, Consistency]]:
    """Measure and judge one drive under one case: the drive, and the verdict on every sensor."""
    robot = make_robot(robot_toml.layered(tables, robot_toml.apply_sets(case.sets)))
    roles = ("wheels", "truth", *REGISTRY)
    streams = {r: topics[tables[r]["topic"]] for r in roles if r in tables}
    drive = measure(cast("dict[str, Stream]", streams), robot)
    rng = np.random.default_rng(seed)
    drive = noisy(drive, "camera", CAMERA_NOISE * rng.normal(size=drive.measurements["camera"].z.shape))
    if case.slow_compass:
        m = drive.measurements["compass"]
        drive = noisy(drive, "compass", slow_noise(m.t, rng)[:, None])
    runs = [Run.of(drive, fuse(drive, robot, sensors)) for sensors in CONFIGURATIONS]
    return drive, judge(runs, robot)["all"]


def noisy(drive: Drive, sensor: str, noise: Array) -> Drive:
    """Add noise to what a sensor measured."""
    m = drive.measurements[sensor]
    return replace(drive, measurements={**drive.measurements, sensor: replace(m, z=wrap_all(m.z + noise))})


def slow_noise(t: Array, rng: np.random.Generator) -> Array:
    """Draw a Gauss-Markov process at times t (n,)."""
    keep = np.exp(-np.diff(t, prepend=t[0]) / SLOW_TIME)
    fresh = np.sqrt(1.0 - keep**2) * rng.normal(size=len(t))
    out = np.empty(len(t))
    value = float(rng.normal())
    for i, (k, f) in enumerate(zip(keep.tolist(), fresh.tolist(), strict=True)):
        value = k * value + f
        out[i] = value
    return SLOW * out


def is_right(case: Case, found: dict[str, Consistency]) -> bool:
    """Whether the expected sensor is accused of the expected fault with the right cure, and nobody else."""
    accused = {s for s, c in found.items() if c.verdict not in {"consistent", "unclear"}}
    if not case.sensor:
        return not accused
    mine = found[case.sensor]
    named = case.key.split(".")[1] in mine.words and case.key in mine.cures
    return accused == {case.sensor} and mine.verdict == case.verdict and named and case.right(mine.cures[case.key])


def one_seed(seed: int, names: Sequence[str]) -> dict[str, tuple[bool, str]]:
    """Return for every case whether the verdicts were right, and what was said."""
    topics, tables, _ = in_memory(load("rounded_rectangle", SCENARIO), seed)
    out = {}
    for name in names:
        _, found = drive_of(topics, tables, CASES[name], seed)
        said = "; ".join(c.words for c in found.values() if c.verdict not in {"consistent", "unclear"})
        out[name] = is_right(CASES[name], found), said
    return out


@click.command()
@click.option("--seeds", default=20, show_default=True)
@click.option("--jobs", default=2, show_default=True)
@click.option("--case", "cases", multiple=True, type=click.Choice(list(CASES)))
def main(seeds: int, jobs: int, cases: tuple[str, ...]) -> None:
    """Count the right verdicts."""
    names = list(cases or CASES)
    with ProcessPoolExecutor(jobs) as pool:
        found = list(pool.map(partial(one_seed, names=names), range(FIRST_SEED, FIRST_SEED + seeds)))
    click.echo("| case | right | said first |\n|---|--:|---|")
    for name in names:
        right = sum(f[name][0] for f in found)
        click.echo(f"| {name} | {right} of {seeds} | {found[0][name][1] or 'nothing'} |")
    for i, f in enumerate(found):
        for name in names:
            if not f[name][0]:
                click.echo(f"seed {FIRST_SEED + i}, {name}: {f[name][1] or 'nothing'}", err=True)


if __name__ == "__main__":
    main()
