"""`locfuse tune`: noise figures from logs, by the likelihood of the innovations."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from .options import LogOptions, log_options

if TYPE_CHECKING:
    from .tuning import Tuning


@click.command()
@click.argument("log", nargs=-1, required=True)
@click.option(
    "--sensors",
    default="all",
    show_default=True,
    help="Comma-separated sensors to tune and to tune by, or: all.",
)
@click.option(
    "--hold-out",
    multiple=True,
    metavar="LOG",
    help="Judge by this log instead of tuning on it. Repeatable.  [default: the last fifth of every log]",
)
@click.option("--drift", is_flag=True, help="Ask also whether the compass' estimated offset drifts.")
@click.option(
    "-o",
    "--out",
    type=click.Path(path_type=Path, dir_okay=False),
    help="Write robot.toml: --robot and --set with the noise that was found.",
)
@click.option("--overwrite", is_flag=True, help="Replace an existing file.")
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON instead of tables.")
@log_options
def tune(
    log: tuple[str, ...],
    sensors: str,
    hold_out: tuple[str, ...],
    drift: bool,
    out: Path | None,
    overwrite: bool,
    as_json: bool,
    how: LogOptions,
) -> int:
    """Find the noise figures of LOGS of one robot: those under which what its sensors said is most likely.

    No truth is needed. What the logs cannot tell is left as it was, and said.

    \b
    locfuse tune monday.mcap tuesday.mcap --hold-out friday.mcap -o robot.toml
    locfuse compare friday.mcap --robot robot.toml
    """
    from ..formats import report_json
    from ..fusion.data import UsageError
    from . import results, show, tuning
    from .grouping import logs_of
    from .load import find_log

    if out is not None and out.exists() and not overwrite:
        raise UsageError(f"{out} exists: choose another name, or replace it with --overwrite")
    paths = [find_log(parts) for parts in logs_of(log)]
    held_out = [find_log(parts) for parts in logs_of(hold_out)]
    with show.progress(how.quiet) as progress:
        found = tuning.tune_logs(paths, held_out, tuning.sensor_names(sensors), drift, how, progress)
    if out is not None:
        tuning.write(out, found, how)
    if as_json:
        click.echo(report_json.encode(found.values()), nl=False)
    else:
        _show(found)
        if out is not None:
            click.echo(f"{out}: use it with --robot {out}")
    lost = [line for one in found.loaded for line in results.loss_lines(one, found.sensors, how.strict)]
    if not how.quiet:
        for line in (*(f"note: {n}" for n in found.notes), *(f"lost: {n}" for n in lost)):
            click.echo(line, err=True)
    return results.LOSS if lost else 0


def _show(found: Tuning) -> None:
    from rich import box
    from rich.console import Console
    from rich.table import Table

    for titles, rows in (
        (("noise", "before", "after", "95 % interval"), found.rows()),
        (("judged by", "before", "after"), found.judgements()),
    ):
        table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
        for i, title in enumerate(titles):
            table.add_column(title, justify="left" if i == 0 else "right", no_wrap=True)
        for row in rows:
            table.add_row(*row)
        Console().print(table)
