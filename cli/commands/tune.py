"""`locfuse tune`: noise figures from logs, by the likelihood of the innovations."""

from __future__ import annotations

import click

from locfuse.cli.terminal import completion
from locfuse.cli.terminal import options as o
from locfuse.cli.terminal.findings import Table, finish

BELOW_NOISE = " before: as configured. 95 % interval: where the value lies by these logs."
BELOW_JUDGED = " ln likelihood: more is better; by 0.69: readings are twice as likely. NIS: 1 is right."


@click.command()
@click.argument("log", nargs=-1, required=True, shell_complete=completion.logs)
@click.option(
    "--sensors",
    shell_complete=completion.sensors,
    default="all",
    show_default=True,
    callback=lambda context, parameter, value: (value,),
    help="Comma-separated sensors to tune and to tune by, or: all.",
)
@click.option(
    "--hold-out",
    multiple=True,
    metavar="LOG",
    help="Judge by this log instead of tuning on it. Repeatable.  [default: the last fifth of every log]",
)
@click.option("--drift", is_flag=True, help="Ask also whether the compass' estimated offset drifts.")
@o.carried(*o.found("Write robot.toml: --robot and --set with the noise that was found.", "tables"), *o.READING)
def tune(log: tuple[str, ...], options: o.Options, hold_out: tuple[str, ...], drift: bool) -> int:
    """Estimate sensor and wheel noise from LOGs of one robot (maximum likelihood).

    No truth is needed. Values that cannot be estimated are listed and unchanged.

    \b
    locfuse tune monday.mcap tuesday.mcap --hold-out friday.mcap -o robot.toml
    locfuse compare friday.mcap --robot robot.toml
    """
    from locfuse.cli.analysis.grouping import logs_of
    from locfuse.cli.analysis.load import find_log
    from locfuse.cli.session import tune
    from locfuse.cli.terminal import show
    from locfuse.formats.whole_files import may_replace

    how, sensors = options.how, tune.sensor_names(options.asked.sensors[0])
    may_replace(options.outputs.out, options.outputs.overwrite, (*log, *hold_out))
    paths = [find_log(parts) for parts in logs_of(log)]
    held_out = [find_log(parts) for parts in logs_of(hold_out)]
    with show.progress(how.quiet) as progress:
        found = tune.tune_logs(paths, held_out, sensors, drift, how, progress)
    tables: list[Table] = [
        (found.titles, found.rows(), BELOW_NOISE),
        (("judged by", "before", "after"), found.judgements(), BELOW_JUDGED),
    ]
    held = "the settings as they were given; the noise that was found is not used" if found.refused else ""
    return finish(found, tables, options.outputs, held)
