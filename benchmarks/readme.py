"""Commands and Python code of README.md and docs: run, and updated with today's output.

    python -m benchmarks.readme           exit 1 where a page differs from what its commands print today
    python -m benchmarks.readme --write   put today's output into the pages

A ```console block has lines `$ locfuse ...`, each followed by its stdout, unless that is sent to /dev/null. On a
Python page, all ```python blocks are run in page order, in one namespace; a ```text block after one has its
output.
"""

import contextlib
import difflib
import io
import os
import re
import shlex
import sys
import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path
from unittest.mock import patch

from benchmarks.experiment import locfuse

ROOT = Path(__file__).parent.parent
PAGES = ("README.md", "docs/bags.md", "docs/export.md", "docs/paper.md", "docs/trust.md")
PYTHON_PAGES = ("docs/python.md",)
PYTHON = re.compile(r"```python\n(.*?)```\n(?:```text\n.*?```\n)?", re.DOTALL)
BLOCK = re.compile(r"```console\n(.*?)```", re.DOTALL)
WIDTH = "100"
NOTHING = " > /dev/null"


def commands(block: str) -> list[str]:
    return [line[2:] for line in block.splitlines() if line.startswith("$ ")]


def output(command: str, folder: Path) -> str:
    """Run one command in `folder` as a user would and return its stdout, without blank lines."""
    words = shlex.split(command.removesuffix(NOTHING))
    if words[0] != "locfuse":
        raise ValueError(f"only locfuse commands are run: {command}")
    terminal = {"COLUMNS": WIDTH, "NO_COLOR": "1", "TERM": "dumb"}  # plain, of the pages' width
    with contextlib.chdir(folder), patch.dict(os.environ, terminal):
        said = locfuse(*words[1:])
    if said.exit_code != 0:
        raise RuntimeError(f"{command}: exit {said.exit_code}\n{said.stderr}")
    if command.endswith(NOTHING):
        return ""
    return "\n".join(line.rstrip() for line in said.stdout.splitlines() if line.strip())


def replayed(page: str, folder: Path) -> str:
    """Return the page with today's output in every block; commands share one folder, in page order."""

    def replay(match: re.Match[str]) -> str:
        parts = [f"$ {c}\n{output(c, folder)}".rstrip() for c in commands(match.group(1))]
        return "```console\n" + "\n".join(parts) + "\n```"

    return BLOCK.sub(replay, page)


def replayed_python(page: str, folder: Path) -> str:
    namespace: dict[str, object] = {}

    def replay(match: re.Match[str]) -> str:
        printed = io.StringIO()
        with contextlib.redirect_stdout(printed), contextlib.chdir(folder):
            exec(compile(match[1], "page", "exec"), namespace)
        text = printed.getvalue()
        return f"```python\n{match[1]}```\n" + (f"```text\n{text}```\n" if text else "")

    return PYTHON.sub(replay, page)


def today() -> Iterator[tuple[Path, str]]:
    for name in (*PAGES, *PYTHON_PAGES):
        with tempfile.TemporaryDirectory() as folder:
            page, replay = (ROOT / name).read_text(), replayed_python if name in PYTHON_PAGES else replayed
            yield ROOT / name, replay(page, Path(folder))


def kept(pages: Iterable[tuple[Path, str]], write: bool) -> None:
    """Write the pages if `write`; else print differences to the files, and exit with 1 if there are any."""
    differ = False
    for path, now in pages:
        before = path.read_text(encoding="utf-8") if path.exists() else ""
        if write:
            path.write_text(now, encoding="utf-8")
        elif now != before:
            differ, lines = True, (before.splitlines(True), now.splitlines(True))
            sys.stdout.writelines(difflib.unified_diff(*lines, path.name, "today"))
    sys.exit(differ)


if __name__ == "__main__":
    kept(today(), "--write" in sys.argv)
