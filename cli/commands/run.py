"""`locfuse run`: one configuration on one log."""

from __future__ import annotations

import click

from locfuse.cli.analysis.settings import OF_RUN as KINDS
from locfuse.cli.terminal import options as o


@click.command(cls=o.Grouped)
@o.LOGS
@o.carried(
    o.sensors("Comma-separated sensors, or: all, odometry."),
    o.ALIGN,
    o.SMOOTH,
    o.ADVICE,
    o.JITTER,
    o.option(
        "--audit", "Write every measurement with its distance, threshold and verdict to this CSV.", type=o.FILE
    ),
    *o.FUSING,
    *o.written(KINDS),
    o.EXPORT,
    o.GIVEN_MAP,
    o.option("--save-map", "Write the line map of this run as JSON, its landmarks as .csv.", type=o.FILE),
    *o.RERUN,
)
def run(log: tuple[str, ...], options: o.Options) -> int:
    """Estimate the trajectory of LOG with one set of sensors.

    LOG is an .mcap, the parts of a split one, a rosbag2 folder, or the name of a sample log.

    \b
    locfuse run rounded_rectangle --sensors all
    locfuse run bag/ --sensors compass,lrf --robot robot.toml -o out
    """
    from locfuse.cli.analysis.configurations import parse
    from locfuse.cli.analysis.errors import EXIT_LOSS
    from locfuse.cli.analysis.results import default_folder
    from locfuse.cli.session.session import opened
    from locfuse.cli.terminal import show
    from locfuse.formats.whole_files import may_replace, may_write
    from locfuse.fusion.data import UsageError
    from locfuse.fusion.sensors.registry import of_points

    how, asked, outputs = options.how, options.asked, options.outputs
    for file in (outputs.audit, outputs.save_map, outputs.rerun_save):
        may_replace(file, outputs.overwrite, log)
    with show.progress(how.quiet) as progress:
        session = opened(log, how, progress, read_again=outputs.recorded)
        configuration = parse(asked.sensors[0], session.drive)
        save, sensors = outputs.save_map, configuration.sensors
        saves_lines = save is not None and (save.suffix != ".csv" or of_points().isdisjoint(sensors))
        option = "--map" if how.given_map is not None else "--save-map" if saves_lines else None
        if option and "lrf" not in sensors:
            raise UsageError(f"{option}: only the laser has a map; add lrf to --sensors")
        may_write(outputs.out or default_folder(session.log.name), outputs.overwrite, options.inputs)
        result = session.run(
            configuration, align=asked.align, smooth=asked.smooth, advice=asked.advice, jitter=asked.jitter
        )
        files = result.write(outputs.out, write=outputs.write, export=outputs.export, overwrite=outputs.overwrite)
        if outputs.save_map is not None:
            result.save_map(outputs.save_map)
        if outputs.audit is not None:
            result.write_audit(outputs.audit)
    return EXIT_LOSS if show.outcome(result, files, options) else 0
