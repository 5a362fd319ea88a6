"""Plain words: texts that users read hold none of the riddles of 0.1 (docs, README, help, messages)."""

from __future__ import annotations

import ast
import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
BANNED = re.compile(
    r"\b(as told|for news|bought|sure and wrong|(its|their) metre|in force|carried off|cures?|cured|oddit(y|ies)|"
    r"witness(es)?|court|modest|luck|honest(ly|y)?|buys|untold|against odometry)\b",
    re.IGNORECASE,
)
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]
SOURCES = [p for top in ("cli", "formats", "fusion", "sample_logs") for p in sorted((ROOT / top).rglob("*.py"))]


def strings(source: str) -> list[tuple[int, str]]:
    """Return every text of a module that a user may read: no docstrings, but those of commands, which are help."""
    tree = ast.parse(source)
    hidden = {
        id(node.body[0].value)
        for node in ast.walk(tree)
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef)
        and not any("command" in ast.dump(d) for d in getattr(node, "decorator_list", ()))
        and node.body
        and isinstance(node.body[0], ast.Expr)
    }
    return [
        (node.lineno, node.value)
        for node in ast.walk(tree)
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in hidden
    ]


def test_pages_use_plain_words() -> None:
    lines = [(page.name, line) for page in PAGES for line in page.read_text(encoding="utf-8").splitlines()]
    assert [line for line in lines if BANNED.search(line[1])] == []


def test_messages_and_help_use_plain_words() -> None:
    found = [
        f"{path.relative_to(ROOT)}:{line}: {text}"
        for path in SOURCES
        for line, text in strings(path.read_text(encoding="utf-8"))
        if BANNED.search(text) and not text.isidentifier()  # a key is no text
    ]
    assert found == []
