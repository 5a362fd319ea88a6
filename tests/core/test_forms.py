"""The core's two forms are one: compiled and interpreted agree to the last bit, and no input makes either fail."""

from __future__ import annotations

import ast
import math
import os
import re
import shutil
import subprocess
import sys
from functools import partial
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace
from rooms import ARENA, poses, scan

from locfuse.fusion.core import form as forms
from locfuse.fusion.core import lines as interpreted
from locfuse.fusion.core.room import Room
from locfuse.fusion.data import Array
from locfuse.fusion.lines.extract import Lines, LineSettings, Scans, lines_of
from locfuse.fusion.lines.sweep import motion_of

CORE = Path(__file__).parents[2] / "fusion" / "core"
UNIT = forms.form().functions
MOUNT = motion_of(np.array([0.2, -0.1, 0.4]))
NUMBERS = st.one_of(
    st.floats(0.05, 30.0),
    st.sampled_from([math.nan, math.inf, -math.inf, 0.0, -1.0, 1e-300, 1e5, 1e30, 2.0, 2.0, 2.0]),
)


def agree(scans: Scans, how: LineSettings | None = None, moving: bool = False) -> Lines:
    """Return the lines, after both forms gave the same bytes."""
    asked = how or LineSettings(), MOUNT if moving else None
    found = lines_of(scans, *asked, Room.of(interpreted, None))
    if UNIT is not None:
        other = lines_of(scans, *asked, Room.of(interpreted, UNIT))
        for name in Lines.__struct_fields__:
            a, b = getattr(found, name), getattr(other, name)
            assert (a.dtype, a.shape, a.tobytes()) == (b.dtype, b.shape, b.tobytes()), name
    return found


def seen(angles: Array, n: int, seed: int = 0) -> Array:
    """Noisy scans of a room with plates in it (n, b), some beams lost."""
    rng = np.random.default_rng(seed)
    real = angles + rng.normal(0.0, math.radians(0.25), (n, len(angles)))
    d = np.array([scan(ARENA, p, a) for p, a in zip(poses(rng, n), real, strict=True)])
    d += rng.normal(0.0, 0.03, d.shape)
    d[rng.uniform(size=d.shape) < 0.05] = math.inf
    return d


@pytest.mark.parametrize("beams", [181, 361, 720])
@pytest.mark.parametrize("moving", [False, True])
def test_scans_of_a_room_have_the_same_lines_in_both_forms(beams: int, moving: bool) -> None:
    turn = 1.0 if beams == 720 else 0.5  # of the circle
    angles = np.linspace(-math.pi, math.pi, beams, endpoint=False) * turn
    d = seen(angles, 20)
    offsets = np.random.default_rng(1).normal(0.0, 0.01, (*d.shape, 3)) if moving else None
    lines = agree(Scans(d, angles, offsets, 0.0, math.inf), moving=moving)
    assert len(lines.z) > 60
    assert (np.abs(lines.sweep).sum() > 0.0) == moving


@pytest.mark.parametrize("turn", [0.5, 1.0])  # of the circle
def test_scans_of_a_round_room_have_the_same_curves_in_both_forms(turn: float) -> None:
    angles = np.linspace(-math.pi, math.pi, 361, endpoint=False) * turn
    d = 4.0 + np.random.default_rng(2).normal(0.0, 0.03, (40, len(angles)))
    lines = agree(Scans(d, angles, None, 0.0, math.inf))
    assert lines.curved.min() > 3
    assert len(lines.z) < 10


