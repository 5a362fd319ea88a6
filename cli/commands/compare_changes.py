"""`locfuse compare` with finished results: set side by side, and what changed between them."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click
from click.core import ParameterSource

from locfuse.cli.analysis.settings import Outputs
from locfuse.cli.terminal import show
from locfuse.cli.terminal.screen import put, say
from locfuse.formats.caps import MAX_REPORT
from locfuse.formats.inputs import read_small
from locfuse.formats.report import changes as sides
from locfuse.formats.report import json_report
from locfuse.formats.whole_files import write_results
from locfuse.fusion.data import LocfuseError, UsageError

ALLOWED_OPTIONS = ("log", "out", "overwrite", "as_json", "quiet")  # options that finished results can follow


def changes(files: Sequence[Path], outputs: Outputs) -> int:
    """Set finished results beside the first of them and print what changed."""
    _refuse_what_needs_a_log()
    reports = [_read(file) for file in files]
    first, *others = zip(files, reports, strict=True)
    found = {str(file.parent): sides.changes(first[1], report) for file, report in others}
    before = str(first[0].parent)
    values = {"before": before, "after": found}
    written: dict[str, str] = {}
    if outputs.out is not None:
        texts = [sides.render((before, after), c) for after, c in found.items()]
        written = {"changes.json": json_report.encode(values), "changes.md": "\n".join(texts)}
        write_results(outputs.out, written, outputs.overwrite)
    if outputs.as_json:
        put(json_report.encode(values))
        return 0
    for after, one in found.items():
        say(f"{before} -> {after}")
        show.table(sides.table(one).once())
        for line in sides.remarks(one):
            say(line)
    if written:
        say(f"{outputs.out}: {', '.join(written)}")
    return 0


def _refuse_what_needs_a_log() -> None:
    """Raise UsageError for an option that finished results cannot follow: a gate is never skipped silently."""
    context = click.get_current_context()
    for option in context.command.params:
        given = context.get_parameter_source(str(option.name)) is ParameterSource.COMMANDLINE
        if given and option.name not in ALLOWED_OPTIONS:
            name = max(option.opts, key=len)
            raise UsageError(f"{name} is for logs; finished results are set side by side as they are")


def _read(file: Path) -> dict[str, Any]:
    try:
        report = json_report.current(json.loads(read_small(file, MAX_REPORT)), str(file))
        sides.changes(report, report)
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        raise LocfuseError(f"{file}: not a report of locfuse; make one with: locfuse compare LOG -o DIR") from None
    return report
