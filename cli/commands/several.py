"""`locfuse compare` with several words: a summary over logs, or finished results side by side."""

from __future__ import annotations

import contextlib
import io
import json
import math
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import click
from click.core import ParameterSource

from locfuse.cli.choose.grouping import logs_of, results_of
from locfuse.cli.jobs import ci_gates
from locfuse.cli.pipeline import results
from locfuse.cli.pipeline.load import find_log
from locfuse.cli.pipeline.verdicts import credit_values, verdicts
from locfuse.cli.terminal.options import chosen
from locfuse.cli.terminal.screen import put, reader_may_leave, say, screen
from locfuse.formats.caps import MAX_REPORT
from locfuse.formats.inputs import read_small
from locfuse.formats.log.files import log_name
from locfuse.formats.report import changes as sides
from locfuse.formats.report import json_report
from locfuse.formats.report import summary as over
from locfuse.formats.report.columns import cell
from locfuse.formats.whole_files import may_write, write_results
from locfuse.fusion.data import LocfuseError, UsageError
from locfuse.fusion.judge.credit import Credit, SensorCredit, credit_over_logs
from locfuse.fusion.judge.verdict import Effect

KINDS = ("json", "md", "csv")
FOLDER = "summary"
OF_RESULTS = ("log", "out", "overwrite", "as_json", "quiet")  # what a comparison of finished results follows


def several(words: Sequence[str]) -> int | None:
    """Run the current `compare` on several words and return its exit code; None where they are one log."""
    context = click.get_current_context()
    finished = results_of(words)
    if finished is not None:
        _refuse_what_needs_a_log(context)
        return compare_results(finished, context.params)
    logs = logs_of(words)
    return None if len(logs) == 1 else compare_logs(logs, context)


def _refuse_what_needs_a_log(context: click.Context) -> None:
    """Raise UsageError for an option that finished results cannot follow: no gate passes by being passed over."""
    for option in context.command.params:
        given = context.get_parameter_source(str(option.name)) is ParameterSource.COMMANDLINE
        if given and option.name not in OF_RESULTS:
            name = max(option.opts, key=len)
            raise UsageError(f"{name} is for logs; finished results are set side by side as they are")


def compare_logs(logs: Sequence[Sequence[str]], context: click.Context) -> int:
    """Compare every log by itself into a folder of its name, then write and print the summary over them."""
    params = context.params
    asked = [o for o in ("rerun", "rerun_save", "rerun_connect") if params.get(o)]
    if asked:
        raise UsageError(f"--{asked[0].replace('_', '-')}: one log at a time; several were given")
    folder = params["out"] or results.default_folder(FOLDER)
    may_write(folder, params["overwrite"])
    codes, reports = [], {}
    for name, parts in _named(logs).items():
        if not params["quiet"]:
            say(f"{name}:", err=True)
        codes.append(_one(name, parts, folder / name, context))
        reports[name] = json.loads((folder / name / "report.json").read_bytes())
    summary = summarised(reports)
    kinds = chosen(params["write"], KINDS) if _only(params["write"], KINDS) else set(KINDS)
    files = {"summary.json": json_report.encode(summary)}
    files |= {"summary.md": over.render(summary)} if "md" in kinds else {}
    files |= {"summary.csv": over.csv(reports)} if "csv" in kinds else {}
    write_results(folder, files, overwrite=True)
    with reader_may_leave():
        if params["as_json"]:
            put(files["summary.json"])
        else:
            _show_summary(summary)
            say(f"{folder}: {', '.join(sorted(files))}; a folder with the report of each log")
    return max(codes, key=lambda code: (code == ci_gates.FAILED, code == results.LOSS))


def _only(write: str | None, kinds: Sequence[str]) -> bool:
    """Return whether --write names nothing but kinds that a summary has."""
    return write is not None and {w.strip() for w in write.split(",") if w.strip()} <= set(kinds)


def _one(name: str, parts: Sequence[str], folder: Path, context: click.Context) -> int:
    """Run `compare` on one log, without its table."""
    params = context.params
    own: dict[str, Any] = {"log": tuple(parts), "out": folder}
    if params["write"] is not None:
        own["write"] = f"{params['write']},json"
    if params.get("figures") is not None:
        own["figures"] = params["figures"] / name
    try:
        with contextlib.redirect_stdout(io.StringIO()):
            return int(context.invoke(context.command, **{**params, **own}))
    except LocfuseError as problem:
        raise type(problem)(str(problem) if name in str(problem) else f"{name}: {problem}") from None


def _named(logs: Sequence[Sequence[str]]) -> dict[str, Sequence[str]]:
    """Return the logs by a name for the folder of each; of equal names the later ones are numbered."""
    named: dict[str, Sequence[str]] = {}
    for parts in logs:
        name = stem = log_name(find_log(parts))
        number = 2
        while name in named:
            name, number = f"{stem}_{number}", number + 1
        named[name] = parts
    return named


