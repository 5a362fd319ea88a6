"""The main line step by step, for those who want to go in between: open_log -> load -> fuse -> evaluate."""

from __future__ import annotations

from collections.abc import Sequence
from typing import cast, get_args

from locfuse.cli.analysis.configurations import Sensors, parse
from locfuse.cli.analysis.load import find_log
from locfuse.cli.analysis.settings import PathLike, one_of, words_of
from locfuse.formats.logs import log as logs
from locfuse.formats.logs.log import Log
from locfuse.fusion.data import Drive, Estimates, Evaluation
from locfuse.fusion.judge import evaluate as judge
from locfuse.fusion.judge.evaluate import Align
from locfuse.fusion.measure import thinned
from locfuse.fusion.robot import Robot


def open_log(log: PathLike | Sequence[PathLike]) -> Log:
    """Open a log without measuring it: `log.topics`, `log.stream("/scan").columns("ranges")`.

    Takes what `load` takes. Raises LocfuseError where there is no such log.
    """
    return logs.open_log(find_log(words_of(log)))


def fuse(drive: Drive, robot: Robot, sensors: Sensors = "all") -> Estimates:
    """Run the filter over a drive with these sensors: `fuse(session.drive, session.robot, ["compass", "lrf"])`.

    Returns pose (n, 3), covariance P (n, 3, 3) and the audit of every measurement at the drive's instants t (n,).
    Raises LocfuseError for an unknown sensor, or one that the drive lacks.
    """
    return parse(sensors, drive).fuse(drive, robot)[0]


def smooth(drive: Drive, robot: Robot, sensors: Sensors = "all") -> Estimates:
    """Run filter and smoother: every pose is estimated from the whole drive, its end included.

    Rauch, Tung and Striebel (1965). Raises LocfuseError as `fuse` does, and where a setting such as lrf.map =
    first-scan makes the filter's gain not the optimal one.
    """
    return parse(sensors, drive).fuse(drive, robot, smooth=True)[-1]


def evaluate(estimates: Estimates, drive: Drive, align: str = "none") -> Evaluation:
    """Judge an estimate by the drive's truth: deviations, and figures such as `figures["position_rmse_m"]`.

    `align`: "none", "origin" or "se2". Without truth the error figures are None.
    """
    one_of(align, get_args(Align), "align")
    seen = thinned(drive, estimates.rates) if estimates.rates else drive
    return judge.evaluate(estimates, seen, cast("Align", align))
