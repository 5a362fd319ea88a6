"""Consistency of the covariance where nothing observes heading or position, in simulated drives.

    python -m benchmarks.consistency --drives 30
    python -m benchmarks.consistency --drives 10 --case "laser alone" --case "laser at 40 Hz"

Each row is a case: the mean over drives with the worst drive in brackets, and the goals. `walls` is the smallest
sigma of a map line's direction at the end, divided by the sigma of the heading at the first scan: with a laser
alone it must not fall below 1. Times at which the filter reports that it is lost are not evaluated.

The robot is the simulator's default one, on the rounded rectangle. It begins to drive at once. Its first scan is
at 0.6 s, in motion, when the heading is uncertain by 1 degree: only an absolute heading can improve that later.
The compass has no iron: its 2 degrees are white noise, as configured. With thirty drives, an ANEES near 1 is known
to about 0.1. If the start is drawn at random and not observed, its error is the same in the whole drive: the
starts of the usual 30 seeds alone have an ANEES of 1.18, and 98 % of such drives are within 3 sigma. If the
laser's clock is wrong, the offset that drive and truth show is set.

Below the table is a lower bound for the error of any filter: the posterior Cramer-Rao bound (Tichavsky, Muravchik
and Nehorai 1998) of a filter that knows the true walls, from the first scan on. It uses every beam and the wheels,
each with their noise. A scan is used from its end on: the truth's stamps of these cases are in the first half of a
sweep, where locfuse too has only the scan before. A filter that must estimate the walls has less information.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import click
import msgspec
import numpy as np

from benchmarks import experiment
from benchmarks.experiment import Row, simulated
from locfuse.fusion import se2
from locfuse.fusion.checks.clocks import lag_of_run
from locfuse.fusion.data import Array, Drive, Estimates, Evaluation
from locfuse.fusion.fuse import fuse
from locfuse.fusion.judge.evaluate import evaluate
from locfuse.fusion.robot import Robot
from locfuse.fusion.whole_drive.smooth import fuse_and_smooth
from locfuse.sample_logs.scenario import LrfSpec, Scenario, load
from locfuse.sample_logs.simulate import Outcome, Simulation
from locfuse.sample_logs.world import Plan, cast

SCENARIO = "rounded_rectangle"
LASER, COMPASS = ("lrf",), ("compass", "lrf")
OFFSET = "compass.offset_deg=-65"  # the true offset: the simulated north is 65 degrees from the map's x axis
STANDING = (
    *("camera.enabled=false", "truth.rate=10", "compass.noise_deg=2", "compass.sigma_deg=2"),
    *("compass.hard_iron=[0, 0]", "compass.soft_iron=[1, 1, 0]"),
)
MOVING = (*STANDING, "control.wait=0", "lrf.phase=0.6")
LATE_S = 0.02
LATE_CLOCK = f'faults=[{{kind="clock_offset", sensor="lrf", seconds={LATE_S}}}]'
Span = tuple[float, float]  # s since the first wheel reading: from, to
# figure -> smallest and largest value; or another case, and the largest ratio to its figure
Goals = dict[str, tuple[float | str, float]]


class Case(msgspec.Struct, frozen=True):
    """One row of the table: scenario, settings of the filter, and sensors."""

    name: str
    sensors: tuple[str, ...]
    goals: Goals
    sets: tuple[str, ...] = MOVING  # of the scenario
    given: tuple[str, ...] = ()  # of robot.toml
    scenario: str = SCENARIO
    smooth: bool = False  # the smoothed estimate is judged
    aligned_from: float = 0.0  # s since the first wheel reading: the aligned error counts from here
    unknowable: Span = (0.0, 0.0)  # not evaluated, since no sensor has observed the state yet


def dropout(sensor: str, start: float, end: float) -> str:
    """Return the setting that makes a sensor lose its messages from start to end [s]."""
    return f'faults=[{{kind="dropout", sensor="{sensor}", start={start}, end={end}}}]'


def vague(degrees: float, metres: float) -> tuple[str, ...]:
    """Return the settings of a moving drive whose start has these sigmas, with an error drawn from them."""
    return (*MOVING, f"start.sigma_theta_deg={degrees}", f"start.sigma_xy={metres}")


def up_to(anees: float, least: float = 0.0, **goals: float | tuple[float | str, float]) -> Goals:
    """Return goals: ANEES at most `anees`, 99 % of errors within 3 sigma, and `goals` (one number: a minimum)."""
    both = {name: goal if isinstance(goal, tuple) else (goal, math.inf) for name, goal in goals.items()}
    return {"anees": (least, anees), "inside": (0.99, 1.0), **both}


ALONE, GIVEN = "laser alone", "compass+lrf, offset given"
AS_ALONE, BOUND = (ALONE, 1.01), "bound"
PLACED = 'faults=[{kind="kidnap", start=30, end=30.1, x=-0.5, y=-0.5, theta_deg=40}]'
CARRIED = (29.9, 30.3)
GPS = ("gps.enabled=true", "gps.rate=5")
ORIGIN = ("gps.topic=/gps/fix", "gps.origin=[21.038, 105.782]", "gps.east_deg=0")
# a precise laser with a constant error of 6 mm in each beam, which does not average out while the robot is at rest
PATTERN = (*STANDING, "lrf.pattern=0.006", "lrf.sigma_range=0.004", "lrf.sigma_angle_deg=0.05")
FAR, NEAR = vague(20, 0.5), vague(5, 0.1)
PLACED_FAR, LATE = (*FAR, PLACED), (*MOVING, LATE_CLOCK)
LIKE_ALONE = up_to(1.65, 0.8, aligned=AS_ALONE, walls=0.95, inside=0.975)
ANYWHERE = up_to(math.inf, aligned=AS_ALONE, inside=0.95)
FAST = (*MOVING, "lrf.rate=40", "lrf.duration=0.02")
CASES = (
    Case(ALONE, LASER, up_to(1.4, 0.8, aligned=(BOUND, 1.1), walls=0.95)),
    Case("laser alone, smoothed", LASER, up_to(1.3, aligned=(ALONE, 1.0)), smooth=True),
    Case("laser, start 2°, 0.05 m", LASER, LIKE_ALONE, vague(2, 0.05)),
    Case("laser, start 5°, 0.1 m", LASER, LIKE_ALONE, NEAR),
    Case("laser, start 20°, 0.5 m", LASER, LIKE_ALONE | {"anees": (0.0, 1.54)}, FAR),
    Case("laser, start 90°, 0.5 m", LASER, ANYWHERE, vague(90, 0.5)),
    Case("laser, start 180°, 0.5 m", LASER, ANYWHERE, vague(180, 0.5)),
    Case("laser at 40 Hz", LASER, up_to(1.4, 0.8, walls=0.95), FAST),
    Case("laser from 6 s", LASER, up_to(1.7), (*MOVING, dropout("lrf", 0, 6)), aligned_from=6.0),
    Case("laser silent 30-50 s", LASER, up_to(1.3), (*MOVING, "path.laps=1.5", dropout("lrf", 30, 50))),
    Case("compass+lrf, offset estimated", COMPASS, up_to(1.4, 0.8)),
    Case("compass+lrf, offset estimated, smoothed", COMPASS, up_to(1.3), smooth=True),
    Case(GIVEN, COMPASS, up_to(1.4, 0.8, position=(0.0, 8.96)), given=(OFFSET,)),
    Case(f"{GIVEN}, smoothed", COMPASS, up_to(1.3, position=(0.0, 6.22)), given=(OFFSET,), smooth=True),
    Case("compass+lrf, start 5°, 0.1 m", COMPASS, up_to(1.2), NEAR, (OFFSET,)),
    Case("compass+lrf, start 20°, 0.5 m", COMPASS, up_to(1.2), FAR, (OFFSET,)),
    Case("compass from 20 s, start 20°, 0.5 m", COMPASS, up_to(1.3), (*FAR, dropout("compass", 0, 20)), (OFFSET,)),
    Case("landmark bearing, start 20°, 0.5 m", ("lrf", "camera"), up_to(1.5), (*FAR, "camera.enabled=true")),
    Case("GPS 1 m, start 20°, 0.5 m", ("lrf", "gps"), up_to(1.4), (*FAR, *GPS, "gps.sigma=1"), ORIGIN),
    Case("GPS 5 cm, start 20°, 0.5 m", ("lrf", "gps"), up_to(1.4), (*FAR, *GPS, "gps.sigma=0.05"), ORIGIN),
    Case("placed anew at 30 s", LASER, up_to(1.2), (*MOVING, PLACED), unknowable=CARRIED),
    Case("placed anew at 30 s, start 20°", LASER, up_to(1.42, inside=0.975), PLACED_FAR, unknowable=CARRIED),
    Case("fixed 6 mm pattern", COMPASS, up_to(1.3), PATTERN, (OFFSET,)),
    Case("fixed 6 mm pattern, 60 s of rest", COMPASS, up_to(1.3), (*PATTERN, "control.wait=60"), (OFFSET,)),
    Case("laser 3 cm off", COMPASS, up_to(math.inf, position=(GIVEN, 1.45)), given=(OFFSET, "lrf.x=0.23")),
    Case("laser 2° off", LASER, up_to(math.inf, position=(ALONE, 1.1)), given=("lrf.yaw_deg=2",)),
    Case("laser's clock 20 ms off", COMPASS, up_to(math.inf, position=(GIVEN, 1.05)), LATE, (OFFSET,)),
    Case("round room", LASER, up_to(2.0), scenario="round_room"),
)
NAMED = {case.name: case for case in CASES}


class Figures(NamedTuple):
    """Figures of one drive against truth, or their means over drives."""

    anees: float  # of x, y and heading together, per degree of freedom: 1 is consistent
    position: float  # mm, rmse without alignment
    aligned: float  # mm, rmse after the best rigid alignment with the truth
    inside: float  # share of all errors of x, y and heading within 3 sigma
    walls: float  # (smallest sigma of a map line's direction at the end) / (heading sigma at the first scan)


def drive_of(case: Case, seed: int) -> tuple[Drive, Robot]:
    """Simulate and measure one drive; if the laser's clock is shifted, set the offset that the truth shows."""
    drive, robot = simulated(case.scenario, case.sets, seed).measured(case.given)
    if LATE_CLOCK not in case.sets:
        return drive, robot
    found = lag_of_run(drive, drive.truth, fuse(drive, robot, LASER))
    if found is None:
        raise click.ClickException(f"{case.name}, seed {seed}: the truth's headings tell no lag")
    return simulated(case.scenario, case.sets, seed).measured((*case.given, f"lrf.time_offset={found.offset}"))


