"""Change one operator, number or guard at a time: do the tests of its file notice? python -m benchmarks.mutants.

Only tests of the thing itself count (TESTS names them by file). Pages whose printed figures change tell that
something changed and not that it is wrong, so they are not run. Kernels that are changed run interpreted, and
tests that hold the interpreted form to the compiled one are left out: they would notice every change.
A mutant that survives is printed as a change of one line.
"""

from __future__ import annotations

import ast
import compileall
import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from py_compile import PycInvalidationMode
from typing import NamedTuple

import click

ROOT = Path(__file__).parents[1]
MCAP = tuple(f"tests/container/test_mcap_{name}.py" for name in ("chunk", "survey", "elsewhere", "walk"))
# files: the tests that must know what is right there, the sharpest and fastest first
TABLE = """
fusion/se2: fusion/se2
fusion/ekf/belief_arrays: ekf map/small_maps fusion/fuse
fusion/ekf/equations: ekf/ekf fusion/fuse
fusion/ekf/events: whole_drive/smooth tune/tune
fusion/ekf/map_frame: ekf/map_frame
fusion/kernels/angles: kernels/line_fits kernels/sight
fusion/kernels/ekf: ekf fusion/fuse
fusion/kernels/line_fits: kernels/line_fits lines/lines
fusion/kernels/places: map/places
fusion/kernels/segments: kernels/segments lines/lines
fusion/kernels/sight: kernels/sight map/line_map sensors/lrf
fusion/wheels/motion: wheels/motion wheels/wheel_states
fusion/wheels/repairs: wheels/wheels
fusion/sensors/compass: sensors/compass sensors/contract
fusion/sensors/gyro: sensors/gyro sensors/contract
fusion/sensors/gps: sensors/gps sensors/contract
fusion/sensors/landmarks: sensors/landmarks sensors/contract
fusion/sensors/pose: sensors/pose sensors/contract
fusion/sensors/sonar: sensors/lrf sensors/contract
fusion/sensors/twist: sensors/pose sensors/contract
fusion/sensors/camera: camera/camera sensors/contract
fusion/map/line_map: map/line_map map/given_map kernels/sight sensors/lrf fusion/mount
fusion/map/scan: map/standing map/line_map sensors/lrf
fusion/map/sonar_echo: sensors/lrf
fusion/judge/evaluate: judge/evaluate judge/consistency
fusion/judge/bootstrap fusion/judge/credit: judge/credit
fusion/judge/consistency: judge/noise_verdicts judge/consistency
fusion/judge/events: judge/against
fusion/judge/innovations: judge/consistency
fusion/judge/predictive: judge/against
fusion/judge/against: judge/against
fusion/whole_drive/smooth: whole_drive/smooth
formats/results/mcap_export formats/container/mcap_write: container/mcap_write
formats/messages/cdr: messages/layout messages/cdr
formats/messages/decode: messages/message_schema
formats/messages/fields: messages/message_schema messages/cdr messages/kinds
formats/messages/json_messages: messages/json_messages messages/protobuf_messages
formats/messages/protobuf_messages: messages/protobuf_messages
formats/messages/schema: messages/message_schema messages/layout
"""
TESTS: dict[str, tuple[str, ...]] = {
    f"{file}.py": tuple(f"tests/{test.replace('/', '/test_')}{'.py' * ('/' in test)}" for test in tests.split())
    for files, _, tests in (line.partition(":") for line in TABLE.split("\n") if line)
    for file in files.split()
} | {f"formats/container/mcap_{name}.py": MCAP for name in ("chunk", "records", "source", "survey")}
BOTH_FORMS = "interpreted or compiled or either"  # words in names of tests that compare two forms of a kernel
SPELLED: dict[type[ast.AST], str] = {
    ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.FloorDiv: "//", ast.Mod: "%", ast.And: "and",
    ast.BitAnd: "&", ast.BitOr: "|", ast.LShift: "<<", ast.RShift: ">>", ast.Or: "or", ast.Is: "is",
    ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=", ast.Eq: "==", ast.NotEq: "!=", ast.IsNot: "is not",
    ast.In: "in", ast.NotIn: "not in",
}  # fmt: skip
SWAPPED = {
    "+": "-", "-": "+", "*": "/", "/": "*", "//": "*", "%": "*", "&": "|", "|": "&", "<<": ">>", ">>": "<<",
    "and": "or", "or": "and", "==": "!=", "!=": "==", "in": "not in", "not in": "in",
    "is": "is not", "is not": "is",
}  # fmt: skip
OPPOSITE = {"<": ">=", "<=": ">", ">": "<=", ">=": "<"}  # of floats: the bound itself never occurs
BOUND = {"<": "<=", "<=": "<", ">": ">=", ">=": ">"}  # of whole numbers, which readers compare
SIZES = re.compile(r"MAX_|\w+_(BYTES|AT_ONCE)\b")  # whole numbers with such names cap or divide work
LEAVES = ast.Raise | ast.Return | ast.Continue | ast.Break  # a guard is an `if` of one such statement
NAMES = {"cos": "sin", "sin": "cos", "min": "max", "max": "min", "minimum": "maximum", "maximum": "minimum"}
TOLERANCE = 1e-6  # a number up to this guards against rounding: twice as large, it does so as well
INFINITE = 1e9  # a number from here on stands for one that none reaches: twice as large, it does so as well
MANY = 64  # a whole number from here on says how many are enough: one more, it does so as well
PATIENCE = 1800  # s for the tests of one mutant: one that hangs is noticed


