"""`locfuse info`: topics of a log, sensors that read them, missing settings, and findings with fixes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from locfuse.cli.analysis.errors import EXIT_LOSS
from locfuse.cli.terminal import options as o
from locfuse.cli.terminal.screen import put

if TYPE_CHECKING:
    from locfuse.cli.inspect.robot_facts import Overview

PICTURES = "pictures"
TRIED = "tried by fusing"


@click.command()
@o.LOGS
@o.flag(
    "--check",
    "Also run the filter with the fixes. Exit with 3 if a problem would spoil an estimate, or a run gets lost.",
)
@o.ADVICE
@o.flag("--topics", "List only the topics; no message is read.")
@o.flag("--json as_json", "Print everything as JSON.")
@o.option(
    "--preview",
    "Write a few camera pictures to this folder; red pixels and detected objects are marked.",
    type=o.DIRECTORY,
    metavar="DIR",
)
@o.carried(*o.READING)
def info(log: tuple[str, ...], options: o.Options, check: bool, topics: bool, preview: Path | None) -> int:
    """Show what is in LOG, which topic each sensor uses, what is missing, and what looks wrong.

    If a setting fixes a problem, the setting is printed; --check runs the filter with it. Several logs of one
    robot are examined together: their common clock lag, track and mount, with the spread over the logs.

    \b
    locfuse info bag/
    locfuse info bag/ --check --set wheels.radius=0.033 --set wheels.track=0.16
    locfuse info bag/ --preview pictures --set camera.outer=230
    locfuse info monday.mcap tuesday.mcap friday.mcap --check
    locfuse info --topics s3://bucket/drive.mcap
    """
    how, as_json = options.how, options.outputs.as_json
    if topics:
        return _list_topics(log, as_json, how.quiet)
    from locfuse.cli.analysis.grouping import expanded, logs_of, named

    logs = logs_of(expanded(log))
    if len(logs) > 1:
        return _several(named(logs), options, check, preview)
    from locfuse.cli.inspect.inspect_log import inspect_log
    from locfuse.cli.inspect.robot_facts import values
    from locfuse.cli.terminal import info_text, show
    from locfuse.formats.report import json_report
    from locfuse.formats.report.findings import void_reasons

    with show.progress(how.quiet) as progress:
        overview = inspect_log(log, how, progress)
        pictures = _preview(overview, preview) if preview is not None else []
        tried: dict[str, Any] = {}
        if check and options.asked.advice and overview.loaded is not None:
            from locfuse.cli.session.session import tried_by_fusing  # imports the filter

            tried = tried_by_fusing(log, how, progress)
    if as_json:
        put(json_report.encode({**values(overview), **({"tried": tried} if check else {})}))
    else:
        text = info_text.lines(overview, (*log, *how.words), show.width(), tried or None)
        show.lines((*text, *pictures), (*info_text.TITLES, PICTURES))
        if tried:
            show.lines(("", TRIED), (TRIED,))
            show.headline(tried)
            show.findings(tried)
    show.transfer(overview.log.transfer, how.quiet)
    losses = {"lost", "refused"} if how.strict else {"lost"}
    lost = any(o.code in losses for o in overview.findings)
    return EXIT_LOSS if lost or (check and (overview.severe or void_reasons(tried))) else 0


def _several(logs: Mapping[str, Sequence[str]], options: o.Options, check: bool, preview: Path | None) -> int:
    """Print the values that several logs of one robot share, and their findings, each once."""
    from locfuse.cli.advice.together import ask, in_this_process, numbers_of
    from locfuse.cli.analysis.load import load
    from locfuse.cli.inspect.inspect_log import inspect_log
    from locfuse.cli.inspect.robot_facts import values
    from locfuse.cli.terminal import info_text, show
    from locfuse.formats.report import json_report, summary
    from locfuse.fusion.data import UsageError

    if preview is not None:
        raise UsageError(f"--preview {preview}: of one log at a time")
    how, asked = options.how, options.asked
    with show.progress(how.quiet) as progress:
        overviews = {name: inspect_log(parts, how, progress) for name, parts in logs.items()}
        shown = {n: found for n, o in overviews.items() if o.loaded and (found := numbers_of(o.loaded))}
        trying = {n: load(logs[n], how, progress) for n in shown if check and asked.advice}
        look = in_this_process(trying, asked.align, progress) if trying else lambda names, sets: {}
        together = {"robot": None, **ask(shown, look)}
    if options.outputs.as_json:
        each = {name: values(overview) for name, overview in overviews.items()}
        put(json_report.encode({"logs": each, "together": together}))
    else:
        show.lines(info_text.together(overviews, together), (*info_text.TITLES, info_text.TOGETHER))
        show.lines(" ".join(line).strip() for line in summary.fix_of(together))
    return EXIT_LOSS if check and any(overview.severe for overview in overviews.values()) else 0


def _list_topics(words: tuple[str, ...], as_json: bool, quiet: bool) -> int:
    """Print the topics of a log from its index; nothing else of a remote log is read."""
    from locfuse.cli.analysis.load import find_log
    from locfuse.cli.inspect.robot_facts import listed
    from locfuse.cli.terminal import info_text, show
    from locfuse.formats.logs.log import open_log
    from locfuse.formats.report import json_report

    log = open_log(find_log(words))
    if as_json:
        put(json_report.encode({"topics": listed(log)}))
    else:
        show.lines(info_text.listed(listed(log), show.width()))
    show.transfer(log.transfer, quiet)
    return EXIT_LOSS if log.losses else 0


def _preview(overview: Overview, folder: Path) -> list[str]:
    """Write preview pictures, and return the lines to print about them."""
    from locfuse.cli.inspect.inspect_log import pictures_of
    from locfuse.formats.whole_files import write_results
    from locfuse.fusion.checks import preview
    from locfuse.fusion.data import LocfuseError

    log, settings = overview.log, overview.robot.settings("camera")
    fit = pictures_of(log, overview.choice)
    if not fit:
        raise LocfuseError(f"--preview: no topic of {log.name} holds pictures")
    if settings.topic not in fit and len(fit) > 1:
        fix = f"camera.topic={fit[0]}"
        words = f"--preview: {log.name} has {len(fit)} topics of pictures;"
        raise LocfuseError(words, fixes=(fix,), hint=f"choose one with --set {fix}")
    topic = settings.topic if settings.topic in fit else fit[0]
    shown = preview.preview(log.stream(topic, overview.robot.order), settings)
    lines = ["", PICTURES]
    write_results(folder, {name: file for one in shown for name, file in one.named().items()}, overwrite=True)
    for one in shown:
        found = ", ".join(f"{b:.1f}" for b in one.bearings_deg)
        what = f"something red at {found} deg" if found else "nothing red and upright"
        lines.append(f"  {folder}/{one.row:06d}-*.png: {what}")
    return lines
