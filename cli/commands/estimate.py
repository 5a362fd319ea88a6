"""`locfuse calibrate` and `locfuse tune`: settings estimated from logs, as tables, JSON and robot.toml."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import click

from locfuse.cli.terminal import options as o
from locfuse.cli.terminal.screen import put, say

if TYPE_CHECKING:
    from locfuse.cli.session.found import Found

Table = tuple[Sequence[str], Iterable[Sequence[str]], str]  # titles, rows, explanation below
BELOW_CALIBRATED = "95 % interval: where the value lies by these logs. was: as configured."
BELOW_NOISE = " before: as configured. 95 % interval: where the value lies by these logs."
BELOW_JUDGED = " ln likelihood: more is better; by 0.69: readings are twice as likely. NIS: 1 is right."


def _estimates(what: str, tables: str) -> tuple[o.Declared, ...]:
    """Return the options of a command that writes estimated settings, or prints them as JSON."""
    json = o.flag("--json as_json", f"Print the result as JSON instead of {tables}.")
    return o.option("-o --out", what, type=o.FILE), o.OVERWRITE, json


@click.command()
@o.LOGS
@o.carried(*_estimates("Write the result as robot.toml, for --robot.", "a table"), *o.READING)
def calibrate(log: tuple[str, ...], options: o.Options) -> int:
    """Estimate wheel noise, wheel geometry, laser mount and magnetometer iron from LOGs of one robot.

    \b
    LOGs have wheels and ...           what is estimated
    truth, straight runs and turns     noise per metre, the paper's delta, radius, ratio, track
    a laser                            radius, ratio, track; mount and clock lag of the laser
    a gyro                             ratio, track, noise
    a magnetometer and one full turn   hard and soft iron

    \b
    locfuse simulate straight_runs -o straight.mcap
    locfuse simulate turns_on_the_spot -o turns.mcap
    locfuse calibrate straight.mcap turns.mcap -o robot.toml
    locfuse compare drive.mcap --robot robot.toml
    """
    from locfuse.cli.analysis.grouping import logs_of
    from locfuse.cli.session import calibrate
    from locfuse.cli.terminal import show
    from locfuse.formats.whole_files import may_replace

    may_replace(options.outputs.out, options.outputs.overwrite, log)
    with show.progress(options.how.quiet) as progress:
        found = calibrate.calibrated(logs_of(log), options.how, progress)
    return _finish(found, [(found.titles, found.rows(), BELOW_CALIBRATED)], options)


@click.command()
@o.LOGS
@o.sensors("Comma-separated sensors to use and to tune, or: all.")
@o.each(
    "--hold-out",
    "Do not tune on this log, but test the result on it. Repeatable.  [default: the last fifth of every log]",
    metavar="LOG",
)
@o.flag("--drift", "Also estimate whether the compass offset drifts.")
@o.carried(*_estimates("Write robot.toml: the given settings with the estimated noise.", "tables"), *o.READING)
def tune(log: tuple[str, ...], options: o.Options, hold_out: tuple[str, ...], drift: bool) -> int:
    """Estimate sensor and wheel noise from LOGs of one robot (maximum likelihood).

    No truth is needed. Values that cannot be estimated are listed and unchanged.

    \b
    locfuse tune monday.mcap tuesday.mcap --hold-out friday.mcap -o robot.toml
    locfuse compare friday.mcap --robot robot.toml
    """
    from locfuse.cli.analysis.grouping import logs_of
    from locfuse.cli.session import tune
    from locfuse.cli.terminal import show
    from locfuse.formats.whole_files import may_replace

    how, sensors = options.how, tune.sensor_names(options.asked.sensors[0])
    may_replace(options.outputs.out, options.outputs.overwrite, (*log, *hold_out))
    with show.progress(how.quiet) as progress:
        found = tune.tune_logs(logs_of(log), logs_of(hold_out), sensors, drift, how, progress)
    judged = (("judged by", "before", "after"), found.judgements(), BELOW_JUDGED)
    held = "the settings as they were given; the noise that was found is not used" if found.refused else ""
    return _finish(found, [(found.titles, found.rows(), BELOW_NOISE), judged], options, held)


def _finish(found: Found, tables: Iterable[Table], options: o.Options, held: str = "") -> int:
    """Write and print estimated settings; return the exit code.

    `held`: text on the content of the written file; "" prints a hint how to use the file instead.
    """
    from locfuse.cli.terminal import show
    from locfuse.formats.report import json_report
    from locfuse.formats.report.table import of_words, texts

    out, as_json = options.outputs.out, options.outputs.as_json
    if out is not None:
        found.write(out, options.outputs.overwrite)
    for titles, rows, below in () if as_json else tables:
        shown = of_words(texts(*titles), rows)
        show.table(shown)
        show.lines([below] if shown.rows else [])
    if as_json:
        put(json_report.encode(found.values()))
    elif out is not None:
        say(f"{out}: {held or f'use it with --robot {out}'}")
    return show.ended(found.notes, found.losses(), options.how.quiet)
