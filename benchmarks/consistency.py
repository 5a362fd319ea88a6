"""Does the covariance stay right where nothing observes the heading or the place? Simulated drives.

    python -m benchmarks.consistency --drives 30
    python -m benchmarks.consistency --drives 10 --case "laser alone" --case "laser at 40 Hz"
    python -m benchmarks.consistency --drives 30 -o drives.jsonl   (goes on where it was stopped)

Each row is a case of `consistency_cases`: the mean over drives with the worst in brackets, and the goals. `walls`
is the smallest sigma of a map line's direction at the end, over the sigma of the heading at the first scan. With
a laser alone it must not fall below 1: nothing that is measured can improve it. Where the filter says that it is
lost, nothing is judged. Thirty drives give an ANEES near 1 to about 0.1, a large one only roughly: with a laser
alone a drive has a single draw of the heading. A start that is drawn, and that nothing observes, errs by that one
draw at every instant. So what the drawn starts alone give stands below the table: the share inside 3 sigma of
those cases is to be at most LEEWAY below it, and where their own ANEES is above 1, the goal is as many times
higher. A laser whose clock is off is judged with it set to what the drive and its truth tell.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from functools import cache
from typing import NamedTuple

import click
import numpy as np
from msgspec.structs import replace

from locfuse.fusion.checks.clocks import lag_of_run
from locfuse.fusion.data import Array, Drive, Estimates, Evaluation
from locfuse.fusion.fuse import fuse
from locfuse.fusion.judge.evaluate import evaluate
from locfuse.fusion.kernels.ekf import bent
from locfuse.fusion.robot import Robot
from locfuse.fusion.whole_drive.smooth import fuse_and_smooth
from locfuse.sample_logs.load import load
from locfuse.sample_logs.messages import streams

from . import experiment
from .consistency_bound import Bound, bound, drive_once, path_in_frame, shape_error
from .consistency_cases import ALONE, CASES, LASER, Case
from .experiment import Row, simulated

NAMED = {case.name: case for case in CASES}
STARTS = (ALONE, *(name for name in NAMED if name.startswith("laser, start")))
DRAWN = (*STARTS, *(name for name in NAMED if name.startswith("placed anew")))  # the start is never observed
LEEWAY = 0.005  # of the share inside 3 sigma, for the errors of the drive itself
POSITION = "position_rmse_m"
Span = tuple[float, float]  # s since the first wheel reading: from, to


class Figures(NamedTuple):
    """One drive, judged against the truth, or the mean over drives."""

    anees: float  # of x, y and heading together, per degree of freedom: 1 is right
    position: float  # mm, rmse as estimated
    aligned: float  # mm, rmse after the best rigid motion onto the truth: the shape alone
    inside: float  # share of all errors of x, y and heading within 3 of their sigmas
    walls: float  # smallest sigma of a map line's direction at the end, over that of the heading at the first scan
    in_frame: float = math.nan  # mm, error of the shape of the path within the map's frame, where it is asked for


def drive_of(case: Case, seed: int) -> tuple[Drive, Robot]:
    """Simulate one drive and measure it."""
    return simulated(case.scenario, case.sets, seed).measured(case.given)


def as_found(case: Case, seed: int) -> Case:
    """Return the case with the laser's clock set to what advice finds by its run and the truth's headings."""
    if not case.late_by:
        return case
    drive, robot = drive_of(case, seed)
    found = lag_of_run(drive, drive.truth, fuse(drive, robot, LASER))
    if found is None:
        raise click.ClickException(f"{case.name}, seed {seed}: the truth's headings tell no lag")
    return replace(case, given=(*case.given, f"lrf.time_offset={found.offset}"))


def judged(case: Case, seed: int) -> Figures:
    """Fuse one drive and judge it."""
    drive, robot = drive_of(as_found(case, seed), seed)
    run = fuse_and_smooth(drive, robot, case.sensors)[1] if case.smooth else fuse(drive, robot, case.sensors)
    found = figures(run, drive, case.aligned_from, case.unknowable)
    if case.goal.in_frame is None or drive.truth is None:
        return found
    within = path_in_frame(drive, robot, case.sensors)
    return found._replace(in_frame=1000.0 * shape_error(within, drive.truth.xy))


def figures(
    estimates: Estimates, drive: Drive, aligned_from: float = 0.0, unknowable: Span = (0.0, 0.0)
) -> Figures:
    """Judge one run except where it says that it is lost, and in the `unknowable` span [s].

    The aligned error counts from `aligned_from` [s] on.
    """
    judged = evaluate(without(estimates, drive, (*estimates.lost, unknowable)), drive)
    early = (-math.inf, aligned_from)
    aligned = evaluate(without(estimates, drive, (*estimates.lost, unknowable, early)), drive, align="se2")
    return Figures(
        number(judged.figures["anees"]),
        1000 * number(judged.figures[POSITION]),
        1000 * number(aligned.figures[POSITION]),
        inside(judged),
        walls_kept(estimates, drive),
    )


def number(value: float | None) -> float:
    """Return a figure, NaN where there is none."""
    return math.nan if value is None else value


def without(estimates: Estimates, drive: Drive, spans: Sequence[Span]) -> Estimates:
    """Return the estimates without what they say of the truth's stamps inside any of the spans [s]."""
    if drive.truth is None or estimates.truth_pose is None:
        return estimates
    t = drive.truth.t
    hidden = np.any([(t >= begin) & (t < end) for begin, end in spans], axis=0)
    return replace(estimates, truth_pose=np.where(hidden[:, None], np.nan, estimates.truth_pose))