def judged(case: Case, seed: int) -> Figures:
    """Fuse and evaluate one drive, except while the filter is lost and in the case's `unknowable` span."""
    drive, robot = drive_of(case, seed)
    run = fuse_and_smooth(drive, robot, case.sensors)[1] if case.smooth else fuse(drive, robot, case.sensors)
    spans = (*run.lost, case.unknowable)
    plain = evaluate(without(run, drive, spans), drive)
    aligned = evaluate(without(run, drive, (*spans, (-math.inf, case.aligned_from))), drive, align="se2")
    asked = ((plain, "anees"), (plain, "position_rmse_m"), (aligned, "position_rmse_m"))
    anees, position, shape = (math.nan if (v := e.figures[key]) is None else float(v) for e, key in asked)
    return Figures(anees, 1000 * position, 1000 * shape, inside(plain), walls_kept(run, drive))


def without(estimates: Estimates, drive: Drive, spans: Sequence[Span]) -> Estimates:
    """Return the estimates without their poses at the truth's stamps inside any of the spans [s]."""
    if drive.truth is None or estimates.truth_pose is None:
        return estimates
    t = drive.truth.t
    hidden = np.any([(t >= begin) & (t < end) for begin, end in spans], axis=0)
    return msgspec.structs.replace(estimates, truth_pose=np.where(hidden[:, None], np.nan, estimates.truth_pose))


