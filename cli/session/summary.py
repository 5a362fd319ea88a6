"""Comparisons of several logs, and figures and verdicts over all of them."""

from __future__ import annotations

import math
import os
from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path
from statistics import fmean, stdev
from typing import Any, NamedTuple, Unpack, overload

from msgspec.structs import replace

from locfuse.cli.advice.report import forget_fixes
from locfuse.cli.advice.together import ask, fixes_files, in_this_process, numbers_of
from locfuse.cli.analysis import results
from locfuse.cli.analysis.configurations import Sensors, configuration_words
from locfuse.cli.analysis.grouping import logs_of, named
from locfuse.cli.analysis.settings import (
    OF_COMPARISON,
    Asked,
    Choices,
    PathLike,
    Progress,
    Sets,
    chosen,
    log_options,
    path_of,
    silent,
    words_of,
)
from locfuse.cli.analysis.verdicts import credit_values, verdicts
from locfuse.formats.report import json_report, summary as over
from locfuse.formats.report.fleet import Entry, slim, summary_files
from locfuse.formats.text import visible
from locfuse.formats.versions import own
from locfuse.formats.whole_files import may_write, write_results
from locfuse.fusion.data import LocfuseError, UsageError
from locfuse.fusion.judge.bootstrap import MIN_REPLICATES, student_t
from locfuse.fusion.judge.credit import MIN_EFFECT, Credit, Effect, SensorCredit, credit_over_logs
from locfuse.fusion.sensors.registry import colours

from .python_words import speaks_python
from .result import Comparison, Kinds, Named
from .session import opened

SUMMARY = "summary"  # the name of the folder of results
RMSE = "position_rmse_m"


class Summary:
    """The comparison of each of several logs, with figures and verdicts over all.

    `results["monday"]` is the comparison of one log, `report` the content of summary.json.
    """

    def __init__(self, found: Mapping[str, Comparison], robots: Sequence[Mapping[str, Any]] = ()) -> None:
        self.results = Named("log", found)
        self._entries = [Entry(name, report=slim({"": r.report})) for name, r in found.items()]
        self.report = {**summarised(self._entries), "robots": list(robots)}

    @property
    def headline(self) -> str:
        """The best configuration over all logs, in one sentence."""
        return over.headline(self.report)

    def table(self) -> list[dict[str, Any]]:
        """Return one row per log and configuration, as `Comparison.table` does, with the log's name in "log"."""
        return [{"log": name, **row} for name, result in self.results.items() for row in result.table()]

    def write(self, folder: PathLike | None = None, *, write: Kinds = None, overwrite: bool = False) -> list[Path]:
        """Write the files of `locfuse compare LOG LOG -o FOLDER`; return those of the summary.

        These are the summary, and a folder of results for each log. `write`: kinds of output among "html", "md",
        "json", "tum", "csv", "tex"; None writes all. "csv" also writes fleet.parquet if pyarrow is installed.

        Raises LocfuseError if the folder has other files, unless `overwrite`.
        """
        place = results.default_folder(SUMMARY) if folder is None else path_of(folder)
        may_write(place, overwrite)
        for name, result in self.results.items():
            result.write(place / name, write=of_each(write), overwrite=overwrite)
        return sorted(write_summary(place, self.report, self._entries, chosen(write, OF_COMPARISON)))

    def __repr__(self) -> str:
        """Return the logs' names and the best configuration as text."""
        return visible(f"<Summary of {', '.join(self.results)}: {self.headline}>")

    def _repr_html_(self) -> str:
        """Return headline, verdicts and table as HTML for a notebook."""
        from locfuse.formats.report import html

        return html.notebook_summary(self.report)


class Keywords(Choices, total=False):
    """The keyword arguments of `compare`."""

    robot: PathLike | None
    sets: Sets | None
    order: str | None
    preset: str | None
    sensors: Sensors | Sequence[Sensors] | None
    progress: Progress


@overload
def compare(log: PathLike | Sequence[PathLike], /, **keywords: Unpack[Keywords]) -> Comparison: ...


@overload
def compare(
    log: PathLike | Sequence[PathLike], /, *more: PathLike | Sequence[PathLike], **keywords: Unpack[Keywords]
) -> Summary: ...


