"""Is a robot that is carried off noticed, and never confident and wrong? Simulated drives, random places.

    python -m benchmarks.kidnapping --drives 20
    python -m benchmarks.kidnapping --drives 20 --seconds 0.1

After 20 s the robot is carried to a random place for `--seconds`. Marked: when the run first says that it is lost.
Worst: the largest position error where it does not say so. Found: runs that know their place again at the end. A
bare rectangle looks the same turned by 180 degrees: without a compass nothing may be found there.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import click
import numpy as np

from locfuse.cli.analysis.load import make_robot
from locfuse.fusion.data import Drive, LocfuseError
from locfuse.fusion.fuse import fuse
from locfuse.fusion.judge.evaluate import evaluate
from locfuse.fusion.measure import measure
from locfuse.fusion.robot import Robot
from locfuse.sample_logs.load import load
from locfuse.sample_logs.record import in_memory

from .accuracy import FIRST_SEED, streams_by_role

AT = 20.0  # s
SETTLES = 0.15  # s: between two scans nobody can know


class Run(NamedTuple):
    """What one run said of being carried."""

    marked: float  # s after AT, NaN never
    before: float  # m, largest error before AT
    worst: float  # m, largest error outside what was marked
    found: bool


def carried(seed: int, seconds: float, bare: bool) -> tuple[Drive, Robot] | None:
    """Return a drive in which the robot is carried off; None where that would end in a wall."""
    rng = np.random.default_rng(seed)
    x, y, turn = rng.uniform(-2.5, -0.3), rng.uniform(0.2, 2.0), rng.uniform(-150.0, 150.0)
    fault = f'{{kind="kidnap", start={AT}, end={AT + seconds}, x={x:.3f}, y={y:.3f}, theta_deg={turn:.2f}}}'
    sets = ("camera.enabled=false", 'control.estimator="truth"', f"faults=[{fault}]")
    try:
        topics, tables, _ = in_memory(
            load("rounded_rectangle", (*sets, *(("room.plates=[]",) if bare else ()))), seed
        )
    except LocfuseError:
        return None
    robot = make_robot(tables)
    return measure(streams_by_role(topics, tables), robot), robot


def judged(drive: Drive, robot: Robot, sensors: tuple[str, ...]) -> Run:
    """Run the filter and say what it said."""
    estimates = fuse(drive, robot, sensors)
    e = evaluate(estimates, drive)
    error = np.hypot(*e.deviation.T)
    known = ~np.any([(e.t >= a) & (e.t <= b) for a, b in (*estimates.lost, (AT, AT + SETTLES))], axis=0)
    marked = min((a - AT for a, _ in estimates.lost if a > AT - 1.0), default=math.nan)
    found = not estimates.lost or estimates.lost[-1][1] < drive.t[-1] - 1e-6
    return Run(marked, float(error[e.t < AT].max()), float(error[known].max()), found)


@click.command()
@click.option("--drives", default=20, show_default=True)
@click.option("--seconds", default=2.0, show_default=True, help="How long the robot is in the air.")
def main(drives: int, seconds: float) -> None:
    """Print what became of robots that were carried off."""
    click.echo("| room | sensors | drives | marked at the latest | worst before | worst outside | found again |")
    click.echo("|---|---|--:|--:|--:|--:|--:|")
    for bare in (False, True):
        made = (carried(seed, seconds, bare) for seed in range(FIRST_SEED, FIRST_SEED + drives))
        logs = [one for one in made if one is not None]
        for sensors in (("lrf",), ("compass", "lrf")):
            runs = [judged(drive, robot, sensors) for drive, robot in logs]
            late = float(np.max([r.marked for r in runs]))
            before, worst = (
                1000.0 * max(values) for values in ([r.before for r in runs], [r.worst for r in runs])
            )
            room = "bare rectangle" if bare else "with plates"
            click.echo(
                f"| {room} | {'+'.join(sensors)} | {len(runs)} | {late:+.1f} s | {before:.0f} mm | {worst:.0f} mm "
                f"| {sum(r.found for r in runs)} |"
            )


if __name__ == "__main__":
    main()
