"""The caps of the house: arguments of a function, fields of a record, what changes in a class, lines of a file.

What was over a cap when the caps were set stands below with its number. The lists may only get shorter and their
numbers smaller: who mends one takes it off, and nothing new comes in.
"""

from __future__ import annotations

import ast
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
FOLDERS = ("fusion", "formats", "sample_logs", "robots", "cli")
MAX_ARGUMENTS = 8  # of a function, without self; a command's are its options: cli/commands has no cap
MAX_RECORD_FIELDS = 12  # of a dataclass, NamedTuple or Struct, without those that it inherits
MAX_CHANGING_FIELDS = 10  # of a class: what methods other than __init__ assign, or assign into
MAX_FILE_LINES = 600

# --- what is over a cap today
ARGUMENTS: dict[str, int] = {}
RECORD_FIELDS: dict[str, int] = {
    "formats/figures/panels.py:Panel": 16,
    "formats/report/structure.py:Result": 30,
    "formats/rerun/scene.py:RerunScene": 15,
    "fusion/data.py:Drive": 14,
    "fusion/data.py:Estimates": 20,
    "fusion/data.py:Evaluation": 17,
    "fusion/judge/innovations.py:Own": 13,
    "fusion/lines/extract.py:LineSettings": 19,
    "fusion/map/line_map.py:LineMap": 15,
    "fusion/robot.py:WheelSettings": 24,
}
CHANGING_FIELDS: dict[str, int] = {
    "fusion/ekf/belief_arrays.py:JointBelief": 15,
    "fusion/kernels/ekf.py:State": 20,
    "fusion/kernels/sight.py:Sight": 22,
    "fusion/map/guard.py:Guard": 14,
    "fusion/map/line_map.py:LineMap": 15,
    "fusion/map/tracker.py:AtlasTracker": 12,
    "fusion/map/tracker.py:LineTracker": 13,
    "fusion/whole_drive/smooth.py:Backward": 13,
}
FILE_LINES: dict[str, int] = {
    "fusion/ekf/belief_arrays.py": 650,
    "fusion/kernels/ekf.py": 635,
}
# ---

Function = ast.FunctionDef | ast.AsyncFunctionDef
Named = Function | ast.ClassDef
RECORDS = {"NamedTuple", "Struct"}
BIRTH = {"__init__", "__post_init__", "__new__", "__cinit__"}
FILES = {
    path.relative_to(ROOT).as_posix(): path.read_text(encoding="utf-8")
    for folder in FOLDERS
    for path in sorted((ROOT / folder).rglob("*.py"))
}


@cache
def definitions(text: str) -> list[tuple[str, ast.AST]]:
    """Return (dotted name, definition) of every function and class, however deep it lies."""
    found: list[tuple[str, ast.AST]] = []
    waiting: list[tuple[str, ast.AST]] = [("", ast.parse(text))]
    while waiting:
        name, node = waiting.pop()
        for child in ast.iter_child_nodes(node):
            below = f"{name}.{child.name}".removeprefix(".") if isinstance(child, Named) else name
            if isinstance(child, Named):
                found.append((below, child))
            waiting.append((below, child))
    return found


def defined(text: str, kind: Any) -> list[tuple[str, ast.AST]]:
    return [(name, node) for name, node in definitions(text) if isinstance(node, kind)]


def arguments(function: ast.AST) -> int:
    assert isinstance(function, Function)
    a = function.args
    names = [x.arg for x in (*a.posonlyargs, *a.args, *a.kwonlyargs)]
    return len(names) - (names[:1] in (["self"], ["cls"]))


def last_name(node: ast.AST) -> str:
    """Return "dataclass" of dataclass, dataclasses.dataclass and dataclass(frozen=True)."""
    while isinstance(node, ast.Call | ast.Subscript):
        node = node.func if isinstance(node, ast.Call) else node.value
    return node.attr if isinstance(node, ast.Attribute) else getattr(node, "id", "")


