"""Commented TOML: a new robot.toml with a comment on every line, or new values in an existing one."""

from __future__ import annotations

import itertools
import json
import re
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from locfuse.formats.inputs import MAX_ROBOT_TOML, read_small
from locfuse.formats.text import escaped
from locfuse.fusion.data import LocfuseError

from . import robot_toml

MAX_LINE_CHARACTERS = 100
WRAPPER = textwrap.TextWrapper(MAX_LINE_CHARACTERS - 2, break_long_words=False, break_on_hyphens=False)


class TomlLine(NamedTuple):
    """One key with its value and a comment."""

    key: str
    value: Any  # None: blank, to be filled in
    words: str = ""  # the comment: source of the value, or how to find the value
    holds: bool = True  # False: the line is commented out


class TomlSection(NamedTuple):
    """One table of a TOML file; the name "" is for keys above all tables."""

    name: str
    lines: tuple[TomlLine, ...]


def render(head: str, sections: Sequence[TomlSection], foot: str = "") -> str:
    """Return a commented TOML file; a table without active lines is commented out as a whole."""
    parts = [comment(head), *("\n".join(_section(section)) for section in sections if section.lines)]
    return "\n\n".join([*parts, comment(foot)] if foot else parts) + "\n"


def comment(text: str) -> str:
    """Return the text as wrapped comment lines; a paragraph that begins with a space is not wrapped."""
    lines: list[str] = []
    for paragraph in text.splitlines():
        plain = printable(paragraph)
        lines += [plain] if plain[:1] == " " else WRAPPER.wrap(plain) or [""]
    return "\n".join(f"# {line}".rstrip() for line in lines)


def as_toml(plain: Any) -> str:
    """Return a value (number, text, list or table) as TOML on one line."""
    if isinstance(plain, Mapping):
        return "{ " + ", ".join(f"{as_toml(str(k))} = {as_toml(v)}" for k, v in plain.items()) + " }"
    if isinstance(plain, list | tuple):
        return "[" + ", ".join(map(as_toml, plain)) + "]"
    return escaped(json.dumps(plain, ensure_ascii=False))


def printable(text: str) -> str:
    """Return text with unprintable characters (line ends, control characters) replaced by "?"."""
    return "".join(c if c.isprintable() else "?" for c in text)


def _section(section: TomlSection) -> Iterator[str]:
    if section.name:
        yield f"[{section.name}]" if any(line.holds for line in section.lines) else f"# [{section.name}]"
    for words, group in itertools.groupby(section.lines, key=lambda line: line.words):
        pairs = [(line, "" if line.value is None else f" {as_toml(line.value)}") for line in group]
        lines = [f"{'' if line.holds else '# '}{line.key} ={value}" for line, value in pairs]
        beside = f"{lines[0]}  # {printable(words)}"
        if not words:
            yield from lines
        elif len(lines) == 1 and len(beside) <= MAX_LINE_CHARACTERS:
            yield beside
        else:
            yield from (comment(words), *lines)


# --- New values in an existing robot.toml; its comments, order and all else stay unchanged
# Values over several lines, and tables not written as [table], cannot be replaced line by line. So the new text is
# parsed again and compared with the merged tables.

HEADING = re.compile(r"\s*(#\s*)?\[\s*([\w-]+)\s*\]\s*(#.*)?$")
BASIC, LITERAL = r'"(?:[^"\\]|\\.)*"', r"'[^']*'"
COMMENT = re.compile(rf"((?:{BASIC}|{LITERAL}|[^#\"'])*?)(\s*#.*)?$")


def text_of(robot: Path | None) -> str:
    """Return the text of a robot.toml; "" without one."""
    return "" if robot is None else read_small(robot, MAX_ROBOT_TOML).decode("utf-8", "replace")


def updated(text: str, changes: Mapping[str, Any], who: str) -> str:
    """Return the text of a robot.toml with changed keys; new keys are added at the end of their tables.

    A commented-out key becomes active in its place. `who` is the comment of an added key. Raises LocfuseError if
    the text cannot be changed line by line.
    """
    wanted = robot_toml.merge(robot_toml.parse(text, "robot.toml"), changes)
    lines = text.splitlines()
    for table, values in changes.items():
        inside = values if isinstance(values, Mapping) else {table: values}
        lines = _in_table(lines, table if isinstance(values, Mapping) else "", inside, who)
    result = "\n".join(lines) + "\n"
    if robot_toml.parse(result, "robot.toml") != wanted:
        raise LocfuseError(
            "robot.toml is written in a way that cannot be changed line by line: write its tables as [table], and "
            "each value on one line"
        )
    return result


def _in_table(lines: list[str], table: str, values: Mapping[str, Any], who: str) -> list[str]:
    """Return the lines with new values in one table; "" is the part above all tables."""
    start, end = _bounds(lines, table)
    if start is None:
        return [*lines, *([""] if lines and lines[-1] else []), f"[{table}]", *_added(values, who)]
    body, missing = lines[start:end], dict(values)
    active = {found[1] for line in body if (found := re.match(r"\s*([\w-]+)\s*=", line))}
    for i, line in enumerate(body):
        found = re.match(r"\s*(?:#\s*)?([\w-]+)\s*=(.*)$", line)
        if found and found[1] in missing and (not line.lstrip().startswith("#") or found[1] not in active):
            comment = COMMENT.match(found[2])
            body[i] = f"{found[1]} = {as_toml(missing.pop(found[1]))}{(comment and comment[2]) or ''}"
    if table:  # activate a commented-out heading
        lines[start - 1] = re.sub(r"^\s*#\s*", "", lines[start - 1])
    while body and not body[-1].strip():
        body.pop()
        end -= 1
    return [*lines[:start], *body, *_added(missing, who), *lines[end:]]


def _bounds(lines: list[str], table: str) -> tuple[int | None, int]:
    """Return the indices of the first line and the end of a table; (None, number of lines) without the table."""
    heads = [(i, m[2], bool(m[1])) for i, line in enumerate(lines) if (m := HEADING.match(line))]
    if not table:
        return 0, heads[0][0] if heads else len(lines)
    for hidden in (False, True):
        for n, (i, name, commented) in enumerate(heads):
            if name == table and commented == hidden:
                return i + 1, heads[n + 1][0] if n + 1 < len(heads) else len(lines)
    return None, len(lines)


def _added(values: Mapping[str, Any], who: str) -> list[str]:
    return [f"{key} = {as_toml(value)}  # {who}" for key, value in values.items()]
