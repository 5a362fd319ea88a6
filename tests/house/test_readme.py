"""Docs are tests: every command the README shows runs, and prints what the page says."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from benchmarks import readme

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
