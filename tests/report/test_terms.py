"""Every word of a table has an explanation that a user can ask for."""

from __future__ import annotations

import pytest
from commands import locfuse

from locfuse.formats.report.findings import notes_of
from locfuse.formats.report.glossary import GLOSSARY, explained
from locfuse.formats.report.tables import COUNTS, MAIN


@pytest.mark.parametrize("heading", [(c.brief or c.heading).split("/")[0].strip() for c in (*MAIN, *COUNTS)])
def test_every_column_of_the_terminals_tables_is_explained(heading: str) -> None:
    done = locfuse("explain", heading)
    assert done.exit_code == 0, done.stderr
    assert done.stdout.strip() == explained(heading)


def test_an_unknown_term_names_the_nearest() -> None:
    done = locfuse("explain", "ANESE")
    assert done.exit_code == 2
    assert "ANEES" in done.stderr


def test_without_a_term_all_are_listed() -> None:
    assert all(f"{term}: " in locfuse("explain").stdout for term in GLOSSARY)


def test_a_number_of_another_configuration_keeps_its_sign() -> None:
    """-88.5 beside -88.8 is not -88.5 beside 88.8; of a span the second number has no sign."""
    runs = {
        name: {"notes": [f"gps: east lies {east} deg off, at 30-40 s"]}
        for name, east in (("gps", -88.5), ("all", -88.8))
    }
    (note,) = notes_of({"notes": [], "configurations": runs})
    assert note == "gps: east lies -88.5 (all: -88.8) deg off, at 30-40 s"
