"""Plain words: texts that users read hold none of the riddles of 0.1 (docs, README, help, messages)."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

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


# --- what an error means stands in its values: no message tells a setting, what a hint sets is among the fixes


RAISING = [path for folder in ("cli", "fusion", "formats") for path in sorted((ROOT / folder).rglob("*.py"))]
ERRORS = {"LocfuseError", "UsageError", "NoWheelsError", "UnreadableTopicError"}


def raised(source: str) -> Iterator[ast.Call]:
    """Yield the calls that make one of our errors."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in ERRORS:
            yield node


def text(node: ast.expr | None) -> str:
    """Return a string or f-string as it is written, {} where a value stands."""
    if isinstance(node, ast.JoinedStr):
        return "".join(str(v.value) if isinstance(v, ast.Constant) else "{}" for v in node.values)
    if isinstance(node, ast.BinOp):
        return text(node.left) + text(node.right)
    return str(node.value) if isinstance(node, ast.Constant) else "{}"


def wrong(call: ast.Call) -> str | None:
    """Say what is wrong with an error: a setting that its reader would have to look for in the words."""
    values = {k.arg: k.value for k in call.keywords}
    message, hint = text(call.args[0]) if call.args else "", text(values.get("hint"))
    if "--set " in message.removeprefix("--set "):  # which may be what it is about
        return f"the message tells a setting, which belongs into the hint: {message}"
    if "--set {}" in hint and "fixes" not in values:
        return f"what the hint sets is not among the fixes: {hint}"
    return None


def test_no_setting_has_to_be_read_out_of_an_error() -> None:
    found = {path: [words for call in raised(path.read_text()) if (words := wrong(call))] for path in RAISING}
    assert {path: words for path, words in found.items() if words} == {}


@pytest.mark.parametrize(
    "source",
    [
        'raise LocfuseError(f"2 topics fit. Choose one with --set lrf.topic={topic}")',
        'raise UsageError("2 topics fit.", hint=f"Choose one with --set {fix}")',
    ],
)
def test_an_error_that_hides_its_setting_is_found(source: str) -> None:
    (call,) = raised(source)
    assert wrong(call)