@settings(deadline=None, max_examples=150)
@given(st.data(), st.integers(0, 60), st.integers(0, 3), st.booleans(), st.booleans())
def test_no_scan_makes_either_form_fail_or_differ(
    data: st.DataObject, beams: int, n: int, ring: bool, moving: bool
) -> None:
    numbers = data.draw(st.lists(NUMBERS, min_size=n * beams, max_size=n * beams))
    step = data.draw(st.sampled_from([0.0, 1e-9, math.radians(0.5), 0.1]))
    angles: Array = np.arange(beams, dtype=np.float64) * (2.0 * math.pi / max(beams, 1) if ring else step)
    offsets = None
    if moving:
        few = st.sampled_from([0.0, 0.0, 0.01, -0.02, 1e30, math.nan])
        offsets = np.resize(data.draw(st.lists(few, min_size=7, max_size=7)), (n, beams, 3))
    with np.errstate(all="ignore"):
        agree(
            Scans(np.array(numbers, np.float64).reshape(n, beams), angles, offsets, 0.0, math.inf), moving=moving
        )


@settings(deadline=None, max_examples=80)
@given(
    st.integers(0, 10_000),
    st.sampled_from(
        ["sigma_angle", "min_points", "min_length", "max_gap", "gap_spacings", "bridge", "split_floor"]
    ),
    st.sampled_from([0.0, 1e-6, 1.0, 1e6]),
)
def test_no_setting_makes_either_form_fail_or_differ(seed: int, name: str, value: float) -> None:
    angles = np.linspace(-math.pi, math.pi, 90, endpoint=False)
    d: Array = np.round(seen(angles, 1, seed), 1)  # to 10 cm: many points lie alike
    how = replace(LineSettings(flatness=0.0), **{name: cast("Any", value)})
    agree(Scans(d, angles, None, 0.0, math.inf), how)


@pytest.mark.parametrize("shape", [(0, 361), (3, 0), (3, 1), (3, 2), (0, 0)])
def test_nothing_to_see_is_no_line_in_both_forms(shape: tuple[int, int]) -> None:
    lines = agree(Scans(np.full(shape, 2.0), np.linspace(-1.0, 1.0, shape[1]), np.zeros((*shape, 3)), 0.0, 9.0))
    assert len(lines.z) == 0


def test_a_hundred_thousand_beams_are_the_same_in_both_forms() -> None:
    angles = np.linspace(-math.pi, math.pi, 100_000, endpoint=False)
    d = 2.0 / np.abs(np.cos((angles + math.pi / 4.0) % (math.pi / 2.0) - math.pi / 4.0))  # a square of 4 m
    assert len(agree(Scans(d[None], angles, None, 0.0, math.inf)).z) == 4


# --- which form runs


def words_of(**environment: str) -> str:
    code = "from locfuse.fusion.core.form import form; print(form().words)"
    done = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stdout.strip()


def test_the_source_runs_where_it_is_asked_for() -> None:
    assert words_of(LOCFUSE_CORE="python") == "not compiled: LOCFUSE_CORE=python"


def test_the_version_says_when_the_core_is_not_compiled() -> None:
    for form, said in (("python", True), ("", UNIT is None)):
        done = subprocess.run(
            [sys.executable, "-m", "locfuse", "--version"],
            env={**os.environ, "LOCFUSE_CORE": form},
            capture_output=True,
            text=True,
            check=True,
        )
        assert ("(core not compiled" in done.stdout) == said


def test_a_source_that_was_changed_counts_and_the_compiled_one_does_not(tmp_path: Path) -> None:
    shutil.copytree(CORE, tmp_path / "core")
    unit = cast("ModuleType", SimpleNamespace(SOURCE=forms.fingerprint(tmp_path / "core")))
    assert forms.checked(unit, tmp_path / "core") == (unit, "compiled")
    with (tmp_path / "core" / "fit.py").open("a") as f:
        f.write("\n")
    with pytest.warns(UserWarning, match="older than its source"):
        form = forms.checked(unit, tmp_path / "core")
    assert form.functions is None
    assert form.words.startswith("not compiled: its source has changed")


OBJECTS = re.compile(r"PyFloat_(From|As)Double|PyLong_From|PyNumber_|PyObject_RichCompare")
TRANSLATE = """
import runpy, setuptools
setuptools.setup = lambda **k: None
print(runpy.run_path("setup.py")["translated"]())
"""


