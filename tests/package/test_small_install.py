"""The small install of docs/install.md: what its one line installs is enough for gates."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

from rewrite_log import rewritten

PAGE = (Path(__file__).parents[2] / "docs" / "install.md").read_text(encoding="utf-8")
HIDE = """
import importlib.abc, re, sys
from importlib.metadata import packages_distributions

installed, owners = set({installed!r}), packages_distributions()
plain = lambda name: re.sub("[-_.]+", "-", name).lower()


class Hidden(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        mine = owners.get(name.partition(".")[0], [])
        if mine and not any(plain(owner) in installed for owner in mine):
            raise ModuleNotFoundError("not installed: " + name, name=name)


sys.meta_path.insert(0, Hidden())
from locfuse.cli.main import main
main({words!r})
"""


def run(*words: str) -> subprocess.CompletedProcess[str]:
    found = re.search(r"pip install --no-deps (.+)", PAGE)
    assert found is not None
    installed = [re.sub("[-_.]+", "-", name).lower() for name in found[1].split()]
    code = HIDE.format(installed=installed, words=list(words))
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)


def test_a_comparison_with_gates_needs_nothing_else(tmp_path: Path) -> None:
    log = rewritten(tmp_path / "log.mcap", None, "/omni/image/compressed", "rounded_triangle")
    out = tmp_path / "out"
    gates = ("--fail-if", "all.position_rmse_m > 0.5", "--write", "json,md", "-o", str(out))
    done = run("compare", str(log), "--sensors", "all", "--sensors", "compass", *gates)
    assert done.returncode == 0, done.stderr
    assert "all" in json.loads((out / "report.json").read_text())["configurations"]


def test_what_it_lacks_is_said_with_the_pip_command(tmp_path: Path) -> None:
    done = run("compare", "rounded_triangle", "--sensors", "odometry", "-o", str(tmp_path / "out"))
    assert done.returncode == 1
    assert "python -m pip install" in done.stderr.splitlines()[-1]
    assert "Traceback" not in done.stderr
