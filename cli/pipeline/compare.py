"""Several configurations over one measured log, judged: by truth where there is truth, else by prediction."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, cast, get_args

import numpy as np

from locfuse.formats.report import json_report
from locfuse.fusion import se2
from locfuse.fusion.data import Drive, Estimates, Evaluation
from locfuse.fusion.judge.consistency import Run
from locfuse.fusion.judge.credit import Credit, credit
from locfuse.fusion.judge.evaluate import Align, evaluate
from locfuse.fusion.judge.predictive import Score, listeners, scores
from locfuse.fusion.paper.preset import fuser
from locfuse.fusion.robot import Robot
from locfuse.fusion.sensors.registry import REGISTRY

from . import results
from .configurations import Configuration
from .key import Asked, key
from .load import Loaded
from .memory import lean
from .settings import Progress, one_of
from .trust import add_consistency, evidence
from .verdicts import credit_values, prediction_values, verdicts

OTHER_FRAME_M, OTHER_FRAME_RAD = 0.5, math.radians(20.0)  # a first pose this far from the truth's: another frame
PSEUDO = (
    "there is no truth in this log. The smoothed estimate has seen the whole drive and serves as a "
    "pseudo-reference: it shows what only the future corrects, and shares every error of its own sensors and map"
)
PLAIN_FRAME = "none"  # no alignment: the covariance can be judged
Watch = Callable[[Estimates, Evaluation], None]
Heard = Callable[[Estimates], None]


@dataclass(frozen=True)
class Compared:
    """What one `compare` found out about one log."""

    loaded: Loaded
    configurations: Sequence[Configuration]
    estimates: Sequence[Estimates]  # without audits, unless they were to be kept
    evaluations: Sequence[Evaluation]
    runs: Sequence[Run]  # evidence of the sensors' noise
    credit: Credit | None  # where there is truth
    scores: Sequence[Score]  # where there is none


class Judged(NamedTuple):
    """One configuration's result, and what its audits say of the sensors' noise."""

    estimates: Estimates
    evaluation: Evaluation
    evidence: list[Run]


def compare_log(
    loaded: Loaded,
    configurations: Sequence[Configuration],
    align: str,
    progress: Progress,
    smooth: bool = False,
    watch: Sequence[Watch] = (),
    audits: bool = False,
    foreign: Sequence[Estimates] = (),
    heard: Sequence[Heard] = (),
) -> Compared:
    """Run and judge every configuration; smoothed ones come after all others.

    `foreign` are other people's estimates, judged beside ours.

    Audits are most of what a run holds. Unless `audits` are kept they end as soon as it is judged: who draws them
    takes what is drawn then (`watch`). So it is with the runs that other sensors only listen to (`heard`).
    """
    one_of(align, get_args(Align), "align")
    drive, robot = loaded.drive, loaded.robot
    if smooth:
        refuse_smoothing(robot, configurations)
    filtered, smoothed = [], []
    for c in configurations:
        progress(f"fusing {c.name}")
        first, *after = lean(_judged, c, loaded, align, smooth, watch, audits)
        filtered.append(first)
        smoothed += after
    plain = {
        frozenset(c.sensors): j.evaluation for c, j in zip(configurations, filtered, strict=True) if not c.rates
    }
    present = [s for s in REGISTRY if s in drive.measurements]
    found = credit(plain, present) if drive.truth is not None else None
    predicted = [] if found is not None else predict(drive, robot, configurations, progress, heard)
    every = [*filtered, *smoothed, *(_judged_foreign(e, drive, align) for e in foreign)]
    return Compared(
        loaded=loaded,
        configurations=configurations,
        estimates=[j.estimates for j in every],
        evaluations=[j.evaluation for j in every],
        runs=[run for j in every for run in j.evidence],
        credit=found,
        scores=predicted,
    )


def _judged(
    c: Configuration, loaded: Loaded, align: str, smooth: bool, watch: Sequence[Watch], audits: bool
) -> list[Judged]:
    """Fuse and judge one configuration: filtered, and perhaps smoothed."""
    drive, robot, judged = c.drive(loaded.drive), loaded.robot, []
    how = cast("Align", align)
    for e in lean(c.fuse, loaded.drive, robot, smooth and bool(c.sensors)):
        evaluation = lean(evaluate, e, drive, how)
        for look in watch:
            look(e, evaluation)
        kept = e if audits else replace(e, audits={})
        judged.append(Judged(kept, evaluation, evidence(drive, e, robot)))
    return judged


def _other_frame(estimates: Estimates, drive: Drive) -> float | None:
    """Return how far [m] a foreign estimate begins from the truth, where that means another frame; else None."""
    if drive.truth is None or estimates.truth_pose is None:
        return None
    rows = np.flatnonzero(np.isfinite(estimates.truth_pose[:, 0]))
    if not len(rows):
        return None
    first, pose = rows[0], estimates.truth_pose[rows[0]]
    point = se2.transform(pose[None], np.array([drive.truth.point]))[0]
    away = float(np.hypot(*(point - drive.truth.xy[first])))
    theta = drive.truth.theta
    turned = 0.0 if theta is None else abs(float(se2.wrap_all(np.array([pose[2] - theta[first]]))[0]))
    return away if away > OTHER_FRAME_M or turned > OTHER_FRAME_RAD else None


def _judged_foreign(e: Estimates, drive: Drive, align: str) -> Judged:
    """Judge an estimate that is not ours; one of another frame is moved to the truth at its first pose."""
    away = _other_frame(e, drive) if align == "none" else None
    if away is not None:
        words = (
            f"{e.name}: begins {away:.2f} m from the truth, so it is of another frame: aligned at its first pose"
        )
        e = replace(e, notes=(*e.notes, words))
    return Judged(e, evaluate(e, drive, cast("Align", align if away is None else "origin")), [])


def refuse_smoothing(robot: Robot, configurations: Sequence[Configuration]) -> None:
    """Raise UsageError before any work is done where one of the filters does not weigh optimally."""
    from locfuse.fusion.smooth import check_optimal

    for c in configurations:
        check_optimal(robot, c.sensors)


def predict(
    drive: Drive,
    robot: Robot,
    configurations: Sequence[Configuration],
    progress: Progress,
    heard: Sequence[Heard] = (),
) -> list[Score]:
    """Return how well each configuration predicts the sensors that only listen to it."""
    if not drive.measurements:
        return []
    sets = [((), "odometry"), *((c.sensors, c.name) for c in configurations if c.sensors and not c.rates)]

    def tried() -> Iterator[Estimates]:
        for sensors, name in sets:
            progress(f"trying how {name} predicts the rest")
            e = lean(fuser(robot.preset), drive, robot, sensors, name, listeners(drive, sensors))
            for take in heard:
                take(e)
            yield e
            del e

    return scores(drive, tried())


def report_of(compared: Compared, asked: Asked | None = None) -> dict[str, Any]:
    """Return the report as plain values: report.json. With what was `asked` it has a key."""
    report = results.build(compared.loaded, compared.evaluations)
    tables = compared.loaded.asked
    report["key"] = key(compared.loaded.log.identity, tables, asked) if asked and tables is not None else None
    report["repeat"] = results.repeat(compared.loaded, asked) if asked else None
    report["changed_settings"] = results.changed_settings(compared.loaded)
    sets = {c.name: c.sensors for c in compared.configurations if not c.rates}
    report["verdicts"] = verdicts(compared.credit, compared.scores, sets)
    report["credit"] = None if compared.credit is None else credit_values(compared.credit)
    report["prediction"] = prediction_values(compared.scores, list(sets)) if compared.scores else None
    add_consistency(report, compared.runs, compared.evaluations, compared.loaded.robot)
    add_pseudo_reference(report, compared.loaded.drive, compared.estimates)
    return json_report.plain(report)


def report_of_run(
    loaded: Loaded, c: Configuration, estimates: Sequence[Estimates], evaluations: Sequence[Evaluation]
) -> dict[str, Any]:
    """Return the report of one configuration, filtered and perhaps smoothed, as plain values: run.json."""
    report = results.build(loaded, evaluations)
    runs = evidence(c.drive(loaded.drive), estimates[0], loaded.robot)
    add_consistency(report, runs, evaluations, loaded.robot)
    return json_report.plain(report)


def add_pseudo_reference(report: dict[str, Any], drive: Drive, estimates: Sequence[Estimates]) -> None:
    """Where there is no truth, compare every configuration with the smoothed one of most sensors, and say so."""
    smoothed = [e for e in estimates if e.smoothed]
    if drive.truth is not None or not smoothed:
        return
    from locfuse.fusion.smooth import against

    best = max(smoothed, key=lambda e: len(e.sensors))
    report["pseudo_reference"] = {"configuration": best.name, "words": PSEUDO}
    for e in estimates:
        report["configurations"][e.name]["against_smoothed"] = against(best, e)
