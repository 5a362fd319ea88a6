"""`locfuse compare` with several logs: each by itself into a folder of its name, then the summary over them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from locfuse.cli.jobs import ci_gates
from locfuse.cli.pipeline.results import LOSS
from locfuse.cli.session.summary import default_folder, named, naming, summarised, summary_files
from locfuse.cli.terminal import show
from locfuse.cli.terminal.screen import reader_may_leave, screen
from locfuse.formats.report import summary as over
from locfuse.formats.report.columns import cell
from locfuse.formats.whole_files import may_write, write_results
from locfuse.fusion.data import UsageError

from .one_log import Wish, one


def several(logs: Sequence[Sequence[str]], wish: Wish) -> int:
    """Compare every log, then write and print the summary; return the worst exit code."""
    _refuse_rerun(wish)
    folder = wish.out or default_folder()
    may_write(folder, wish.overwrite)
    done = {}
    for name, parts in named(logs).items():
        if not wish.how.quiet:
            show.say(f"{name}:")
        with naming(name):
            done[name] = one(parts, _of_one(wish, name, folder), table=False)
    judged = {name: found.judged for name, found in done.items()}
    summary = summarised(judged)
    files = summary_files(summary, judged, wish.write)
    write_results(folder, files, overwrite=True)
    with reader_may_leave():
        if wish.as_json:
            click.echo(files["summary.json"], nl=False)
        else:
            _show_summary(summary)
            click.echo(f"{folder}: {', '.join(sorted(files))}; a folder with the report of each log")
    codes = [found.code for found in done.values()]
    return max(codes, key=lambda code: (code == ci_gates.FAILED, code == LOSS))


def _refuse_rerun(wish: Wish) -> None:
    rerun = wish.rerun
    asked = {"--rerun": rerun.show, "--rerun-save": rerun.save, "--rerun-connect": rerun.connect}
    for option, value in asked.items():
        if value:
            raise UsageError(f"{option}: one log at a time; several were given")


def _of_one(wish: Wish, name: str, folder: Path) -> Wish:
    """Return what is asked of one of the logs: its report.json always, in a folder of its name."""
    write = None if wish.write is None else f"{wish.write},json"
    return replace(wish, out=folder / name, write=write, figures=wish.figures and wish.figures / name)


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
