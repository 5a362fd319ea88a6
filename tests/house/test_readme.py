"""Docs are tests: every command the README shows runs, and prints what the page says."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks import readme
from locfuse.cli.main import COMMANDS
from locfuse.fusion.sensors.registry import REGISTRY

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "README.md").read_text()


@pytest.mark.parametrize("name", readme.PAGES)
def test_every_command_on_a_page_prints_what_it_shows(name: str, tmp_path: Path) -> None:
    page = (ROOT / name).read_text(encoding="utf-8")
    assert len(readme.commands("\n".join(readme.BLOCK.findall(page)))) >= 2
    assert readme.replayed(page, tmp_path) == page


@pytest.mark.parametrize("name", readme.PYTHON_PAGES)
def test_the_python_on_a_page_runs_in_order_and_prints_what_it_shows(name: str, tmp_path: Path) -> None:
    page = (ROOT / name).read_text(encoding="utf-8")
    assert len(readme.PYTHON.findall(page)) >= 2
    assert readme.replayed_python(page, tmp_path) == page


def test_the_two_set_up_commands_are_the_ones_ci_uses() -> None:
    assert "python3 -m venv .venv && .venv/bin/pip install -e . && .venv/bin/locfuse compare" in PAGE
    # a fresh environment may hold a pip that knows no groups (before 25.1)
    groups = ".venv/bin/python -m pip install -U pip && .venv/bin/pip install --group test"
    assert f"{groups} && .venv/bin/python -m pytest" in PAGE


@pytest.mark.parametrize("link", sorted(set(re.findall(r"\]\(((?!http)[^)#]+)", PAGE))))
def test_every_link_of_the_readme_leads_somewhere(link: str) -> None:
    assert (ROOT / link).exists(), link


# --- the reference pages say what the code says today


PAGES = ("commands.md", "settings.md", "report_keys.md")


def test_the_reference_pages_are_what_their_command_writes() -> None:
    """In a process of its own: another test may have registered a sensor."""
    command = [sys.executable, "-m", "benchmarks.reference"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (0, ""), done.stderr


def test_every_command_and_every_sensor_has_its_heading() -> None:
    lines = {line for name in PAGES for line in (ROOT / "docs" / name).read_text(encoding="utf-8").splitlines()}
    sensors = {name for name, sensor in REGISTRY.items() if type(sensor).__module__.startswith("locfuse.")}
    assert {f"## {name}" for name in (*COMMANDS, *sensors)} <= lines