@speaks_python
def compare(
    *logs: PathLike | Sequence[PathLike],
    robot: PathLike | None = None,
    sets: Sets | None = None,
    order: str | None = None,
    preset: str | None = None,
    sensors: Sensors | Sequence[Sensors] | None = None,
    progress: Progress = silent,
    **choices: Unpack[Choices],
) -> Comparison | Summary:
    """Evaluate what each sensor adds, over one log or over several of one robot.

    One log gives a Comparison, as `load(log).compare()`. Several logs give a Summary: the comparison of each, and
    figures over all. Arguments are those of `load` and of `Session.compare`. Only a single log keeps its audits.

        locfuse.compare("rounded_rectangle")
        locfuse.compare("monday.mcap", "tuesday.mcap", robot="robot.toml", sensors=["odometry", "lrf"])

    Raises:
        LocfuseError: a log cannot be used, or a sensor is unknown; one line with the log's name.
    """
    how = log_options(robot, sets, order, preset)
    asked = Asked(configuration_words(sensors), **choices)
    if len(logs) == 1:
        return opened(words_of(logs[0]), how, progress).compared(asked)
    found: dict[str, Comparison] = {}
    known: dict[str, Any] = {}
    if not logs:
        raise UsageError("which log? Name one or several, such as locfuse.compare('rounded_rectangle')")
    # a list is one log, single files are grouped by name and time
    single = [word for log in logs if isinstance(log, str | os.PathLike) for word in words_of(log)]
    lists = [words_of(log) for log in logs if not isinstance(log, str | os.PathLike)]
    for name, parts in named([*logs_of(single), *lists]).items():
        try:
            found[name] = result = opened(parts, how, progress).compared(asked.of_each())
        except LocfuseError as problem:
            words = str(problem)
            raise type(problem)(words if name in words else f"{name}: {words}") from None
        result.report["measured"] = numbers = numbers_of(result.loaded, tuple(result.estimates.values()))
        known |= {name: numbers} if numbers is not None else {}
    if not asked.advice or len(known) < 2:
        return Summary(found)
    look = in_this_process({name: r.loaded for name, r in found.items()}, asked.align, progress)
    return Summary(found, [{"robot": None, **ask(known, look)}])  # fixes common to the logs of one robot


def write_summary(
    folder: Path,
    summary: Mapping[str, Any],
    entries: Sequence[Entry],
    kinds: Collection[str],
    keys: Sequence[str] = (),
) -> list[Path]:
    """Write the summary and each robot's fixes to `folder`; return the files. `keys`: the swept settings."""
    files = summary_files(summary, entries, kinds, colours(), tuple(keys)) | fixes_files(summary["robots"])
    write_results(folder, files, overwrite=True)
    written = [folder / name for name in files]
    forget_fixes(written)
    return written


def summarised(entries: Sequence[Entry]) -> dict[str, Any]:
    """Return the summary over logs: mean figures, and each sensor's effect."""
    done = [e for e in entries if e.state == "done"]
    over_all = over.summarise({e.name: e.report for e in done})
    summary = {"locfuse": own(), **over_all, "credit": None, "verdicts": {}}
    keys = ("robot", "state", "reason", "void", "losses")
    standing = {e.name: {**{key: getattr(e, key) for key in keys}, "reason": e.reason or None} for e in entries}
    summary["logs"] = {name: {**summary["logs"].get(name, {}), **found} for name, found in standing.items()}
    robots = {e.robot for e in done if e.robot is not None}
    summary["replicates"] = {"of": "robots" if robots else "logs", "robots": len(robots), "logs": len(done)}
    for name, configuration in summary["configurations"].items():
        for key, figure in configuration["figures"].items():
            figure.update(mean_over(_replicate_means(done, _values(done, name, key)))._asdict())
    summary["ties"] = _ties(summary, entries)
    together = credit_over(entries)
    if together is not None:
        credit, of = together
        summary["credit"] = credit_values(credit)
        summary["verdicts"] = verdicts(credit, [], {}, of)
    return json_report.plain(summary)


def of_each(write: Kinds) -> set[str]:
    """Return the kinds of output to write for each single log: those the user chose, and always "json"."""
    return chosen(write, OF_COMPARISON) | {"json"}


class Mean(NamedTuple):
    """A mean over replicates with its 95 % interval [low, high]; both None for too few replicates."""

    mean: float
    low: float | None
    high: float | None
    replicates: int


def mean_over(values: Sequence[float], fewest: int = MIN_REPLICATES) -> Mean:
    """Return the mean of independent values, with Student's t interval (95 %) for at least `fewest` values."""
    mean = fmean(values)
    if len(values) < fewest:
        return Mean(mean, None, None, len(values))
    half = student_t(len(values) - 1.0) * stdev(values) / math.sqrt(len(values))
    return Mean(mean, mean - half, mean + half, len(values))