def test_no_number_of_the_compiled_core_is_an_object(tmp_path: Path) -> None:
    """Where Cython cannot tell a type it takes an object, silently: 20 times slower (`cython.locals` tells it)."""
    shutil.copytree(CORE, tmp_path / "fusion" / "core", ignore=shutil.ignore_patterns("*.so", "__pycache__"))
    shutil.copy(CORE.parents[1] / "setup.py", tmp_path)
    done = subprocess.run(
        [sys.executable, "-c", TRANSLATE], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    unit = tmp_path / done.stdout.split()[-1]
    source, found, line = unit.with_suffix(".py").read_text(encoding="utf-8").splitlines(), set(), 0
    inside = False
    for text in unit.read_text(encoding="utf-8").splitlines():
        if text.startswith(("static", "}")):
            inside = "__pyx_f_" in text and text.endswith("{") and "unpickle" not in text
        elif at := re.match(r' */\* "locfuse/fusion/core/compiled.py":(\d+)', text):
            line = int(at[1])
        elif inside and OBJECTS.search(text) and not re.search(r"= (floats|wholes)\(", source[line - 1]):
            found.add(source[line - 1].strip())  # room of the caller's own is an object
    assert line > 0
    assert not found
    # no exception ends in a warning on stderr, and a result that is none
    assert not re.findall(r'__Pyx_WriteUnraisable\("(locfuse[^"]*)', unit.read_text(encoding="utf-8"))


@pytest.mark.parametrize("unit", [None, UNIT], ids=["interpreted", "compiled"])
def test_room_that_is_not_to_be_had_is_an_error_in_both_forms(unit: ModuleType | None) -> None:
    def full(n: int) -> Array:
        raise MemoryError(f"no room for {n} numbers")

    angles = np.linspace(-1.5, 1.5, 181)
    room = Room.of(interpreted, unit)
    within = room._replace(functions=SimpleNamespace(extract=partial(_without_room, room.functions.extract, full)))
    with pytest.raises(MemoryError, match="no room for 181 numbers"):
        lines_of(Scans(seen(angles, 1), angles, None, 0.0, math.inf), LineSettings(), None, within)


def _without_room(extract: Any, full: Any, _: Any, *rest: Any) -> Any:
    return extract(full, *rest)


# --- one source, three files


@pytest.mark.parametrize("name", forms.SOURCES)
def test_functions_types_and_stubs_name_the_same_arguments(name: str) -> None:
    def arguments(kind: str) -> dict[str, list[str]]:
        tree = ast.parse((CORE / name).with_suffix(kind).read_text(encoding="utf-8"))
        found = [node for node in tree.body if isinstance(node, ast.FunctionDef)]
        return {f.name: [a.arg for a in f.args.args] for f in found}

    text = (CORE / name).with_suffix(".pxd").read_text(encoding="utf-8")
    types = {
        function: [word.split()[-1] for word in re.split(r",(?![^\[]*\])", given)]
        for function, given in re.findall(r"^cp?def \w+ (\w+)\(([^)]*)\)", text, re.MULTILINE)
    }
    assert arguments(".py") == arguments(".pyi") == types


def test_a_file_of_the_core_uses_those_before_it_only() -> None:
    names: list[str] = []
    for i, name in enumerate(forms.SOURCES):
        tree = ast.parse((CORE / f"{name}.py").read_text(encoding="utf-8"))
        used = {n.module for n in tree.body if isinstance(n, ast.ImportFrom)}
        assert used <= {"math", *forms.SOURCES[:i]}
        names += [n.name for n in tree.body if isinstance(n, ast.FunctionDef)]
    assert len(names) == len(set(names)), "the files become one: a name may stand once"
    written = {path.stem for path in CORE.glob("*.py")} - {"__init__", "form", "room"}
    assert written == set(forms.SOURCES)