def inside(judged: Evaluation) -> float:
    """Return the share of the errors of x, y and heading within 3 sigma; where sigma is 0, nothing is judged."""
    assert judged.heading is not None
    errors = np.column_stack((judged.deviation, judged.heading))
    stated = judged.sigma > 0
    return float((np.abs(errors) <= 3 * judged.sigma)[stated].mean())


def walls_kept(estimates: Estimates, drive: Drive) -> float:
    """Return the smallest sigma of a line's direction at the end over that of the heading at the first scan.

    With a laser alone it cannot honestly be below 1: every direction in the map hangs on that one heading.
    """
    first = drive.instant["lrf"][0]
    heading = math.sqrt(estimates.triangles[first, 5])
    directions = [math.sqrt(line.P_map[1, 1]) for line in estimates.final_map]
    return min(directions) / heading if directions and heading > 0 else math.nan


# --- What the drawn starts alone do: the figures of a filter that errs nowhere else


class Start(NamedTuple):
    """The sigmas of a start."""

    theta: float  # rad
    xy: float  # m


class Alone(NamedTuple):
    """What the starts alone give."""

    anees: float
    inside: float  # share of errors of x, y and heading within 3 sigma


def alone(start: Start, way: Array, seeds: Iterable[int]) -> Alone:
    """Return what the starts of these drives alone give along the way (n, 2) [m] from the start."""
    drawn = np.array([streams(seed)("start").standard_normal(3) for seed in seeds])
    return Alone(float(np.square(drawn).mean()), float(share_inside(drawn, start, way).mean()))


def share_inside(drawn: Array, start: Start, way: Array) -> Array:
    """Return which share of a drive's errors lies within 3 sigma (k,), by draws (k, 3) of its start.

    An error of the start moves and turns the whole drive. The covariance is the start's, carried along the way as
    it is believed: across a lever r by the heading's variance, along it by E (cos a - 1)^2 of a Gaussian angle a.
    """
    off = drawn * (start.xy, start.xy, start.theta)
    c, s = np.cos(off[:, 2:]), np.sin(off[:, 2:])
    x, y = c * way[:, 0] - s * way[:, 1], s * way[:, 0] + c * way[:, 1]  # (k, n) m, as believed
    turned = start.theta**2
    along = bent(turned)
    heading = np.broadcast_to(off[:, 2:], x.shape)
    errors = np.abs([off[:, :1] + x - way[:, 0], off[:, 1:2] + y - way[:, 1], heading])
    variances = [start.xy**2 + y * y * turned + along * x * x, start.xy**2 + x * x * turned + along * y * y]
    limits = 3.0 * np.sqrt([*variances, np.full(x.shape, turned)])
    share: Array = (errors <= limits).mean(axis=(0, 2))
    return share


def start_of(sets: Iterable[str]) -> Start | None:
    """Return the sigmas of the start that a scenario's settings state; None: it is known exactly."""
    stated = dict(one.split("=", 1) for one in sets)
    if "start.sigma_theta_deg" not in stated:
        return None
    return Start(math.radians(float(stated["start.sigma_theta_deg"])), float(stated["start.sigma_xy"]))


@cache
def least(case: Case, seeds: range) -> Bound:
    """Return the mean over drives of the least error that the shape of the path can have [m]."""
    scenario = load(case.scenario, case.sets)
    found = [bound(scenario, *drive_once(scenario, seed)) for seed in seeds]
    return Bound(*np.mean(found, axis=0).tolist())