def summarised(reports: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """Return the summary over reports by log: figures, and what each sensor bought over all of them."""
    summary = {"locfuse": version("locfuse"), **over.summarise(reports), "credit": None, "verdicts": {}}
    found = [read_credit(r["credit"]) for r in reports.values() if r.get("credit")]
    if len(found) > 1:
        together = credit_over_logs(found)
        summary["credit"] = credit_values(together)
        summary["verdicts"] = verdicts(together, [], {})
    return summary


def read_credit(values: Mapping[str, Any]) -> Credit:
    """Return the credit that a report.json holds: the inverse of `verdicts.credit_values`."""
    interval = values["interval"]
    return Credit(
        sensors={name: _read_sensor(v) for name, v in values["sensors"].items()},
        total=_ln(values["total_factor"]),
        complete=values["complete"],
        method=interval["method"],
        effective_samples=interval["effective_samples"],
        block_s=interval["block_s"],
        logs=interval["logs"],
    )


def _read_sensor(values: Mapping[str, Any]) -> SensorCredit:
    anees = (values["anees_without"], values["anees_with"])
    return SensorCredit(
        verdict="does nothing",  # not read: it is judged again over all logs
        credit=_read_effect(values["credit"]),
        alone=_read_effect(values["alone"]),
        last=_read_effect(values["leave_one_out"]),
        share=values["share"],
        anees=None if None in anees else anees,
        beside=tuple(values.get("beside", ())),
    )


def _read_effect(values: Mapping[str, Any] | None) -> Effect | None:
    if values is None:
        return None
    return Effect(values["ln"], math.log(values["low"]), math.log(values["high"]), _ln(values["expected"]))


def _ln(factor: float | None) -> float | None:
    return None if factor is None else math.log(factor)


def _show_summary(summary: Mapping[str, Any]) -> None:
    from rich import box
    from rich.table import Table
    from rich.text import Text

    columns = [c for c in over.columns_of(summary) if c.key in {over.MAIN, "heading_rmse_deg", "anees"}]
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column("configuration", no_wrap=True)
    for column in columns:
        heads = ("mean", "median", "worst") if column.key == over.MAIN else ("mean",)
        for head in heads:
            table.add_column(f"{column.title} {head}", justify="right")
    table.add_column("best in", justify="right", no_wrap=True)
    for name, values in summary["configurations"].items():
        cells = []
        for column in columns:
            figure = values["figures"].get(column.key, {})
            which = ("mean", "median", "worst") if column.key == over.MAIN else ("mean",)
            unit = f" {column.unit}" if column.unit == "m" else column.unit
            cells += [cell(column, figure.get(w)) + unit if figure else "-" for w in which]
        table.add_row(Text(name), *cells, f"{values['best_in']} of {summary['judged']}")
    console = screen()
    if columns:
        console.print(table)
    console.print(Text(over.headline(summary)))
    for sensor, verdict in summary["verdicts"].items():
        console.print(Text.assemble((f"{sensor} {verdict['verdict']}. ", "bold"), verdict["words"]))


def compare_results(files: Sequence[Path], params: Mapping[str, Any]) -> int:
    """Set finished results beside the first of them and print what changed."""
    reports = [_read(file) for file in files]
    first, *others = zip(files, reports, strict=True)
    found = {str(file.parent): sides.changes(first[1], report) for file, report in others}
    before = str(first[0].parent)
    values = {"before": before, "after": found}
    written: dict[str, str] = {}
    if params["out"] is not None:
        texts = [sides.render((before, after), c) for after, c in found.items()]
        written = {"changes.json": json_report.encode(values), "changes.md": "\n".join(texts)}
        write_results(params["out"], written, params["overwrite"])
    if params["as_json"]:
        put(json_report.encode(values))
        return 0
    for after, one in found.items():
        say(f"{before} -> {after}")
        _show_changes(one)
        for line in sides.remarks(one):
            say(line)
    if written:
        say(f"{params['out']}: {', '.join(written)}")
    return 0


def _read(file: Path) -> dict[str, Any]:
    try:
        report: dict[str, Any] = json.loads(read_small(file, MAX_REPORT))
        sides.changes(report, report)
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        raise LocfuseError(f"{file}: not a report of locfuse; make one with: locfuse compare LOG -o DIR") from None
    return report


def _show_changes(found: Mapping[str, Any]) -> None:
    from rich import box
    from rich.table import Table
    from rich.text import Text

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for i, title in enumerate(("configuration", "figure", "before", "after", "change")):
        table.add_column(title, justify="left" if i < 2 else "right", no_wrap=True)
    last = ""
    for name, column, figure in sides.rows(found):
        table.add_row(Text(name if name != last else ""), column.title, *sides.cells(column, figure))
        last = name
    screen().print(table)
