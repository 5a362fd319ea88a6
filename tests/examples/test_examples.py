"""The examples run, and show what they print today."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks.notebook import EXAMPLES, executed, without_figures

ROOT = Path(__file__).parents[2]
NOTEBOOKS = sorted(EXAMPLES.glob("*.ipynb"))


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)
def test_a_notebook_holds_what_its_cells_print_today(path: Path, tmp_path: Path) -> None:
    notebook = json.loads(path.read_text(encoding="utf-8"))
    now = executed(notebook, tmp_path)
    assert without_figures(now) == without_figures(notebook)
    assert any(
        "image/png" in output.get("data", {}) for cell in now["cells"] for output in cell.get("outputs", ())
    )


def test_the_script_tunes_on_one_log_and_gates_on_another(tmp_path: Path) -> None:
    words = ("rounded_triangle", "rounded_triangle", "--sensors", "compass", "-o", str(tmp_path / "tuned.toml"))
    command = [sys.executable, str(EXAMPLES / "tune_and_gate.py"), *words]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode in {0, 4}, done.stderr
    assert (done.returncode == 4) == ("FAILED" in done.stdout)
    assert {line.partition(":")[0] for line in done.stdout.splitlines()} == {
        "position_rmse_m",
        "heading_rmse_deg",
        "anees",
    }
    assert "[compass]" in (tmp_path / "tuned.toml").read_text()


def test_every_example_has_a_line_on_the_page_about_python() -> None:
    page = (ROOT / "docs" / "python.md").read_text(encoding="utf-8")
    assert [p.name for p in EXAMPLES.iterdir() if p.is_file() and p.name not in page] == []