def by_start(case: Case, seeds: range) -> Alone | None:
    """Return what the starts alone give in a case where nothing observes them; None: another."""
    start = start_of(case.sets)
    if case.name not in DRAWN or start is None:
        return None
    truth = drive_of(case, seeds[0])[0].truth
    assert truth is not None
    return alone(start, truth.xy - truth.xy[0], seeds)


class Wanted(NamedTuple):
    """The goal of one figure."""

    name: str
    value: float
    low: float = -math.inf
    high: float = math.inf

    @property
    def met(self) -> bool:
        """Whether the figure is within its goal."""
        return self.low <= self.value <= self.high

    def __str__(self) -> str:
        """Return the goal in words."""
        bounds = [f"≥ {self.low:.3g}"] * math.isfinite(self.low) + [f"≤ {self.high:.3g}"] * math.isfinite(
            self.high
        )
        return f"{self.name} {' '.join(bounds)}"


def wanted(case: Case, found: dict[str, Figures], seeds: range) -> Iterator[Wanted]:
    """Yield the goals of a case that can be judged by the cases that were run."""
    now, goal, start = found[case.name], case.goal, by_start(case, seeds)
    if goal.anees is not None:
        low, high = goal.anees
        yield Wanted("ANEES", now.anees, low, high * max(1.0, start.anees if start else 1.0))
    yield Wanted("inside", now.inside, min(goal.inside, start.inside - LEEWAY if start else 1.0))
    if goal.walls is not None:
        yield Wanted("walls", now.walls, goal.walls)
    if goal.position is not None:
        yield Wanted("position", now.position, high=goal.position)
    if goal.of_bound is not None:
        yield Wanted("aligned", now.aligned, high=1000.0 * goal.of_bound * least(case, seeds).at_truth)
    others = {"position": goal.position_as, "aligned": goal.aligned_as, "in_frame": goal.in_frame}
    for name, other in others.items():
        if other is not None and other[0] in found:
            base = found[other[0]]
            limit = other[1] * (base.aligned if name == "in_frame" else getattr(base, name))
            yield Wanted(name, getattr(now, name), high=limit)


def work(name: str, seed: int) -> Row:
    """Return the figures of one drive."""
    return {"figures": list(judged(NAMED[name], seed))}


def table(rows: list[Row]) -> Iterator[str]:
    """Yield the figures and goals of every case, and below them what no filter could do better."""
    numbers = [row["task"][1] for row in rows]
    seeds = range(min(numbers), max(numbers) + 1)
    drives = {n: [row["figures"] for row in rows if row["task"][0] == n] for n in {r["task"][0]: 0 for r in rows}}
    found = {
        name: Figures(*np.mean(every, axis=0).tolist())._replace(walls=min(one[4] for one in every))
        for name, every in drives.items()
    }
    lines = []
    for name, m in found.items():
        worst = Figures(*np.max(drives[name], axis=0).tolist())
        goals = list(wanted(NAMED[name], found, seeds))
        framed = "" if math.isnan(m.in_frame) else f", in its frame {m.in_frame:.1f}"
        aligned = f"{m.aligned:.1f} ({worst.aligned:.1f}){framed}"
        cells = (f"{m.anees:.3g} ({worst.anees:.3g})", f"{m.position:.1f}", aligned, f"{m.inside:.1%}")
        missed = "; ".join(str(goal) for goal in goals if not goal.met)
        lines.append((name, *cells, f"{m.walls:.2f}", "; ".join(map(str, goals)), missed))
    head = ("case", "ANEES", "position [mm]", "aligned [mm]", "inside 3 sigma", "walls", "goals", "missed")
    yield from experiment.table(head, lines)
    for name in found:
        if NAMED[name].goal.of_bound is not None:
            at_truth, after_scan = (1000.0 * b for b in least(NAMED[name], seeds))
            yield (
                f"{name}: a filter that knew the walls and used every beam would still have an aligned error of "
                f"{at_truth:.2f} mm at the truth's stamps ({after_scan:.2f} mm after each scan)."
            )
        if (start := by_start(NAMED[name], seeds)) is not None:
            alone_have = f"ANEES {start.anees:.2f} and {start.inside:.2%} inside 3 sigma"
            yield f"{name}: the drawn starts alone have {alone_have}."


main = experiment.command(work, table, NAMED, drives=30)

if __name__ == "__main__":
    main()
