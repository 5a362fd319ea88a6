"""`locfuse compare`: every configuration over one log, measured once."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from locfuse.cli.analysis.settings import OF_COMPARISON as KINDS
from locfuse.cli.terminal import completion
from locfuse.cli.terminal.fleet_options import fleet_options
from locfuse.cli.terminal.options import (
    advice_option,
    export_option,
    given_map_option,
    jitter_option,
    log_options,
    out_options,
    preset_option,
    reference_option,
    smooth_option,
    window_options,
)
from locfuse.cli.terminal.rerun_options import rerun_options

from .compare_one_log import Wish, one


@click.command()
@click.argument("log", nargs=-1, shell_complete=completion.logs)
@click.option(
    "--sensors",
    shell_complete=completion.sensors,
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
    "--estimate",
    multiple=True,
    metavar="NAME=SOURCE",
    help="Another estimate as a row: a topic of poses, two frames of /tf, a .tum or .csv file, "
    "e.g. --estimate amcl=/amcl_pose. Repeatable.",
)
@click.option(
    "--align",
    type=click.Choice(["none", "origin", "se2"]),
    default="none",
    show_default=True,
    help="Move each estimate onto the truth before judging it.",
)
@smooth_option
@reference_option
@advice_option
@jitter_option
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
    help='Exit with 4 if it holds, e.g. "all.position_rmse_m > 0.02"; of several logs also '
    '"fleet.all.position_rmse_m.p90 > 0.05". Repeatable.',
)
@click.option(
    "--baseline",
    type=click.Path(path_type=Path, exists=True, dir_okay=False),
    metavar="REPORT.JSON",
    help="Exit with 4 if an error figure is worse than in this earlier report of the same log (of several logs: "
    "their summary.json).",
)
@click.option(
    "--tolerance",
    default="5%",
    show_default=True,
    help="How much worse than the baseline is allowed: a share, a floor (1mm, 0.1deg), or both: 5%,1mm.",
)
@click.option("--open", is_flag=True, help="Open the report in the browser when it is written.")
@fleet_options
@log_options
@preset_option
@window_options
@out_options(KINDS)
@given_map_option
@export_option
@rerun_options
def compare(log: tuple[str, ...], **asked: Any) -> int:
    """Say what each sensor of LOG adds: all configurations in one pass, and a report.

    LOG is an .mcap, the parts of a split one, a rosbag2 folder, or the name of a sample log. Several logs, also as
    @list.txt or "pattern*.mcap", give a summary over them (docs/fleet.md); folders of finished results are set
    side by side.

    \b
    locfuse compare rounded_rectangle
    locfuse compare rounded_rectangle --all-subsets
    locfuse compare bag/ --sensors odometry --sensors lrf -o out
    locfuse compare log.mcap --fail-if "all.position_rmse_m > 0.02"
    locfuse compare rounded_rectangle rounded_triangle disturbed --jobs 2
    locfuse compare @logs.txt --robot-from "fleet/([^/]+)/" --robot "robots/{robot}.toml"
    locfuse compare locfuse-out/before locfuse-out/after
    """
    from locfuse.cli.analysis.grouping import logs_of, results_of
    from locfuse.cli.fleet.words import expanded

    wish = Wish(**asked)
    words = expanded(log, wish.fleet.each)
    if not words:
        raise click.UsageError("Missing argument 'LOG...'.", click.get_current_context())
    finished = results_of(words)
    if finished is not None:
        from .compare_changes import changes

        return changes(finished, wish)
    listed = any(word.startswith("@") for word in log) or wish.fleet.asked
    if not listed and (len(words) == 1 or len(logs_of(words)) == 1):
        return one(words, wish)
    from .compare_several import several

    return several(words, wish)
