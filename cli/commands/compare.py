"""`locfuse compare`: every configuration over one log, measured once."""

from __future__ import annotations

from pathlib import Path

import click

from locfuse.cli.pipeline.settings import LogOptions
from locfuse.cli.rerun.record import Recorded, RerunOptions, record, sketched
from locfuse.cli.terminal.findings import may_replace
from locfuse.cli.terminal.options import (
    chosen,
    export_option,
    log_options,
    out_options,
    preset_option,
    smooth_option,
)
from locfuse.cli.terminal.rerun_options import rerun_options
from locfuse.cli.terminal.screen import say

KINDS = ("html", "md", "json", "tum", "csv", "tex")


@click.command()
@click.argument("log", nargs=-1, required=True)
@click.option(
    "--sensors",
    multiple=True,
    help="A configuration to compare, e.g. --sensors odometry --sensors compass,lrf, or a what-if at a lower "
    "rate, --sensors lrf@2Hz. Repeatable.  [default: odometry, each sensor alone, all]",
)
@click.option(
    "--all-subsets",
    is_flag=True,
    help="Run every subset of the sensors: each one's credit, not only its effect alone.",
)
@click.option(
    "--align",
    type=click.Choice(["none", "origin", "se2"]),
    default="none",
    show_default=True,
    help="Move each estimate onto the truth before judging it.",
)
@smooth_option
@click.option(
    "--figures",
    type=click.Path(path_type=Path, file_okay=False),
    metavar="DIR",
    help="Also write every figure there as SVG and PDF, for a paper.",
)
@click.option(
    "--fail-if",
    multiple=True,
    metavar="GATE",
    help='Exit with 4 if it holds, e.g. "all.position_rmse_m > 0.02". Repeatable.',
)
@click.option(
    "--baseline",
    type=click.Path(path_type=Path, exists=True, dir_okay=False),
    metavar="REPORT.JSON",
    help="Exit with 4 if an error figure is worse than in this earlier report.",
)
@click.option("--tolerance", default="5%", show_default=True, help="How much worse than the baseline is allowed.")
@log_options
@preset_option
@out_options(KINDS)
@export_option
@rerun_options
def compare(
    log: tuple[str, ...],
    sensors: tuple[str, ...],
    all_subsets: bool,
    align: str,
    smooth: bool,
    figures: Path | None,
    fail_if: tuple[str, ...],
    baseline: Path | None,
    tolerance: str,
    how: LogOptions,
    out: Path | None,
    overwrite: bool,
    write: str | None,
    as_json: bool,
    export: set[str],
    rerun: RerunOptions,
) -> int:
    """Say what each sensor of LOG bought: all configurations in one pass, and a report.

    LOG is an .mcap, the parts of a split one, a rosbag2 folder, or the name of a sample log. Several logs give a
    summary over them; folders of finished results are set side by side.

    \b
    locfuse compare rounded_rectangle
    locfuse compare rounded_rectangle --all-subsets
    locfuse compare bag/ --sensors odometry --sensors lrf -o out
    locfuse compare log.mcap --fail-if "all.position_rmse_m > 0.02"
    locfuse compare rounded_rectangle rounded_triangle disturbed
    locfuse compare locfuse-out/before locfuse-out/after
    """
    from locfuse.cli.jobs import ci_gates
    from locfuse.cli.pipeline import configurations, exports, outputs, results
    from locfuse.cli.pipeline.compare import compare_log, report_of
    from locfuse.cli.pipeline.load import find_log, load_to_fuse
    from locfuse.cli.terminal import show
    from locfuse.formats.whole_files import may_write, write_results

    if len(log) > 1:
        from .several import several

        if (code := several(log)) is not None:
            return code
    kinds = chosen(write, KINDS)
    limits = [ci_gates.parse_gate(text) for text in fail_if]
    before = ci_gates.read_baseline(baseline, tolerance) if baseline else None
    may_replace(rerun.save, overwrite, log)
    with show.progress(how.quiet) as progress:
        loaded = load_to_fuse(find_log(log), how, progress, rerun.wanted)
        wanted = configurations.for_comparison(sensors, loaded.drive, all_subsets)
        folder = out or results.default_folder(loaded.log.name)
        may_write(folder, overwrite, (how.robot, baseline))
        drawn, recorded = outputs.Drawn(), Recorded()
        watch = [drawn.take] if "html" in kinds or figures else []
        watch += [recorded.take] if rerun.wanted else []
        compared = compare_log(loaded, wanted, align, progress, smooth, watch)
        report = report_of(compared)
        progress("writing")
        files = outputs.files(compared, drawn, report, kinds)
        files |= exports.files(export, loaded, {e.name: e for e in compared.estimates})
        write_results(folder, files, overwrite)
        if figures is not None:
            progress("drawing figures")
            write_results(figures, outputs.figure_files(compared, drawn), overwrite=True)
    used = sorted({s for e in compared.estimates for s in e.sensors})
    lost = results.loss_lines(loaded, used, how.strict)
    show.result(report, folder, files, as_json)
    show.notes(report, lost, how.quiet)
    sketch = sketched(rerun, loaded, recorded.in_order(compared.estimates), compared.evaluations, report, show.say)
    del loaded, compared, drawn, recorded, watch, files  # Rerun's import takes as much memory as all of them
    record(rerun, sketch, folder, show.say)
    other = ci_gates.of_another_log(report, before) if before is not None else None
    if other is not None and not how.quiet:
        say(f"note: {other}", err=True)
    failed = ci_gates.failures(report, limits, before)
    for line in failed:
        say(f"gate: {line}", err=True)
    return ci_gates.FAILED if failed else results.LOSS if lost else 0
