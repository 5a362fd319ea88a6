"""locfuse on somebody's computer: what is missing is one line with the command that installs it."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
from importlib import metadata
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[2]
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
PROJECT = PYPROJECT["project"]


def python(code: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)


def command(before: str, *words: str) -> subprocess.CompletedProcess[str]:
    return python(f"import sys\n{before}\nfrom locfuse.cli.main import main\nmain({list(words)!r})")


@pytest.mark.parametrize(
    ("module", "package", "words"),
    [
        ("cv2", "opencv-python-headless", ("run", "rounded_triangle", "--sensors", "camera")),
        (
            "jinja2",
            "jinja2",
            ("compare", "rounded_triangle", "--sensors", "odometry", "--write", "html", "--no-advice"),
        ),
        (
            "rerun",
            "rerun-sdk",
            ("run", "rounded_triangle", "--sensors", "odometry", "--rerun-save", "x.rrd", "--no-advice"),
        ),
    ],
)
def test_a_missing_package_is_one_line_with_the_pip_command(
    module: str, package: str, words: tuple[str, ...], tmp_path: Path
) -> None:
    done = command(f"sys.modules[{module!r}] = None", *words, "-o", str(tmp_path / "out"), "-q")
    assert done.returncode == 1, done.stderr
    assert "Traceback" not in done.stderr
    assert f"python -m pip install {package}" in done.stderr.strip().splitlines()[-1]


def test_a_module_of_our_own_that_is_missing_is_a_bug_and_shown_as_one() -> None:
    done = command("sys.modules['locfuse.cli.analysis.compare'] = None", "compare", "rounded_triangle")
    assert "Traceback" in done.stderr


def test_an_old_python_is_one_line() -> None:
    done = python("import sys\nsys.version_info = (3, 10, 2)\nimport locfuse")
    assert done.stderr.splitlines()[-1].endswith("this is 3.10: python3.11 -m pip install locfuse")
    assert PROJECT["requires-python"] == ">=3.11"


def test_import_locfuse_loads_nothing_heavy() -> None:
    code = "import sys, locfuse; print({'numpy', 'cv2', 'rerun', 'rich', 'msgspec', 'click'} & set(sys.modules))"
    assert python(code).stdout.strip() == "set()"


def test_the_metadata_says_what_it_is_and_names_no_person() -> None:
    about = metadata.metadata("locfuse")
    assert about["License-Expression"] == "Apache-2.0 AND CC-BY-SA-4.0"
    assert "Author" not in about
    assert "Author-email" not in about
    assert "Programming Language :: Python :: 3.11" in (about.get_all("Classifier") or [])


def test_the_extra_all_names_only_extras_that_exist() -> None:
    extras = PROJECT["optional-dependencies"]
    named = {n for line in extras["all"] for n in line.partition("[")[2].rstrip("]").split(",") if n}
    assert named <= extras.keys() - {"all"}


LOCKED = re.compile(
    r"^([a-z0-9-]+)==(\S+)(?: ; .*)? \\\n((?:    --hash=sha256:[0-9a-f]{64}(?: \\)?\n)+)", re.MULTILINE
)


@pytest.mark.parametrize("name", ["run", "product", "release"])
def test_a_lock_pins_every_package_with_hashes(name: str) -> None:
    text = (ROOT / ".ci" / "locks" / f"{name}.txt").read_text(encoding="utf-8")
    assert LOCKED.sub("", text) == ""  # no line of another kind


@pytest.mark.parametrize(
    ("name", "groups"), [("run", ("test", "docs")), ("product", ()), ("release", ("release",))]
)
def test_a_lock_holds_what_pyproject_asks_for(name: str, groups: tuple[str, ...]) -> None:
    """A dependency that was added, or whose bounds moved, needs .ci/lock."""
    text = (ROOT / ".ci" / "locks" / f"{name}.txt").read_text(encoding="utf-8")
    pinned: dict[str, set[str]] = {}
    for package, version, _ in LOCKED.findall(text):
        pinned.setdefault(package, set()).add(version)
    extras = PROJECT["optional-dependencies"]
    asked = [] if name == "release" else [*PROJECT["dependencies"], *extras["remote"], *extras["cluster"]]
    waiting = list(groups)
    while waiting:
        for line in PYPROJECT["dependency-groups"][waiting.pop()]:
            if isinstance(line, str):
                asked.append(line)
            else:
                waiting.append(line["include-group"])
    for line in map(Requirement, asked):
        versions = pinned.get(canonicalize_name(line.name), set())
        assert versions, line
        assert all(line.specifier.contains(v) for v in versions), line
