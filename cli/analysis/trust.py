"""Trust in the report: each sensor's noise without truth, each covariance with truth, any reference."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from typing import Any

from msgspec.structs import asdict, replace

from locfuse.formats.report.findings import length
from locfuse.fusion.data import Drive, Estimates, Evaluation
from locfuse.fusion.judge.against import Reference
from locfuse.fusion.judge.consistency import Consistency, Run, judge
from locfuse.fusion.judge.covariance import Honesty, honesty
from locfuse.fusion.robot import Robot


def evidence(drive: Drive, estimates: Estimates, robot: Robot) -> list[Run]:
    """Return a run's evidence on its sensors' noise; empty if it is smoothed or has no noise setting.

    The noise of the paper's filter is fixed by the paper, whatever is set in robot.toml.
    """
    return [] if estimates.smoothed or robot.preset == "paper" else [Run.of(drive, estimates)]


def sensors_consistency(
    runs: Sequence[Run], robot: Robot, by_truth: Mapping[str, Honesty | None]
) -> dict[str, dict[str, Consistency]]:
    """Return the verdicts of runs on every sensor's noise, by configuration and sensor; {} for no runs."""
    return judge(runs, robot, overconfident(by_truth)) if runs else {}


def overconfident(by_truth: Mapping[str, Honesty | None]) -> set[str]:
    """Return the configurations that truth shows to be overconfident."""
    return {name for name, h in by_truth.items() if h is not None and h.overconfident}


def add_consistency(
    report: dict[str, Any], runs: Sequence[Run], evaluations: Sequence[Evaluation], robot: Robot
) -> None:
    """Add `consistency` to every sensor of every configuration, to configurations with truth, and to the whole."""
    rows = report["configurations"]
    by_truth = {judged.name: honesty(judged) for judged in evaluations}
    for name, honest in by_truth.items():
        rows[name]["consistency"] = None if honest is None else asdict(honest)
    if not runs:
        return
    verdicts: dict[str, dict[str, Any]] = {}
    judged = sensors_consistency(runs, robot, by_truth)
    for name, sensors in judged.items():
        for sensor, verdict in sensors.items():
            using = [by_truth.get(n) for n, used in judged.items() if sensor in used]
            found = unless_overconfident(sensor, verdict, using)
            values = rows[name]["sensors"][sensor]["consistency"] = asdict(found)
            del values["cures"]  # what nobody tried is no advice: `findings` has what was
            verdicts[sensor] = {key: values[key] for key in ("verdict", "words")}
    report["consistency"] = verdicts


def unless_overconfident(sensor: str, found: Consistency, using: Sequence[Honesty | None]) -> Consistency:
    """Withdraw the advice to trust a sensor more if by truth every run with it is overconfident.

    Its readings repeat well and are wrong together: a mount, a scale or a clock, which no noise figure fixes.
    """
    wrong = [honest for honest in using if honest is not None]
    all_wrong = bool(wrong) and all(honest.overconfident for honest in wrong)
    if found.verdict != "overstated" or found.scale is None or not all_wrong:
        return found
    times = math.sqrt(min(honest.anees for honest in wrong))
    words = (
        f"residuals are {1.0 / found.scale:.2g} times smaller than configured, yet position errors are "
        f"{times:.1f} times what the covariance says: check mount, scale and clock; a smaller sigma would make "
        "this worse"
    )
    return replace(found, words=words, cures={})


REFERENCE = (
    "Errors are measured against the smoothed solution of the {base}{sensors} (1 sigma {sigma}), not against "
    "truth. See: locfuse explain reference."
)
TOO_SMALL = {"understated", "correlated"}  # verdicts on a sigma


def noise_factors(runs: Sequence[Run], robot: Robot) -> dict[str, float]:
    """Return the factor by which each sensor's sigma is too small by its residuals, at least 1."""
    found = {s: c for sensors in sensors_consistency(runs, robot, {}).values() for s, c in sensors.items()}
    return {s: max(1.0, c.scale) for s, c in found.items() if c.verdict in TOO_SMALL and c.scale is not None}


def reference_values(whole: Reference, quarrels: Sequence[tuple[str, str]], base: str) -> dict[str, Any]:
    """Return the reference of all sensors and of the motion `base` as plain values, with a name in words."""
    sensors = "".join(f", {s}" for s in whole.sensors[:-1]) + f" and {whole.sensors[-1]}"
    words = REFERENCE.format(base=base, sensors=sensors, sigma=length(whole.sigma))
    words += "".join(f" {s} contradicts all others and is left out." for s in whole.left_out)
    doubtful = [pair for pair in quarrels if set(pair) <= set(whole.sensors)]
    words += "".join(f" {a} and {b} contradict each other, so it is doubtful." for a, b in doubtful)
    return {
        "sensors": list(whole.sensors),
        "left_out": list(whole.left_out),
        "sigma_m": whole.sigma,
        "words": words,
    }


def judge_values(reference: Reference, whole: Reference, used: Collection[str]) -> dict[str, Any]:
    """Return the record of the reference that judged a result; `shared` are the sensors that both of them use."""
    return {
        "sensors": list(reference.sensors),
        "left_out": list(reference.left_out),
        "sigma_m": reference.sigma,
        "shared": [s for s in reference.sensors if s in used],
        "agrees": reference.agrees(whole),
    }
