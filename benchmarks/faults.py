"""What a fault costs: each kind of fault in simulated drives, against drives without the sensor or the fault.

    python -m benchmarks.faults --drives 10

A sensor fault may make `all` at most twice as wrong as `all` without that sensor; a wheel slip at most
three times as wrong as the same drive without it. Outside the fault (plus 5 s) the filter must stay consistent. A
clock offset must be reported within 20 ms and cost nothing once it is set.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import click
import numpy as np

from locfuse.cli.analysis.load import make_robot
from locfuse.formats.robot import robot_toml
from locfuse.fusion.checks.clocks import clock_lags
from locfuse.fusion.data import Array, Drive, Evaluation
from locfuse.fusion.fuse import fuse
from locfuse.fusion.judge.evaluate import evaluate
from locfuse.fusion.measure import measure
from locfuse.fusion.robot import Robot
from locfuse.sample_logs.load import load
from locfuse.sample_logs.record import in_memory

from .accuracy import FIRST_SEED, streams_by_role

START, END, RECOVERY = 15.0, 25.0, 5.0  # s
OFFSET = 0.12  # s, of the shifted clock
CLOCK = "clock offset of lrf"
ALL = ("compass", "lrf", "camera")


@dataclass(frozen=True)
class Case:
    """One fault, the sensor it hits, and how much worse `all` may become than its yardstick."""

    name: str
    fault: str  # inline TOML
    sensor: str  # the yardstick is `all` without it; "" = `all` without the fault
    factor: float


def _interval(kind: str, more: str) -> str:
    return f'{{kind="{kind}", start={START}, end={END}, {more}}}'


CASES = (
    *(Case(f"dropout of {s}", _interval("dropout", f'sensor="{s}"'), s, 2.0) for s in ALL),
    Case("magnet", _interval("magnetic", "x=6.9, y=2.2, strength=8e-6, axis_deg=20.0"), "compass", 2.0),
    Case("people", _interval("people", "path=[[7.4, 1.0], [5.5, 2.6], [7.2, 5.0]]"), "lrf", 2.0),
    Case("hidden landmark", _interval("hidden_landmark", "colour=[120, 120, 118]"), "camera", 2.0),
    Case("wrong red object", _interval("red_object", "x=1.1, y=5.6, radius=0.08"), "camera", 2.0),
    Case("slip", f'{{kind="slip", start={START}, end={START + 1.5}, wheel="left", ratio=0.35}}', "", 3.0),
)


def simulated(seed: int, faults: str) -> tuple[Drive, Robot, dict[str, Any]]:
    """Return a measured drive of the shipped scenario, steered on truth, with these faults."""
    sets = (f"faults=[{faults}]",) if faults else ()
    topics, tables, _ = in_memory(load("rounded_rectangle", sets), seed)
    robot = make_robot(tables)
    return measure(streams_by_role(topics, tables), robot), robot, {"topics": topics, "tables": tables}


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


class Clock(NamedTuple):
    """What is found of the shifted clock in one drive."""

    off: float  # s, error of the reported lag
    alone: float  # s, the same where only the wheels are there to compare with
    ratio: float  # how much worse `all` is once the reported lag is set


def clock_case(seed: int) -> Clock:
    """Return what is found of the laser's clock in one drive."""
    fault = f'{{kind="clock_offset", sensor="lrf", seconds={OFFSET}}}'
    drive, _, raw = simulated(seed, fault)
    lag = clock_lags(drive.measurements, drive.wheels).get("lrf")
    alone = clock_lags({"lrf": drive.measurements["lrf"]}, drive.wheels).get("lrf")
    if lag is None or alone is None:
        return Clock(math.inf, math.inf, math.inf)
    cure = {"lrf": {"time_offset": lag.offset}}
    robot = make_robot(robot_toml.layered(raw["tables"], cure))
    cured = judged(measure(streams_by_role(raw["topics"], raw["tables"]), robot), robot, ALL)
    clean, plain, _ = simulated(seed, "")
    return Clock(lag.offset + OFFSET, alone.offset + OFFSET, rmse(cured) / rmse(judged(clean, plain, ALL)))


def in_ms(errors: Array) -> str:
    """Return what errors (n,) [s] amount to."""
    ms = 1000 * errors
    inside = int((np.abs(ms) <= 20).sum())
    rms = math.sqrt(float((ms**2).mean()))
    return (
        f"{rms:.1f} ms rms, mean {ms.mean():+.1f}, worst {np.abs(ms).max():.0f}, {inside} of {len(ms)} within 20"
    )


def cost(case: Case, seeds: range) -> tuple[float, float, float]:
    """Return the error with the fault [m], its ratio to the yardstick, and the worst ANEES outside the fault."""
    with_fault, yard, anees = [], [], []
    for seed in seeds:
        drive, robot, _ = simulated(seed, case.fault)
        e = judged(drive, robot, ALL)
        with_fault.append(rmse(e))
        anees.append(anees_outside(e))
        if case.sensor:
            yard.append(rmse(judged(drive, robot, tuple(s for s in ALL if s != case.sensor))))
        else:
            clean, plain, _ = simulated(seed, "")
            yard.append(rmse(judged(clean, plain, ALL)))
    return float(np.mean(with_fault)), float(np.mean(with_fault) / np.mean(yard)), float(np.mean(anees))


@click.command()
@click.option("--drives", default=10, show_default=True)
@click.option("--case", "names", multiple=True, type=click.Choice([*(c.name for c in CASES), CLOCK]))
def main(drives: int, names: tuple[str, ...]) -> None:
    """Print what each fault costs."""
    seeds = range(FIRST_SEED, FIRST_SEED + drives)
    click.echo("| fault | all with it | against yardstick | allowed | ANEES outside |\n|---|--:|--:|--:|--:|")
    for case in (c for c in CASES if not names or c.name in names):
        error, ratio, anees = cost(case, seeds)
        click.echo(f"| {case.name} | {1000 * error:.1f} mm | {ratio:.2f} | {case.factor:g} | {anees:.2f} |")
    if not names or CLOCK in names:
        found = [clock_case(seed) for seed in seeds]
        ratios = np.array([f.ratio for f in found])
        click.echo(f"| {CLOCK}, once set as reported | | {ratios.mean():.2f}, at most {ratios.max():.2f} | 2 | |")
        click.echo(f"\nreported: {in_ms(np.array([f.off for f in found]))}")
        click.echo(f"without the compass: {in_ms(np.array([f.alone for f in found]))}")


if __name__ == "__main__":
    main()
