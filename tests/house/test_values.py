"""What an error means stands in its values: no message tells a setting, what a hint sets is among the fixes."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SOURCES = [path for folder in ("cli", "fusion", "formats") for path in sorted((ROOT / folder).rglob("*.py"))]
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
    found = {path: [words for call in raised(path.read_text()) if (words := wrong(call))] for path in SOURCES}
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
