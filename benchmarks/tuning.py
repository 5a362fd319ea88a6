"""Accuracy of `tune`: simulated drives, configured with noise that is far off.

    python -m benchmarks.tuning --drives 3
    python -m benchmarks.tuning --drives 1 --scenario straight_runs
    python -m benchmarks.tuning --drives 1 --set camera.enabled=true

Standard deviations are configured 10 times too large or too small (wheels.noise, a variance: 100 times). The table
has the ratios of tuned to simulated noise. The compass has no iron, so that its noise is white.
"""

import time
from collections.abc import Iterator
from typing import Any

from benchmarks import experiment
from benchmarks.experiment import Row
from locfuse.fusion.measure import measure
from locfuse.fusion.sensors.registry import REGISTRY
from locfuse.fusion.tune.tune import TuneLog, tune

WHITE = (
    *("compass.hard_iron=[0, 0]", "compass.soft_iron=[1, 1, 0]", "compass.sigma_deg=0.5"),
    "camera.enabled=false",
)


def work(seed: int, scenario: str, sets: tuple[str, ...]) -> Row:
    """Return the ratio of tuned to true noise for one simulated drive, and the CPU time [s]."""
    run = experiment.simulated(scenario, (*WHITE, *sets), seed)
    true, found = run.robot(), {}
    keys = [(sensor, key) for sensor in REGISTRY if sensor in run.tables for key in REGISTRY[sensor].noise_keys]
    for factor in (10.0, 0.1):
        start = time.process_time()
        wrong = [f"{sensor}.{key}={getattr(true.settings(sensor), key) * factor!r}" for sensor, key in keys]
        drive, robot = run.measured([f"wheels.noise={true.wheels.noise * factor**2!r}", *wrong])
        tuned = tune(
            [TuneLog(scenario, drive, robot)],
            list(drive.measurements),
            remeasure=lambda _, sensor, now: measure(run.streams, now).measurements[sensor],
        )
        scale = {"wheels.noise": factor**2}
        ratios = [[r.key, r.after / r.before * scale.get(r.key, factor)] for r in tuned.rows]
        found[f"{factor:g}"] = {"ratios": ratios, "flags": list(tuned.flags), "s": time.process_time() - start}
    return {"found": found}


def table(rows: list[Row]) -> Iterator[str]:
    lines: list[tuple[Any, ...]] = []
    for seed, factor, found in ((row["task"][0], *item) for row in rows for item in row["found"].items()):
        lines += [(seed, factor, key, f"{ratio:.3f}", f"{found['s']:.0f} s") for key, ratio in found["ratios"]]
        lines += [(seed, factor, flag, "", "") for flag in found["flags"]]
    yield from experiment.table(("seed", "configured", "key", "found / true", "CPU"), lines, "0134")


OPTIONS = (
    experiment.option("--scenario", default="tour"),
    experiment.option("--set", "sets", multiple=True, help="Change the scenario."),
)
main = experiment.command(work, table, drives=3, options=OPTIONS)

if __name__ == "__main__":
    main()
