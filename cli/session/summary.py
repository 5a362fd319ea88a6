"""Several logs compared one by one, and the figures and verdicts over all of them."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Unpack, overload

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
from locfuse.formats.fleet.entry import Entry, slim
from locfuse.formats.fleet.files import summary_files
from locfuse.formats.report import json_report
from locfuse.formats.report import summary as over
from locfuse.formats.versions import own
from locfuse.formats.visible import visible
from locfuse.formats.whole_files import may_write, write_results
from locfuse.fusion.data import LocfuseError, UsageError
from locfuse.fusion.sensors.registry import colours

from .python_words import speaks_python
from .replicates import add_intervals, add_ties, credit_over
from .result import Comparison, Kinds, Named
from .session import opened

DEFAULT_FOLDER = "summary"


class Summary:
    """The comparisons of several logs, and the figures and verdicts over all of them.

    `results["monday"]` is the comparison of one log, `report` what summary.json holds.
    """

    def __init__(self, found: Mapping[str, Comparison]) -> None:
        self.results = Named("log", found)
        self._entries = [Entry(name, report=slim({"": r.report})) for name, r in found.items()]
        self.report = summarised(self._entries)

    @property
    def headline(self) -> str:
        """Which configuration is best, in one sentence."""
        return over.headline(self.report)

    def table(self) -> list[dict[str, Any]]:
        """Return one row per log and configuration, as `Comparison.table`, with the log's name in "log"."""
        return [{"log": name, **row} for name, result in self.results.items() for row in result.table()]

    def write(self, folder: PathLike | None = None, *, write: Kinds = None, overwrite: bool = False) -> list[Path]:
        """Write what `locfuse compare LOG LOG -o FOLDER` writes: the summary, and every log's results in a folder.

        `write` chooses among "html", "md", "json", "tum", "csv", "tex"; None writes all. With "csv" comes
        fleet.parquet, where pyarrow is installed. Returns the summary's files.

        Raises LocfuseError where the folder holds something else, unless `overwrite`.
        """
        place = default_folder() if folder is None else path_of(folder)
        may_write(place, overwrite)
        for name, result in self.results.items():
            result.write(place / name, write=of_each(write), overwrite=overwrite)
        files = summary_files(self.report, self._entries, chosen(write, OF_COMPARISON), colours())
        write_results(place, files, overwrite=True)
        return [place / name for name in sorted(files)]

    def __repr__(self) -> str:
        """Return the logs and which configuration is best."""
        return visible(f"<Summary of {', '.join(self.results)}: {self.headline}>")

    def _repr_html_(self) -> str:
        """Return headline, verdicts and table, as a notebook shows them."""
        from locfuse.formats.report import notebook

        return notebook.render_summary(self.report)


class Keywords(Choices, total=False):
    """The keywords of `compare`."""

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

    One log gives a Comparison, as `load(log).compare()`. Several give a Summary: every log compared by itself,
    and figures over all. Arguments are those of `load` and of `Session.compare`; audits are kept of a single
    log only.

        locfuse.compare("rounded_rectangle")
        locfuse.compare("monday.mcap", "tuesday.mcap", robot="robot.toml", sensors=["odometry", "lrf"])

    Raises:
        LocfuseError: a log cannot be used, or a sensor is unknown; in one line that names the log.
    """
    how = log_options(robot, sets, order, preset)
    asked = Asked(configuration_words(sensors), **choices)
    if len(logs) == 1:
        return opened(words_of(logs[0]), how, progress).compared(asked)
    found = {}
    for name, parts in named(_each(logs)).items():
        with naming(name):
            found[name] = opened(parts, how, progress).compared(asked.of_each())
    return Summary(found)


def _each(logs: Sequence[PathLike | Sequence[PathLike]]) -> list[list[str]]:
    """Return the parts of every log: a list is one log, single files are grouped as on the command line."""
    if not logs:
        raise UsageError("which log? Name one or several, such as locfuse.compare('rounded_rectangle')")
    single = [word for log in logs if isinstance(log, str | os.PathLike) for word in words_of(log)]
    return [*logs_of(single), *(words_of(log) for log in logs if not isinstance(log, str | os.PathLike))]


@contextmanager
def naming(log: str) -> Iterator[None]:
    """Let an error inside name the log, unless it does so already."""
    try:
        yield
    except LocfuseError as problem:
        raise type(problem)(str(problem) if log in str(problem) else f"{log}: {problem}") from None


def summarised(entries: Sequence[Entry]) -> dict[str, Any]:
    """Return the summary over logs: figures, and what each sensor does over all of them."""
    reports = {e.name: e.report for e in entries if e.state == "done"}
    summary = {"locfuse": own(), **over.summarise(reports), "credit": None, "verdicts": {}}
    summary["logs"] = {e.name: {**summary["logs"].get(e.name, {}), **_standing(e)} for e in entries}
    add_intervals(summary, entries)
    add_ties(summary, entries)
    together = credit_over(entries)
    if together is not None:
        credit, of = together
        summary["credit"] = credit_values(credit)
        summary["verdicts"] = verdicts(credit, [], {}, of)
    return json_report.plain(summary)


def _standing(entry: Entry) -> dict[str, Any]:
    return {
        "robot": entry.robot,
        "state": entry.state,
        "reason": entry.reason or None,
        "void": entry.void,
        "losses": entry.losses,
    }


def default_folder() -> Path:
    """Return the folder of a summary where no other is given."""
    return results.default_folder(DEFAULT_FOLDER)


def of_each(write: Kinds) -> set[str]:
    """Return the kinds to write of every single log: those that were chosen, and the report always."""
    return chosen(write, OF_COMPARISON) | {"json"}