def by_robot(entries: Iterable[Entry]) -> dict[str, list[Entry]]:
    """Group logs into replicates: return robot -> its logs; a log without robot is a group by itself."""
    found: dict[str, list[Entry]] = {}
    for entry in entries:
        found.setdefault(entry.name if entry.robot is None else entry.robot, []).append(entry)
    return found


def _replicate_means(entries: Sequence[Entry], values: Mapping[str, float]) -> list[float]:
    """Return one value per replicate: the mean of `values` (log name -> value) over the replicate's logs."""
    groups = by_robot(e for e in entries if e.name in values)
    return [fmean(values[e.name] for e in group) for group in groups.values()]


def _values(entries: Sequence[Entry], configuration: str, key: str) -> dict[str, float]:
    found = {e.name: e.report.get("configurations", {}).get(configuration, {}).get(key) for e in entries}
    return {name: float(value) for name, value in found.items() if value is not None}


def _ties(summary: Mapping[str, Any], entries: Sequence[Entry]) -> dict[str, Any]:
    """Return configurations as good as the best: by error ratios near 1, or a 95 % interval that includes 1.

    Ratios are averaged over the logs of each robot, then over robots.
    """
    best, ties = summary["best"], {}
    for name in summary["configurations"] if best is not None else ():
        ours, theirs = _values(entries, name, RMSE), _values(entries, best, RMSE)
        ln = {x: math.log(ours[x] / theirs[x]) for x in ours if x in theirs and ours[x] > 0.0 < theirs[x]}
        if name == best or not ln:
            continue
        mean, low, high, replicates = mean_over(_replicate_means(entries, ln), fewest=2)
        if abs(mean) < MIN_EFFECT or (low is not None and high is not None and low <= 0.0 <= high):
            bounds = (low, high) if replicates >= MIN_REPLICATES else (None, None)
            low, high = (None if bound is None else math.exp(bound) for bound in bounds)
            ties[name] = {"factor": math.exp(mean), "low": low, "high": high, "replicates": replicates}
    return ties


def credit_over(entries: Sequence[Entry]) -> tuple[Credit, str] | None:
    """Return each sensor's mean effect over logs, and the replicates, "robots" or "drives"; None: too few logs."""
    judged = [e for e in entries if e.state == "done" and e.report.get("credit")]
    if len(judged) < 2:
        return None
    groups = by_robot(judged)
    over = "robots" if any(e.robot is not None for e in judged) else "drives"
    if len(groups) < 2:  # one robot: no sample of robots, so its logs are the replicates
        groups, over = {e.name: [e] for e in judged}, "drives"
    credit = credit_over_logs([_of_robot([e.report["credit"] for e in group]) for group in groups.values()])
    return replace(credit, method=f"Student's t over {over.replace('drives', 'logs')}"), over


def _of_robot(found: Sequence[Mapping[str, Any]]) -> Credit:
    """Return the mean effects over the logs of one robot, without intervals."""
    names = [s for s in found[0]["sensors"] if all(s in credit["sensors"] for credit in found)]
    totals = [credit["total_factor"] for credit in found]
    sensors = {}
    for s in names:
        of = [credit["sensors"][s] for credit in found]
        alone, last, credit = (_mean([f[name] for f in of]) for name in ("alone", "leave_one_out", "credit"))
        pairs = [(f["anees_without"], f["anees_with"]) for f in of if f["anees_with"] is not None]
        anees = (fmean(p[0] for p in pairs), fmean(p[1] for p in pairs)) if pairs else None
        shares = [f["share"] for f in of]
        share = None if None in shares else fmean(shares)
        sensors[s] = SensorCredit("no verdict", credit, alone, last, share, anees, tuple(of[0]["beside"]))
    return Credit(
        sensors=sensors,
        total=None if None in totals else fmean(math.log(total) for total in totals),
        complete=all(credit["complete"] for credit in found),
        method="mean over the logs of one robot",
        effective_samples=float(len(found)),
        block_s=None,
        logs=len(found),
    )


def _mean(effects: Sequence[Mapping[str, Any] | None]) -> Effect | None:
    known = [e for e in effects if e is not None]
    if len(known) < len(effects):
        return None
    value = fmean(e["ln"] for e in known)
    expected = [math.log(e["expected"]) for e in known if e["expected"]]
    return Effect(value, value, value, fmean(expected) if len(expected) == len(known) else None)
