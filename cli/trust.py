"""What a report says of trust: every sensor's noise without truth, every covariance where there is truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from ..fusion.consistency import Run, judge
from ..fusion.data import Drive, Estimates, Evaluation
from ..fusion.honesty import honesty
from ..fusion.robot import Robot


def evidence(drive: Drive, estimates: Estimates, robot: Robot) -> list[Run]:
    """Return what a run says of its sensors' noise; nothing where it is smoothed or has no noise to set.

    The noise of the printed filter is the print's, whatever robot.toml says.
    """
    return [] if estimates.smoothed or robot.preset == "paper" else [Run.of(drive, estimates)]


def add_consistency(
    report: dict[str, Any], runs: Sequence[Run], evaluations: Sequence[Evaluation], robot: Robot
) -> None:
    """Add `consistency` to every sensor of every configuration, to those with truth, and for all of them."""
    rows = report["configurations"]
    for judged in evaluations:
        honest = honesty(judged)
        rows[judged.name]["consistency"] = None if honest is None else asdict(honest)
    if not runs:
        return
    verdicts: dict[str, dict[str, Any]] = {}
    for name, sensors in judge(runs, robot).items():
        for sensor, found in sensors.items():
            values = rows[name]["sensors"][sensor]["consistency"] = asdict(found)
            verdicts[sensor] = {key: values[key] for key in ("verdict", "words", "cures")}
    report["consistency"] = verdicts