def inside(judged: Evaluation) -> float:
    """Return the share of errors of x, y and heading within 3 sigma, where sigma is not 0."""
    assert judged.heading is not None
    errors = np.column_stack((judged.deviation, judged.heading))
    return float((np.abs(errors) <= 3 * judged.sigma)[judged.sigma > 0].mean())


def walls_kept(estimates: Estimates, drive: Drive) -> float:
    """Return (smallest sigma of a line's direction at the end) / (sigma of the heading at the first scan)."""
    heading = math.sqrt(estimates.triangles[drive.instant["lrf"][0], 5])
    directions = [math.sqrt(line.P_map[1, 1]) for line in estimates.final_map]
    return min(directions) / heading if directions and heading > 0 else math.nan


def work(name: str, seed: int) -> Row:
    """Return the figures of one drive, and the lower bound of the error if a goal needs it."""
    case = NAMED[name]
    found: Row = {"figures": list(judged(case, seed)), BOUND: None}
    if case.goals.get("aligned", ("", 0.0))[0] == BOUND:
        outcome = simulated(case.scenario, case.sets, seed).outcome
        found[BOUND] = bound(load(case.scenario, case.sets), seed, outcome)
    return found


def table(rows: list[Row]) -> Iterator[str]:
    drives = {name: np.array([row["figures"] for row in mine]) for name, mine in experiment.by_case(rows).items()}
    found = {name: Figures(*m.mean(axis=0).tolist())._replace(walls=m[:, 4].min()) for name, m in drives.items()}
    of_bound = {n: [row[BOUND] for row in mine if row[BOUND]] for n, mine in experiment.by_case(rows).items()}
    bounds = {name: 1000 * np.mean(each, axis=0) for name, each in of_bound.items() if each}
    lines, after = [], []
    for name, m in found.items():
        worst, goals, missed = Figures(*drives[name].max(axis=0).tolist()), [], []
        for figure, (least, most) in NAMED[name].goals.items():
            if isinstance(least, str):
                of = bounds[name][0] if least == BOUND else getattr(found.get(least), figure, math.inf)
                least, most = 0.0, most * of  # noqa: PLW2901
            parts = [f"≥ {least:.3g}"] * (least > 0) + [f"≤ {most:.3g}"] * (most < math.inf and figure != "inside")
            if parts:
                goals.append(f"{figure} {' '.join(parts)}")
                missed += [] if least <= getattr(m, figure) <= most else goals[-1:]
        cells = (
            f"{m.anees:.3g} ({worst.anees:.3g})",
            f"{m.position:.1f}",
            f"{m.aligned:.1f} ({worst.aligned:.1f})",
        )
        lines.append((name, *cells, f"{m.inside:.1%}", f"{m.walls:.2f}", "; ".join(goals), "; ".join(missed)))
        if name in bounds:
            at_truth, after_scan = bounds[name]
            after.append(
                f"{name}: a filter that knew the walls and used every beam would still have an aligned error of "
                f"{at_truth:.2f} mm at the truth's stamps ({after_scan:.2f} mm after each scan)."
            )
    head = ("case", "ANEES", "position [mm]", "aligned [mm]", "inside 3 sigma", "walls", "goals", "missed")
    yield from (*experiment.table(head, lines), *after)


