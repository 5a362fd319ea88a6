"""Does `calibrate` find the simulator's noise? The paper's experiment for delta, many times.

    python -m benchmarks.calibration --seeds 20

Each seed is one log of straight runs and one of turns on the spot, from the lowest to the highest speed.
"""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor
from functools import partial

import click
import numpy as np

from benchmarks.accuracy import FIRST_SEED, streams_by_role
from locfuse.cli.analysis.load import make_robot
from locfuse.fusion.data import Drive
from locfuse.fusion.measure import measure
from locfuse.fusion.wheels.calibrate import WheelCalibration, calibrate_wheels
from locfuse.sample_logs.load import load
from locfuse.sample_logs.record import in_memory

LIGHT = ("camera.enabled=false", "lrf.enabled=false", "compass.enabled=false")


def drive(scenario: str, seed: int, sets: tuple[str, ...]) -> Drive:
    """Drive one scenario, wheels and truth only."""
    topics, tables, _ = in_memory(load(scenario, (*LIGHT, *sets)), seed)
    return measure(streams_by_role(topics, tables), make_robot(tables))


def calibrated(seed: int, sets: tuple[str, ...]) -> WheelCalibration:
    """Run both experiments of one seed and calibrate on both."""
    return calibrate_wheels([drive(name, seed, sets) for name in ("straight_runs", "turns_on_the_spot")])


@click.command()
@click.option("--seeds", default=20, show_default=True)
@click.option("--set", "sets", multiple=True, help="Scenario key, e.g. --set wheels.noise=2e-4.")
@click.option("--jobs", default=2, show_default=True)
def main(seeds: int, sets: tuple[str, ...], jobs: int) -> None:
    """Count how often the noise that the simulator draws from lies in the interval."""
    truth = load("straight_runs", sets).wheels.noise
    with ProcessPoolExecutor(jobs) as pool:
        found = list(pool.map(partial(calibrated, sets=sets), range(FIRST_SEED, FIRST_SEED + seeds)))
    click.echo("| seed | k [m] | 95 % interval | holds it | delta | radius | ratio | track |")
    click.echo("|--:|--:|---|---|--:|--:|--:|--:|")
    for seed, f in zip(range(FIRST_SEED, FIRST_SEED + seeds), found, strict=True):
        holds = "yes" if f.k.low <= truth <= f.k.high else "**no**"
        geometry = (
            f"{100 * p:+.2f} ± {100 * s:.2f} %"
            for p, s in zip(f.parameters.tolist(), f.sigmas.tolist(), strict=True)
        )
        click.echo(
            f"| {seed} | {f.k.value:.3g} | {f.k.low:.3g} .. {f.k.high:.3g} | {holds} | {f.delta.value:.4f} | "
            + " | ".join(geometry)
            + " |"
        )
    inside = sum(f.k.low <= truth <= f.k.high for f in found)
    z = np.array([f.parameters / f.sigmas for f in found])
    mean = float(np.mean([f.k.value for f in found]))
    click.echo(f"\nk = {truth:g} m lies in {inside} of {seeds} intervals; their mean is {mean:.3g} m.")
    click.echo(f"Noise per metre is likelier than delta in {sum(f.prefers_k > 0 for f in found)} of {seeds}.")
    click.echo(
        f"Radius, ratio, track: error over its sigma {np.round(np.sqrt((z**2).mean(axis=0)), 2).tolist()} rms."
    )


if __name__ == "__main__":
    main()
