"""The commands and the Python that README.md and the docs show are run, and print what the page says.

    python -m benchmarks.readme           exit 1 where a page differs from what its commands print today
    python -m benchmarks.readme --write   put today's output into the pages

A block is a fence of ```console with lines `$ locfuse ...`, each followed by its stdout, if it is not sent to
/dev/null. On a Python page every fence of ```python is run in page order, in one namespace, and a fence of ```text
below it holds what it prints.
"""

from __future__ import annotations

import contextlib
import difflib
import io
import os
import re
import shlex
import signal
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from locfuse.cli.main import main as main_of_locfuse

ROOT = Path(__file__).parent.parent
PAGES = ("README.md", "docs/bags.md", "docs/export.md", "docs/paper.md", "docs/trust.md")
PYTHON_PAGES = ("docs/python.md",)
PYTHON = re.compile(r"```python\n(.*?)```\n(?:```text\n.*?```\n)?", re.DOTALL)
BLOCK = re.compile(r"```console\n(.*?)```", re.DOTALL)
WIDTH = "100"
NOTHING = " > /dev/null"


def commands(block: str) -> list[str]:
    """Return the commands of one block."""
    return [line[2:] for line in block.splitlines() if line.startswith("$ ")]


def output(command: str, folder: Path) -> str:
    """Run one command in `folder` as a user would and return its stdout, without blank lines."""
    words = shlex.split(command.removesuffix(NOTHING))
    if words[0] != "locfuse":
        raise ValueError(f"only locfuse commands are run: {command}")
    printed, said = io.StringIO(), io.StringIO()
    with contextlib.chdir(folder), typed(), contextlib.redirect_stdout(printed), contextlib.redirect_stderr(said):
        code = exit_code(words[1:])
    if code != 0:
        raise RuntimeError(f"{command}: exit {code}\n{said.getvalue()}")
    if command.endswith(NOTHING):
        return ""
    return "\n".join(line.rstrip() for line in printed.getvalue().splitlines() if line.strip())


@contextlib.contextmanager
def typed() -> Iterator[None]:
    """Let this process look like a plain terminal of the pages' width, and leave it as it was."""
    before, handler = dict(os.environ), signal.getsignal(signal.SIGTERM)
    os.environ |= {"COLUMNS": WIDTH, "NO_COLOR": "1", "TERM": "dumb"}
    try:
        yield
    finally:
        os.environ.clear()
        os.environ |= before
        signal.signal(signal.SIGTERM, handler)


def exit_code(words: list[str]) -> int:
    """Run the command line in this process, which has imported what it needs, and return its exit code."""
    try:
        main_of_locfuse(words)
    except SystemExit as e:
        return int(e.code or 0)
    return 0


def replayed(page: str, folder: Path) -> str:
    """Return the page with today's output in every block; commands share one folder, in page order."""

    def replay(match: re.Match[str]) -> str:
        parts = [f"$ {c}\n{output(c, folder)}".rstrip() for c in commands(match.group(1))]
        return "```console\n" + "\n".join(parts) + "\n```"

    return BLOCK.sub(replay, page)


def replayed_python(page: str, folder: Path) -> str:
    """Return the page with what its Python prints today, run in `folder`."""
    namespace: dict[str, object] = {}

    def replay(match: re.Match[str]) -> str:
        printed = io.StringIO()
        with contextlib.redirect_stdout(printed), contextlib.chdir(folder):
            exec(compile(match[1], "page", "exec"), namespace)
        text = printed.getvalue()
        return f"```python\n{match[1]}```\n" + (f"```text\n{text}```\n" if text else "")

    return PYTHON.sub(replay, page)


def main(write: bool) -> int:
    """Check or rewrite all pages."""
    wrong = 0
    for name in (*PAGES, *PYTHON_PAGES):
        path = ROOT / name
        page = path.read_text(encoding="utf-8")
        with tempfile.TemporaryDirectory() as folder:
            now = (replayed_python if name in PYTHON_PAGES else replayed)(page, Path(folder))
        if write:
            path.write_text(now, encoding="utf-8")
        elif now != page:
            wrong += 1
            sys.stdout.writelines(difflib.unified_diff(page.splitlines(True), now.splitlines(True), name, "today"))
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main("--write" in sys.argv))
