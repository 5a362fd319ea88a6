"""`locfuse compare`: every configuration over one log, measured once."""

from __future__ import annotations

from pathlib import Path

import click

from .options import LogOptions, chosen, log_options, out_options
from .rerun_options import RerunOptions, record, rerun_options

KINDS = ("json", "md", "tum")


@click.command()
@click.argument("log", nargs=-1, required=True)
@click.option(
    "--sensors",
    multiple=True,
    help="A configuration to compare, e.g. --sensors odometry --sensors compass,lrf. Repeatable.  "
    "[default: odometry, each sensor alone, all]",
)
@click.option(
    "--align",
    type=click.Choice(["none", "origin", "se2"]),
    default="none",
    show_default=True,
    help="Move each estimate onto the truth before judging it.",
)
@log_options
@out_options(KINDS)
@rerun_options
def compare(
    log: tuple[str, ...],
    sensors: tuple[str, ...],
    align: str,
    how: LogOptions,
    out: Path | None,
    overwrite: bool,
    write: str | None,
    as_json: bool,
    rerun: RerunOptions,
) -> int:
    """Say what each sensor of LOG bought: all configurations in one pass, and a report.

    LOG is an .mcap, the parts of a split one, a rosbag2 folder, or the name of a sample log.

    \b
    locfuse compare rounded_rectangle
    locfuse compare bag/ --sensors odometry --sensors lrf -o out
    """
    from ..formats import report_json, report_md, trajectory
    from ..formats.outdir import write_results
    from ..fusion.evaluate import evaluate
    from ..fusion.fuse import fuse
    from . import configurations, results, show
    from .load import find_log, load

    kinds = chosen(write, KINDS)
    with show.progress(how.quiet) as progress:
        loaded = load(find_log(log), how, progress)
        drive, robot = loaded.drive, loaded.robot
        estimates = []
        for names in configurations.for_comparison(sensors, drive):
            progress(f"fusing {'+'.join(names) or 'odometry'}")
            estimates.append(fuse(drive, robot, names))
        evaluations = [evaluate(e, drive, align) for e in estimates]  # type: ignore[arg-type]
        report = results.build(loaded, evaluations)
        progress("writing")
        files: dict[str, str] = {"robot.toml": results.robot_file(robot)}
        if "tum" in kinds:
            files |= {f"{e.name}.tum": trajectory.estimates_tum(drive, e) for e in estimates}
            if drive.truth is not None:
                files["truth.tum"] = trajectory.truth_tum(drive, drive.truth)
        if "md" in kinds:
            files["report.md"] = report_md.render(report)
        if "json" in kinds:
            files["report.json"] = report_json.encode(report)
        folder = out or results.default_folder(loaded.log.name)
        write_results(folder, files, overwrite)
    used = sorted({s for e in estimates for s in e.sensors})
    lost = results.loss_lines(loaded, used, how.strict)
    if as_json:
        click.echo(report_json.encode(report), nl=False)
    else:
        show.figures(report)
        click.echo(f"{folder}: {', '.join(sorted(files))}")
    show.notes(report, lost, how.quiet)
    record(rerun, loaded, estimates, evaluations, report, folder)
    return results.LOSS if lost else 0
