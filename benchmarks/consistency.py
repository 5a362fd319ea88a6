"""Does the covariance stay right where nothing observes the heading or the place? Simulated drives.

    python -m benchmarks.consistency --drives 30
    python -m benchmarks.consistency --drives 10 --case "laser alone" --case "laser at 40 Hz"
    python -m benchmarks.consistency --drives 30 --keep drives.jsonl   (goes on where it was stopped)

Each row is a case of `consistency_cases`: the mean over drives with the worst in brackets, the same of version
0.1, and the goal. `walls` is the smallest sigma of a map line's direction at the end, over the sigma of the
heading at the first scan. With a laser alone it must not fall below 1: nothing that is measured can improve it.
Where the filter says that it is lost, nothing is judged. Thirty drives give an ANEES near 1 to about 0.1, a large
one only roughly: with a laser alone a drive has a single draw of the heading. A start that is drawn, and that
nothing observes, errs by that one draw at every instant. So what the drawn starts alone give stands below the
table: the share inside 3 sigma of those cases is to be at most LEEWAY below it, and where their own ANEES is above
1, the goal is as many times higher. Where a position is to be no worse than that of 0.1, the drives are the same.
A laser whose clock is off is judged with it set to what the drive and its truth tell; 0.1 told nothing.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from functools import cache, lru_cache
from pathlib import Path

import click
import numpy as np
from msgspec.structs import replace

from locfuse.fusion.checks.clocks import lag_of_run
from locfuse.fusion.checks.lag import SAID_SIGMAS, Lag
from locfuse.fusion.data import Array, Drive
from locfuse.fusion.fuse import fuse
from locfuse.fusion.robot import Robot
from locfuse.fusion.whole_drive.smooth import fuse_and_smooth
from locfuse.sample_logs.load import load

from . import experiment
from .consistency_before import BEFORE
from .consistency_bound import Bound, bound, drive_once, path_in_frame, shape_error
from .consistency_cases import ALONE, CASES, LASER, Case
from .consistency_figures import Figures, Means, figures, means
from .consistency_starts import ENOUGH, Start, alone, often_short, start_of
from .consistency_table import HEAD
from .consistency_table import row as row_of
from .experiment import FIRST_SEED, Row, simulated

NAMED = {case.name: case for case in CASES}
STARTS = (ALONE, *(name for name in NAMED if name.startswith("laser, start")))
DRAWN = (*STARTS, *(name for name in NAMED if name.startswith("placed anew")))  # the start is never observed
LEEWAY = 0.005  # of the share inside 3 sigma, for the errors of the drive itself
RATES = (ALONE, "laser at 40 Hz")


def drive_of(case: Case, seed: int) -> tuple[Drive, Robot]:
    """Simulate one drive and measure it."""
    return simulated(case.scenario, case.sets, seed).measured(case.given)


@lru_cache(maxsize=64)
def late(case: Case, seed: int) -> Lag:
    """Return the laser's clock by its own run and the truth's headings, as advice finds it."""
    drive, robot = drive_of(case, seed)
    found = lag_of_run(drive, drive.truth, fuse(drive, robot, LASER))
    if found is None:
        raise click.ClickException(f"{case.name}, seed {seed}: the truth's headings tell no lag")
    return found


def as_found(case: Case, seed: int) -> Case:
    """Return the case with the laser's clock set to what is found, where it is wrong."""
    if not case.late_by:
        return case
    return replace(case, given=(*case.given, f"lrf.time_offset={late(case, seed).offset}"))


def judged(case: Case, seed: int) -> Figures:
    """Fuse one drive and judge it."""
    drive, robot = drive_of(as_found(case, seed), seed)
    run = fuse_and_smooth(drive, robot, case.sensors)[1] if case.smooth else fuse(drive, robot, case.sensors)
    found = figures(run, drive, case.aligned_from, case.unknowable)
    if case.goal.in_frame is None or drive.truth is None:
        return found
    within = path_in_frame(drive, robot, case.sensors)
    return found._replace(in_frame=1000.0 * shape_error(within, drive.truth.xy))


@cache
def least(case: Case, seeds: range) -> Bound:
    """Return the mean over drives of the least error that the shape of the path can have [m]."""
    scenario = load(case.scenario, case.sets)
    found = [bound(scenario, *drive_once(scenario, seed)) for seed in seeds]
    return Bound(*np.mean(found, axis=0).tolist())


def way_of(case: Case, seeds: range) -> tuple[Start, Array] | None:
    """Return the start and the way (n, 2) [m] from it in a case where nothing observes it; None: another."""
    start = start_of(case.sets)
    if case.name not in DRAWN or start is None:
        return None
    truth = drive_of(case, seeds[0])[0].truth
    assert truth is not None
    return start, truth.xy - truth.xy[0]


def fair(case: Case, seeds: range) -> Case:
    """Return the case with the ANEES and the share inside 3 sigma that its drawn starts allow, and its bound."""
    goal, found = case.goal, way_of(case, seeds)
    if goal.of_bound is not None:
        goal = replace(goal, aligned=1000.0 * goal.of_bound * least(case, seeds).at_truth)
    if found is not None:
        by_start = alone(*found, seeds)
        goal = replace(goal, inside=min(goal.inside, by_start.inside - LEEWAY))
        if goal.anees is not None:
            goal = replace(goal, anees=(goal.anees[0], goal.anees[1] * max(1.0, by_start.anees)))
    return replace(case, goal=goal)