class Mutant(NamedTuple):
    """One change of one line."""

    file: str
    line: int
    before: str
    after: str
    source: str  # the whole changed file


def mutants(file: str) -> Iterator[Mutant]:
    """Yield every change that the rules know of one file."""
    source = (ROOT / file).read_text(encoding="utf-8")
    bounds = BOUND if file.startswith("formats/") else OPPOSITE
    for node in _looked_at(ast.parse(source)):
        for start, end, text in _changes(node, source, bounds):
            changed = source[:start] + text + source[end:]
            line = source.count("\n", 0, start)
            lines = source.splitlines()[line].strip(), changed.splitlines()[line].strip()
            yield Mutant(file, line + 1, *lines, changed)


def _looked_at(node: ast.AST) -> Iterator[ast.AST]:
    """Yield a node and what is in it, but for messages, sizes and annotations."""
    is_size = isinstance(node, ast.Assign) and SIZES.match(text := ast.unparse(node)) and "." not in text
    if not is_size and not isinstance(node, ast.JoinedStr | ast.Raise):
        yield node
        for name, value in ast.iter_fields(node):
            for part in value if isinstance(value, list) else [value]:
                if isinstance(part, ast.AST) and name not in {"annotation", "returns"}:
                    yield from _looked_at(part)


def _changes(node: ast.AST, source: str, bounds: dict[str, str]) -> Iterator[tuple[int, int, str]]:
    """Yield (start, end, text) of what may stand in place of a node's own characters."""
    for left, operator, right in _operations(node):
        old, before, behind = SPELLED.get(type(operator), ""), _end(left, source), _start(right, source)
        at = source.find(old, before, behind)
        if old and at >= 0 and not (old in BOUND and bounds is BOUND and SIZES.match(ast.unparse(right))):
            yield at, at + len(old), (SWAPPED | bounds)[old]
    match node:
        case ast.If(test, [statement], []) if isinstance(statement, LEAVES):
            yield _start(test, source), _end(test, source), "False"
        case ast.UnaryOp(ast.USub() | ast.Not() as operator):
            start = _start(node, source)
            yield start, start + (1 if isinstance(operator, ast.USub) else len("not ")), ""
        case ast.Constant(float(value)) if TOLERANCE < value < INFINITE:
            yield _start(node, source), _end(node, source), repr(value * 2.0)
        case ast.Constant(int(value)) if type(value) is int and value < MANY:
            yield _start(node, source), _end(node, source), repr(value + 1)
        case ast.Attribute(ast.Name(), name) if name in NAMES:
            yield _end(node, source) - len(name), _end(node, source), NAMES[name]


