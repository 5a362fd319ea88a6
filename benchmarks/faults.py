"""Effect of faults: each kind in simulated drives, compared with drives without the sensor or the fault.

    python -m benchmarks.faults --drives 10

With a sensor fault, the error of `all` may be at most twice the error of `all` without this sensor. With a wheel
slip, it may be at most three times the error of the same drive without the slip. Outside the fault (plus 5 s) the
filter must stay consistent. A clock offset must be reported within 20 ms, and have no effect once it is set.
"""

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from benchmarks import experiment
from benchmarks.experiment import Row, Simulated
from locfuse.fusion.checks.clocks import clock_lags
from locfuse.fusion.data import Drive, Evaluation
from locfuse.fusion.fuse import fuse
from locfuse.fusion.judge.evaluate import evaluate
from locfuse.fusion.robot import Robot

START, END, RECOVERY = 15.0, 25.0, 5.0  # s
OFFSET = 0.12  # s, of the shifted clock
CLOCK = "clock offset of lrf"
ALL = ("compass", "lrf", "camera")


class Case(NamedTuple):
    """One fault, the sensor it affects, and the allowed ratio of the error of `all` to its reference."""

    fault: str  # inline TOML
    sensor: str  # the reference is `all` without this sensor; "": `all` without the fault
    factor: float


def _hits(sensor: str, kind: str, more: str) -> Case:
    return Case(f'{{kind="{kind}", start={START}, end={END}, {more}}}', sensor, 2.0)


CASES = {
    **{f"dropout of {s}": _hits(s, "dropout", f'sensor="{s}"') for s in ALL},
    "magnet": _hits("compass", "magnetic", "x=6.9, y=2.2, strength=8e-6, axis_deg=20.0"),
    "people": _hits("lrf", "people", "path=[[7.4, 1.0], [5.5, 2.6], [7.2, 5.0]]"),
    "hidden landmark": _hits("camera", "hidden_landmark", "colour=[120, 120, 118]"),
    "wrong red object": _hits("camera", "red_object", "x=1.1, y=5.6, radius=0.08"),
    "slip": Case(f'{{kind="slip", start={START}, end={START + 1.5}, wheel="left", ratio=0.35}}', "", 3.0),
    CLOCK: Case(f'{{kind="clock_offset", sensor="lrf", seconds={OFFSET}}}', "", 2.0),
}


def judged(drive: Drive, robot: Robot, without: str = "") -> Evaluation:
    """Return the evaluation of `all`, or of `all` without a sensor."""
    return evaluate(fuse(drive, robot, [s for s in ALL if s in drive.measurements and s != without]), drive)


def rmse(e: Evaluation) -> float:
    """Return the position error [m]."""
    return float(e.figures["position_rmse_m"] or math.nan)


def anees_outside(e: Evaluation) -> float:
    """Return the mean NEES per degree of freedom outside the fault and the recovery time after it."""
    nees = e.nees[(e.t < START) | (e.t > END + RECOVERY)]
    return float(nees[np.isfinite(nees)].mean())


def driven(fault: str, seed: int) -> Simulated:
    """Return a drive of the shipped scenario, steered on truth, with a fault ("": without)."""
    return experiment.simulated("rounded_rectangle", (f"faults=[{fault}]",) if fault else (), seed)


def work(name: str, seed: int) -> Row:
    """Return the error [m] with the fault and that of the reference, and the ANEES outside the fault.

    For a clock offset, the reported value is set first; `off` [s] is the error of this value.
    """
    case, found, run = CASES[name], {}, driven(CASES[name].fault, seed)
    drive, robot = run.measured()
    if name == CLOCK:
        lag = clock_lags(drive.measurements, drive.wheels)["lrf"].offset
        found = {"off": lag + OFFSET}
        drive, robot = run.measured((f"lrf.time_offset={lag}",))
    e = judged(drive, robot)
    yard = judged(drive, robot, case.sensor) if case.sensor else judged(*driven("", seed).measured())
    return found | {"error": rmse(e), "yard": rmse(yard), "anees": anees_outside(e)}


def table(rows: list[Row]) -> Iterator[str]:
    """Yield the effect of each fault, and the error of the estimated clock offset."""
    lines = []
    for name, mine in experiment.by_case(rows).items():
        error, yard, anees = (np.mean([row[key] for row in mine]) for key in ("error", "yard", "anees"))
        words = (f"{1000 * error:.1f} mm", f"{error / yard:.2f}", f"{CASES[name].factor:g}", f"{anees:.2f}")
        lines.append((name, *words))
    yield from experiment.table(
        ("fault", "all with it", "against yardstick", "allowed", "ANEES outside"), lines, "1234"
    )
    if off := [abs(row["off"]) for row in rows if "off" in row]:
        near = sum(one <= 0.02 for one in off)
        yield f"\n{CLOCK}: reported {1000 * max(off):.0f} ms off at worst, {near} of {len(off)} within 20 ms."


main = experiment.command(work, table, CASES, drives=10)

if __name__ == "__main__":
    main()
