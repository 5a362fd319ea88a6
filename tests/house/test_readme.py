"""Docs are tests: every command the README shows runs, and prints what the page says."""

from __future__ import annotations

import contextlib
import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import locfuse, ok

from benchmarks import readme
from locfuse.cli.main import COMMANDS
from locfuse.fusion.data import ArrayStream
from locfuse.fusion.sensors.registry import REGISTRY, SOURCES, register_installed

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


# --- the page on a first sensor: its package, typed in as it stands and installed, is a sensor


FIRST_PAGE = (Path(__file__).parents[2] / "docs" / "first_sensor.md").read_text(encoding="utf-8")
(PYPROJECT,) = re.findall(r"```toml\n(.*?)```", FIRST_PAGE, re.DOTALL)
MAKE_LOG, SENSOR, READINGS = re.findall(r"```python\n(.*?)```", FIRST_PAGE, re.DOTALL)


def test_its_log_and_its_sensor_give_a_verdict_and_its_noise(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "pyproject.toml").write_text(PYPROJECT)
    (tmp_path / "locfuse_cable.py").write_text(SENSOR)
    words = ("install", "-q", "--no-deps", "--no-build-isolation", "--target", tmp_path / "installed", tmp_path)
    subprocess.run([sys.executable, "-m", "pip", *map(str, words)], check=True)
    monkeypatch.syspath_prepend(tmp_path / "installed")
    register_installed()
    try:
        _has_a_verdict_and_its_noise(tmp_path)
        assert SOURCES["cable"] == "package locfuse-cable 0.1 (locfuse_cable:Cable)"
    finally:
        del REGISTRY["cable"], SOURCES["cable"]


def _has_a_verdict_and_its_noise(tmp_path: Path) -> None:
    with contextlib.chdir(tmp_path):
        exec(compile(MAKE_LOG, "make_log.py", "exec"), {})
    log, post = tmp_path / "cable.mcap", ("--set", "cable.post=[4, 2]")
    words = ("--sensors", "odometry", "--sensors", "cable", "--write", "json", "-o", tmp_path / "out")
    ok("compare", log, *post, *words)
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    rows = report["configurations"]
    assert rows["cable"]["position_rmse_m"] < 0.5 * rows["odometry"]["position_rmse_m"]
    assert report["settings"]["cable"]["sigma"] == 0.05
    assert 0.5 < rows["cable"]["sensors"]["cable"]["consistency"]["scale"] < 0.7  # 3 cm are true, 5 are set
    assert "cable.post is not set" in locfuse("info", log).stdout


def test_its_readings_for_the_contract_are_lengths() -> None:
    typed: dict[str, Any] = {"np": np, "ArrayStream": ArrayStream}
    exec(compile(READINGS, "six_sensors.py", "exec"), typed)
    fields = {"pose.position.x": np.array([4.0, 7.0]), "pose.position.y": np.array([2.0, 6.0])}
    stream = typed["cable"](ArrayStream("/truth", "geometry_msgs/msg/PoseStamped", np.array([0, 1]), fields))
    assert stream.columns("data")["data"].tolist() == [0.0, 5.0]
