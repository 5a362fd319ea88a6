"""`locfuse export`: estimated settings of a robot as parameter files of its ROS nodes."""

from __future__ import annotations

from pathlib import Path

import click

from locfuse.cli.terminal import options as o

TARGETS = ("diff_drive", "ekf", "amcl", "fusioncore")  # as in cli/ros/export.py, which imports NumPy


@click.command()
@click.argument("kind", type=click.Choice(["ros"]))
@o.LOGS
@o.each(
    "--to targets",
    "The node to write for: diff_drive_controller, robot_localization, nav2's AMCL, FusionCore. Repeatable.",
    type=click.Choice([*TARGETS, "all"]),
    required=True,
)
@o.option(
    "--into",
    "Change the values in this YAML file, keep its comments, and show a diff.",
    type=o.FILE,
    metavar="FILE",
)
@o.option("--node", "Name of the node in the --into file, if it has several of this kind.", metavar="NAME")
@o.option("-o --out", "Write to this file.  [default: print, or change the --into file]", type=o.FILE)
@o.OVERWRITE
@o.flag("--as-set", "Use the present settings: do not calibrate or tune.")
@o.carried(o.GIVEN_MAP, *o.READING)
def export(
    log: tuple[str, ...],
    options: o.Options,
    kind: str,
    targets: tuple[str, ...],
    into: Path | None,
    node: str | None,
    as_set: bool,
) -> int:
    """Write parameters of ROS nodes, estimated from LOG: ekf.yaml, controllers, AMCL, FusionCore.

    LOG is calibrated and tuned first. If LOG is a folder of results, its settings and fixes are used instead. A
    comment on each line says where the value comes from (docs/export.md).

    \b
    locfuse export ros drive.mcap --to ekf -o ekf.yaml
    locfuse export ros drive.mcap --to diff_drive --into controllers.yaml
    locfuse export ros locfuse-out/drive --to amcl --into nav2_params.yaml
    """
    from locfuse.cli.analysis.results import loss_lines
    from locfuse.cli.ros.export import edited, fresh, refuse_read_only, targets_in, write
    from locfuse.cli.ros.found import gather
    from locfuse.cli.terminal import show
    from locfuse.cli.terminal.screen import put, say
    from locfuse.formats.robot.ros_yaml import read
    from locfuse.formats.whole_files import may_replace, write_text

    how, out = options.how, options.outputs.out
    chosen = tuple(TARGETS) if "all" in targets else tuple(dict.fromkeys(targets))
    may_replace(out, options.outputs.overwrite, log)
    if into is not None and out is not None and out.exists() and out.samefile(into):
        out = None  # change the file itself, which keeps its mode and its links
    file = None if into is None else read(into)
    if file is not None:
        chosen = targets_in(file, chosen, node, "all" in targets)
        if out is None:
            refuse_read_only(file.path)
    with show.progress(how.quiet) as progress:
        found = gather(log, how, as_set, {"diff_drive", "amcl"}.issuperset(chosen), progress)
        progress("writing")
        made = fresh(found, chosen) if file is None else edited(found, chosen, file, node)
    changed = file is None or bool(made.diff)
    place = out or into
    if out is not None:
        write_text(out, made.text)
    elif into is not None and changed:
        write(into, made.text)
    if place is None:
        put(made.text)
    for line in (*made.diff, *made.reasons):
        say(line)
    if place is not None:
        say(f"{place}: {'written' if changed else 'nothing to change'}")
    lost = loss_lines(found.loaded, list(found.loaded.drive.measurements), how.strict)
    return show.ended(found.notes, lost, how.quiet)
