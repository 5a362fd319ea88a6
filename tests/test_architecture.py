"""Who may import whom: data flows one way, and physics and estimator must not share a bug."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
FOLDERS = ("cli", "fusion", "formats", "sample_logs")
STANDARD = set(sys.stdlib_module_names)
LAZY = {"rerun", "matplotlib", "scipy", "jinja2"}  # only inside the function that needs them

# what each folder may import besides itself and the standard library
OURS = {
    "cli": {"fusion", "formats", "sample_logs"},
    "fusion": set(),
    "formats": {"fusion.data"},
    "sample_logs": {"formats", "fusion.se2", "fusion.data"},
}
OTHERS = {
    "fusion": {"numpy", "msgspec", "cv2", "scipy"},
    "sample_logs": {"numpy", "msgspec", "cv2", "tomli_w"},
}


def files(folder: str) -> list[Path]:
    return sorted((ROOT / folder).rglob("*.py"))


def imports(path: Path) -> Iterator[tuple[str, bool]]:
    """Yield (module as "fusion.data" or "numpy", whether it is imported at module level)."""
    package = path.relative_to(ROOT).with_suffix("").parts[:-1]
    tree = ast.parse(path.read_text())
    deferred = (ast.FunctionDef, ast.ClassDef)
    now = [n for n in tree.body if not isinstance(n, deferred) and not types_only(n)]
    top = set(ast.walk(ast.Module(now, [])))
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield alias.name.removeprefix("locfuse."), node in top
        elif isinstance(node, ast.ImportFrom):
            base = ".".join(package[: len(package) - node.level + 1]) if node.level else ""
            module = ".".join(p for p in (base, node.module or "") if p).removeprefix("locfuse.")
            whole = module in FOLDERS  # `from ..fusion import se2` imports a module, not a name
            names = [f"{module}.{a.name}" for a in node.names] if whole else [module]
            for name in names:
                yield name, node in top


def types_only(node: ast.stmt) -> bool:
    """Tell `if TYPE_CHECKING:`, whose imports never run."""
    return isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING"


ALL = [pytest.param(f, path, id=str(path.relative_to(ROOT))) for f in FOLDERS for path in files(f)]


@pytest.mark.parametrize(("folder", "path"), ALL)
def test_imports_follow_the_one_way_flow(folder: str, path: Path) -> None:
    for module, top in imports(path):
        root = module.split(".")[0]
        if root in FOLDERS and root != folder:
            allowed = OURS[folder]
            assert any(module == a or module.startswith(a + ".") for a in allowed), f"{path} imports {module}"
        elif root not in FOLDERS and root not in STANDARD and folder in OTHERS:
            assert root in OTHERS[folder], f"{path} imports {module}"
        if top:
            assert root not in LAZY, f"{path} imports {root} at module level"


def test_only_the_camera_imports_opencv_in_fusion() -> None:
    users = {path.stem for path in files("fusion") for module, _ in imports(path) if module.split(".")[0] == "cv2"}
    assert users <= {"cv", "panorama", "images", "camera", "radial", "optics"}, users


def test_help_imports_neither_numpy_nor_opencv_nor_rerun() -> None:
    code = (
        "import sys\n"
        "from locfuse.cli.main import main\n"
        "try:\n    main(['--help'])\nexcept SystemExit as e:\n    assert e.code == 0\n"
        "heavy = {'numpy', 'cv2', 'rerun', 'rich', 'msgspec', 'mcap', 'rosbags'} & set(sys.modules)\n"
        "assert not heavy, heavy\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "compare" in done.stdout
