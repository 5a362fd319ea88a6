"""What `calibrate` and `tune` share: figures that logs gave, as tables, as JSON and as a robot.toml."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, TypeVar

import click

from .screen import put, reader_may_leave, say

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


def print_findings(values: Any, tables: Iterable[Table], out: Path | None, as_json: bool, held: str = "") -> None:
    """Print what was found as JSON, or as tables and with how the file is used; `held`: what it holds instead."""
    from locfuse.formats.report import json_report
    from locfuse.formats.report.table import of_words, texts

    from . import show

    with reader_may_leave():
        if as_json:
            put(json_report.encode(values))
            return
        for titles, rows, below in tables:
            shown = of_words(texts(*titles), rows)
            show.table(shown)
            if shown.rows and below:
                show.lines([below])
        if out is not None:
            say(f"{out}: {held or f'use it with --robot {out}'}")


def end(notes: Iterable[str], lost: Sequence[str], quiet: bool) -> int:
    """Print notes and losses on stderr; return the exit code."""
    from locfuse.cli.analysis.errors import EXIT_LOSS

    for line in (*(() if quiet else (f"note: {n}" for n in notes)), *(f"lost: {n}" for n in lost)):
        say(line, err=True)  # the reason of exit code 3 is printed with --quiet too
    return EXIT_LOSS if lost else 0