# --- the bound

PIECES = 12  # pieces of a sweep, with the wheels' noise in between
STEP = 1e-6  # m, rad: step of numerical derivatives
MAX_SLOPE = 50.0  # m/m: with a larger derivative, a beam grazes a wall or passes its end within one step


class Roll(NamedTuple):
    """True motion of a drive: poses, and the distance rolled by each wheel."""

    t: Array  # (n,) s
    pose: Array  # (n, 3)
    rolled_t: Array  # (k,) s
    rolled: Array  # (k, 2) m, left and right, sum of absolute distances

    @classmethod
    def of(cls, outcome: Outcome) -> Roll:
        """Return the true drive of a simulation."""
        steps = np.abs(np.diff(outcome.counts, axis=0, prepend=outcome.counts[:1]))
        rolled = np.cumsum(steps, axis=0) * outcome.rad_per_count * outcome.radius
        return cls(outcome.truth_t, outcome.truth, outcome.ticks_t, rolled)

    def at(self, t: Array) -> tuple[Array, Array]:
        """Return poses (m, 3) and rolled distances (m, 2) [m] at times t (m,)."""
        pose = np.stack([np.interp(t, self.t, column) for column in self.pose.T], axis=-1)
        return pose, np.stack([np.interp(t, self.rolled_t, column) for column in self.rolled.T], axis=-1)


