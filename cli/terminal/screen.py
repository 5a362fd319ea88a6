"""The screen: lines by click, tables by rich, and text of a log with its control characters made visible.

A reader of stdout that has gone (`| head`) is no error of ours.
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
    """Return rich's console; it passes a broken pipe on instead of ending the program with code 1."""
    from rich.console import Console
    from rich.segment import Segment

    class Patient(Console):
        def on_broken_pipe(self) -> None:
            raise BrokenPipeError

        def render(
            self, renderable: RenderableType, options: ConsoleOptions | None = None
        ) -> Iterator[Segment]:  # its own controls (colours, the spinner) pass
            for text, style, control in super().render(renderable, options):
                yield Segment(text if control else visible_lines(text), style, control)

    return Patient(**options)


def say(line: str, err: bool = False) -> None:
    """Print one line on stdout or stderr, with control characters escaped.

    Where the reader of stderr has gone (`2>&1 | head`) it is dropped: the exit code is still returned.
    """
    try:
        click.echo(visible(line), err=err)
    except BrokenPipeError:
        if not err:
            raise  # `reader_may_leave` knows
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stderr.fileno())


def put(document: str) -> None:
    """Print JSON or TOML unchanged: its writer has escaped control characters."""
    click.echo(document, nl=False)


def settle_streams() -> None:
    """Make the streams safe: a closed one becomes the null device, characters outside an encoding are escaped."""
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest number: this one, so that no file of ours gets it
    for number, name in ((1, "stdout"), (2, "stderr")):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, os.fdopen(number, "w", errors="backslashreplace", closefd=False))
        elif hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")


@contextmanager
def reader_may_leave() -> Iterator[None]:
    """Ignore a closed stdout (`| head`): drop further output, still write files and return the exit code."""
    try:
        yield
        sys.stdout.flush()
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
