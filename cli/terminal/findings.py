"""What `calibrate` and `tune` share: figures that logs gave, as tables, as JSON and as a robot.toml."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from .screen import put, reader_may_leave, say

if TYPE_CHECKING:
    from locfuse.cli.session.found import Found

Command = TypeVar("Command", bound=Callable[..., Any])
Table = tuple[Sequence[str], Iterable[Sequence[str]], str]  # titles, rows, the line below that explains them


def findings_options(what: str, tables: str) -> Callable[[Command], Command]:
    """Return the options -o, --overwrite and --json: `what` -o writes, and what --json prints instead of."""

    def add(command: Command) -> Command:
        options = (
            click.option("-o", "--out", type=click.Path(path_type=Path, dir_okay=False), help=what),
            click.option("--overwrite", is_flag=True, help="Replace an existing file."),
            click.option("--json", "as_json", is_flag=True, help=f"Print the result as JSON instead of {tables}."),
        )
        for option in reversed(options):
            command = option(command)
        return command

    return add


def finish(
    found: Found, tables: Iterable[Table], out: Path | None, overwrite: bool, as_json: bool, held: str = ""
) -> int:
    """Write and print what was found; return the exit code; `held`: what the file holds instead of settings."""
    from locfuse.formats.report import json_report
    from locfuse.formats.report.table import of_words, texts

    from . import show

    if out is not None:
        found.write(out, overwrite)
    with reader_may_leave():
        for titles, rows, below in () if as_json else tables:
            shown = of_words(texts(*titles), rows)
            show.table(shown)
            if shown.rows and below:
                show.lines([below])
        if as_json:
            put(json_report.encode(found.values()))
        elif out is not None:
            say(f"{out}: {held or f'use it with --robot {out}'}")
    return end(found.notes, found.losses(), found.how.quiet)


def end(notes: Iterable[str], lost: Sequence[str], quiet: bool) -> int:
    """Print notes and losses on stderr; return the exit code."""
    from locfuse.cli.analysis.errors import EXIT_LOSS

    for line in (*(() if quiet else (f"note: {n}" for n in notes)), *(f"lost: {n}" for n in lost)):
        say(line, err=True)  # the reason of exit code 3 is printed with --quiet too
    return EXIT_LOSS if lost else 0
