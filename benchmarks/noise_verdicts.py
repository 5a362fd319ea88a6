"""Do the verdicts on noise name the right sensor and the right cure? Wrong settings by the dozen, without truth.

    python -m benchmarks.noise_verdicts --seeds 20

Each seed is one lap of the paper's robot. The filter is given the noise that the simulator drew, except for one
setting that is wrong; `compare`'s runs are judged. Right is: the sensor's verdict is the expected one, its key
gets a right value, and no other sensor is named. A clean drive gets no complaint. The simulated camera is more
exact than any real mirror, so 0.5 degrees of white noise are added to its bearings.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from msgspec.structs import replace

from benchmarks import experiment
from benchmarks.experiment import Row, Simulated
from locfuse.fusion.data import Array, Drive
from locfuse.fusion.fuse import fuse
from locfuse.fusion.judge.consistency import Consistency, Run, judge
from locfuse.fusion.se2 import wrap_all

SCENARIO = ("compass.hard_iron=[0, 0]", "compass.soft_iron=[1, 1, 0]", "compass.sigma_deg=0.5")
CAMERA_NOISE = math.radians(0.5)
NORTH_DEG = -65.0  # what compass.offset_deg should be: the scenario's magnetic north
SLOW, SLOW_TIME = math.radians(1.0), 2.0  # rad, s: correlated compass noise
SENSORS = ("compass", "lrf", "camera")
CONFIGURATIONS: tuple[tuple[str, ...], ...] = ((), *((s,) for s in SENSORS), SENSORS)


@dataclass(frozen=True)
class Case:
    """One wrong setting and what should be said of it."""

    sets: tuple[str, ...] = ()
    sensor: str = ""  # none: nobody
    verdict: str = ""
    key: str = ""
    right: tuple[float, float] = (-math.inf, math.inf)  # between which the value of the key is right
    slow_compass: bool = False


DEGREES, METRES = (0.3, 0.8), (0.015, 0.06)  # around the noise that was drawn
LINES = ("lrf.sigma_range", "lrf.sigma_angle_deg")
OFF = f"compass.offset_deg={NORTH_DEG + 5.0}"
NEAR_NORTH = (NORTH_DEG - 1.0, NORTH_DEG + 1.0)
SMALL, LARGE = "understated", "overstated"
CASES = {
    "clean": Case(),
    "compass sigma / 3": Case(("compass.sigma_deg=0.1667",), "compass", SMALL, "compass.sigma_deg", DEGREES),
    "compass sigma * 3": Case(("compass.sigma_deg=1.5",), "compass", LARGE, "compass.sigma_deg", DEGREES),
    "lrf sigma / 3": Case((f"{LINES[0]}=0.01", f"{LINES[1]}=0.0833"), "lrf", SMALL, LINES[0], METRES),
    "lrf sigma * 3": Case((f"{LINES[0]}=0.09", f"{LINES[1]}=0.75"), "lrf", LARGE, LINES[0], METRES),
    "camera sigma / 3": Case(("camera.sigma_deg=0.1667",), "camera", SMALL, "camera.sigma_deg", DEGREES),
    "camera sigma * 3": Case(("camera.sigma_deg=1.5",), "camera", LARGE, "camera.sigma_deg", DEGREES),
    "compass offset + 5 deg": Case((OFF,), "compass", "biased", "compass.offset_deg", NEAR_NORTH),
    "camera zero + 3 deg": Case(("camera.zero_deg=3.0",), "camera", "biased", "camera.zero_deg", (-1.0, 1.0)),
    "compass noise of 2 s": Case(
        ("compass.sigma_deg=1.0",), "compass", "correlated", "compass.sigma_deg", (3.0, math.inf), True
    ),
}


def found(run: Simulated, case: Case, seed: int) -> dict[str, Consistency]:
    """Measure and judge one drive under one case: the verdict on every sensor."""
    drive, robot = run.measured(case.sets)
    rng = np.random.default_rng(seed)
    drive = noisy(drive, "camera", CAMERA_NOISE * rng.normal(size=drive.measurements["camera"].z.shape))
    if case.slow_compass:
        m = drive.measurements["compass"]
        drive = noisy(drive, "compass", slow_noise(m.t, rng)[:, None])
    runs = [Run.of(drive, fuse(drive, robot, sensors)) for sensors in CONFIGURATIONS]
    return judge(runs, robot)["all"]


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
    """Whether the expected sensor is named, with its fault and a right value of its key, and nobody else."""
    accused = {s for s, c in found.items() if c.verdict not in {"consistent", "unclear"}}
    if not case.sensor:
        return not accused
    mine = found[case.sensor]
    value, (low, high) = mine.cures.get(case.key), case.right
    return accused == {case.sensor} and mine.verdict == case.verdict and value is not None and low < value < high


def work(name: str, seed: int) -> Row:
    """Return whether the verdicts of one case were right, and what was said."""
    verdicts = found(experiment.simulated("rounded_rectangle", SCENARIO, seed), CASES[name], seed)
    words = [c.words for c in verdicts.values() if c.verdict not in {"consistent", "unclear"}]
    return {"right": is_right(CASES[name], verdicts), "words": "; ".join(words) or "nothing"}


def table(rows: list[Row]) -> Iterator[str]:
    """Yield how often the verdicts were right, then what was said where they were not."""
    lines = []
    for name in dict.fromkeys(row["task"][0] for row in rows):
        mine = [row for row in rows if row["task"][0] == name]
        lines.append((name, f"{sum(row['right'] for row in mine)} of {len(mine)}", mine[0]["words"]))
    yield from experiment.table(("case", "right", "said first"), lines, "1")
    for row in rows:
        if not row["right"]:
            name, seed = row["task"]
            yield f"seed {seed}, {name}: {row['words']}"


main = experiment.command(work, table, CASES, first=2000)

if __name__ == "__main__":
    main()