def _operations(node: ast.AST) -> Iterator[tuple[ast.expr, ast.AST, ast.expr]]:
    """Yield (left, operator, right) of each operator that a node has."""
    match node:
        case ast.BinOp(left, operator, right) | ast.AugAssign(left, operator, right):
            yield left, operator, right
        case ast.BoolOp(operator, values):
            yield from ((left, operator, right) for left, right in pairwise(values))
        case ast.Compare(first, operators, others):
            yield from zip([first, *others], operators, others, strict=False)


def _place(source: str, line: int, column: int) -> int:
    """Return the position of an AST place, whose column counts bytes."""
    lines = source.splitlines(keepends=True)
    return sum(map(len, lines[: line - 1])) + len(lines[line - 1].encode()[:column].decode())


def _start(node: ast.expr, source: str) -> int:
    return _place(source, node.lineno, node.col_offset)


def _end(node: ast.expr, source: str) -> int:
    return _place(source, node.end_lineno or 0, node.end_col_offset or 0)


def laid_out(folder: Path, interpreted: bool = True) -> Path:
    """Lay the package out as it is installed, with its own fusion/ and formats/."""
    package = folder / "locfuse"
    package.mkdir()
    for path in (ROOT / "cli" / "facade").iterdir():
        if path.is_file():
            (package / path.name).symlink_to(path)
    for name in ("cli", "robots", "sample_logs"):
        (package / name).symlink_to(ROOT / name)
    left_out = shutil.ignore_patterns("__pycache__", *(("*.so", "*.pyd") if interpreted else ()))
    for name in ("fusion", "formats"):
        shutil.copytree(ROOT / name, package / name, ignore=left_out)
        # bytecode that knows its source by its content: a changed file is noticed within the same second
        compileall.compile_dir(package / name, quiet=2, invalidation_mode=PycInvalidationMode.CHECKED_HASH)
    return package


def first_on_path(package: Path) -> dict[str, str]:
    """Return the environment of a process that imports this package, and not the installed one."""
    return {**os.environ, "PYTHONPATH": str(package.parent)}


def passes(package: Path, tests: tuple[str, ...]) -> bool:
    """Return whether tests pass with this package in front of the installed one."""
    env = {**first_on_path(package), "PYTHONDONTWRITEBYTECODE": "1", "NO_COLOR": "1"}
    command = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", "--no-header"]
    command += ["-k", f"not ({BOTH_FORMS})", *tests]
    try:
        done = subprocess.run(command, cwd=ROOT, env=env, capture_output=True, timeout=PATIENCE, check=False)
    except subprocess.TimeoutExpired:
        return False
    return done.returncode == 0


@click.command()
@click.option("--count", default=60, show_default=True)
@click.option("--seed", default=1, show_default=True)
@click.option("--only", help="Part of a file's name.")
@click.option("--least", default=0.95, show_default=True, help="Exit with 1 below this share.")
def main(count: int, seed: int, only: str | None, least: float) -> None:
    """Say which changes of one line no test of the thing itself notices."""
    rng = random.Random(seed)
    every = [list(mutants(file)) for file in TESTS if only is None or only in file]
    each = [rng.sample(found, len(found)) for found in every]
    drawn = [found[i] for i in range(count) for found in each if i < len(found)][:count]  # as many of each file
    survivors = 0
    with tempfile.TemporaryDirectory() as folder:
        package = laid_out(Path(folder), any("kernels" in m.file for m in drawn))
        for tests in dict.fromkeys(TESTS[m.file] for m in drawn):
            if not passes(package, tests):
                raise click.ClickException(f"tests fail without any change: {' '.join(tests)}")
        for mutant in drawn:
            begin = time.monotonic()
            target = package / mutant.file
            before = target.read_bytes()
            target.write_text(mutant.source, encoding="utf-8")
            noticed = not passes(package, TESTS[mutant.file])
            target.write_bytes(before)
            survivors += not noticed
            word = "killed" if noticed else "SURVIVED"
            click.echo(f"{word:8} {time.monotonic() - begin:4.0f} s  {mutant.file}:{mutant.line}: {mutant.after}")
            if not noticed:
                click.echo(f"{'':16}was: {mutant.before}")
    share = 1.0 - survivors / max(len(drawn), 1)
    click.echo(f"{len(drawn) - survivors} of {len(drawn)} killed ({share:.0%})")
    raise SystemExit(share < least)


if __name__ == "__main__":
    main()
