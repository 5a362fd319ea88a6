"""The reference pages say what the code says today."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from locfuse.cli.main import COMMANDS
from locfuse.fusion.sensors.registry import REGISTRY

ROOT = Path(__file__).parents[2]
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
