"""Change one operator or number of the filter's core at a time: do its tests notice? python -m benchmarks.mutants.

Only tests of the thing itself count (TESTS names them by file). Pages whose printed figures change tell that
something changed and not that it is wrong, so they are not run.
A mutant that survives is printed as a change of one line.
"""

from __future__ import annotations

import ast
import compileall
import importlib.util
import os
import random
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from py_compile import PycInvalidationMode
from typing import NamedTuple

import click

ROOT = Path(__file__).parents[1]
# file of the core -> the tests that must know what is right there
TESTS: dict[str, tuple[str, ...]] = {  # the sharpest and fastest first
    "fusion/se2.py": ("tests/fusion/test_se2.py",),
    "fusion/ekf/belief_arrays.py": ("tests/ekf", "tests/atlas/test_anchors.py", "tests/fusion/test_fuse.py"),
    "fusion/ekf/rows.py": ("tests/ekf", "tests/linemap/test_association.py", "tests/fusion/test_fuse.py"),
    "fusion/wheels/motion.py": ("tests/wheels/test_motion.py", "tests/wheels/test_wheel_states.py"),
    "fusion/wheels/repairs.py": ("tests/wheels/test_rollover.py", "tests/wheels/test_wheels.py"),
    "fusion/sensors/compass.py": (
        "tests/sensors/test_compass.py",
        "tests/sensors/test_contract.py",
        "tests/sensors/test_level.py",
    ),
    "fusion/sensors/gyro.py": ("tests/sensors/test_gyro.py", "tests/sensors/test_contract.py"),
    "fusion/sensors/gps.py": ("tests/sensors/test_gps.py", "tests/sensors/test_contract.py"),
    "fusion/sensors/camera.py": ("tests/camera/test_camera.py", "tests/sensors/test_contract.py"),
    "fusion/linemap/line_map.py": (
        "tests/linemap/test_prediction.py",
        "tests/linemap/test_map_keeping.py",
        "tests/linemap/test_association.py",
        "tests/linemap/test_given_map.py",
        "tests/linemap/test_standing.py",
        "tests/sensors/test_lrf.py",
    ),
    "fusion/linemap/association.py": (
        "tests/linemap/test_association.py",
        "tests/linemap/test_standing.py",
        "tests/linemap/test_two_scans.py",
        "tests/sensors/test_lrf.py",
    ),
    "fusion/core/filter.py": ("tests/ekf", "tests/core/test_filter.py", "tests/core/test_stretch.py"),
    "fusion/core/coast.py": ("tests/core/test_stretch.py", "tests/fusion/test_coast.py"),
    "fusion/core/singles.py": ("tests/core/test_singles.py", "tests/fusion/test_coast_singles.py"),
    "fusion/core/echoes.py": ("tests/core/test_singles.py", "tests/sensors/test_sonar.py"),
    "fusion/core/fixes.py": ("tests/core/test_singles.py", "tests/sensors/test_gps.py"),
    "fusion/core/turns.py": ("tests/core/test_singles.py", "tests/sensors/test_gyro.py"),
    "fusion/core/sightings.py": ("tests/core/test_singles.py", "tests/sensors/test_landmarks.py"),
    "fusion/core/rests.py": ("tests/core/test_rests.py", "tests/linemap/test_standing.py"),
    "fusion/core/poses.py": ("tests/core/test_singles.py", "tests/sensors/test_pose.py"),
    "fusion/core/twists.py": ("tests/core/test_singles.py", "tests/sensors/test_pose.py"),
    "fusion/core/nees.py": ("tests/core/test_nees.py", "tests/judge/test_consistency.py"),
    "fusion/core/intervals.py": ("tests/wheels/test_motion.py", "tests/core/test_intervals.py"),
    "fusion/core/pairs.py": ("tests/linemap/test_pairing.py",),
    "fusion/core/match.py": (
        "tests/linemap/test_association.py",
        "tests/linemap/test_prediction.py",
        "tests/sensors/test_lrf.py",
    ),
    "fusion/core/places.py": ("tests/recovery/test_places.py", "tests/core/test_filter.py"),
    "fusion/core/fit.py": ("tests/core/test_fit.py", "tests/lines/test_lines.py"),
    "fusion/core/pieces.py": ("tests/core/test_pieces.py", "tests/lines/test_lines.py"),
    "fusion/judge/evaluate.py": ("tests/judge/test_evaluate.py", "tests/judge/test_way.py"),
    "fusion/judge/way.py": ("tests/judge/test_way.py", "tests/judge/test_evaluate.py"),
    "fusion/judge/bootstrap.py": ("tests/judge/test_credit.py",),
    "fusion/judge/credit.py": ("tests/judge/test_credit.py",),
    "fusion/judge/verdict.py": ("tests/judge/test_credit.py",),
    "fusion/judge/innovations.py": ("tests/judge/test_consistency.py", "tests/judge/test_by_truth.py"),
    "fusion/judge/predictive.py": ("tests/judge/test_predictive.py",),
    "fusion/judge/against.py": ("tests/judge/test_against.py",),
    "fusion/smooth.py": ("tests/fusion/test_smooth.py",),
}
SWAPPED = {ast.Add: "-", ast.Sub: "+", ast.Mult: "/", ast.Div: "*"}
SPELLED = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/"}
NAMES = {"cos": "sin", "sin": "cos", "min": "max", "max": "min", "minimum": "maximum", "maximum": "minimum"}
TOLERANCE = 1e-6  # a number up to this guards against rounding: twice as large, it does so as well
INFINITE = 1e9  # a number from here on stands for one that none reaches: twice as large, it does so as well
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
    for node in ast.walk(ast.parse(source)):
        for start, end, text in _changes(node, source):
            changed = source[:start] + text + source[end:]
            line = source.count("\n", 0, start)
            lines = source.splitlines()[line].strip(), changed.splitlines()[line].strip()
            yield Mutant(file, line + 1, *lines, changed)


