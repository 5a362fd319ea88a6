"""The screen, by rich, for which a reader of stdout that has gone (`| head`) is no error of ours."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from rich.console import Console


def screen(**options: Any) -> Console:
    """Return rich's console; it passes a broken pipe on instead of ending the program with code 1."""
    from rich.console import Console

    class Patient(Console):
        def on_broken_pipe(self) -> None:
            raise BrokenPipeError

    return Patient(**options)


@contextmanager
def reader_may_leave() -> Iterator[None]:
    """Say the rest to nobody once the reader of stdout has gone, and go on: files and exit code are still due."""
    try:
        yield
        sys.stdout.flush()
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def say(line: str) -> None:
    """Print a line on stderr; to nobody where its reader has gone (`2>&1 | head`): the exit code is still due."""
    try:
        click.echo(line, err=True)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stderr.fileno())
