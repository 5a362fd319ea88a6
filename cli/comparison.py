"""Several configurations over one measured log, judged: by truth where there is truth, else by prediction."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal, cast

from ..fusion.credit import Credit, credit
from ..fusion.data import Drive, Estimates, Evaluation
from ..fusion.evaluate import evaluate
from ..fusion.predictive import Score, listeners, scores
from ..fusion.robot import Robot
from ..fusion.sensors.registry import REGISTRY
from . import results
from .configurations import Configuration
from .filters import fuser
from .load import Loaded
from .verdicts import credit_values, prediction_values, verdicts

Progress = Callable[[str], None]


@dataclass(frozen=True)
class Compared:
    """What one `compare` found out about one log."""

    loaded: Loaded
    configurations: Sequence[Configuration]
    estimates: Sequence[Estimates]
    evaluations: Sequence[Evaluation]
    credit: Credit | None  # where there is truth
    scores: Sequence[Score]  # where there is none


def compare_log(
    loaded: Loaded, configurations: Sequence[Configuration], align: str, progress: Progress
) -> Compared:
    """Run and judge every configuration."""
    drive, robot = loaded.drive, loaded.robot
    estimates = []
    for c in configurations:
        progress(f"fusing {c.name}")
        estimates.append(c.fuse(drive, robot))
    how = cast("Literal['none', 'origin', 'se2']", align)
    judged = [evaluate(e, c.drive(drive), how) for c, e in zip(configurations, estimates, strict=True)]
    plain = {frozenset(c.sensors): j for c, j in zip(configurations, judged, strict=True) if not c.rates}
    present = [s for s in REGISTRY if s in drive.measurements]
    found = credit(plain, present) if drive.truth is not None else None
    predicted = [] if found is not None else predict(drive, robot, configurations, progress)
    return Compared(loaded, configurations, estimates, judged, found, predicted)


def predict(
    drive: Drive, robot: Robot, configurations: Sequence[Configuration], progress: Progress
) -> list[Score]:
    """Return how well each configuration predicts the sensors that only listen to it."""
    if not drive.measurements:
        return []
    tried = []
    sets = [((), "odometry"), *((c.sensors, c.name) for c in configurations if c.sensors and not c.rates)]
    for sensors, name in sets:
        progress(f"trying how {name} predicts the rest")
        tried.append(fuser(robot.preset)(drive, robot, sensors, name, listeners(drive, sensors)))
    return scores(drive, tried)


def report_of(compared: Compared) -> dict[str, Any]:
    """Return the report as plain values: report.json."""
    report = results.build(compared.loaded, compared.evaluations)
    sets = {c.name: c.sensors for c in compared.configurations if not c.rates}
    report["verdicts"] = verdicts(compared.credit, compared.scores, sets)
    report["credit"] = None if compared.credit is None else credit_values(compared.credit)
    report["prediction"] = prediction_values(compared.scores, list(sets)) if compared.scores else None
    return report
