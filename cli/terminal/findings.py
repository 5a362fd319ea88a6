"""The common output of `calibrate` and `tune`: estimated figures as tables, as JSON and as a robot.toml."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

from .screen import put, reader_may_leave, say

if TYPE_CHECKING:
    from locfuse.cli.analysis.settings import Outputs
    from locfuse.cli.session.found import Found

Table = tuple[Sequence[str], Iterable[Sequence[str]], str]  # titles, rows, the line below that explains them


def finish(found: Found, tables: Iterable[Table], outputs: Outputs, held: str = "") -> int:
    """Write and print what was found; return the exit code; `held`: what the file holds instead of settings."""
    from locfuse.formats.report import json_report
    from locfuse.formats.report.table import of_words, texts

    from . import show

    if outputs.out is not None:
        found.write(outputs.out, outputs.overwrite)
    with reader_may_leave():
        for titles, rows, below in () if outputs.as_json else tables:
            shown = of_words(texts(*titles), rows)
            show.table(shown)
            if shown.rows and below:
                show.lines([below])
        if outputs.as_json:
            put(json_report.encode(found.values()))
        elif outputs.out is not None:
            say(f"{outputs.out}: {held or f'use it with --robot {outputs.out}'}")
    return end(found.notes, found.losses(), found.how.quiet)


def end(notes: Iterable[str], lost: Sequence[str], quiet: bool) -> int:
    """Print notes and losses on stderr; return the exit code."""
    from locfuse.cli.analysis.errors import EXIT_LOSS

    for line in (*(() if quiet else (f"note: {n}" for n in notes)), *(f"lost: {n}" for n in lost)):
        say(line, err=True)  # the reason of exit code 3 is printed with --quiet too
    return EXIT_LOSS if lost else 0
