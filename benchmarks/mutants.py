"""Mutation test: change one operator, number or guard at a time, and see whether the file's tests fail.

A guard is an `if` with only a raise, return, continue or break. Only direct tests of a file count (TESTS names
them). Tests that compare printed numbers of pages are not run: they show that a number changed, not that it is
wrong. Changed kernels run interpreted, without the tests that compare interpreted and compiled kernels, since
these would fail for every change. Every mutant is printed: its line, and the expression before and after.
"""

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
from pathlib import Path
from py_compile import PycInvalidationMode
from typing import Any, NamedTuple

import click

ROOT = Path(__file__).parents[1]
MCAP = tuple(f"tests/container/test_mcap_{name}.py" for name in ("chunk", "survey", "elsewhere"))
# file -> tests that must fail if it is wrong, the strictest and fastest first
TABLE = """
fusion/se2: fusion/se2
fusion/ekf/belief_arrays: ekf map/small_maps fusion/fuse
fusion/ekf/equations: ekf/ekf fusion/fuse
fusion/ekf/events: whole_drive/smooth tune/tune
fusion/ekf/map_frame: ekf/ekf
fusion/kernels/ekf: ekf fusion/fuse
fusion/kernels/line_fits: kernels/line_fits lines/lines
fusion/kernels/nearest: kernels/nearest
fusion/kernels/places: map/places kernels/line_fits kernels/sight
fusion/kernels/segments: kernels/line_fits lines/lines
fusion/kernels/sight: kernels/sight map/line_map sensors/lrf
fusion/wheels/motion: wheels/motion
fusion/wheels/repairs: wheels/wheels
fusion/sensors/compass: sensors/compass sensors/contract
fusion/sensors/gyro: sensors/gyro sensors/contract
fusion/sensors/gps: sensors/gps sensors/contract
fusion/sensors/landmarks: sensors/landmarks sensors/contract
fusion/sensors/pose: sensors/pose sensors/contract
fusion/sensors/sonar: sensors/lrf sensors/contract
fusion/sensors/twist: sensors/pose sensors/contract
fusion/sensors/camera: camera/camera sensors/contract
fusion/map/line_map: map/line_map map/given_map kernels/sight sensors/lrf fusion/start_at
fusion/map/scan: map/line_map sensors/lrf
fusion/judge/evaluate: judge/evaluate judge/consistency judge/against
fusion/judge/bootstrap fusion/judge/credit: judge/credit
fusion/judge/consistency: judge/noise_verdicts judge/consistency
fusion/judge/innovations: judge/consistency
fusion/judge/without_truth: judge/against
fusion/whole_drive/reference: judge/against
fusion/whole_drive/smooth: whole_drive/smooth
formats/results/mcap_export formats/container/mcap_write: container/mcap_write
formats/messages/cdr: messages/layout messages/cdr
formats/logs/files: messages/message_schema container/sources logs/log
formats/messages/json_messages: messages/json_messages messages/protobuf_messages
formats/messages/protobuf_messages: messages/protobuf_messages
formats/messages/schema: messages/message_schema messages/layout messages/cdr
"""
TESTS: dict[str, tuple[str, ...]] = {
    f"{file}.py": tuple(f"tests/{test.replace('/', '/test_')}{'.py' * ('/' in test)}" for test in tests.split())
    for files, _, tests in (line.partition(":") for line in TABLE.split("\n") if line)
    for file in files.split()
} | {f"formats/container/mcap_{name}.py": MCAP for name in ("records", "source", "survey")}
BOTH_FORMS = "interpreted or compiled or either"  # words in names of tests that compare two forms of a kernel
Swaps = dict[type[ast.AST], type[ast.AST]]
SWAPPED: Swaps = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.FloorDiv: ast.Mult,
    ast.Mod: ast.Mult, ast.BitAnd: ast.BitOr, ast.BitOr: ast.BitAnd, ast.LShift: ast.RShift,
    ast.RShift: ast.LShift, ast.And: ast.Or, ast.Or: ast.And, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.In: ast.NotIn, ast.NotIn: ast.In, ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.USub: ast.UAdd,
}  # fmt: skip
# changed comparisons: of floats, which are never exactly at the limit; of integers, as in readers
OPPOSITE = {ast.Lt: ast.GtE, ast.LtE: ast.Gt, ast.Gt: ast.LtE, ast.GtE: ast.Lt}
BOUND = {ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt}
SIZES = re.compile(r"MAX_|\w+_(BYTES|AT_ONCE)\b")  # whole numbers with such names cap or divide work
LEAVES = ast.Raise | ast.Return | ast.Continue | ast.Break  # a guard is an `if` of one such statement
NAMES = {"cos": "sin", "sin": "cos", "min": "max", "max": "min", "minimum": "maximum", "maximum": "minimum"}
TOLERANCE = 1e-6  # smaller numbers are tolerances for rounding: doubling one does not matter
INFINITE = 1e9  # larger numbers stand for infinity: doubling one does not matter
MANY = 64  # larger integers are rough counts: one more does not matter
PATIENCE = 1800  # s, longest time for the tests of one mutant


