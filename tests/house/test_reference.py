"""The reference pages say what the code says today."""

from __future__ import annotations

import pytest

from benchmarks.reference import DOCS, PAGES
from locfuse.cli.main import COMMANDS
from locfuse.fusion.sensors.registry import REGISTRY


@pytest.mark.parametrize("name", PAGES)
def test_a_reference_page_is_what_the_command_writes(name: str) -> None:
    written = (DOCS / name).read_text(encoding="utf-8")
    assert PAGES[name]() == written, "renew it with: python -m benchmarks.reference --write"


def test_every_command_and_every_sensor_has_its_heading() -> None:
    headings = {line for name in PAGES for line in (DOCS / name).read_text(encoding="utf-8").splitlines()}
    assert {f"## {name}" for name in (*COMMANDS, *REGISTRY)} <= headings
