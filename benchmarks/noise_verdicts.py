"""Accuracy of noise verdicts without truth: how often is the right sensor named, with the right fix?

    python -m benchmarks.noise_verdicts --seeds 20

Each seed is one lap of the paper's robot. The filter uses the noise of the simulator, except for one wrong
setting, and the verdicts of `compare` are evaluated. They are right if the sensor has the expected verdict, its
key gets a right value, and no other sensor is named. Without a wrong setting, no sensor may be named. The
simulated camera is more exact than any real mirror, so 0.5 degrees of white noise are added to its bearings.
"""

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from msgspec.structs import replace

from benchmarks import experiment
from benchmarks.experiment import Row
from locfuse.fusion.data import Array, Drive
from locfuse.fusion.fuse import fuse
from locfuse.fusion.judge.consistency import Consistency, RunInnovations, judge
from locfuse.fusion.se2 import wrap_all

SCENARIO = ("compass.hard_iron=[0, 0]", "compass.soft_iron=[1, 1, 0]", "compass.sigma_deg=0.5")
CAMERA_NOISE = math.radians(0.5)
SLOW, SLOW_TIME = math.radians(1.0), 2.0  # rad, s: correlated compass noise
SENSORS = ("compass", "lrf", "camera")


class Case(NamedTuple):
    """Wrong settings of one sensor, and the expected verdict."""

    sets: tuple[str, ...] = ()
    verdict: str = ""
    right: tuple[float, float] = (-math.inf, math.inf)  # interval of right values of the first key

    @property
    def key(self) -> str:
        """The key that a fix sets; "" if nothing is wrong."""
        return self.sets[0].partition("=")[0] if self.sets else ""


DEGREES, METRES = (0.3, 0.8), (0.015, 0.06)  # right values: intervals about the simulated noise
SLOW_CASE = "compass noise of 2 s"
CASES = {
    "clean": Case(),
    "compass sigma / 3": Case(("compass.sigma_deg=0.1667",), "understated", DEGREES),
    "compass sigma * 3": Case(("compass.sigma_deg=1.5",), "overstated", DEGREES),
    "lrf sigma / 3": Case(("lrf.sigma_range=0.01", "lrf.sigma_angle_deg=0.08333"), "understated", METRES),
    "lrf sigma * 3": Case(("lrf.sigma_range=0.09", "lrf.sigma_angle_deg=0.75"), "overstated", METRES),
    "camera sigma / 3": Case(("camera.sigma_deg=0.1667",), "understated", DEGREES),
    "camera sigma * 3": Case(("camera.sigma_deg=1.5",), "overstated", DEGREES),
    # the scenario's magnetic north is at -65 degrees
    "compass offset + 5 deg": Case(("compass.offset_deg=-60.0",), "biased", (-66.0, -64.0)),
    "camera zero + 3 deg": Case(("camera.zero_deg=3.0",), "biased", (-1.0, 1.0)),
    SLOW_CASE: Case(("compass.sigma_deg=1.0",), "correlated", (3.0, math.inf)),
}


def noisy(drive: Drive, sensor: str, noise: Array) -> Drive:
    m = drive.measurements[sensor]
    return replace(drive, measurements={**drive.measurements, sensor: replace(m, z=wrap_all(m.z + noise))})


def slow_noise(t: Array, rng: np.random.Generator) -> Array:
    """Draw a Gauss-Markov process at times t (n,)."""
    keep = np.exp(-np.diff(t, prepend=t[0]) / SLOW_TIME)
    fresh = np.sqrt(1.0 - keep**2) * rng.normal(size=len(t))
    out, value = np.empty(len(t)), float(rng.normal())
    for i, (k, f) in enumerate(zip(keep.tolist(), fresh.tolist(), strict=True)):
        value = k * value + f
        out[i] = value
    return SLOW * out


def is_right(case: Case, found: dict[str, Consistency]) -> bool:
    """Return whether exactly the expected sensor is named, with its verdict and a right value."""
    accused = {s for s, c in found.items() if c.verdict not in {"consistent", "unclear"}}
    sensor = case.key.partition(".")[0]
    if not sensor:
        return not accused
    value, (low, high) = found[sensor].fix_values.get(case.key, math.nan), case.right
    return accused == {sensor} and found[sensor].verdict == case.verdict and low < value < high


def work(name: str, seed: int) -> Row:
    case, rng = CASES[name], np.random.default_rng(seed)
    drive, robot = experiment.simulated("rounded_rectangle", SCENARIO, seed).measured(case.sets)
    drive = noisy(drive, "camera", CAMERA_NOISE * rng.normal(size=drive.measurements["camera"].z.shape))
    if name == SLOW_CASE:
        drive = noisy(drive, "compass", slow_noise(drive.measurements["compass"].t, rng)[:, None])
    configurations = ((), *((s,) for s in SENSORS), SENSORS)
    runs = [RunInnovations.of(drive, fuse(drive, robot, sensors)) for sensors in configurations]
    found = judge(runs, robot)["all"]
    words = [c.words for c in found.values() if c.verdict not in {"consistent", "unclear"}]
    return {"right": is_right(case, found), "words": "; ".join(words) or "nothing"}


def table(rows: list[Row]) -> Iterator[str]:
    """Yield the share of right verdicts, then the wrong ones."""
    cases = experiment.by_case(rows).items()
    lines = [(name, f"{sum(row['right'] for row in m)} of {len(m)}", m[0]["words"]) for name, m in cases]
    yield from experiment.table(("case", "right", "said first"), lines, "1")
    yield from (f"seed {row['task'][1]}, {row['task'][0]}: {row['words']}" for row in rows if not row["right"])


main = experiment.command(work, table, CASES, first=2000)

if __name__ == "__main__":
    main()
