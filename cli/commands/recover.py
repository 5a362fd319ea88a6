"""`locfuse recover`: everything readable of a damaged log, in one clean MCAP."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from locfuse.cli.analysis.errors import EXIT_LOSS
from locfuse.cli.terminal import completion
from locfuse.cli.terminal.screen import put, reader_may_leave, say

if TYPE_CHECKING:
    from locfuse.formats.results.recovered_log import Recovered


@click.command()
@click.argument("log", nargs=-1, required=True, shell_complete=completion.logs)
@click.option(
    "-o", "--out", required=True, type=click.Path(path_type=Path, dir_okay=False), help="MCAP file to write."
)
@click.option("--overwrite", is_flag=True, help="Replace an existing file.")
@click.option("--json", "as_json", is_flag=True, help="Print what was copied and what is lost as JSON.")
@click.option("-q", "--quiet", is_flag=True, help="Print no progress and no notes.")
def recover(log: tuple[str, ...], out: Path, overwrite: bool, as_json: bool, quiet: bool) -> int:
    """Copy what can be read of LOG into one MCAP that is whole, indexed and checksummed.

    LOG is a damaged or unfinished .mcap, .db3 or .bag, its parts, or a rosbag2 folder. Bytes, times and
    attachments stay as they are. What is lost is printed, stands in the copy's metadata, and gives exit code 3.

    \b
    locfuse recover crashed.mcap -o fixed.mcap
    locfuse recover bag/ -o fixed.mcap && mcap doctor fixed.mcap
    """
    from locfuse.cli.analysis.load import find_log
    from locfuse.cli.terminal import show
    from locfuse.formats.logs.log import open_log
    from locfuse.formats.results.recovered_log import recover as copy
    from locfuse.formats.whole_files import may_replace

    may_replace(out, overwrite, log)
    with show.progress(quiet) as progress:
        progress("opening")
        opened = open_log(find_log(log))
        progress("copying")
        found = copy(opened, out)
    with reader_may_leave():
        _print(found, as_json)
    if not quiet:
        for line in found.lost:
            say(f"lost: {line}", err=True)
    return EXIT_LOSS if found.lost else 0


def _print(found: Recovered, as_json: bool) -> None:
    from locfuse.formats.report import json_report

    if as_json:
        put(json_report.encode({"file": str(found.path), "messages": found.messages, "lost": list(found.lost)}))
    else:
        total = sum(found.messages.values())
        say(f"{found.path}: {total} messages on {len(found.messages)} topics")
