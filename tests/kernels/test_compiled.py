"""What the C of the kernels must not do, and how a process says that its kernels are interpreted."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from interpreted import KERNELS

from locfuse.fusion.kernels.built import INTERPRETED, how

NAMES = sorted(path.stem for path in KERNELS.glob("*.pxd"))
OBJECTS = re.compile(r"PyFloat_(From|As)Double|PyLong_From|PyNumber_|PyObject_RichCompare")
MADE = r"\s*def |.*[A-Z]\w+\("  # how Python calls a method, and records that are made, are of objects
# what these take or give are Python's own: tuples of a sensor, more room, a pose
METHODS = "compare|write_row|replace|listed|variance|of|noise_of|pose|pose_in_map|located|room_for|judge"
METHODS += "|correct_queued|state_rows"
BORDER = re.compile(rf"_({METHODS})\(")
TRANSLATE = """
import runpy, setuptools, sys
setuptools.setup = lambda **k: None
build = runpy.run_path("setup.py")
print(build["translated"](build["mirrored"]() / f"{sys.argv[1]}.py"))
"""


@pytest.fixture(scope="module")
def sources(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The kernels' sources and setup.py, without what was built."""
    folder = tmp_path_factory.mktemp("kernels")
    built = shutil.ignore_patterns("*.so", "*.pyd", "__pycache__")
    shutil.copytree(KERNELS.parent, folder / "fusion", ignore=built)
    shutil.copy(KERNELS.parents[1] / "setup.py", folder)
    return folder


@pytest.mark.parametrize("name", NAMES)
def test_no_number_of_a_compiled_kernel_is_an_object(name: str, sources: Path) -> None:
    """Where Cython cannot tell a type it takes an object, silently: 20 times slower (`cython.locals` tells it)."""
    pytest.importorskip("Cython")
    code = subprocess.run(
        [sys.executable, "-c", TRANSLATE, name], cwd=sources, capture_output=True, text=True, check=True
    )
    text = (sources / code.stdout.split()[-1]).read_text(encoding="utf-8")
    source = re.escape(f'"locfuse/fusion/kernels/{name}.py"')
    lines = (KERNELS / f"{name}.py").read_text(encoding="utf-8").splitlines()
    line, inside, found = 0, False, set()
    for row in text.splitlines():
        if row.startswith(("static", "}")):
            inside = "__pyx_f_" in row and row.endswith("{") and "unpickle" not in row and not BORDER.search(row)
        elif at := re.match(rf" */\* {source}:(\d+)", row):
            line = int(at[1])
        elif inside and OBJECTS.search(row) and not re.match(MADE, lines[line - 1]):
            found.add(lines[line - 1].strip())
    assert line > 0
    assert not found, found
    # no exception ends in a warning on stderr, and a result that is none; methods only look for one of a subclass
    assert not re.findall(r'__Pyx_WriteUnraisable\("(locfuse\.fusion\.kernels\.\w+\.[a-z]\w*)"', text)


def test_without_a_compiled_kernel_the_version_says_that_it_is_slower(sources: Path) -> None:
    """Asked of a copy that has no extension, and of the command itself."""
    folder = sources / "fusion" / "kernels"
    code = f"import sys; sys.path.insert(0, {str(folder.parent)!r}); from kernels.built import how; print(how())"
    assert run("-c", code) == INTERPRETED
    assert run("-m", "locfuse", "--version").endswith(f"(kernels {INTERPRETED})") == (how() == INTERPRETED)


def run(*arguments: str) -> str:
    done = subprocess.run([sys.executable, *arguments], capture_output=True, text=True, check=True)
    return done.stdout.strip()