def invariants(found: Mapping[str, Means], seeds: range) -> Iterator[str]:
    """Say what must not depend on the start's sigma or on the laser's rate, and what is chance."""
    for case in CASES:
        if case.goal.of_bound is not None and case.name in found:
            at_truth, after_scan = (1000.0 * b for b in least(case, seeds))
            yield (
                f"{case.name}: a filter that knew the walls and used every beam would still have an aligned error "
                f"of {at_truth:.2f} mm at the truth's stamps ({after_scan:.2f} mm after each scan). Here it is "
                f"{found[case.name].aligned / at_truth:.2f} times that (goal: {case.goal.of_bound:g})."
            )
        if case.late_by and case.name in found:
            yield f"{case.name}: {clock_words([late(case, seed) for seed in seeds], case.late_by)}"
        started = way_of(case, seeds) if case.name in found else None
        if started is not None:
            by_start, chance = alone(*started, seeds), often_short(*started, len(seeds))
            yield (
                f"{case.name}: the drawn starts alone have ANEES {by_start.anees:.2f} and "
                f"{by_start.inside:.2%} inside 3 sigma, whatever the filter does. Of other sets of {len(seeds)} "
                f"drawn starts {chance:.0%} have less than {ENOUGH:.0%}."
            )
    starts = [name for name in STARTS if name in found]
    if len(starts) > 1:
        values = [found[name].aligned for name in starts]
        listed = ", ".join(f"{v:.2f}" for v in values)
        spread = 100 * (max(values) / min(values) - 1)
        yield f"Aligned error by the start's sigma: {listed} mm, {spread:.1f} % apart (goal: 1 %)."
    if all(name in found for name in RATES):
        slow, fast = (found[name].anees for name in RATES)
        yield f"Laser at 10 Hz and at 40 Hz: ANEES {slow:.2f} and {fast:.2f} (goal: equal)."


def clock_words(lags: Sequence[Lag], late_by: float) -> str:
    """Return how well the clocks of lasers that are `late_by` [s] late were found."""
    off, sigmas = np.array([lag.offset + late_by for lag in lags]), np.array([lag.sigma for lag in lags])
    clear = sum(abs(lag.offset) > SAID_SIGMAS * lag.sigma for lag in lags)
    worst, rms, sigma = (1000.0 * float(s) for s in (np.abs(off).max(), np.sqrt((off**2).mean()), sigmas.mean()))
    return (
        f"found within {worst:.1f} ms, {rms:.1f} ms rms; its sigma is {sigma:.1f} ms. Beyond {SAID_SIGMAS:g} "
        f"sigma in {clear} of {len(lags)} drives (goal: all)."
    )


def work(name: str, seed: int) -> Row:
    """Return the figures of one drive, and how long it took [s]."""
    begin = time.perf_counter()
    return {"figures": list(judged(NAMED[name], seed)), "s": time.perf_counter() - begin}


@click.command()
@click.option("--drives", default=30, show_default=True)
@click.option("--case", "names", multiple=True, type=click.Choice(list(NAMED)))
@click.option("--seed", default=FIRST_SEED, show_default=True, help="Of the first drive.")
@click.option("--record", is_flag=True, help="Print the figures as lines of consistency_before.py.")
@click.option("--keep", type=click.Path(path_type=Path), help="Finished drives: they are not driven again.")
@click.option("--jobs", default=1, show_default=True)
def main(drives: int, names: tuple[str, ...], seed: int, record: bool, keep: Path | None, jobs: int) -> None:
    """Print how accurate and how consistent the filter is in every case."""
    seeds = range(seed, seed + drives)
    tasks = [(name, s) for name in NAMED if not names or name in names for s in seeds]
    made = experiment.rows(work, tasks, keep, jobs)
    found: dict[str, Means] = {}
    if not record:
        click.echo(HEAD)
    for name in dict.fromkeys(row["task"][0] for row in experiment.well(made)):
        mine = [row for row in experiment.well(made) if row["task"][0] == name]
        case, every = fair(NAMED[name], seeds), [Figures(*row["figures"]) for row in mine]
        found[name], before, seconds = means(every), BEFORE.get(name), sum(row["s"] for row in mine)
        same = means(every[: before.drives]) if before and seed == FIRST_SEED and drives > before.drives else None
        click.echo(recorded(case, found[name]) if record else row_of(case, found, before, seconds, same))
    for line in (*([] if record else ["", *invariants(found, seeds)]), *experiment.failures(made)):
        click.echo(line)


def recorded(case: Case, m: Means) -> str:
    """Return the figures with four digits, as a line of consistency_before.py."""
    values = ", ".join(f"{float(f'{value:.4g}')}" for value in m[1:])
    return f'    "{case.name}": Means({m.drives}, {values}),'


if __name__ == "__main__":
    main()
