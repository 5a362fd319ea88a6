"""New values in a robot.toml that people have written: comments, order and everything else stay as they are.

A value that spans lines, or a table that is written in another way than [table], cannot be replaced line by line:
whatever comes out is read again, and must say exactly what the merged tables say.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from locfuse.formats.caps import MAX_ROBOT_TOML
from locfuse.formats.inputs import read_small
from locfuse.fusion.data import LocfuseError

from . import robot_toml
from .commented_toml import value as written

HEADING = re.compile(r"\s*(#\s*)?\[\s*([\w-]+)\s*\]\s*(#.*)?$")
BASIC, LITERAL = r'"(?:[^"\\]|\\.)*"', r"'[^']*'"
COMMENT = re.compile(rf"((?:{BASIC}|{LITERAL}|[^#\"'])*?)(\s*#.*)?$")


def text_of(robot: Path | None) -> str:
    """Return the text of a robot.toml; "" without one."""
    return "" if robot is None else read_small(robot, MAX_ROBOT_TOML).decode("utf-8", "replace")


def updated(text: str, changes: Mapping[str, Any], who: str) -> str:
    """Return the text of a robot.toml with some keys of tables changed, or added at the end of their tables.

    A key that stands behind a # is filled in there. `who` is named where a key is added. Raises LocfuseError
    where the text cannot be changed line by line.
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
    """Return the lines with the values of one table; "" is what stands above all tables."""
    start, end = _bounds(lines, table)
    if start is None:
        return [*lines, *([""] if lines and lines[-1] else []), f"[{table}]", *_added(values, who)]
    body, missing = lines[start:end], dict(values)
    for i, line in enumerate(body):
        found = re.match(r"\s*(?:#\s*)?([\w-]+)\s*=(.*)$", line)
        if found and found[1] in missing and (not line.lstrip().startswith("#") or not _holds(body, found[1])):
            comment = COMMENT.match(found[2])
            body[i] = f"{found[1]} = {written(missing.pop(found[1]))}{(comment and comment[2]) or ''}"
    if table:  # it may have stood behind a #
        lines[start - 1] = re.sub(r"^\s*#\s*", "", lines[start - 1])
    while body and not body[-1].strip():
        body.pop()
        end -= 1
    return [*lines[:start], *body, *_added(missing, who), *lines[end:]]


def _bounds(lines: list[str], table: str) -> tuple[int | None, int]:
    """Return the first line of a table's body and the one after its last; None where there is no such table."""
    heads = [(i, m[2], bool(m[1])) for i, line in enumerate(lines) if (m := HEADING.match(line))]
    if not table:
        return 0, heads[0][0] if heads else len(lines)
    for hidden in (False, True):
        for n, (i, name, behind) in enumerate(heads):
            if name == table and behind == hidden:
                return i + 1, heads[n + 1][0] if n + 1 < len(heads) else len(lines)
    return None, len(lines)


def _holds(body: list[str], key: str) -> bool:
    """Return whether a key has a line that is in effect."""
    return any(re.match(rf"\s*{re.escape(key)}\s*=", line) for line in body)


def _added(values: Mapping[str, Any], who: str) -> list[str]:
    return [f"{key} = {written(value)}  # {who}" for key, value in values.items()]
