"""`import locfuse`: light, complete, and useful to who types `locfuse.<TAB>` or help()."""

import ast
import inspect
import pydoc
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import pytest

import locfuse
from locfuse.cli.session.session import Session

SOURCE = Path(__file__).parents[2] / "cli" / "facade" / "__init__.py"
FUNCTIONS = ("compare", "evaluate", "fuse", "info", "load", "open_log", "simulate", "smooth")


NOTHING_HEAVY = (
    "import sys, locfuse\n"
    "heavy = {'numpy', 'cv2', 'rerun', 'rich', 'msgspec', 'mcap', 'rosbags', 'click'} & set(sys.modules)\n"
    "assert not heavy, heavy\n"
    "locfuse.load\n"
    "assert 'numpy' in sys.modules and not {'rerun', 'rich', 'click', 'matplotlib'} & set(sys.modules)\n"
)
LITTLE_MORE_THAN_CLICK = (
    "import sys, click\n"
    "alone = len(sys.modules)\n"
    "from locfuse.cli.main import main\n"
    "try:\n    main(['--help'])\nexcept SystemExit as e:\n    assert e.code == 0\n"
    "assert len(sys.modules) < 1.5 * alone, sorted(sys.modules)\n"
)


@pytest.mark.parametrize("code", [NOTHING_HEAVY, LITTLE_MORE_THAN_CLICK], ids=["import", "help"])
def test_the_import_and_the_help_load_little(code: str) -> None:
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_what_types_see_is_what_there_is() -> None:
    tree = ast.parse(SOURCE.read_text(encoding="utf-8"))
    (typed,) = (n for n in tree.body if isinstance(n, ast.If) and ast.unparse(n.test) == "TYPE_CHECKING")
    names = {a.name for n in typed.body if isinstance(n, ast.ImportFrom) for a in n.names}
    assert {*names, "__version__"} == set(locfuse.__all__)
    assert locfuse.__all__ == sorted(locfuse.__all__)
    for name in locfuse.__all__:
        assert getattr(locfuse, name) is not None


def test_tab_offers_the_public_names_before_any_is_used() -> None:
    code = "import locfuse; print(*dir(locfuse))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert {n for n in done.stdout.split() if not n.startswith("__")} == set(locfuse.__all__) - {"__version__"}


def test_an_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="no attribute 'fusee'"):
        getattr(locfuse, "fusee")  # noqa: B009 - mypy would refuse the plain form


@pytest.mark.parametrize("name", FUNCTIONS)
def test_help_says_what_a_call_takes_gives_and_raises(name: str) -> None:
    function = getattr(locfuse, name)
    text = pydoc.plain(pydoc.render_doc(function))
    words = {p for p in inspect.signature(function).parameters if p not in {"logs", "log", "drive", "estimates"}}
    assert all(f"{word}:" in text for word in words)
    assert "LocfuseError" in text or name == "evaluate"


def test_every_public_method_is_documented_and_every_function_is_listed() -> None:
    for kind in (Session, locfuse.Run, locfuse.Comparison, locfuse.Summary):
        for name, member in inspect.getmembers(kind):
            if not name.startswith("_") and (callable(member) or isinstance(member, property)):
                assert inspect.getdoc(member), f"{kind.__name__}.{name}"
    text = pydoc.plain(pydoc.render_doc(locfuse))
    assert all(f"\n    {name}(" in text for name in FUNCTIONS)


def test_the_package_runs_as_a_program_and_says_its_version() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "locfuse", "--version"], capture_output=True, text=True, check=True
    )
    assert locfuse.__version__ == version("locfuse")
    assert locfuse.__version__ in done.stdout
