"""Accuracy of `calibrate`: the paper's experiment for delta, repeated with the simulator.

    python -m benchmarks.calibration --seeds 20

Each seed is one log of straight runs and one of turns on the spot, from the lowest to the highest speed.
"""

from collections.abc import Iterator

import numpy as np

from benchmarks import experiment
from benchmarks.experiment import Row
from locfuse.fusion.wheels.calibrate import calibrate_wheels
from locfuse.sample_logs.scenario import load

LIGHT = ("camera.enabled=false", "lrf.enabled=false", "compass.enabled=false")


def work(seed: int, sets: tuple[str, ...]) -> Row:
    """Simulate both experiments of one seed, with wheels and truth only, and calibrate with both logs."""
    runs = [experiment.simulated(name, (*LIGHT, *sets), seed) for name in ("straight_runs", "turns_on_the_spot")]
    found, true = calibrate_wheels([run.measured()[0] for run in runs]), load("straight_runs", sets).wheels.noise
    geometry, k = [found.parameters.tolist(), found.sigmas.tolist()], [found.k.value, found.k.low, found.k.high]
    return {
        "true": true,
        "k": k,
        "delta": found.delta.value,
        "prefers_k": found.prefers_k > 0,
        "geometry": geometry,
    }


def table(rows: list[Row]) -> Iterator[str]:
    """Yield a row per seed, and how often the true noise lies in the 95 % interval."""
    lines, true = [], rows[0]["true"]
    inside = [row["k"][1] <= true <= row["k"][2] for row in rows]
    for row, holds in zip(rows, inside, strict=True):
        value, low, high = row["k"]
        geometry = (f"{100 * p:+.2f} ± {100 * s:.2f} %" for p, s in zip(*row["geometry"], strict=True))
        words = (f"{value:.3g}", f"{low:.3g} .. {high:.3g}", "yes" if holds else "**no**", f"{row['delta']:.4f}")
        lines.append((row["task"][0], *words, *geometry))
    head = ("seed", "k [m]", "95 % interval", "holds it", "delta", "radius", "ratio", "track")
    yield from experiment.table(head, lines, "014567")
    parameters, sigmas = np.array([row["geometry"] for row in rows]).swapaxes(0, 1)
    mean = float(np.mean([row["k"][0] for row in rows]))
    off = np.round(np.sqrt(((parameters / sigmas) ** 2).mean(axis=0)), 2).tolist()
    yield f"\nk = {true:g} m lies in {sum(inside)} of {len(rows)} intervals; their mean is {mean:.3g} m."
    yield f"Noise per metre is likelier than delta in {sum(row['prefers_k'] for row in rows)} of {len(rows)}."
    yield f"Radius, ratio, track: error over its sigma {off} rms."


SETS = experiment.option("--set", "sets", multiple=True, help="Scenario key, e.g. --set wheels.noise=2e-4.")
main = experiment.command(work, table, options=[SETS])

if __name__ == "__main__":
    main()
