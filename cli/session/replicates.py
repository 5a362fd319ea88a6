"""Statistics over logs: the robot is the replicate.

Logs of one robot share its tyres, mounts and calibration, so they are no independent samples: figures are averaged
within each robot first, and the interval is Student's t over the robots. Where robots are not named every log
counts as one replicate, and the result names that.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from statistics import fmean, stdev
from typing import Any, NamedTuple

from msgspec.structs import replace

from locfuse.formats.fleet.entry import Entry
from locfuse.fusion.judge.bootstrap import CONFIDENCE, MIN_REPLICATES, student_t
from locfuse.fusion.judge.credit import Credit, SensorCredit, credit_over_logs
from locfuse.fusion.judge.verdict import MIN_EFFECT, Effect

RMSE = "position_rmse_m"


class Mean(NamedTuple):
    """A mean over replicates with its 95 % interval; no interval over fewer than four."""

    value: float
    low: float | None
    high: float | None
    replicates: int


def mean_over(values: Sequence[float], fewest: int = MIN_REPLICATES) -> Mean:
    """Return the mean of independent values and, of at least `fewest`, Student's interval."""
    mean = fmean(values)
    if len(values) < fewest:
        return Mean(mean, None, None, len(values))
    half = student_t(CONFIDENCE, len(values) - 1.0) * stdev(values) / math.sqrt(len(values))
    return Mean(mean, mean - half, mean + half, len(values))


def by_robot(entries: Iterable[Entry]) -> dict[str, list[Entry]]:
    """Return the entries of each replicate: of a robot, or of one log where it has none."""
    found: dict[str, list[Entry]] = {}
    for entry in entries:
        found.setdefault(entry.name if entry.robot is None else entry.robot, []).append(entry)
    return found


def replicate_means(entries: Sequence[Entry], values: Mapping[str, float]) -> list[float]:
    """Return the mean of each replicate's values; `values` are by the name of the log."""
    groups = by_robot(e for e in entries if e.name in values)
    return [fmean(values[e.name] for e in group) for group in groups.values()]


def add_intervals(summary: dict[str, Any], entries: Sequence[Entry]) -> None:
    """Make the means of all figures those over replicates, with intervals, and note what the replicates are."""
    done = [e for e in entries if e.state == "done"]
    robots = {e.robot for e in done if e.robot is not None}
    summary["replicates"] = {"of": "robots" if robots else "logs", "robots": len(robots), "logs": len(done)}
    for name, found in summary["configurations"].items():
        for key, figure in found["figures"].items():
            known = _values(done, name, key)
            mean = mean_over(replicate_means(done, known))
            figure |= {"mean": mean.value, "low": mean.low, "high": mean.high, "replicates": mean.replicates}


def _values(entries: Sequence[Entry], configuration: str, key: str) -> dict[str, float]:
    found = {e.name: e.report.get("configurations", {}).get(configuration, {}).get(key) for e in entries}
    return {name: float(value) for name, value in found.items() if value is not None}


def add_ties(summary: dict[str, Any], entries: Sequence[Entry]) -> None:
    """Name the configurations that tie with the best one: ratios of errors per log, then per robot."""
    best, ties = summary["best"], {}
    for name in summary["configurations"]:
        if best is not None and name != best:
            ratio = _ratio(entries, name, best)
            if ratio is not None and _is_tie(ratio):
                few = ratio.replicates < MIN_REPLICATES
                low, high = (None, None) if few else (ratio.low, ratio.high)
                ties[name] = {
                    "factor": math.exp(ratio.value),
                    "low": None if low is None else math.exp(low),
                    "high": None if high is None else math.exp(high),
                    "replicates": ratio.replicates,
                }
    summary["ties"] = ties


def _ratio(entries: Sequence[Entry], name: str, best: str) -> Mean | None:
    """Return the mean of ln(error of `name` / error of `best`) over replicates, where both were judged."""
    ours, theirs = _values(entries, name, RMSE), _values(entries, best, RMSE)
    logs = [log for log in ours if log in theirs and ours[log] > 0.0 < theirs[log]]
    if not logs:
        return None
    return mean_over(replicate_means(entries, {log: math.log(ours[log] / theirs[log]) for log in logs}), fewest=2)


def _is_tie(ratio: Mean) -> bool:
    """Return whether two errors are equal: within 2 %, or within the 95 % interval."""
    if abs(ratio.value) < MIN_EFFECT:
        return True
    return ratio.low is not None and ratio.high is not None and ratio.low <= 0.0 <= ratio.high


def credit_over(entries: Sequence[Entry]) -> tuple[Credit, str] | None:
    """Return what each sensor does to the error over all "robots" or, of one, over its "drives".

    None for a single log.
    """
    judged = [e for e in entries if e.state == "done" and e.report.get("credit")]
    if len(judged) < 2:
        return None
    groups = by_robot(judged)
    over = "robots" if any(e.robot is not None for e in judged) else "drives"
    if len(groups) < 2:  # one robot: its logs are no sample of other robots
        groups, over = {e.name: [e] for e in judged}, "drives"
    credit = credit_over_logs([_of_robot([e.report["credit"] for e in group]) for group in groups.values()])
    return replace(credit, method=f"Student's t over {over.replace('drives', 'logs')}"), over


def _of_robot(found: Sequence[Mapping[str, Any]]) -> Credit:
    """Return the mean effects of one replicate's logs, without intervals."""
    names = [s for s in found[0]["sensors"] if all(s in credit["sensors"] for credit in found)]
    totals = [credit["total_factor"] for credit in found]
    return Credit(
        sensors={s: _of_sensor([credit["sensors"][s] for credit in found]) for s in names},
        total=None if None in totals else fmean(math.log(total) for total in totals),
        complete=all(credit["complete"] for credit in found),
        method="mean over the logs of one robot",
        effective_samples=float(len(found)),
        block_s=None,
        logs=len(found),
    )


def _of_sensor(found: Sequence[Mapping[str, Any]]) -> SensorCredit:
    alone, last, credit = (_mean([f[name] for f in found]) for name in ("alone", "leave_one_out", "credit"))
    shares = [f["share"] for f in found]
    pairs = [(f["anees_without"], f["anees_with"]) for f in found if f["anees_with"] is not None]
    anees = (fmean(p[0] for p in pairs), fmean(p[1] for p in pairs)) if pairs else None
    share = None if None in shares else fmean(shares)
    return SensorCredit("no verdict", credit, alone, last, share, anees, tuple(found[0]["beside"]))


def _mean(effects: Sequence[Mapping[str, Any] | None]) -> Effect | None:
    known = [e for e in effects if e is not None]
    if len(known) < len(effects):
        return None
    value = fmean(e["ln"] for e in known)
    expected = [math.log(e["expected"]) for e in known if e["expected"]]
    return Effect(value, value, value, fmean(expected) if len(expected) == len(known) else None)
