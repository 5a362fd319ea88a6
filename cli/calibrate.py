"""`locfuse calibrate`: noise and geometry of the wheels, iron around the compass, from logs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from .options import LogOptions, log_options

if TYPE_CHECKING:
    from .calibration import Calibration


@click.command()
@click.argument("log", nargs=-1, required=True)
@click.option(
    "-o",
    "--out",
    type=click.Path(path_type=Path, dir_okay=False),
    help="Write what was found as robot.toml, to be used with --robot.",
)
@click.option("--overwrite", is_flag=True, help="Replace an existing file.")
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON instead of a table.")
@log_options
def calibrate(log: tuple[str, ...], out: Path | None, overwrite: bool, as_json: bool, how: LogOptions) -> int:
    """Find wheel noise, wheel geometry and magnetometer iron from LOGs of one robot.

    From straight runs and turns on the spot with truth: the noise per metre (and the paper's delta), wheel radius,
    ratio and track. From any log in which the robot turns once, without truth: hard and soft iron.

    \b
    locfuse simulate straight_runs -o straight.mcap
    locfuse simulate turns_on_the_spot -o turns.mcap
    locfuse calibrate straight.mcap turns.mcap -o robot.toml
    locfuse compare drive.mcap --robot robot.toml
    """
    from ..formats import report_json
    from ..fusion.data import UsageError
    from . import calibration, results, show
    from .grouping import logs_of
    from .load import find_log, load

    if out is not None and out.exists() and not overwrite:
        raise UsageError(f"{out} exists: choose another name, or replace it with --overwrite")
    with show.progress(how.quiet) as progress:
        loaded = [load(find_log(parts), how, progress, only=("compass",)) for parts in logs_of(log)]
        progress("calibrating")
        found = calibration.calibrate_logs(loaded)
    if out is not None:
        calibration.write(out, found)
    if as_json:
        click.echo(report_json.encode(found.values()), nl=False)
    else:
        _show(found)
        if out is not None:
            click.echo(f"{out}: use it with --robot {out}")
    lost = [line for one in loaded for line in results.loss_lines(one, list(one.drive.measurements), how.strict)]
    if not how.quiet:
        for line in (*(f"note: {n}" for n in found.notes), *(f"lost: {n}" for n in lost)):
            click.echo(line, err=True)
    return results.LOSS if lost else 0


def _show(found: Calibration) -> None:
    from rich import box
    from rich.console import Console
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for i, title in enumerate(("setting", "found", "95 % interval", "was")):
        table.add_column(title, justify="left" if i == 0 else "right", no_wrap=True)
    for row in found.rows():
        table.add_row(*row)
    Console().print(table)
