"""`locfuse recover`: everything readable of a damaged log, in one clean MCAP."""

from __future__ import annotations

from pathlib import Path

import click

from locfuse.cli.analysis.errors import EXIT_LOSS
from locfuse.cli.terminal import options as o
from locfuse.cli.terminal.screen import put, say


@click.command()
@o.LOGS
@o.option("-o --out", "MCAP file to write.", required=True, type=o.FILE)
@o.OVERWRITE
@o.flag("--json as_json", "Print what was copied and what is lost as JSON.")
@o.QUIET
def recover(log: tuple[str, ...], out: Path, overwrite: bool, as_json: bool, quiet: bool) -> int:
    """Copy the readable part of LOG into a new MCAP with an index and checksums.

    LOG is a damaged or unfinished .mcap, .db3 or .bag, its parts, or a rosbag2 folder. Messages, times and
    attachments are not changed. Losses are printed and stored in the copy's metadata; the exit code is then 3.

    \b
    locfuse recover crashed.mcap -o fixed.mcap
    locfuse recover bag/ -o fixed.mcap && mcap doctor fixed.mcap
    """
    from locfuse.cli.analysis.load import find_log
    from locfuse.cli.terminal import show
    from locfuse.formats.logs.log import open_log
    from locfuse.formats.report import json_report
    from locfuse.formats.results.mcap_export import recover as copy
    from locfuse.formats.whole_files import may_replace

    may_replace(out, overwrite, log)
    with show.progress(quiet) as progress:
        progress("opening")
        opened = open_log(find_log(log))
        progress("copying")
        found = copy(opened, out)
    if as_json:
        values = {"file": str(found.path), "messages": found.messages, "lost": list(found.lost)}
        put(json_report.encode(values))
    else:
        say(f"{found.path}: {sum(found.messages.values())} messages on {len(found.messages)} topics")
    show.ended((), [] if quiet else found.lost, quiet)
    return EXIT_LOSS if found.lost else 0