def bound(scenario: Scenario, seed: int, outcome: Outcome) -> tuple[float, float]:
    """Return the lower bounds of the rms position error [m]: at the truth's stamps, and at the ends of scans."""
    roll, plan = Roll.of(outcome), Simulation(scenario, seed).scene.plan(scenario.lrf.z)
    lrf, wheels, end = scenario.lrf, scenario.wheels, float(roll.t[-1])
    scans = np.arange(lrf.phase, end - lrf.duration, 1.0 / lrf.rate)
    stamps = np.arange(scenario.truth.phase, end, 1.0 / scenario.truth.rate)
    share = (np.arange(PIECES) + 0.5) / PIECES
    t = (scans[:, None] + lrf.duration * share).ravel()
    known = np.concatenate([information(lrf, roll, plan, s) for s in scans])
    P, last, ends, at_truth = np.zeros((3, 3)), t[0], list[Array](), list[Array]()
    for k, (now, fresh) in enumerate(zip(t.tolist(), known, strict=True)):
        if k % PIECES == 0:
            due = stamps[(stamps > last) & (stamps <= now + lrf.duration * (1.0 - share[0]))]
            at_truth += [moved(P, roll, (last, stamp), wheels.noise, wheels.track) for stamp in due]
        P = moved(P, roll, (last, now), wheels.noise, wheels.track)
        P = P - P @ fresh @ np.linalg.solve(np.eye(3) + P @ fresh, P)
        last = now
        if k % PIECES == PIECES - 1:
            ends.append(P)
    first, second = (math.sqrt(float(np.mean([P[0, 0] + P[1, 1] for P in each]))) for each in (at_truth, ends))
    return first, second


def information(lrf: LrfSpec, roll: Roll, plan: Plan, begin: float) -> Array:
    """Return the information matrices of the pose (PIECES, 3, 3) from parts of the scan that starts at `begin`."""
    half = math.radians(lrf.field_of_view_deg) / 2.0
    angles, times = np.linspace(-half, half, lrf.beams), begin + np.linspace(0.0, lrf.duration, lrf.beams)
    pose, mount = roll.at(times)[0], np.array([lrf.x, lrf.y, math.radians(lrf.yaw_deg)])

    def ranges(off: Array, turn: float = 0.0) -> Array:
        laser = se2.compose(pose + off, mount)
        return cast(plan, laser[:, :2], laser[:, 2] + angles + turn)

    none, steps = np.zeros(3), STEP * np.eye(3)
    with np.errstate(invalid="ignore"):  # beams that hit nothing
        H = np.stack([(ranges(step) - ranges(-step)) / (2.0 * STEP) for step in steps], axis=-1)
        by_angle = (ranges(none, STEP) - ranges(none, -STEP)) / (2.0 * STEP)
    variance = lrf.sigma_range**2 + (math.radians(lrf.sigma_angle_deg) * by_angle) ** 2
    seen = (np.abs(H).max(axis=1) < MAX_SLOPE) & (ranges(none) <= lrf.range_max)
    weights = np.where(seen, (1.0 - lrf.lost) / variance, 0.0)
    H = np.where(seen[:, None], H, 0.0)
    return np.stack([(H[i].T * weights[i]) @ H[i] for i in np.array_split(np.arange(lrf.beams), PIECES)])


def moved(P: Array, roll: Roll, span: Span, noise: float, track: float) -> Array:
    """Return the covariance (3, 3) after the wheels rolled over a span [s]."""
    (a, b), (before, after) = roll.at(np.array(span))
    dx, dy = (b - a)[:2].tolist()
    F = np.array([[1.0, 0.0, -dy], [0.0, 1.0, dx], [0.0, 0.0, 1.0]])
    c, s = math.cos(0.5 * (a[2] + b[2])), math.sin(0.5 * (a[2] + b[2]))
    B = np.array([[0.5 * c, 0.5 * c], [0.5 * s, 0.5 * s], [-1.0 / track, 1.0 / track]])
    out: Array = F @ P @ F.T + (B * (noise * (after - before))) @ B.T
    return out


main = experiment.command(work, table, NAMED, drives=30)

if __name__ == "__main__":
    main()