class Mutant(NamedTuple):
    """One change of one line: a new value for a field of a syntax node."""

    file: str
    tree: ast.Module
    node: ast.expr | ast.stmt
    field: str
    new: Any

    def sources(self) -> tuple[str, str, str]:
        """Return the changed file, and the node before and after, as Python code."""
        old, before = getattr(self.node, self.field), _words(self.node)
        setattr(self.node, self.field, self.new)
        found = ast.unparse(self.tree), before, _words(self.node)
        setattr(self.node, self.field, old)
        return found


def _words(node: ast.AST) -> str:
    return ast.unparse(node).partition("\n")[0]


def mutants(file: str) -> Iterator[Mutant]:
    tree = ast.parse((ROOT / file).read_text(encoding="utf-8"))
    swapped = SWAPPED | (BOUND if file.startswith("formats/") else OPPOSITE)
    for node in _looked_at(tree):
        if isinstance(node, ast.expr | ast.stmt):
            yield from (Mutant(file, tree, node, field, new) for field, new in _changes(node, swapped))


def _looked_at(node: ast.AST) -> Iterator[ast.AST]:
    is_size = isinstance(node, ast.Assign) and SIZES.match(text := ast.unparse(node)) and "." not in text
    if not is_size and not isinstance(node, ast.JoinedStr | ast.Raise):
        yield node
        for name, value in ast.iter_fields(node):
            for part in value if isinstance(value, list) else [value]:
                if isinstance(part, ast.AST) and name not in {"annotation", "returns"}:
                    yield from _looked_at(part)


def _changes(node: ast.AST, swapped: Swaps) -> Iterator[tuple[str, Any]]:
    """Yield (field, new value) for a node."""
    match node:
        case ast.BinOp(op=operator) | ast.AugAssign(op=operator) | ast.BoolOp(operator) | ast.UnaryOp(operator):
            if type(operator) in swapped:
                yield "op", swapped[type(operator)]()
            elif isinstance(node, ast.UnaryOp) and isinstance(operator, ast.Not):
                yield "operand", ast.UnaryOp(operator, node.operand)
        case ast.Compare():
            yield from _comparisons(node, swapped)
        case ast.If(_, [statement], []) if isinstance(statement, LEAVES):
            yield "test", ast.Constant(value=False)
        case ast.Constant(float(value)) if TOLERANCE < value < INFINITE:
            yield "value", value * 2.0
        case ast.Constant(int(value)) if type(value) is int and value < MANY:
            yield "value", value + 1
        case ast.Attribute(ast.Name(), name) if name in NAMES:
            yield "attr", NAMES[name]


def _comparisons(node: ast.Compare, swapped: Swaps) -> Iterator[tuple[str, Any]]:
    for i, (operator, right) in enumerate(zip(node.ops, node.comparators, strict=True)):
        other = swapped[type(operator)]
        if BOUND.get(type(operator)) is not other or not SIZES.match(ast.unparse(right)):
            yield "ops", [*node.ops[:i], other(), *node.ops[i + 1 :]]


def laid_out(folder: Path, interpreted: bool) -> Path:
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
        # bytecode that is checked by the content of its source, so that a change within the same second is noticed
        compileall.compile_dir(package / name, quiet=2, invalidation_mode=PycInvalidationMode.CHECKED_HASH)
    return package


def passes(package: Path, tests: tuple[str, ...]) -> bool:
    first = {"PYTHONPATH": str(package.parent), "PYTHONDONTWRITEBYTECODE": "1", "NO_COLOR": "1"}
    env = {**os.environ, **first}
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
    drawn = [found[i] for i in range(count) for found in each if i < len(found)][:count]  # equally many per file
    survivors = 0
    with tempfile.TemporaryDirectory() as folder:
        package = laid_out(Path(folder), any("kernels" in m.file for m in drawn))
        for tests in dict.fromkeys(TESTS[m.file] for m in drawn):
            if not passes(package, tests):
                raise click.ClickException(f"tests fail without any change: {' '.join(tests)}")
        for mutant in drawn:
            begin, target = time.monotonic(), package / mutant.file
            original, (changed, before, after) = target.read_bytes(), mutant.sources()
            target.write_text(changed, encoding="utf-8")
            noticed = not passes(package, TESTS[mutant.file])
            target.write_bytes(original)
            survivors += not noticed
            word, seconds = "killed" if noticed else "SURVIVED", time.monotonic() - begin
            click.echo(f"{word:8} {seconds:4.0f} s  {mutant.file}:{mutant.node.lineno}: {before} -> {after}")
    share = 1.0 - survivors / max(len(drawn), 1)
    click.echo(f"{len(drawn) - survivors} of {len(drawn)} killed ({share:.0%})")
    raise SystemExit(share < least)


if __name__ == "__main__":
    main()