def _changes(node: ast.AST, source: str) -> Iterator[tuple[int, int, str]]:
    """Yield (start, end, text) of what may stand in place of a node's own characters."""
    if isinstance(node, ast.BinOp) and type(node.op) in SWAPPED:
        yield from _between(node.left, node.right, SPELLED[type(node.op)], SWAPPED[type(node.op)], source)
    elif isinstance(node, ast.AugAssign) and type(node.op) in SWAPPED:
        sign = SPELLED[type(node.op)] + "="
        yield from _between(node.target, node.value, sign, SWAPPED[type(node.op)] + "=", source)
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
        start = _offset(source, node.lineno, node.col_offset)
        yield start, start + 1, ""
    elif isinstance(node, ast.Constant) and type(node.value) is float and TOLERANCE < node.value < INFINITE:
        start = _offset(source, node.lineno, node.col_offset)
        yield start, _end(node, source), repr(node.value * 2.0)
    elif isinstance(node, ast.Attribute) and node.attr in NAMES and isinstance(node.value, ast.Name):
        end = _end(node, source)
        yield end - len(node.attr), end, NAMES[node.attr]


def _between(left: ast.expr, right: ast.expr, old: str, new: str, source: str) -> Iterator[tuple[int, int, str]]:
    start, end = _end(left, source), _offset(source, right.lineno, right.col_offset)
    at = source.find(old, start, end)
    if at >= 0:
        yield at, at + len(old), new


def _offset(source: str, line: int, column: int) -> int:
    """Return the position of an AST place, whose column counts bytes."""
    lines = source.splitlines(keepends=True)
    return sum(map(len, lines[: line - 1])) + len(lines[line - 1].encode()[:column].decode())


def _end(node: ast.expr, source: str) -> int:
    assert node.end_lineno is not None
    assert node.end_col_offset is not None
    return _offset(source, node.end_lineno, node.end_col_offset)


def laid_out(folder: Path) -> Path:
    """Lay the package out as it is installed, with a fusion/ of its own; return that."""
    package = folder / "locfuse"
    package.mkdir()
    for path in (ROOT / "cli" / "facade").iterdir():
        if path.is_file():
            (package / path.name).symlink_to(path)
    for name in ("cli", "formats", "robots", "sample_logs"):
        (package / name).symlink_to(ROOT / name)
    built = shutil.ignore_patterns("__pycache__", "*.so", "*.pyd")  # a core that was built in the source tree
    shutil.copytree(ROOT / "fusion", package / "fusion", ignore=built)
    core = importlib.util.find_spec("locfuse.fusion.core.compiled")
    if core is not None and core.origin is not None:  # runs until a file of the core is changed
        (package / "fusion" / "core" / Path(core.origin).name).symlink_to(Path(core.origin).resolve())
    # bytecode that knows its source by its content: a changed file is noticed within the same second
    compileall.compile_dir(package / "fusion", quiet=2, invalidation_mode=PycInvalidationMode.CHECKED_HASH)
    return package


def notices(package: Path, mutant: Mutant) -> bool:
    """Return whether a test fails under the mutant."""
    target = package / mutant.file
    before = target.read_bytes()
    target.write_text(mutant.source, encoding="utf-8")
    try:
        return not passes(package, TESTS[mutant.file])
    finally:
        target.write_bytes(before)


def passes(package: Path, tests: tuple[str, ...]) -> bool:
    """Return whether tests pass with this package in front of the installed one."""
    env = {**os.environ, "PYTHONPATH": str(package.parent), "PYTHONDONTWRITEBYTECODE": "1", "NO_COLOR": "1"}
    command = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", "--no-header", *tests]
    try:
        done = subprocess.run(command, cwd=ROOT, env=env, capture_output=True, timeout=PATIENCE, check=False)
    except subprocess.TimeoutExpired:
        return False
    return done.returncode == 0


def chosen(count: int, seed: int, only: str | None) -> list[Mutant]:
    """Draw mutants, the same number from every file as far as it goes."""
    rng = random.Random(seed)
    files = [file for file in TESTS if only is None or only in file]
    each = {file: rng.sample(found := list(mutants(file)), len(found)) for file in files}
    drawn = [found[i] for i in range(count) for found in each.values() if i < len(found)]
    return drawn[:count]


@click.command()
@click.option("--count", default=60, show_default=True)
@click.option("--seed", default=1, show_default=True)
@click.option("--only", help="Part of a file's name.")
@click.option("--least", default=0.95, show_default=True, help="Exit with 1 below this share.")
def main(count: int, seed: int, only: str | None, least: float) -> None:
    """Say which changes of one line no test of the thing itself notices."""
    drawn = chosen(count, seed, only)
    survivors = 0
    with tempfile.TemporaryDirectory() as folder:
        package = laid_out(Path(folder))
        for file in dict.fromkeys(m.file for m in drawn):
            if not passes(package, TESTS[file]):
                raise click.ClickException(f"the tests of {file} fail without any change: {' '.join(TESTS[file])}")
        for mutant in drawn:
            begin = time.monotonic()
            noticed = notices(package, mutant)
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
