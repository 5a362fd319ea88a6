"""`locfuse run`: one configuration over one log."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import click

from locfuse.cli.pipeline.maps import MapOptions
from locfuse.cli.pipeline.settings import LogOptions
from locfuse.cli.rerun.record import RerunOptions, record, sketched
from locfuse.cli.terminal.findings import may_replace
from locfuse.cli.terminal.options import (
    chosen,
    export_option,
    log_options,
    map_options,
    out_options,
    preset_option,
    smooth_option,
)
from locfuse.cli.terminal.rerun_options import rerun_options

KINDS = ("tum", "csv", "json")


@click.command()
@click.argument("log", nargs=-1, required=True)
@click.option(
    "--sensors",
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
@click.option(
    "--audit",
    type=click.Path(path_type=Path, dir_okay=False),
    help="Write every measurement with its distance, threshold and verdict to this CSV.",
)
@log_options
@preset_option
@out_options(KINDS)
@export_option
@map_options
@rerun_options
def run(
    log: tuple[str, ...],
    sensors: str,
    align: str,
    smooth: bool,
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
    from locfuse.cli.pipeline import configurations, exports, results
    from locfuse.cli.pipeline.load import find_log, load_to_fuse
    from locfuse.cli.pipeline.memory import lean
    from locfuse.cli.pipeline.trust import add_consistency, evidence
    from locfuse.cli.terminal import show
    from locfuse.formats.report import json_report
    from locfuse.formats.results import trajectory
    from locfuse.formats.results.audit import audit_csv
    from locfuse.formats.whole_files import Content, may_write, whole_file, write_results
    from locfuse.fusion.judge.evaluate import evaluate

    kinds = chosen(write, KINDS)
    for file in (audit, maps.save, rerun.save):
        may_replace(file, overwrite, log)
    with show.progress(how.quiet) as progress:
        loaded = maps.give(load_to_fuse(find_log(log), how, progress, rerun.wanted))
        drive, robot = loaded.drive, loaded.robot
        configuration = configurations.parse(sensors, drive)
        maps.check(configuration.sensors)
        folder = out or results.default_folder(loaded.log.name)
        may_write(folder, overwrite, (how.robot, maps.given))
        progress("fusing")
        found = lean(configuration.fuse, drive, robot, smooth)
        judged = [evaluate(e, configuration.drive(drive), align) for e in found]  # type: ignore[arg-type]
        report = results.build(loaded, judged)
        add_consistency(report, evidence(configuration.drive(drive), found[0], robot), judged, robot)
        progress("writing")
        files: dict[str, Content] = {"robot.toml": results.robot_file(robot)}
        named = dict(zip(("trajectory", "smoothed"), found, strict=False))
        for name, estimates in named.items():
            if "tum" in kinds:
                files[f"{name}.tum"] = partial(trajectory.write_blocks, trajectory.tum_blocks(drive, estimates))
            if "csv" in kinds:
                files[f"{name}.csv"] = partial(trajectory.write_blocks, trajectory.csv_blocks(drive, estimates))
        files |= exports.files(export, loaded, named)
        if "json" in kinds:
            files["run.json"] = json_report.encode(report)
        write_results(folder, files, overwrite)
        maps.keep(found[0], loaded.log.name)
        if audit is not None:
            with whole_file(audit) as path:
                path.write_text(audit_csv(drive, found[0]))
    lost = results.loss_lines(loaded, configuration.sensors, how.strict)
    show.result(report, folder, files, as_json)
    show.notes(report, lost, how.quiet)
    sketch = sketched(rerun, loaded, found, judged, report, show.say)
    del loaded, drive, found, named, estimates, files, judged  # Rerun's import takes as much memory as all of them
    record(rerun, sketch, folder, show.say)
    return results.LOSS if lost else 0
