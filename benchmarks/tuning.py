"""Does tuning find the noise that was drawn? Simulated drives, configured with noise that is far off.

    python -m benchmarks.tuning --drives 3
    python -m benchmarks.tuning --drives 1 --scenario straight_runs
    python -m benchmarks.tuning --drives 1 --set camera.enabled=true

Standard deviations are configured 10 times too large and too small (wheels.noise, a variance: 100 times). The
table says what was found over what the simulator drew from. The compass has no iron, so that its noise is white.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

from benchmarks import experiment
from benchmarks.experiment import Row, Simulated
from locfuse.fusion.measure import measure
from locfuse.fusion.robot import Robot
from locfuse.fusion.sensors.registry import REGISTRY
from locfuse.fusion.tune.tune import Trial, tune

SETS = (
    "compass.hard_iron=[0, 0]",
    "compass.soft_iron=[1, 1, 0]",
    "compass.sigma_deg=0.5",
    "camera.enabled=false",
)


def wrong(run: Simulated, factor: float) -> list[str]:
    """Return settings with every standard deviation `factor` times too large."""
    robot = run.robot()
    found = [f"wheels.noise={robot.wheels.noise * factor**2!r}"]
    for sensor in (s for s in REGISTRY if s in run.tables):
        settings = robot.settings(sensor)
        found += [f"{sensor}.{key}={getattr(settings, key) * factor!r}" for key in REGISTRY[sensor].noise_keys]
    return found


def work(seed: int, scenario: str, sets: tuple[str, ...]) -> Row:
    """Return what tuning makes of one simulated drive, and its CPU time [s]."""
    run = experiment.simulated(scenario, (*SETS, *sets), seed)
    found = {}
    for factor in (10.0, 0.1):
        start = time.process_time()
        drive, robot = run.measured(wrong(run, factor))

        def again(_: int, sensor: str, now: Robot) -> Any:
            return measure(run.streams, now).measurements[sensor]

        tuned = tune([Trial(scenario, drive, robot)], list(drive.measurements), remeasure=again)
        ratios = [
            [r.key, r.after / r.before * (factor**2 if r.key == "wheels.noise" else factor)] for r in tuned.rows
        ]
        found[f"{factor:g}"] = {"ratios": ratios, "flags": list(tuned.flags), "s": time.process_time() - start}
    return {"found": found}


def table(rows: list[Row]) -> Iterator[str]:
    """Yield what was found over what is true."""
    lines: list[tuple[Any, ...]] = []
    for row in rows:
        for factor, found in row["found"].items():
            seed, seconds = row["task"][0], f"{found['s']:.0f} s"
            lines += [(seed, factor, key, f"{ratio:.3f}", seconds) for key, ratio in found["ratios"]]
            lines += [(seed, factor, flag, "", "") for flag in found["flags"]]
    yield from experiment.table(("seed", "configured", "key", "found / true", "CPU"), lines, "0134")


OPTIONS = (
    experiment.option("--scenario", default="tour"),
    experiment.option("--set", "sets", multiple=True, help="Change the scenario."),
)
main = experiment.command(work, table, drives=3, options=OPTIONS)

if __name__ == "__main__":
    main()