def record_fields(cls: ast.AST) -> int:
    """Count the fields of a record; 0 of another class."""
    assert isinstance(cls, ast.ClassDef)
    made = any(last_name(d) == "dataclass" for d in cls.decorator_list)
    if not made and not RECORDS & {last_name(base) for base in cls.bases}:
        return 0
    fields = [n for n in cls.body if isinstance(n, ast.AnnAssign)]
    return len([n for n in fields if last_name(n.annotation) != "ClassVar"])


def changing_fields(cls: ast.AST) -> int:
    """Count the fields of self that methods other than __init__ assign, or assign into."""
    assert isinstance(cls, ast.ClassDef)
    found = set()
    for method in cls.body:
        if not isinstance(method, Function) or method.name in BIRTH:
            continue
        for node in ast.walk(method):
            if not isinstance(node, ast.Attribute | ast.Subscript) or isinstance(node.ctx, ast.Load):
                continue
            inner: ast.AST = node
            while isinstance(inner, ast.Subscript):
                inner = inner.value
            if isinstance(inner, ast.Attribute) and last_name(inner.value) == "self":
                found.add(inner.attr)
    return len(found)


def over(cap: int, counted: Mapping[str, int]) -> dict[str, int]:
    return {name: count for name, count in counted.items() if count > cap}


def functions(files: Mapping[str, str]) -> dict[str, int]:
    here = {f: text for f, text in files.items() if not f.startswith("cli/commands/")}
    return {f"{f}:{name}": arguments(x) for f, text in here.items() for name, x in defined(text, Function)}


def records(files: Mapping[str, str]) -> dict[str, int]:
    return {
        f"{f}:{name}": record_fields(x) for f, text in files.items() for name, x in defined(text, ast.ClassDef)
    }


def classes(files: Mapping[str, str]) -> dict[str, int]:
    return {
        f"{f}:{name}": changing_fields(x) for f, text in files.items() for name, x in defined(text, ast.ClassDef)
    }


def lengths(files: Mapping[str, str]) -> dict[str, int]:
    return {f: len(text.splitlines()) for f, text in files.items()}


CAPS = {
    "arguments": (MAX_ARGUMENTS, functions, ARGUMENTS),
    "record fields": (MAX_RECORD_FIELDS, records, RECORD_FIELDS),
    "changing fields": (MAX_CHANGING_FIELDS, classes, CHANGING_FIELDS),
    "lines": (MAX_FILE_LINES, lengths, FILE_LINES),
}


@pytest.mark.parametrize("what", CAPS)
def test_nothing_is_over_its_cap_but_what_was_so_when_the_caps_were_set(what: str) -> None:
    cap, count, known = CAPS[what]
    today = over(cap, count(FILES))
    more = {name: n for name, n in today.items() if n > known.get(name, 0)}
    assert not more, f"more than {cap} {what}, or more than before: {more}"
    less = {name: today.get(name, 0) for name, n in known.items() if today.get(name, 0) < n}
    assert not less, f"mended: write the smaller number, or take it off the list where it is 0: {less}"


def test_the_caps_see_what_is_over_them() -> None:
    many = "\n".join(f"    x{i}: int = 0" for i in range(13))
    words = ", ".join(f"x{i}" for i in range(9))
    sets = "\n".join(f"        self.x{i} = self.y[{i}] = 0" for i in range(10))
    files = {
        "fusion/a.py": f"def far(*, {words}): ...\nclass A(NamedTuple):\n{many}\n",
        "fusion/c.py": f"@dataclass(frozen=True)\nclass B:\n{many}\n",
        "fusion/b.py": f"class C:\n    def go(self, {words}):\n{sets}\n    def __init__(self):\n{sets}\n",
        "cli/commands/a.py": f"def far({words}): ...\n",
        "fusion/long.py": "\n" * 601,
    }
    assert over(8, functions(files)) == {"fusion/a.py:far": 9, "fusion/b.py:C.go": 9}
    assert over(12, records(files)) == {"fusion/a.py:A": 13, "fusion/c.py:B": 13}
    assert over(10, classes(files)) == {"fusion/b.py:C": 11}
    assert over(600, lengths(files)) == {"fusion/long.py": 601}
