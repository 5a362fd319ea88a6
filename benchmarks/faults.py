"""What a fault costs: each kind of fault in simulated drives, against drives without the sensor or the fault.

    python -m benchmarks.faults --drives 10

A sensor fault may make `all` at most twice as wrong as `all` without that sensor; a wheel slip at most
three times as wrong as the same drive without it. Outside the fault (plus 5 s) the filter must stay consistent. A
clock offset must be reported within 20 ms and cost nothing once it is set.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from benchmarks import experiment
from benchmarks.experiment import Row, Simulated
from locfuse.fusion.checks.clocks import clock_lags
from locfuse.fusion.data import Array, Drive, Evaluation
from locfuse.fusion.fuse import fuse
from locfuse.fusion.judge.evaluate import evaluate
from locfuse.fusion.robot import Robot

START, END, RECOVERY = 15.0, 25.0, 5.0  # s
OFFSET = 0.12  # s, of the shifted clock
CLOCK = "clock offset of lrf"
ALL = ("compass", "lrf", "camera")


@dataclass(frozen=True)
class Case:
    """One fault, the sensor it hits, and how much worse `all` may become than its yardstick."""

    fault: str  # inline TOML
    sensor: str  # the yardstick is `all` without it; "" = `all` without the fault
    factor: float


def _interval(kind: str, more: str) -> str:
    return f'{{kind="{kind}", start={START}, end={END}, {more}}}'


CASES = {
    **{f"dropout of {s}": Case(_interval("dropout", f'sensor="{s}"'), s, 2.0) for s in ALL},
    "magnet": Case(_interval("magnetic", "x=6.9, y=2.2, strength=8e-6, axis_deg=20.0"), "compass", 2.0),
    "people": Case(_interval("people", "path=[[7.4, 1.0], [5.5, 2.6], [7.2, 5.0]]"), "lrf", 2.0),
    "hidden landmark": Case(_interval("hidden_landmark", "colour=[120, 120, 118]"), "camera", 2.0),
    "wrong red object": Case(_interval("red_object", "x=1.1, y=5.6, radius=0.08"), "camera", 2.0),
    "slip": Case(f'{{kind="slip", start={START}, end={START + 1.5}, wheel="left", ratio=0.35}}', "", 3.0),
}


def judged(drive: Drive, robot: Robot, sensors: tuple[str, ...]) -> Evaluation:
    """Return one configuration's evaluation."""
    return evaluate(fuse(drive, robot, [s for s in sensors if s in drive.measurements]), drive)


def rmse(e: Evaluation) -> float:
    """Return the position error [m]."""
    return float(e.figures["position_rmse_m"] or math.nan)


def anees_outside(e: Evaluation) -> float:
    """Return the mean NEES per degree of freedom outside the fault and the time to recover from it."""
    outside = (e.t < START) | (e.t > END + RECOVERY)
    nees = e.nees[outside]
    return float(nees[np.isfinite(nees)].mean())


def work(name: str, seed: int) -> Row:
    """Return the error [m] with the fault and that of the yardstick, and the ANEES outside the fault."""
    if name == CLOCK:
        return clock(seed)
    case = CASES[name]
    drive, robot = driven(case.fault, seed).measured()
    e = judged(drive, robot, ALL)
    if case.sensor:
        yard = judged(drive, robot, tuple(s for s in ALL if s != case.sensor))
    else:
        yard = judged(*driven("", seed).measured(), ALL)
    return {"error": rmse(e), "yard": rmse(yard), "anees": anees_outside(e)}


def driven(fault: str, seed: int) -> Simulated:
    """Return a drive of the shipped scenario, steered on truth, with a fault; "" has none."""
    return experiment.simulated("rounded_rectangle", (f"faults=[{fault}]",) if fault else (), seed)


def clock(seed: int) -> Row:
    """Return what is found of the laser's clock in one drive: how far off [s], also without the compass."""
    run = driven(f'{{kind="clock_offset", sensor="lrf", seconds={OFFSET}}}', seed)
    drive, _ = run.measured()
    lag = clock_lags(drive.measurements, drive.wheels)["lrf"]
    alone = clock_lags({"lrf": drive.measurements["lrf"]}, drive.wheels)["lrf"]
    fixed = judged(*run.measured((f"lrf.time_offset={lag.offset}",)), ALL)
    clean = judged(*driven("", seed).measured(), ALL)
    return {"off": lag.offset + OFFSET, "alone": alone.offset + OFFSET, "ratio": rmse(fixed) / rmse(clean)}


def in_ms(errors: Array) -> str:
    """Return what errors (n,) [s] amount to."""
    ms = 1000 * errors
    inside = int((np.abs(ms) <= 20).sum())
    rms = math.sqrt(float((ms**2).mean()))
    return (
        f"{rms:.1f} ms rms, mean {ms.mean():+.1f}, worst {np.abs(ms).max():.0f}, {inside} of {len(ms)} within 20"
    )


def table(rows: list[Row]) -> Iterator[str]:
    """Yield what each fault costs."""
    lines: list[tuple[str, ...]] = []
    after = []
    for name in dict.fromkeys(row["task"][0] for row in rows):
        mine = [row for row in rows if row["task"][0] == name]
        if name == CLOCK:
            ratios = np.array([row["ratio"] for row in mine])
            words = f"{ratios.mean():.2f}, at most {ratios.max():.2f}"
            lines.append((f"{CLOCK}, once set as reported", "", words, "2", ""))
            after.append(f"\nreported: {in_ms(np.array([row['off'] for row in mine]))}")
            after.append(f"without the compass: {in_ms(np.array([row['alone'] for row in mine]))}")
            continue
        error, yard, anees = (float(np.mean([row[key] for row in mine])) for key in ("error", "yard", "anees"))
        lines.append(
            (name, f"{1000 * error:.1f} mm", f"{error / yard:.2f}", f"{CASES[name].factor:g}", f"{anees:.2f}")
        )
    head = ("fault", "all with it", "against yardstick", "allowed", "ANEES outside")
    yield from (*experiment.table(head, lines, "1234"), *after)


main = experiment.command(work, table, (*CASES, CLOCK), drives=10)

if __name__ == "__main__":
    main()
