"""`locfuse run`: one configuration over one log."""

from __future__ import annotations

from pathlib import Path

import click

from locfuse.cli.analysis.settings import OF_RUN as KINDS
from locfuse.cli.analysis.settings import LogOptions, MapOptions
from locfuse.cli.rerun.record import RerunOptions, record
from locfuse.cli.terminal import completion
from locfuse.cli.terminal.options import (
    advice_option,
    chosen,
    export_option,
    jitter_option,
    log_options,
    map_options,
    out_options,
    preset_option,
    smooth_option,
    window_options,
)
from locfuse.cli.terminal.rerun_options import rerun_options


@click.command()
@click.argument("log", nargs=-1, required=True, shell_complete=completion.logs)
@click.option(
    "--sensors",
    shell_complete=completion.sensors,
    default="all",
    show_default=True,
    help="Comma-separated sensors, or: all, odometry.",
)
@click.option(
    "--align",
    type=click.Choice(["none", "origin", "se2"]),
    default="none",
    show_default=True,
    help="Move the estimate onto the truth before judging it.",
)
@smooth_option
@advice_option
@jitter_option
@click.option(
    "--audit",
    type=click.Path(path_type=Path, dir_okay=False),
    help="Write every measurement with its distance, threshold and verdict to this CSV.",
)
@log_options
@preset_option
@window_options
@out_options(KINDS)
@export_option
@map_options
@rerun_options
def run(
    log: tuple[str, ...],
    sensors: str,
    align: str,
    smooth: bool,
    advice: bool,
    jitter: int,
    audit: Path | None,
    how: LogOptions,
    out: Path | None,
    overwrite: bool,
    write: str | None,
    as_json: bool,
    export: set[str],
    maps: MapOptions,
    rerun: RerunOptions,
) -> int:
    """Estimate the trajectory of LOG with one set of sensors.

    LOG is an .mcap, the parts of a split one, a rosbag2 folder, or the name of a sample log.

    \b
    locfuse run rounded_rectangle --sensors all
    locfuse run bag/ --sensors compass,lrf --robot robot.toml -o out
    """
    from locfuse.cli.analysis.results import LOSS, default_folder
    from locfuse.cli.session.session import opened
    from locfuse.cli.terminal import show
    from locfuse.formats.whole_files import may_replace, may_write

    kinds = chosen(write, KINDS)
    for file in (audit, maps.save, rerun.save):
        may_replace(file, overwrite, log)
    with show.progress(how.quiet) as progress:
        session = opened(log, how, progress, read_again=rerun.wanted)
        if maps.given is not None:
            session = session.with_map(maps.given)
        configuration = session.configuration(sensors)
        maps.check(configuration.sensors)
        may_write(out or default_folder(session.log.name), overwrite, (*how.robot_files, maps.given))
        result = session.run(configuration, align=align, smooth=smooth, advice=advice, jitter=jitter)
        files = result.write(out, write=kinds, export=export, overwrite=overwrite)
        if maps.save is not None:
            result.save_map(maps.save)
        if audit is not None:
            result.write_audit(audit)
    lost = result.losses(how.strict)
    show.result(result.report, files, as_json)
    show.notes(result.report, lost, how.quiet)
    show.transfer(session.log.transfer, how.quiet)
    record(rerun, result, files[0].parent, show.say)
    return LOSS if lost else 0
