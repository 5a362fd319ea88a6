"""The screen: lines, paragraphs and documents, with control characters in a log's text made visible.

A closed stdout (`| head`) is not an error: files are still written, and the exit code is returned.
"""

from __future__ import annotations

import os
import sys
import textwrap
from typing import Any

import click

from locfuse.formats.text import visible


def say(line: str, err: bool = False, styled: int | None = None, **style: Any) -> None:
    """Print one line on stdout or stderr, with control characters escaped.

    Its first `styled` characters (None: all) are in the `style` of click.style, if the screen supports it.
    """
    text = visible(line)
    head = len(text) if styled is None else max(styled, 0)
    _echo((click.style(text[:head], **style) + text[head:] if style and head else text) + "\n", err)


def put(document: str) -> None:
    """Print JSON or TOML unchanged; its control characters are escaped already."""
    _echo(document)


def _echo(text: str, err: bool = False) -> None:
    """Print text; if the stream is closed, drop it and all further output."""
    plain = bool(os.environ.get("NO_COLOR")) or os.environ.get("TERM") == "dumb"
    stream = sys.stderr if err else sys.stdout
    try:
        click.echo(text, stream, nl=False, color=False if plain else None)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def wrapped(head: str, words: str, width: int | None, indent: str | None = None) -> list[str]:
    """Return a paragraph after `head`, wrapped at `width` characters (None: one line)."""
    if width is None:
        return [f"{head}{words}"]
    later = " " * len(head) if indent is None else indent
    return textwrap.wrap(
        words, max(width, 40), initial_indent=head, subsequent_indent=later, break_long_words=False,
        break_on_hyphens=False,
    )  # fmt: skip


def settle_streams() -> None:
    """Open closed standard streams on the null device; escape characters that an output's encoding lacks."""
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # opens the lowest free descriptor, which is this one
    for number, name in ((1, "stdout"), (2, "stderr")):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, os.fdopen(number, "w", errors="backslashreplace", closefd=False))
        elif hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")
