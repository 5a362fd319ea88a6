"""`locfuse calibrate`: noise and geometry of the wheels, the laser's mount, iron around the compass, from logs."""

from __future__ import annotations

import click

from locfuse.cli.terminal import completion
from locfuse.cli.terminal import options as o
from locfuse.cli.terminal.findings import finish

BELOW = "95 % interval: where the value lies by these logs. was: as configured."


@click.command()
@click.argument("log", nargs=-1, required=True, shell_complete=completion.logs)
@o.carried(*o.found("Write what was found as robot.toml, to be used with --robot.", "a table"), *o.READING)
def calibrate(log: tuple[str, ...], options: o.Options) -> int:
    """Find wheel noise, wheel geometry, laser mount and magnetometer iron from LOGs of one robot.

    From straight runs and turns on the spot with truth: the noise per metre (and the paper's delta), wheel radius,
    ratio and track. Without truth, from any drive with wheels and a laser: radius, ratio, track, where the laser
    sits and how late it is; with wheels and a gyro: ratio, track and noise. From any log in which the robot turns
    once, without truth: hard and soft iron.

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
    return finish(found, [(found.titles, found.rows(), BELOW)], options.outputs)
