"""The screen: lines by click, tables by rich, with control characters in a log's text made visible.

A closed stdout (`| head`) is not an error.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import click

from locfuse.formats.visible import visible, visible_lines

if TYPE_CHECKING:
    from rich.console import Console, ConsoleOptions, RenderableType
    from rich.segment import Segment


def screen(**options: Any) -> Console:
    """Return rich's console, changed to raise BrokenPipeError instead of exiting with code 1."""
    from rich.console import Console
    from rich.segment import Segment

    class PipeConsole(Console):
        def on_broken_pipe(self) -> None:
            raise BrokenPipeError

        def render(
            self, renderable: RenderableType, options: ConsoleOptions | None = None
        ) -> Iterator[Segment]:  # rich's own control codes (colours, spinner) are kept
            for text, style, control in super().render(renderable, options):
                yield Segment(text if control else visible_lines(text), style, control)

    return PipeConsole(**options)


def say(line: str, err: bool = False) -> None:
    """Print one line on stdout or stderr, with control characters escaped.

    If stderr is closed (`2>&1 | head`), the line is dropped, and the exit code is still returned.
    """
    try:
        click.echo(visible(line), err=err)
    except BrokenPipeError:
        if not err:
            raise  # handled by `ignore_closed_stdout`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stderr.fileno())


def put(document: str) -> None:
    """Print JSON or TOML unchanged; its control characters are escaped already."""
    click.echo(document, nl=False)


def settle_streams() -> None:
    """Open closed standard streams on the null device; escape characters that an output's encoding lacks."""
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # gets the lowest free number, which is this one
    for number, name in ((1, "stdout"), (2, "stderr")):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, os.fdopen(number, "w", errors="backslashreplace", closefd=False))
        elif hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")


@contextmanager
def ignore_closed_stdout() -> Iterator[None]:
    """Ignore a closed stdout (`| head`): drop further output, still write files and return the exit code."""
    try:
        yield
        sys.stdout.flush()
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
