"""robot.toml files of robots that many people own; the comment beside every figure says where it comes from.

`locfuse init` recognises them by what a log holds (locfuse.cli.inspect.template). A new one is a file here and
a line there.
"""

from __future__ import annotations

import re
import tomllib
from importlib import resources
from typing import Any, NamedTuple

LINE = re.compile(r"(\w+) = .*?\s# (.+)")


class RobotFigure(NamedTuple):
    """One key of such a file."""

    value: Any
    words: str  # its comment: unit and source


def names() -> list[str]:
    """Return the names of the robots."""
    files = resources.files(__package__).iterdir()
    return sorted(f.name.removesuffix(".toml") for f in files if f.name.endswith(".toml"))


def figures(name: str) -> dict[str, RobotFigure]:
    """Return the figures of a robot by "table.key"."""
    text = resources.files(__package__).joinpath(f"{name}.toml").read_text(encoding="utf-8")
    words, table = dict[str, str](), ""
    for line in text.splitlines():
        if line.startswith("["):
            table = line.strip("[]")
        elif (found := LINE.match(line)) is not None:
            words[f"{table}.{found[1]}"] = found[2]
    flat = {f"{t}.{key}": value for t, keys in tomllib.loads(text).items() for key, value in keys.items()}
    return {key: RobotFigure(value, words[key]) for key, value in flat.items()}
