"""TOML for people to read and edit: every line has a comment, inactive lines start with #."""

from __future__ import annotations

import itertools
import json
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from locfuse.formats.visible import escaped

WIDTH = 100


class Line(NamedTuple):
    """One key. `words` say where its value comes from, or how to find it."""

    key: str
    value: Any  # None: blank, to be filled in
    words: str = ""
    holds: bool = True  # False: behind a #


class Section(NamedTuple):
    """One table; "" for keys above all tables."""

    name: str
    lines: tuple[Line, ...]


def render(head: str, sections: Sequence[Section], foot: str = "") -> str:
    """Return the text. A table without an active line is itself commented out."""
    parts = [comment(head), *("\n".join(_section(section)) for section in sections if section.lines)]
    return "\n\n".join([*parts, comment(foot)] if foot else parts) + "\n"


def comment(text: str) -> str:
    """Return text behind #, paragraph by paragraph; an indented one is not wrapped."""
    lines: list[str] = []
    for paragraph in text.splitlines():
        plain = printable(paragraph)
        lines += [plain] if plain[:1] == " " else textwrap.wrap(plain, WIDTH - 2, **_WHOLE) or [""]
    return "\n".join(f"# {line}".rstrip() for line in lines)


def value(plain: Any) -> str:
    """Return a number, text, list or table on one line."""
    if isinstance(plain, Mapping):
        return "{ " + ", ".join(f"{value(str(k))} = {value(v)}" for k, v in plain.items()) + " }"
    if isinstance(plain, list | tuple):
        return "[" + ", ".join(map(value, plain)) + "]"
    return escaped(json.dumps(plain, ensure_ascii=False))


def printable(text: str) -> str:
    """Return text without what would end a comment or move a terminal's cursor."""
    return "".join(c if c.isprintable() else "?" for c in text)


def _section(section: Section) -> Iterator[str]:
    if section.name:
        yield f"[{section.name}]" if any(line.holds for line in section.lines) else f"# [{section.name}]"
    for words, group in itertools.groupby(section.lines, key=lambda line: line.words):
        lines = [("" if line.holds else "# ") + _assigned(line) for line in group]
        beside = f"{lines[0]}  # {printable(words)}"
        if not words:
            yield from lines
        elif len(lines) == 1 and len(beside) <= WIDTH:
            yield beside
        else:
            yield from (comment(words), *lines)


def _assigned(line: Line) -> str:
    return f"{line.key} =" if line.value is None else f"{line.key} = {value(line.value)}"


_WHOLE: Mapping[str, Any] = {"break_long_words": False, "break_on_hyphens": False}
